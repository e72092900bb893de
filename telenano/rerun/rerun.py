"""`telenano bag rerun`: run a node again on the inputs of its journal, and compare its outputs with the recorded ones.

A node records the order in which it handled messages and deadlines, and its state (`node/journal`, ADR 0012). The
re-run builds the node, restores that state, and repeats the turns one by one. Only recorded keys are compared: older
recordings stay equal although newer versions of a node may send further optional keys. Messages that the link forwards
are also compared with those that left it at either site (ADR 0012).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import zmq
from pydantic import BaseModel

from telenano.analysis.plugins import differences, recorded_plugins
from telenano.recording.field_differences import Tolerances
from telenano.recording.reader import Recording
from telenano.rerun.rerun_bus import DifferenceError, RerunBus, RerunOutlet
from telenano.rerun.rerun_inputs import JOURNAL, RecordedNode, Turn, start_ns, turns_of
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import Reader, Subscriber, ZmqBus
from telenano.runtime.bus.publisher import Publisher, ZmqPublisher
from telenano.runtime.loop.journal import COMMAND, DEADLINE, DEFERRED
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import Node
from telenano.runtime.wiring.link_transports import LinkEnds
from telenano.runtime.wiring.main import Wiring, node_kind
from telenano.runtime.wiring.participant import NoNetwork
from telenano.settings.config import flag_overrides, merge, parse_yaml, validate
from telenano.settings.link_files import OWN_TRACES, Traces
from telenano.settings.named_instruments import on_instrument
from telenano.settings.scenario import LoadedScenario
from telenano.timing.clock import TurnClock
from telenano.wire import Message
from telenano.wire.errors import ConfigError, RecordingError, TelenanoError, known_names
from telenano.wire.journal_messages import NodeJournal
from telenano.wire.messages import SessionControl
from telenano.wire.node_state import is_whole, restore
from telenano.wire.nodes import LINK, NODES, RERUN_NODES, is_console, name_of, no_rerun_reason
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival

# Longest time at the begin of a journal in which inputs may be missing, because the recording began after them; later
# parts have to be complete.
_LATEST_START_NS = 1_500_000_000
# Longest time in which the recorder may connect to a publisher later than the node; publishers start one by one.
_LATEST_JOIN_NS = 30_000_000_000


class RerunResult(BaseModel):
    """The result of a re-run.

    `compared` is the number of recorded outputs found equal within the tolerances, by topic, or topic@site for messages
    that a link forwarded there; `first_seq` is the number of the first of each. `left_out` is the number of recorded
    outputs that were not compared, because the recording lacks the journal, or an input from before the first or after
    the last compared turn. `difference` describes the first difference, and is empty without one; `topic`, `seq`,
    `time_s` (since the start of the recording) and `field` are its place. `ended_early` is the reason why the
    comparison ended before the journal did; `packages` lists the packages of the node that are not as recorded.
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
        recording: The recording with the inputs and outputs.
        key: The node, as node@site.
        tolerances: The tolerances by field; None compares exactly.
        settings: Settings that replace those of the recorded scenario, as `section.key=value`.
        take: Called with the topic and the message of each output that was compared.

    Raises:
        ConfigError: The node cannot be re-run, or the scenario is invalid.
        RecordingError: The recording lacks the scenario, the journal or the inputs of the node.
    """
    if reason := no_rerun_reason(key):
        # For a known node, similar names are not suggested, because it was not misspelt.
        is_known = is_console(key) or key in {row.key for row in NODES}
        names = f"those that can are {', '.join(RERUN_NODES)}" if is_known else known_names(key, RERUN_NODES)
        raise ConfigError(f"node {key}: cannot be run again: {reason}; {names}")
    batches, states = _journal(recording, key)
    if not batches:
        raise RecordingError(
            f"{recording.path}: has no {JOURNAL} of {key}, which a re-run follows: it was recorded without that topic; "
            "it can still be read, replayed, compared and plotted"
        )
    recorded = RecordedNode(recording, key, batches)
    begun = _begin(recorded, batches, states)
    clock = TurnClock(start_ns(batches[begun]), batches[begun].epoch_offset_ns)
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
            for turn in turns_of(batch):
                _take_turn(node, clock, turn, recorded)
    except DifferenceError as error:
        facts = error.facts
    except _EndError as error:
        facts = {"ended_early": str(error)}
    except _OverError:
        # The node went on for longer than the recording of one of its sources.
        pass
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
    """Return the batches of a node's journal, and the state at the begin of each, joined from its messages."""
    batches: list[NodeJournal] = []
    pieces: list[list[bytes]] = []
    for batch in recording.messages([JOURNAL]):
        if batch.src == key:
            message = cast(NodeJournal, batch.decode())
            if message.kind.data:
                batches.append(message)
                pieces.append([message.state.data])
            elif batches and message.first_turn == batches[-1].first_turn:
                pieces[-1].append(message.state.data)
    return batches, list(map(b"".join, pieces))


def _packages(recording: Recording, key: str) -> list[str]:
    """Return the differences of the node's packages from the recorded ones; raise ConfigError if one is missing."""
    document = parse_yaml(recording.attachments.get("scenario.yaml", b"{}"), f"scenario.yaml in {recording.path}")
    section = name_of(key)
    return differences(recorded_plugins(recording, {section: document.get(section, {})}))


class _EndError(Exception):
    """The re-run cannot continue with this recording; the text has the reason, such as a missing input."""


class _OverError(Exception):
    """The recording of a source has ended, so the turns from here on are not covered by the recording."""


def _begin(recorded: RecordedNode, batches: Sequence[NodeJournal], states: Sequence[bytes]) -> int:
    """Return the index of the batch with which a re-run begins: the first one with a whole state and all inputs.

    While the rig starts, inputs from before the recorder connected to their publisher may be missing, and others in one
    or two batches after the last of those.

    Raises:
        RecordingError: None of the early batches is complete.
    """
    starting = [batch for batch in batches if start_ns(batch) - start_ns(batches[0]) <= _LATEST_JOIN_NS]
    first = 1 + max((place for place, batch in enumerate(starting) if recorded.is_early(batch)), default=-1)
    # Not every batch has a state, because a large state is captured only every few seconds.
    begins = [place for place in range(first, len(batches)) if is_whole(states[place])]
    for place in begins:
        if start_ns(batches[place]) - start_ns(batches[begins[0]]) > _LATEST_START_NS:
            break
        if not recorded.missing(batches[place]):
            return place
    missing = next(filter(None, map(recorded.missing, batches)), "the node's state")
    raise RecordingError(
        f"{recorded.path}: has no part of the journal of {recorded.key} with all inputs: lacks {missing}"
    )


def _follows(earlier: NodeJournal, batch: NodeJournal) -> None:
    expected = earlier.first_turn + len(earlier.kind.data)
    if batch.first_turn < expected:
        raise _EndError("the node was started again")
    if batch.first_turn > expected:
        raise _EndError(f"the recording lacks turns {expected} to {batch.first_turn - 1} of the journal")


def _take_turn(node: Node, clock: TurnClock, turn: Turn, recorded: RecordedNode) -> None:
    clock.time_ns = turn.time_ns
    if turn.kind == DEADLINE:
        node.on_deadline(clock.monotonic_ns())
    elif turn.kind == DEFERRED:
        # Tasks run in the order in which the node adds them, and no task waits at the begin of a batch.
        if (task := node.context.deferred.take_turn()) is not None:
            task()
    else:
        _take_message(node, turn, recorded)


def _take_message(node: Node, turn: Turn, recorded: RecordedNode) -> None:
    recorded_input = recorded.input(turn)
    if recorded_input is None:
        if recorded.has_ended(turn):
            raise _OverError
        raise _EndError(f"the recording lacks {turn.topic}, seq {turn.seq} of {turn.src}, which the node received")
    message = cast(Message, recorded_input.decode())
    node.on_message(Received(turn.topic, message, recorded_input.payload, turn.time_ns, Arrival.NEXT))
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
    settings_set = flag_overrides(settings)
    document = merge(
        parse_yaml(attached, origin), on_instrument(settings_set) if "instrument" in settings_set else settings_set
    )
    loaded = LoadedScenario.of(document, origin, is_whole=True)
    kind = node_kind(name_of(key))
    config = loaded.section(kind.name, kind.config)
    if not getattr(config, "simulated", True):
        text = f"node {key} drove a real device ({kind.name}.driver: {config.driver}), which cannot be run again"
        raise ConfigError(f"{text}; its messages are in {recording.path}")
    wiring = _RerunWiring(
        key=key,
        book=_book(recording) if name_of(key) == LINK else AddressBook(nodes={}),
        site_file=Path(),
        period_s=loaded.scenario.period_s,
        # Traces of the link with relative names are searched for in the folder of this file.
        scenario_file=Path(recording.metadata.get("recording", {}).get("scenario_file", "")),
        clock=clock,
        log=_NoLog(key),
        # Nothing is connected: `_RerunWiring` overrides every method by which a node with a journal opens a socket.
        network=cast(Any, NoNetwork("")),
        wake_descriptor=-1,
        rerun_bus=bus,
    )
    return kind.open(wiring, loaded)[0]


class _NoLog(StructuredLog):
    """A log that drops everything, because the node has already logged it in the session."""

    def write(self, level: str, text: str, **facts: Any) -> None:
        """Write nothing."""


def _book(recording: Recording) -> AddressBook:
    """Return the address book that a recording has attached: a link between two machines also measures its line.

    No other node looks at it, so another node is run again whatever site file the recording has.
    """
    attached = recording.attachments.get("site.yaml")
    if attached is None:
        return AddressBook(nodes={})
    origin = f"site.yaml in {recording.path}"
    return validate(AddressBook, parse_yaml(attached, origin), origin)


@dataclass(frozen=True)
class _RerunWiring(Wiring):
    """Wiring without sockets: every bus that a node requests is that of the re-run."""

    rerun_bus: RerunBus

    def bus(self, topics: Sequence[str], *, newest_only: bool = False) -> ZmqBus:
        """Return the bus of the re-run."""
        return cast(ZmqBus, self.rerun_bus)

    def bind(self, key: str, kind: int = zmq.PUB, *, ends: bool = False) -> ZmqPublisher:
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
        """Return no subscribers, because the re-run passes the messages to the node itself."""
        return []

    def traces(self) -> Traces:
        """Return a reader that reads at once: the journal names the turn in which the node had the file."""
        return OWN_TRACES

    def link_ends(self, outgoing: ZmqPublisher, reports: ZmqPublisher, readers: Sequence[Subscriber]) -> LinkEnds:
        """Return no transport, because the re-run passes the messages to the node itself."""
        return LinkEnds()

    def estop_inlet(self) -> list[Subscriber]:
        """Return no inlet, because stops are among the recorded inputs."""
        return []

    def kept_stop(self) -> Path | None:
        """Return no file, because a stop that the node found there is among the recorded inputs."""
        return None

    def bus_of(self, publisher: Publisher, subscribers: Sequence[Reader]) -> ZmqBus:
        """Return the bus of the re-run."""
        return cast(ZmqBus, self.rerun_bus)
