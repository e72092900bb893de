"""`telenano bag rerun`: a node run once more on the inputs of its journal, its outputs compared.

A node writes down in which order it took its messages and deadlines, and what state it was in (`node/journal`,
ADR 0012). The re-run builds the node, puts it into that state, and repeats the turns one by one. The keys that were
recorded are compared: an optional key that a node has learned to say since leaves older recordings equal. What the link
sends on beside that is compared with what came out of it at either site (ADR 0019).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

import zmq
from pydantic import BaseModel

from analysis.forwarded import Forwarded, compare_forwarded
from analysis.plugins import differences, recorded_plugins
from proto import TOPICS, Message, encode
from proto.errors import ConfigError, RecordingError, TelenanoError, known_names
from proto.journal_messages import NodeJournal
from proto.messages import SessionControl
from proto.nodes import LINK, RERUN_NODES, endpoints_of, name_of, no_rerun_reason, site_of
from proto.ranges import limited
from proto.sequence import Arrival
from proto.topics import output_name
from recording.messages import RecordedChannel, RecordedMessage
from recording.reader import Recording
from recording.records import REJECTED_TOPIC, RejectedRecord
from recording.tolerance import Tolerances, first_difference
from services.runtime.bus.address_book import AddressBook
from services.runtime.bus.bus import Received, Subscriber, ZmqBus
from services.runtime.bus.publisher import Publisher, ZmqPublisher
from services.runtime.bus.reader import Reader
from services.runtime.loop.clock import TurnClock
from services.runtime.loop.journal import COMMAND, DEADLINE, DEFERRED, MESSAGE
from services.runtime.loop.log import StructuredLog
from services.runtime.loop.main import Wiring, node_kind
from services.runtime.loop.node import Node
from services.runtime.loop.node_state import is_whole, restore
from services.runtime.settings.config import flag_overrides, merge, parse_yaml, validate
from services.runtime.settings.scenario import LoadedScenario, Scenario

JOURNAL = "node/journal"
# the loop around the node publishes on these too, with the same numbering: they are not compared
_NOT_COMPARED = (JOURNAL, "node/health", "session/event", "link/key", "link/network")
# the first parts of a journal may name inputs from before the recording began; later ones have to be complete
_LATEST_START_NS = 1_500_000_000
# publishers start one after the other, and the recorder may be connected to each a moment after the node
_LATEST_JOIN_NS = 30_000_000_000


class RerunResult(BaseModel):
    """What came of a re-run.

    `compared` counts recorded outputs met, by topic, with `@site` for what a link sent on there; `first_seq` is the
    number of the first of them. `left_out` counts
    recorded outputs that were not compared, because the journal or an input from before the first or after the last
    compared turn is not in the recording. `difference` describes the first difference, and is empty when there is
    none; `topic`, `seq`, `time_s` (since the start of the recording) and `field` are its place. `ended_early` is the
    reason why the comparison ended before the journal did; `packages` says which of other packages is not as recorded.
    """

    node: str
    compared: dict[str, int]
    first_seq: dict[str, int]
    left_out: int
    identical: bool
    difference: str = ""
    topic: str = ""
    seq: int = -1
    time_s: float = 0.0
    field: str = ""
    ended_early: str = ""
    packages: list[str] = []

    def verdict(self) -> str:
        """Return the outcome as a sentence."""
        counts = ", ".join(f"{count} {topic}" for topic, count in self.compared.items()) or "nothing"
        outside = f"; {self.left_out} outside of what the journal and the recorded inputs cover" * (self.left_out > 0)
        if self.difference:
            changed = "".join(f"; {text}" for text in self.packages)
            return f"differs after {counts}: {self.difference}{changed}"
        if self.ended_early:
            return f"the same as far as it could be compared ({counts}): {self.ended_early}"
        return f"the same in every message: {counts}{outside}" if self.identical else "nothing could be compared"


def rerun(
    recording: Recording,
    key: str,
    tolerances: Tolerances | None = None,
    settings: Sequence[str] = (),
    take: Callable[[str, Message], None] = lambda topic, message: None,
) -> RerunResult:
    """Run a node on its recorded inputs and compare its outputs with the recorded ones.

    Args:
        recording: The recording that has the inputs.
        key: The node, as node@site.
        tolerances: The tolerances by field; None compares exactly.
        settings: Settings over the recorded scenario, as `section.key=value`.
        take: Called with the topic and the message of each output that was compared.

    Raises:
        ConfigError: The node is not one that can be re-run, or the scenario is wrong.
        RecordingError: The recording lacks the scenario, the journal or the inputs of the node.
    """
    if reason := no_rerun_reason(key):
        raise ConfigError(f"node {key}: cannot be run again: {reason}; {known_names(key, RERUN_NODES)}")
    batches, states = _journal(recording, key)
    if not batches:
        raise RecordingError(
            f"{recording.path}: has no {JOURNAL} of {key}, which a re-run follows: it was recorded without that topic; "
            "it can still be read, replayed, compared and plotted"
        )
    recorded = _Recorded(recording, key, batches)
    begun = _begin(recorded, batches, states)
    clock = TurnClock(_start_ns(batches[begun]), batches[begun].epoch_offset_ns)
    bus = RerunBus(key, clock, recorded, tolerances or Tolerances(), take)
    packages = _packages(recording, key)
    node = _build(recording, key, clock, bus, settings)
    restore(node, states[begun], recorded.payload)
    bus.numbers = dict(batches[begun].outputs)
    facts: dict[str, Any] = {}
    try:
        for earlier, batch in zip((None, *batches[begun:]), batches[begun:], strict=False):
            if earlier is not None:
                _follows(earlier, batch)
                bus.check_counts(batch)
                node.context.deferred.forget_unneeded()
            for turn in _turns(batch):
                _take_turn(node, clock, turn, recorded)
    except _DifferenceError as error:
        facts = error.facts
    except _EndError as error:
        facts = {"ended_early": str(error)}
    if "difference" not in facts:
        facts |= bus.compare_forwarded()
    total = sum(map(len, recorded.outputs.values())) + sum(map(len, recorded.forwarded.values()))
    compared = {topic: count for topic, count in bus.compared.items() if count}
    return RerunResult(
        node=key,
        compared=compared,
        first_seq=bus.first_seq,
        left_out=0 if "difference" in facts else total - sum(compared.values()),
        identical=not facts and bool(compared),
        packages=packages,
        **facts,
    )


def _journal(recording: Recording, key: str) -> tuple[list[NodeJournal], list[bytes]]:
    """Return the batches of a node's journal, and the state that each begins with, put together of its messages."""
    batches: list[NodeJournal] = []
    pieces: list[list[bytes]] = []
    for found in recording.messages([JOURNAL]):
        if found.src == key:
            message = cast(NodeJournal, found.decode())
            if message.kind.data:
                batches.append(message)
                pieces.append([message.state.data])
            elif batches and message.first_turn == batches[-1].first_turn:
                pieces[-1].append(message.state.data)
    return batches, list(map(b"".join, pieces))


def _packages(recording: Recording, key: str) -> list[str]:
    """Return what is not as recorded of the packages that a node used; ConfigError where one is not installed."""
    document = parse_yaml(recording.attachments.get("scenario.yaml", b"{}"), f"scenario.yaml in {recording.path}")
    section = name_of(key)
    return differences(recorded_plugins(recording, {section: document.get(section, {})}))


class Turn(NamedTuple):
    """A line of the journal: topic and source are empty and seq is -1 for a deadline or a deferred task."""

    kind: int
    time_ns: int
    topic: str
    src: str
    seq: int


class _DifferenceError(Exception):
    """The node publishes something else than what is recorded."""

    def __init__(self, **facts: Any) -> None:
        super().__init__(facts["difference"])
        self.facts = facts


class _EndError(Exception):
    """The recording lacks what would be needed to go on; the text names it."""


class _Recorded:
    """The recorded inputs and outputs of one node, by number."""

    def __init__(self, recording: Recording, key: str, batches: Sequence[NodeJournal]) -> None:
        self.path, self.key = recording.path, key
        self.start_ns = recording.span_ns[0]
        self.outputs: dict[tuple[str, int], list[RecordedMessage]] = {}
        # The messages that were forwarded, by endpoint.
        self.forwarded: dict[str, list[Forwarded]] = {}
        self._inputs: dict[tuple[str, str, int], list[RecordedMessage]] = {}
        # when the recorder first received from a source
        self._first_received_ns: dict[tuple[str, str], int] = {}
        sources = {(source.topic, source.src) for batch in batches for source in batch.inputs}
        endpoints, is_link = endpoints_of(key), name_of(key) == LINK

        def is_input(channel: RecordedChannel) -> bool:
            # the link is connected to the publishers of both sites
            received = channel.via == "direct" if is_link else channel.site == site_of(key)
            return received and (channel.topic, channel.src) in sources

        def is_output(channel: RecordedChannel) -> bool:
            return channel.src in endpoints and channel.via == "direct" and channel.topic not in _NOT_COMPARED

        def is_forwarded(channel: RecordedChannel) -> bool:
            return is_link and (channel.via == "link" or channel.topic == REJECTED_TOPIC)

        inputs, outputs, forwarded = (
            {channel for channel in recording.channels if wanted(channel)}
            for wanted in (is_input, is_output, is_forwarded)
        )
        for found in recording.select((inputs | outputs | forwarded).__contains__):
            channel = found.channel
            if channel in inputs:
                self._inputs.setdefault((channel.topic, channel.src, found.seq), []).append(found)
                self._first_received_ns.setdefault((channel.topic, channel.src), found.log_ns)
            if channel in outputs:
                self.outputs.setdefault((output_name(channel.topic, found.src), found.seq), []).append(found)
            if channel in forwarded:
                self._add_forwarded(found)

    def _add_forwarded(self, found: RecordedMessage) -> None:
        endpoint, topic, payload = f"{LINK}@{found.site}", found.topic, found.payload
        if topic == REJECTED_TOPIC:
            # Flipped bits have left this message without a header.
            rejected = cast(RejectedRecord, found.decode())
            if name_of(rejected.publisher) != LINK or len(rejected.frames) != 2:
                return
            endpoint, (frame, payload) = rejected.publisher, rejected.frames
            topic = frame.decode(errors="replace")
        self.forwarded.setdefault(endpoint, []).append(Forwarded(topic, payload, found.log_ns))

    def input(self, turn: Turn) -> RecordedMessage | None:
        """Return the message of a turn; of those with one number, from before and after a restart, the nearest."""
        found = self._inputs.get((turn.topic, turn.src, turn.seq), ())
        if len(found) == 1:
            return found[0]
        return min(found, key=lambda message: abs(message.log_ns - turn.time_ns), default=None)

    def payload(self, topic: str, src: str, seq: int, arrived_ns: int, size_bytes: int) -> bytes:
        """Return the bytes of an input, zeros when it is not in the recording."""
        found = self.input(Turn(MESSAGE, arrived_ns, topic, src, seq))
        return bytes(size_bytes) if found is None else found.payload

    def output(self, name: str, seq: int, time_ns: int) -> RecordedMessage | None:
        """Return what the node published under a name and number."""
        found = self.outputs.get((name, seq), ())
        if len(found) == 1:
            return found[0]
        return min(found, key=lambda message: abs(message.publish_ns - time_ns), default=None)

    def missing(self, batch: NodeJournal) -> str:
        """Name the first input of a batch that is not there; empty when all are."""
        found = next(self._missing(batch), None)
        return "" if found is None else f"{found.topic}, seq {found.seq} of {found.src}"

    def is_early(self, batch: NodeJournal) -> bool:
        """Return whether a batch has an input from before the recorder was connected to its publisher."""
        missing = ((turn.time_ns, self._first_received_ns.get((turn.topic, turn.src))) for turn in self._missing(batch))
        return any(first_ns is not None and time_ns < first_ns for time_ns, first_ns in missing)

    def _missing(self, batch: NodeJournal) -> Iterator[Turn]:
        return (turn for turn in _turns(batch) if turn.src and self.input(turn) is None)


class RerunBus:
    """A bus that compares what a node publishes with the recorded message of the same number."""

    def __init__(
        self,
        key: str,
        clock: TurnClock,
        recorded: _Recorded,
        tolerances: Tolerances,
        take: Callable[[str, Message], None],
    ) -> None:
        self.numbers: dict[str, int] = {}
        self.compared: dict[str, int] = {}
        self.first_seq: dict[str, int] = {}
        self._forwarded: dict[str, list[Forwarded]] = {}
        self._key = key
        self._clock = clock
        self._recorded = recorded
        self._tolerances = tolerances
        self._take = take

    def publish(self, topic: str, **fields: Any) -> Message:
        """Compare a message of the node."""
        return self.publish_as(self._key, topic, fields)

    def publish_as(self, src: str, topic: str, fields: Mapping[str, Any]) -> Message:
        """Compare a message of one of the node's endpoints; its `t_ns`, the time of sending, is the recorded one."""
        name, model = output_name(topic, src), TOPICS[topic].model
        seq = self.numbers.get(name, 0)
        self.numbers[name] = seq + 1
        recorded = None if topic in _NOT_COMPARED else self._recorded.output(name, seq, self._clock.time_ns)
        t_ns = self._clock.time_ns if recorded is None else recorded.publish_ns
        message = limited(model, {"seq": seq, "t_ns": t_ns, "src": src, "v": model.version_of(fields), **fields})
        if recorded is not None:
            self._compare(message, recorded)
            self.compared[name] = self.compared.get(name, 0) + 1
            self.first_seq.setdefault(name, seq)
            self._take(topic, message)
        return message

    def forward(self, endpoint: str, topic: str, payload: bytes) -> None:
        """Keep a message that was sent on, for the comparison at the end."""
        self.numbers[endpoint] = self.numbers.get(endpoint, 0) + 1
        self._forwarded.setdefault(endpoint, []).append(Forwarded(topic, payload, self._clock.time_ns))

    def compare_forwarded(self) -> dict[str, Any]:
        """Compare what was sent on, in its order; return the facts of the first difference."""
        for endpoint, sent in self._forwarded.items():
            found = compare_forwarded(sent, self._recorded.forwarded.get(endpoint, ()))
            for topic, count in found.compared.items():
                name = f"{topic}@{site_of(endpoint)}"
                self.compared[name], self.first_seq[name] = count, found.first_seq[topic]
            if found.difference:
                message = sent[found.place]
                text = f"forwarded at {endpoint}: {found.difference}"
                return self._difference(message.topic, message.number[0], message.time_ns, found.field, text).facts
        return {}

    def receive(self) -> Iterator[Received]:
        """Return nothing: the re-run hands the messages over itself."""
        return iter(())

    def wait(self, deadline_ns: int) -> None:
        """Do not wait."""

    def check_counts(self, batch: NodeJournal) -> None:
        """Raise the difference when the node has sent more or fewer messages than before this batch it had."""
        for topic in {*self.numbers, *batch.outputs} - set(_NOT_COMPARED):
            sent, expected = self.numbers.get(topic, 0), batch.outputs.get(topic, 0)
            if sent != expected:
                text = f"the node sends {sent} messages up to here, its journal counts {expected}"
                raise self._difference(topic, min(sent, expected), int(batch.time_ns.to_numpy()[0]), "", text)

    def _compare(self, message: Message, recorded: RecordedMessage) -> None:
        if encode(message) == recorded.payload:
            return
        topic, said, kept = recorded.topic, message.model_dump(), recorded.decode().model_dump()
        found = first_difference(said, kept, self._tolerances.on(topic), _said_since(message, kept))
        if found is not None:
            text = f"re-run {found.text} recorded"
            raise self._difference(topic, message.seq, recorded.publish_ns, found.field, text)

    def _difference(self, topic: str, seq: int, t_ns: int, field: str, text: str) -> _DifferenceError:
        time_s = (t_ns - self._recorded.start_ns) * 1e-9
        place = f"{topic}, seq {seq}, {time_s:.6f} s after the start"
        return _DifferenceError(difference=f"{place}: {text}", topic=topic, seq=seq, time_s=time_s, field=field)


class RerunOutlet:
    """A further endpoint of a node, where it publishes and sends on what others published."""

    def __init__(self, bus: RerunBus, endpoint: str) -> None:
        self.node = endpoint
        self._bus = bus

    def publish(self, topic: str, **fields: Any) -> Message:
        """Compare a message of the endpoint."""
        return self._bus.publish_as(self.node, topic, fields)

    def send(self, topic: str, payload: bytes) -> None:
        """Keep what is sent on for the comparison."""
        self._bus.forward(self.node, topic, payload)

    def sequence_numbers(self) -> dict[str, int]:
        """Return nothing: the numbers are those of the bus of the re-run."""
        return {}


def _said_since(message: Message, kept: Mapping[str, Any]) -> set[str]:
    """Return what a message may have that a recording of before does not: optional keys, and a higher version."""
    since = {key for key in message.additions if key not in kept}
    return since | {"v"} if message.v > kept["v"] else since


def _begin(recorded: _Recorded, batches: Sequence[NodeJournal], states: Sequence[bytes]) -> int:
    """Return the batch that a re-run begins with: the first with a whole state and all inputs.

    While the rig starts, inputs from before the recorder was connected to their publisher may be missing, and others in
    a batch or two after the last of those. Raises RecordingError when no such batch is whole.
    """
    starting = [batch for batch in batches if _start_ns(batch) - _start_ns(batches[0]) <= _LATEST_JOIN_NS]
    first = 1 + max((place for place, batch in enumerate(starting) if recorded.is_early(batch)), default=-1)
    # a large state is captured every few seconds
    begins = [place for place in range(first, len(batches)) if is_whole(states[place])]
    for place in begins:
        if _start_ns(batches[place]) - _start_ns(batches[begins[0]]) > _LATEST_START_NS:
            break
        if not recorded.missing(batches[place]):
            return place
    missing = next((found for found in map(recorded.missing, batches) if found), "the node's state")
    raise RecordingError(
        f"{recorded.path}: has no part of the journal of {recorded.key} with all inputs: lacks {missing}"
    )


def _start_ns(batch: NodeJournal) -> int:
    return int(batch.time_ns.to_numpy()[0])


def _turns(batch: NodeJournal) -> Iterator[Turn]:
    arrays = (batch.kind, batch.time_ns, batch.input, batch.number)
    for kind, time_ns, place, seq in zip(*(found.to_numpy().tolist() for found in arrays), strict=True):
        source = batch.inputs[place] if kind in (MESSAGE, COMMAND) else None
        yield Turn(kind, time_ns, source.topic if source else "", source.src if source else "", seq)


def _follows(earlier: NodeJournal, batch: NodeJournal) -> None:
    expected = earlier.first_turn + len(earlier.kind.data)
    if batch.first_turn < expected:
        raise _EndError("the node was started again")
    if batch.first_turn > expected:
        raise _EndError(f"the recording lacks turns {expected} to {batch.first_turn - 1} of the journal")


def _take_turn(node: Node, clock: TurnClock, turn: Turn, recorded: _Recorded) -> None:
    clock.time_ns = turn.time_ns
    if turn.kind == DEADLINE:
        node.on_deadline(clock.monotonic_ns())
    elif turn.kind == DEFERRED:
        # Tasks run in the order in which the node adds them, and none waits where a batch begins.
        if (task := node.context.deferred.take_turn()) is not None:
            task()
    else:
        _take_message(node, turn, recorded)


def _take_message(node: Node, turn: Turn, recorded: _Recorded) -> None:
    found = recorded.input(turn)
    if found is None:
        raise _EndError(f"the recording lacks {turn.topic}, seq {turn.seq} of {turn.src}, which the node received")
    message = cast(Message, found.decode())
    node.on_message(Received(turn.topic, message, found.payload, turn.time_ns, Arrival.NEXT))
    if turn.kind == COMMAND and isinstance(message, SessionControl):
        try:
            node.on_control(message)
        except TelenanoError:
            # The command is refused, as it was in the session.
            return


def _build(recording: Recording, key: str, clock: TurnClock, bus: RerunBus, settings: Sequence[str]) -> Node:
    attached = recording.attachments.get("scenario.yaml")
    if attached is None:
        raise RecordingError(f"{recording.path}: has no scenario.yaml attached, which a re-run takes its settings from")
    origin = f"scenario.yaml in {recording.path}"
    document = merge(parse_yaml(attached, origin), flag_overrides(settings))
    loaded = LoadedScenario(validate(Scenario, document, origin), origin, document)
    kind = node_kind(name_of(key))
    config = loaded.section(kind.name, kind.config)
    if not getattr(config, "simulated", True):
        text = f"node {key} drove a real device ({kind.name}.driver: {config.driver}), which cannot be run again"
        raise ConfigError(f"{text}; its messages are in {recording.path}")
    wiring = _RerunWiring(
        key=key,
        book=AddressBook(nodes={}),
        site_file=Path(),
        period_s=loaded.scenario.period_s,
        # Traces of the link with relative names are sought beside this file.
        scenario_file=Path(recording.metadata.get("recording", {}).get("scenario_file", "")),
        clock=clock,
        log=_NoLog(key),
        # Nothing is connected: a node with a journal uses only `bus` of its wiring.
        network=cast(Any, None),
        wake_descriptor=-1,
        rerun_bus=bus,
    )
    node, _ = kind.build(wiring, config)
    return node


class _NoLog(StructuredLog):
    """What the node wrote to its log then is of no interest now."""

    def write(self, level: str, text: str, **facts: Any) -> None:
        """Write nothing."""


@dataclass(frozen=True)
class _RerunWiring(Wiring):
    """Wiring without sockets: whoever asks for a bus gets the one of the re-run."""

    rerun_bus: RerunBus

    def bus(self, topics: Sequence[str], *, newest_only: bool = False) -> ZmqBus:
        """Return the bus of the re-run."""
        return cast(ZmqBus, self.rerun_bus)

    def bind(self, key: str, kind: int = zmq.PUB, *, batched: bool = False) -> ZmqPublisher:
        """Return an endpoint of the node."""
        return cast(ZmqPublisher, RerunOutlet(self.rerun_bus, key))

    def subscribers(
        self,
        connections: Mapping[str, Sequence[str]],
        *,
        apart: bool = False,
        newest_only: bool = False,
        shared: bool = False,
    ) -> list[Subscriber]:
        """Return none: the re-run hands the messages over itself."""
        return []

    def datagrams(self, outgoing: ZmqPublisher, reports: ZmqPublisher, readers: Sequence[Subscriber]) -> list[Reader]:
        """Return none, as for all inputs."""
        return []

    def estop_inlet(self) -> list[Subscriber]:
        """Return none, as for all inputs."""
        return []

    def kept_stop(self) -> Path | None:
        """Return none: a stop that the node found is among the recorded inputs."""
        return None

    def bus_of(self, publisher: Publisher, subscribers: Sequence[Reader]) -> ZmqBus:
        """Return the bus of the re-run."""
        return cast(ZmqBus, self.rerun_bus)
