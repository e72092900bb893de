"""`telenano bag rerun`: a node driven once more by what a recording says it heard, its outputs compared.

The recorder hears all publishers through connections of its own, so the order of its file is not the order in which a
node got its inputs. That order is rebuilt from what the node said: all outputs of a process carry stamps of one clock,
and each names the input that it answers (`hand_seq`, `command_seq`, `answered_at_ns`, the id of a command). Where two
orders remain possible, such as a state of the instrument that came at the very moment of a command, the more likely
one is tried first and the others if its outputs differ: what is proved is that the code gives the recorded outputs for
an order that the stamps allow.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, cast

import yaml
from pydantic import BaseModel

from proto import TOPICS, Message, encode
from proto.errors import ConfigError, RecordingError, RefusedError
from proto.messages import (
    AfmState,
    HapticCommand,
    HapticState,
    SessionControl,
    SessionEvent,
    TeleopBackward,
    TeleopForward,
)
from proto.sequence import Arrival
from recording.messages import RecordedMessage
from recording.reader import Recording
from recording.tolerance import Tolerances, first_difference
from services.runtime.address_book import AddressBook
from services.runtime.bus import Received, ZmqBus
from services.runtime.config import flag_overrides, merge, validate
from services.runtime.log import StructuredLog
from services.runtime.main import Wiring, node_kind
from services.runtime.node import Node
from services.runtime.scenario import LoadedScenario, Scenario

# a message is acted on this long after it was published, as a rule; the alternatives cover what was otherwise
_TRANSIT_NS = 100_000
# orders tried for one tick before it counts as different
_MOST_ORDERS = 6
# turns back, and how often at one place, before a difference counts as one
_LONGEST_RETURN = 12
_MOST_RETURNS = 500
# far more than an instrument takes to answer
_LONGEST_ANSWER_NS = 50_000_000
_FAR_FUTURE_NS = 2**63
_START_NS = 10**9
# outputs in a row with known inputs after which one without is a loss and not the start
_SETTLED = 200
_MOST_ON_THEIR_WAY = 100
# commands of the session on which the instrument makes a step at once
_STEPPING = ("arm", "estop")


class RerunResult(BaseModel):
    """What came of a re-run.

    `compared` counts recorded outputs met, by topic; `first_seq` is the number of the first of them: above 0, what the
    node heard before is not in the recording, and its state then is taken to be that after a start. `reordered` counts
    ticks at which another than the most likely order of inputs gave the recorded outputs. `difference` says in words
    what the first difference is, and is empty when there is none; `topic`, `seq`, `time_s` (since the start of the
    recording) and `field` say where. `ended_early` says why not all could be compared.
    """

    node: str
    compared: dict[str, int]
    first_seq: dict[str, int]
    reordered: int
    identical: bool
    difference: str = ""
    topic: str = ""
    seq: int = -1
    time_s: float = 0.0
    field: str = ""
    ended_early: str = ""

    def verdict(self) -> str:
        """Say in a sentence what came of it."""
        counts = ", ".join(f"{count} {topic}" for topic, count in self.compared.items()) or "nothing"
        if self.difference:
            late = max(self.first_seq.values(), default=0)
            begun = f" (the recording begins with seq {late}, what the node heard before is unknown)" if late else ""
            return f"differs after {counts}: {self.difference}{begun}"
        if self.ended_early:
            return f"the same as far as it could be compared ({counts}): {self.ended_early}"
        return f"the same in every message: {counts}" if self.identical else "nothing could be compared"


class ReplayClock:
    """A clock that shows what the re-run says; pace and stamps are set apart."""

    epoch_offset_ns = 0

    def __init__(self) -> None:
        self.monotonic = _START_NS
        self.now = _START_NS

    def monotonic_ns(self) -> int:
        """Give the time that paces the node [ns]."""
        return self.monotonic

    def now_ns(self) -> int:
        """Give the time of stamps [ns]."""
        return self.now


class RerunBus:
    """A bus that gives what a node says the headers of the recorded messages it is to equal."""

    def __init__(self, key: str, clock: ReplayClock, outputs: Sequence["Output"]) -> None:
        self._key = key
        self._clock = clock
        self._expected: dict[str, list[Output]] = {}
        for output in outputs:
            self._expected.setdefault(output.topic, []).append(output)
        self._met = dict.fromkeys(self._expected, 0)
        self._others = 0
        self.produced: list[tuple[str, Message]] = []

    def publish(self, topic: str, **fields: Any) -> Message:
        """Keep a message; `t_ns` and `seq` are those of the recorded one that comes next on the topic."""
        expected = self._expected.get(topic)
        if expected is None:
            self._others += 1
            return self._make(topic, self._others, self._clock.now, fields)
        if self._met[topic] == len(expected):
            raise _BeyondRecordingError
        recorded = expected[self._met[topic]]
        self._met[topic] += 1
        self._clock.now = recorded.t_ns
        message = self._make(topic, recorded.seq, recorded.t_ns, fields)
        self.produced.append((topic, message))
        return message

    def receive(self) -> Iterator[Received]:
        """Give nothing: the re-run hands the messages over itself."""
        return iter(())

    def wait(self, deadline_ns: int) -> None:
        """Do not wait."""

    def mark(self) -> dict[str, int]:
        """Give the state of the bus, to return to."""
        return dict(self._met)

    def reset(self, mark: dict[str, int]) -> None:
        """Return to a state of the bus."""
        self._met = dict(mark)

    def _make(self, topic: str, seq: int, t_ns: int, fields: dict[str, Any]) -> Message:
        model = TOPICS[topic].model
        return model(seq=seq, t_ns=t_ns, src=self._key, v=model.version, **fields)


class _BeyondRecordingError(Exception):
    """The node says more than the recording has."""


class Output(NamedTuple):
    """A message that the node sent, as recorded."""

    topic: str
    seq: int
    t_ns: int
    payload: bytes
    message: Any


Act = Callable[[Node, ReplayClock], None]


class Place(NamedTuple):
    """How far a re-run has come: outputs, inputs that come in a row and session commands taken, and what is pending.

    `pending` is an output that the next turn has to give first, `used` the stamp of the newest input of its kind.
    """

    output: int = 0
    taken: int = 0
    controls: int = 0
    used: int = 0
    pending: "Output | None" = None


class Candidate(NamedTuple):
    """One possible order of inputs, the recorded outputs that it has to give, and the place where it leads."""

    acts: Sequence[Act]
    expected: Sequence[Output]
    following: Place


# the possible orders of one turn, the likely ones first; none at the end of the recording
Turns = Callable[[Place], Sequence[Candidate]]


@dataclass
class RecordedInputs:
    """What a recording says about one node: its outputs by time, its inputs by topic, the commands it answered."""

    key: str
    outputs: list[Output]
    inputs: dict[str, list[RecordedMessage]]
    answered: list[tuple[int, SessionControl]] = field(default_factory=list)

    def index(self, topic: str, key: Callable[[Any], object]) -> dict[object, tuple[Any, RecordedMessage]]:
        """Give the inputs of a topic by something that identifies them."""
        found = ((recorded.decode(), recorded) for recorded in self.inputs[topic])
        return {key(message): (message, recorded) for message, recorded in found}

    def controls_before(self, t_ns: int, first: int) -> list[SessionControl]:
        """Give the commands of the session from number `first` on that were answered before a time [ns]."""
        return [control for answered_ns, control in self.answered[first:] if answered_ns < t_ns]

    def commands_before(self, t_ns: int, first: int) -> list[Act]:
        """Give the same as acts of the re-run."""
        return [_control(control) for control in self.controls_before(t_ns, first)]

    def next_is(self, number: int, kind: type[Message]) -> bool:
        """Say whether the output of a number exists and is of a kind."""
        return number < len(self.outputs) and isinstance(self.outputs[number].message, kind)


def rerun(
    recording: Recording,
    key: str,
    tolerances: Tolerances | None = None,
    settings: Sequence[str] = (),
    take: Callable[[str, Message], None] = lambda topic, message: None,
) -> RerunResult:
    """Drive a node with what a recording says it heard and compare what it says.

    Parameters: key, node@site; tolerances, none when None; settings, `section.key=value` over the recorded scenario;
    take, is given topic and message of each output that was met.
    Raises ConfigError when the node is not one that can be re-run or the scenario is wrong, RecordingError when the
    recording lacks the scenario or the node.
    """
    if key not in _TURNS:
        raise ConfigError(f"node {key}: cannot be re-run, those that can are {', '.join(_TURNS)}")
    kind = _TURNS[key]
    heard = _read(recording, key, kind)
    clock = ReplayClock()
    bus = RerunBus(key, clock, heard.outputs)
    node = _build(recording, key, clock, bus, settings)
    return _Comparison(recording, heard, node, clock, bus, tolerances or Tolerances()).run(kind.turns(heard), take)


class _Comparison:
    """One re-run on its way."""

    def __init__(
        self,
        recording: Recording,
        heard: RecordedInputs,
        node: Node,
        clock: ReplayClock,
        bus: RerunBus,
        tolerances: Tolerances,
    ) -> None:
        self._start_ns = recording.span_ns[0]
        self._heard = heard
        self._node = node
        self._clock = clock
        self._bus = bus
        self._tolerances = tolerances
        self._choices: deque[_Choice] = deque(maxlen=_LONGEST_RETURN)
        self._reordered = 0
        # the place that no order got beyond, what differs there, and the returns to earlier turns made for it
        self._furthest: tuple[int, dict[str, int], dict[str, Any]] = (-1, {}, {})
        self._returns = 0

    def run(self, turns: Turns, take: Callable[[str, Message], None]) -> RerunResult:
        """Take the turns until none of the orders that are possible gives what was recorded."""
        place, number = Place(), 0
        try:
            orders = turns(place)
            while orders:
                chosen, fault = self._first_that_holds(orders, number, _Snapshot.of(self._node, self._bus, self._clock))
                if chosen is None:
                    self._note(number, fault)
                    # an order that gave the right outputs may have left the wrong state
                    chosen, number = self._earlier_choice(number)
                if chosen is None:
                    _, reached, fault = self._furthest
                    self._bus.reset(reached)
                    return self._result(**fault)
                for topic, message in self._bus.produced:
                    take(topic, message)
                place, number = chosen.following, number + 1
                orders = turns(place)
        except _MissingInputError as error:
            return self._result(ended_early=str(error))
        return self._result()

    def _first_that_holds(
        self, orders: Sequence[Candidate], number: int, before: "_Snapshot"
    ) -> tuple[Candidate | None, dict[str, Any]]:
        """Try orders; those left are a choice to return to. If none holds, the likeliest tells what differs."""
        first: dict[str, Any] = {}
        for position, attempt in enumerate(orders):
            fault = self._attempt(attempt)
            if not fault:
                if position + 1 < len(orders):
                    self._choices.append(_Choice(number, before, orders[position + 1 :]))
                self._reordered += position > 0
                return attempt, {}
            first = first or fault
            before.restore(self._node, self._bus, self._clock)
        return None, first

    def _note(self, number: int, fault: dict[str, Any]) -> None:
        if number > self._furthest[0]:
            self._furthest = (number, self._bus.mark(), fault)
            self._returns = 0

    def _earlier_choice(self, number: int) -> tuple[Candidate | None, int]:
        """Return to the last choices and take another order there."""
        while self._choices and self._returns < _MOST_RETURNS:
            choice = self._choices.pop()
            if self._furthest[0] - choice.number > _LONGEST_RETURN:
                break
            self._returns += 1
            choice.before.restore(self._node, self._bus, self._clock)
            found, _ = self._first_that_holds(choice.orders, choice.number, choice.before)
            if found is not None:
                self._reordered += 1
                return found, choice.number
        return None, number

    def _attempt(self, attempt: Candidate) -> dict[str, Any]:
        self._bus.produced.clear()
        if attempt.expected:
            self._clock.now = attempt.expected[0].t_ns
        try:
            for act in attempt.acts:
                act(self._node, self._clock)
        except _BeyondRecordingError:
            pass
        produced = self._bus.produced
        for output, (topic, message) in zip(attempt.expected, produced, strict=False):
            fault = self._fault(output, topic, message)
            if fault:
                return fault
        if len(produced) < len(attempt.expected):
            return self._where(attempt.expected[len(produced)], "", "the node does not send this message")
        if len(produced) > len(attempt.expected):
            topic, message = produced[len(attempt.expected)]
            last = attempt.expected[-1] if attempt.expected else self._heard.outputs[0]
            return self._where(last, "", f"after it the node sends another {topic}, seq {message.seq}")
        return {}

    def _fault(self, output: Output, topic: str, message: Message) -> dict[str, Any]:
        if topic != output.topic:
            return self._where(output, "", f"the node sends {topic} instead")
        if encode(message) == output.payload:
            return {}
        different = first_difference(message.model_dump(), output.message.model_dump(), self._tolerances.on(topic))
        return self._where(output, different.field, f"re-run {different.text} recorded") if different else {}

    def _where(self, output: Output, name: str, text: str) -> dict[str, Any]:
        time_s = (output.t_ns - self._start_ns) * 1e-9
        place = f"{output.topic}, seq {output.seq}, {time_s:.6f} s after the start"
        facts = {"topic": output.topic, "seq": output.seq, "time_s": time_s, "field": name}
        return {"difference": f"{place}: {text}", **facts}

    def _result(self, **facts: Any) -> RerunResult:
        first = {output.topic: output.seq for output in reversed(self._heard.outputs)}
        compared = {topic: count for topic, count in self._bus.mark().items() if count}
        identical = not facts and bool(compared)
        return RerunResult(
            node=self._heard.key,
            compared=compared,
            first_seq=first,
            reordered=self._reordered,
            identical=identical,
            **facts,
        )


class _Snapshot(NamedTuple):
    """The state of a re-run, to return to; a node's parts are values, so a shallow copy holds."""

    parts: dict[str, Any]
    met: dict[str, int]
    times: tuple[int, int]

    @classmethod
    def of(cls, node: Node, bus: RerunBus, clock: ReplayClock) -> "_Snapshot":
        return cls(dict(node.__dict__), bus.mark(), (clock.monotonic, clock.now))

    def restore(self, node: Node, bus: RerunBus, clock: ReplayClock) -> None:
        node.__dict__.clear()
        node.__dict__.update(self.parts)
        bus.reset(self.met)
        clock.monotonic, clock.now = self.times


class _Choice(NamedTuple):
    """A turn at which other orders are left to try."""

    number: int
    before: _Snapshot
    orders: Sequence[Candidate]


class _MissingInputError(Exception):
    """The recording lacks a message that the node heard; the text says which."""


def _read(recording: Recording, key: str, kind: "_Kind") -> RecordedInputs:
    names = {channel.channel_topic for channel in recording.channels}
    absent = [topic for topic in (*kind.outputs, *kind.inputs) if topic not in names]
    if absent:
        raise RecordingError(f"{recording.path}: has no {', '.join(absent)}, which a re-run of {key} needs")
    outputs: list[Output] = []
    answers: dict[str, int] = {}
    inputs: dict[str, list[RecordedMessage]] = {topic: [] for topic in kind.inputs}
    controls: dict[str, SessionControl] = {}
    control_topics = ("session/control", "session/control@slave")
    for recorded in recording.messages((*kind.outputs, *kind.inputs, "session/event", *control_topics)):
        topic = recorded.channel_topic
        if topic in kind.outputs and recorded.src == key:
            outputs.append(_output(recorded))
        elif topic in inputs:
            inputs[topic].append(recorded)
        elif topic == "session/event" and recorded.src == key:
            event = cast(SessionEvent, recorded.decode())
            if event.kind in ("ack", "refused"):
                # a command that comes again is answered again, but carried out once
                answers.setdefault(event.id, event.t_ns)
        elif topic in control_topics:
            control = cast(SessionControl, recorded.decode())
            controls[control.id] = control
    outputs.sort(key=lambda output: output.t_ns)
    outputs = _from_first_known(kind, outputs, inputs)
    if not outputs:
        raise RecordingError(f"{recording.path}: has nothing that {key} said with all that it heard before")
    known = sorted(
        ((t_ns, controls[name]) for name, t_ns in answers.items() if name in controls), key=lambda pair: pair[0]
    )
    return RecordedInputs(key, outputs, inputs, known)


def _from_first_known(
    kind: "_Kind", outputs: list[Output], inputs: Mapping[str, list[RecordedMessage]]
) -> list[Output]:
    """Leave out what the node said at the start to messages that the recorder, still connecting, did not hear."""
    heard = {topic: {_hand_time(recorded) for recorded in found} | {0} for topic, found in inputs.items()}
    # a number above 0 at the start: the node may have heard more than the recorder
    begun_ns = max((found[0].publish_ns for found in inputs.values() if found and found[0].seq > 0), default=0)
    unknown = settled = 0
    for number, output in enumerate(outputs):
        topic, hand_t_ns = kind.input_of(output.message)
        if hand_t_ns not in heard[topic] or output.t_ns < begun_ns:
            unknown, settled = number + 1, 0
        settled += hand_t_ns > 0
        # from here on a message that is not there is a loss
        if settled > _SETTLED:
            break
    while unknown < len(outputs) and outputs[unknown].topic != kind.outputs[0]:
        unknown += 1
    return outputs[unknown:]


def _hand_time(recorded: RecordedMessage) -> int:
    fields = recorded.fields()
    return int(fields["t_ns" if recorded.topic == "haptic/state" else "hand_t_ns"])


def _output(recorded: RecordedMessage) -> Output:
    message = cast(Message, recorded.decode())
    return Output(recorded.topic, message.seq, message.t_ns, recorded.payload, message)


def _build(recording: Recording, key: str, clock: ReplayClock, bus: RerunBus, settings: Sequence[str]) -> Node:
    attached = recording.attachments.get("scenario.yaml")
    if attached is None:
        raise RecordingError(f"{recording.path}: has no scenario.yaml attached, which a re-run takes its settings from")
    origin = f"scenario.yaml in {recording.path}"
    document = merge(yaml.safe_load(attached), flag_overrides(settings))
    loaded = LoadedScenario(validate(Scenario, document, origin), origin, document)
    kind = node_kind(key.partition("@")[0])
    config = loaded.section(kind.name, kind.config)
    wiring = _RerunWiring(
        key=key,
        book=AddressBook(nodes={}),
        site_file=Path(),
        scenario_file=Path(),
        clock=clock,
        log=_NoLog(key),
        network=cast(Any, None),
        wake_descriptor=-1,
    )
    node, _ = kind.build(wiring.with_bus(bus), config)
    return node


class _NoLog(StructuredLog):
    """What the node wrote to its log then is of no interest now."""

    def write(self, level: str, text: str, **facts: Any) -> None:
        """Write nothing."""


class _RerunWiring(Wiring):
    """Wiring without sockets: whoever asks for a bus gets the one of the re-run."""

    def with_bus(self, bus: RerunBus) -> "_RerunWiring":
        object.__setattr__(self, "_rerun_bus", bus)
        return self

    def bus(self, topics: Sequence[str]) -> ZmqBus:
        """Give the bus of the re-run, which is all that a node asks of one."""
        return cast(ZmqBus, vars(self)["_rerun_bus"])


def _control(control: SessionControl) -> Act:
    def act(node: Node, clock: ReplayClock) -> None:
        try:
            node.on_control(control)
        except (RefusedError, ConfigError):
            # the node refused it then as well
            return

    return act


def _hear(message: Any, recorded: RecordedMessage, received_ns: int | None = None) -> Act:
    def act(node: Node, clock: ReplayClock) -> None:
        at_ns = clock.now if received_ns is None else received_ns
        node.on_message(Received(recorded.topic, message, recorded.payload, at_ns, Arrival.NEXT))

    return act


def _at(t_ns: int) -> Act:
    """Let the clock show the time of the next output before what follows."""

    def act(node: Node, clock: ReplayClock) -> None:
        clock.now = t_ns

    return act


def _sample_key(message: Any) -> tuple[int, int]:
    return message.hand_seq, message.hand_t_ns


def _own_key(message: Any) -> tuple[int, int]:
    return message.seq, message.t_ns


def _named(found: Mapping[object, Any], key: object, topic: str, output: Output) -> tuple[Any, RecordedMessage]:
    if key not in found:
        raise _MissingInputError(
            f"{output.topic}, seq {output.seq} answers a message of {topic} that the recording does not have"
        )
    return cast(tuple[Any, RecordedMessage], found[key])


def _master_turns(heard: RecordedInputs) -> Turns:
    """Rebuild what the master half heard: each forward names its hand sample, each command the answer it used.

    One command follows each forward: when a new answer comes, or else at the next sample of the hand. An answer that
    came before its forward and was used after it is told from the other case by what the outputs are.
    """
    hands = heard.index("haptic/state", _own_key)
    answers = heard.index("teleop/backward@master", _sample_key)

    def orders(place: Place) -> Sequence[Candidate]:
        if place.output >= len(heard.outputs):
            return ()
        forward = heard.outputs[place.output]
        sent = [*([place.pending] if place.pending else ()), forward]
        before = heard.commands_before(sent[0].t_ns, place.controls)
        hand = _hear(*_named(hands, _sample_key(forward.message), "haptic/state", forward))
        after = place._replace(output=place.output + 1, controls=place.controls + len(before), pending=None)
        if not heard.next_is(after.output, HapticCommand):
            return [Candidate([*before, hand], sent, after)]
        command = heard.outputs[after.output]
        between = heard.commands_before(command.t_ns, after.controls)
        key = _sample_key(command.message)
        done = after._replace(output=after.output + 1, controls=after.controls + len(between), used=key[1])
        overdue = done._replace(pending=command)
        if key[1] == place.used:
            return [Candidate([*before, hand, *between], sent, overdue)]
        answer, recorded = _named(answers, key, "teleop/backward@master", command)
        prompt = [*before, hand, _at(command.t_ns), *between, _hear(answer, recorded)]
        early = [*before, _hear(answer, recorded, sent[0].t_ns), hand, *between]
        return [Candidate(prompt, [*sent, command], done), Candidate(early, sent, overdue)]

    return orders


def _slave_turns(heard: RecordedInputs) -> Turns:
    """Rebuild what the slave half heard: each command names its forward, and the instrument's states are in order.

    The signal back goes out when the instrument has answered the command, or else at the next forward. States that the
    instrument sent on its own clock are placed by their stamps; the other places near a forward are tried as well.
    """
    forwards = heard.index("teleop/forward@slave", _sample_key)
    states = [(cast(AfmState, recorded.decode()), recorded) for recorded in heard.inputs["afm/state"]]

    def orders(place: Place) -> Sequence[Candidate]:
        if place.output >= len(heard.outputs):
            return ()
        command = heard.outputs[place.output]
        sent = [*([place.pending] if place.pending else ()), command]
        before = heard.commands_before(sent[0].t_ns, place.controls)
        forward = _hear(*_named(forwards, _sample_key(command.message), "teleop/forward@slave", command))
        after = place._replace(output=place.output + 1, controls=place.controls + len(before), pending=None)
        backward = heard.outputs[after.output] if heard.next_is(after.output, TeleopBackward) else None
        between: list[Act] = []
        if backward is not None:
            between = heard.commands_before(backward.t_ns, after.controls)
            after = after._replace(output=after.output + 1, controls=after.controls + len(between))
        waiting, answer = _states_until(islice(states, place.taken, None), command, backward or command)
        likely = sum(state.t_ns + _TRANSIT_NS <= sent[0].t_ns for state, _ in waiting)
        # the last one: at the start the node may hear nothing of the instrument for longer than the recorder
        splits = [*sorted(range(1, len(waiting) + 1), key=lambda n: abs(n - likely))[:_MOST_ORDERS], 0]
        prompt: list[Candidate] = []
        late: list[Candidate] = []
        for split in splits:
            acts = [*before, *_all(waiting[:split]), forward]
            late.append(Candidate([*acts, *between], sent, after._replace(taken=place.taken + split, pending=backward)))
            if backward is not None and answer is not None:
                rest = [*_all(waiting[split:]), _at(backward.t_ns), *between, _hear(*answer)]
                done = after._replace(taken=place.taken + len(waiting) + 1)
                prompt.append(Candidate([*acts, *rest], [*sent, backward], done))
        return [*prompt, *late]

    return orders


State = tuple[AfmState, RecordedMessage]


def _states_until(states: Iterable[State], command: Output, last: Output) -> tuple[list[State], State | None]:
    """Give the states up to the instrument's answer to a command, and that answer; None where there is none.

    Without an answer they are those that were sent before `last`.
    """
    waiting: list[State] = []
    for state, recorded in states:
        if (state.command_seq, state.hand_t_ns) == (command.seq, command.message.hand_t_ns) and state.hand_t_ns > 0:
            return waiting, (state, recorded)
        # the answers to later commands cannot have been heard yet
        if state.t_ns > last.t_ns + _LONGEST_ANSWER_NS:
            break
        waiting.append((state, recorded))
    return [pair for pair in waiting if pair[0].t_ns <= last.t_ns], None


def _all(states: Sequence[State]) -> list[Act]:
    return [_hear(*state) for state in states]


def _instrument_turns(heard: RecordedInputs) -> Turns:
    """Rebuild what the AFM did: one state a step, for a new command, for a command of the session, or by itself.

    `step_s` gives the time of each step exactly.
    """
    commands = heard.index("afm/command", lambda message: (message.seq, message.hand_t_ns))

    def orders(place: Place) -> Sequence[Candidate]:
        if place.output >= len(heard.outputs):
            return ()
        output = heard.outputs[place.output]
        state = cast(AfmState, output.message)
        following = place.output + 1
        # the answer to a command of the session comes after the state that it made
        after_ns = heard.outputs[following].t_ns if following < len(heard.outputs) else _FAR_FUTURE_NS
        controls = heard.controls_before(after_ns, place.controls)
        asked = [_control(control) for control in controls if control.command in _STEPPING]
        done = place._replace(output=following, controls=place.controls + len(controls), used=state.hand_t_ns)
        step = _advance(round(state.step_s * 1e9))
        if state.hand_t_ns not in (0, place.used):
            key = (state.command_seq, state.hand_t_ns)
            message, recorded = _named(commands, key, "afm/command", output)
            return [Candidate([step, _hear(message, recorded, output.t_ns)], [output], done)]
        return [Candidate([step, *(asked or [_step_by_itself])], [output], done)]

    return orders


def _hand_turns(heard: RecordedInputs) -> Turns:
    """Rebuild what the haptic node did: one state a tick of its grid, with the command that had arrived before it.

    `answered_at_ns` gives the arrival exactly, `step_s` the periods that a step covers.
    """
    commands = sorted(
        ((cast(HapticCommand, recorded.decode()), recorded) for recorded in heard.inputs["haptic/command"]),
        key=lambda pair: pair[0].t_ns,
    )
    times = [command.t_ns for command, _ in commands]

    def orders(place: Place) -> Sequence[Candidate]:
        if place.output >= len(heard.outputs):
            return ()
        output = heard.outputs[place.output]
        state = cast(HapticState, output.message)
        acts = heard.commands_before(output.t_ns, place.controls)
        done = Place(place.output + 1, 0, place.controls + len(acts), state.answered_at_ns)
        if state.answered_at_ns not in (0, place.used):
            # the newest that answers that sample and had been sent by then: a newer one may have been on its way
            last = bisect_right(times, state.answered_at_ns)
            sent = commands[max(0, last - _MOST_ON_THEIR_WAY) : last]
            key = (state.answered_seq, state.answered_t_ns)
            found = next((pair for pair in reversed(sent) if _sample_key(pair[0]) == key), None)
            if found is None:
                text = f"{output.topic}, seq {output.seq} acts on a message of haptic/command that the recording lacks"
                raise _MissingInputError(text)
            acts.append(_hear(*found, received_ns=state.answered_at_ns))
        return [Candidate([*acts, _at(output.t_ns), _tick(state.step_s)], [output], done)]

    return orders


def _advance(elapsed_ns: int) -> Act:
    def act(node: Node, clock: ReplayClock) -> None:
        clock.monotonic += elapsed_ns

    return act


def _step_by_itself(node: Node, clock: ReplayClock) -> None:
    node.on_deadline(clock.monotonic)


def _tick(step_s: float) -> Act:
    def act(node: Node, clock: ReplayClock) -> None:
        periods = max(1, round(step_s / node.period_s))
        clock.monotonic = node.deadline_ns() + (periods - 1) * round(node.period_s * 1e9)
        node.on_deadline(clock.monotonic)

    return act


def _master_input(message: Any) -> tuple[str, int]:
    return ("haptic/state" if isinstance(message, TeleopForward) else "teleop/backward@master"), message.hand_t_ns


class _Kind(NamedTuple):
    """How a node is re-run: its compared outputs, its inputs by channel, and how their order is rebuilt.

    The first output is the one that a turn begins with. `input_of` gives the topic that an output answers and the stamp
    of the hand's sample [ns] by which the message is known; 0 for none yet.
    """

    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    turns: Callable[[RecordedInputs], Turns]
    input_of: Callable[[Any], tuple[str, int]]


_TURNS: dict[str, _Kind] = {
    "controller@master": _Kind(
        ("teleop/forward", "haptic/command"), ("haptic/state", "teleop/backward@master"), _master_turns, _master_input
    ),
    "controller@slave": _Kind(
        ("afm/command", "teleop/backward"),
        ("teleop/forward@slave", "afm/state"),
        _slave_turns,
        lambda message: ("teleop/forward@slave", message.hand_t_ns),
    ),
    "afm_node@slave": _Kind(
        ("afm/state",), ("afm/command",), _instrument_turns, lambda message: ("afm/command", message.hand_t_ns)
    ),
    "haptic_node@master": _Kind(
        ("haptic/state",), ("haptic/command",), _hand_turns, lambda message: ("haptic/command", message.answered_t_ns)
    ),
}
