"""The node of the link: the only path between the sites of a rig, with the set impairments in each direction.

A signal comes from one half of the law. `telenano/link/engine.py` decides its fate, and it goes to the half at the
other site: from the hand to `services/controller/slave_half.py`, and back to `master_half.py`.
"""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import msgspec

from services.delay_node.far_stop import FarStop, FarStopState, stop_in_answer
from telenano.link.declared_delay import DECLARED, ONE_MACHINE, BetweenSites, DeclaredDelay, between_sites
from telenano.link.engine import LinkState
from telenano.link.fate import Fate, Release
from telenano.link.ping_times import Questions
from telenano.runtime.bus.publisher import publish_end
from telenano.runtime.impaired_link import DirectionPath, ImpairedLink, SiteEndpoint
from telenano.runtime.loop.node import NodeBus, NodeContext
from telenano.runtime.wiring.link_transports import TRAIN
from telenano.settings.link_files import OWN_TRACES, Traces
from telenano.settings.link_settings import LinkSettings
from telenano.timing.clock_offset import OffsetState
from telenano.wire import encode
from telenano.wire.answers import OBEYED
from telenano.wire.codec import WireError, accept
from telenano.wire.errors import RefusedError
from telenano.wire.messages import ClockPong, Message, SessionControl, SessionEvent
from telenano.wire.node_state import FindInput
from telenano.wire.nodes import HAND, LINK, TIP, site_of
from telenano.wire.received import Received
from telenano.wire.topics import crosses_from, output_name

# Topics that the link blocks while the instrument has not obeyed an emergency stop.
_HELD_BACK = ("teleop/forward", "session/control")
_STOP = "stop"


def crossing(topic: str, message: Message) -> str | None:
    """Return the direction in which a message crosses the link, None if it does not; back cross stops alone."""
    direction = crosses_from(topic, site_of(message.src))
    is_command = type(message) is SessionControl and message.command != "estop"
    return None if direction == "backward" and is_command else direction


class DelayNodeState(msgspec.Struct, array_like=True, kw_only=True):
    """The state of the node, which the node changes in place, except `engine`.

    engine: written only when the state is captured, because its models also hold values derived from the settings;
    forward_delay, backward_delay: the delays as published; between: transit time and clocks between the sites; clock:
    the exchanges of time stamps by second; answer: times of sending and reception of the newest answer [ns], 0 before
    it; session_id: the command that began the session; status_ns, unreported: time of the next report [ns], and the
    number of messages that it will count; stop: the emergency stop that the instrument has not obeyed yet; questions:
    the times of the questions for the other site's time; hand_stop: the emergency stop of the instrument's site that
    the hand has not obeyed yet.
    """

    engine: LinkState
    forward_delay: DeclaredDelay
    backward_delay: DeclaredDelay
    between: BetweenSites = ONE_MACHINE
    clock: OffsetState
    answer: tuple[int, int] = (0, 0)
    session_id: str = ""
    status_ns: int
    unreported: int
    stop: FarStopState = msgspec.field(default_factory=FarStopState)
    questions: Questions = msgspec.field(default_factory=Questions)
    hand_stop: FarStopState = msgspec.field(default_factory=FarStopState)


class DelayNode(ImpairedLink):
    """Forwards messages between the sites when the engine releases them, and reports on link/status.

    An emergency stop for the instrument is kept until the instrument has obeyed it (`FarStop`).
    """

    journalled = True
    state_kind = DelayNodeState
    state_version = 2
    memory: DelayNodeState

    def __init__(
        self,
        context: NodeContext,
        settings: LinkSettings,
        to_slave: SiteEndpoint,
        to_master: SiteEndpoint,
        folder: Path,
        *,
        spans_machines: bool = False,
        send_train: Callable[[], bool] | None = None,
        traces: Traces = OWN_TRACES,
    ) -> None:
        """Start with the settings.

        Args:
            context: The context of the node.
            settings: The settings of the link.
            to_slave: The endpoint at the slave's site.
            to_master: The endpoint at the master's site.
            folder: The folder of the files that the settings name.
            spans_machines: Whether the sites have separate clocks, and a network between them.
            send_train: Sends a train of datagrams between the machines and returns whether that was possible, or None.
            traces: Reads the files that the settings name.

        Raises:
            ConfigError: A trace cannot be used; the message names file and line.
        """
        super().__init__(context, settings, to_slave, to_master, folder, traces=traces)
        self._forwarded = {way.endpoint: 0 for way in self.directions}
        # Fate of the newest message sent on, by endpoint and topic.
        self._newest: dict[str, dict[str, Fate]] = {way.endpoint: {} for way in self.directions}
        self.memory = DelayNodeState(
            engine=self.engine.capture(),
            forward_delay=DeclaredDelay(DECLARED[self.forward.name]),
            backward_delay=DeclaredDelay(DECLARED[self.backward.name]),
            clock=self.offset.state,
            status_ns=self.memory.status_ns,
            unreported=0,
        )
        self._spans_machines, self._send_train = spans_machines, send_train
        self._stop = FarStop(context.kept_stop, self.memory.stop)
        self._hand_stop = FarStop(None, self.memory.hand_stop, HAND)
        # Each report also publishes the delays, because late readers need them and the clocks change them, and starts
        # the next exchange of time stamps.
        self.report_tasks += self._declare_forward, partial(self._declare, self.backward), self._ask

    def deadline_ns(self) -> int:
        due_ns = min(super().deadline_ns(), self._stop.due_ns, self._hand_stop.due_ns)
        if self._spans_machines:
            due_ns = min(due_ns, self.memory.questions.due_ns(2 * self.memory.between.transit_ns))
        return due_ns

    def on_message(self, received: Received) -> None:
        self.begin_turn(received.received_ns - self.clock.epoch_offset_ns)
        if type(received.message) is ClockPong:
            self._take_answer(received.message, received.received_ns)
        message = received.message
        if type(message) is SessionEvent:
            self._note_answer(message)
        direction = crossing(received.topic, message)
        if direction is None:
            return
        if self._spans_machines and received.topic == self.memory.backward_delay.topic:
            self.memory.questions.hear(received.received_ns - self.clock.epoch_offset_ns)
        is_stop = type(message) is SessionControl and message.command == "estop"
        if type(message) is SessionControl and is_stop:
            stop = self._stop if direction == "forward" else self._hand_stop
            if fault := stop.record(message, received.payload, self.clock.monotonic_ns()):
                self.event("fault", "warning", fault)
        elif received.topic in _HELD_BACK and self._stop.holds_back(message):
            self.forward.engine.leave_out(
                received.received_ns, received.topic, received.payload, message.seq, message.src, _STOP
            )
            return
        if type(message) is SessionControl and message.command == "start" and message.id != self.memory.session_id:
            # The session begins at the first copy of the repeated command, at this side of the link.
            self.memory.session_id = message.id
            self.engine.begin_session(received.received_ns)
        for way in self.directions:
            if direction == way.name:
                # An emergency stop is no part of the experiment, and must not wait for a stalled line.
                due = way.engine.submit(
                    received.received_ns, received.topic, received.payload, message.seq, message.src, at_once=is_stop
                )
                self.send(way, due)
        self.count_unreported(may_report=direction == "backward")

    def on_deadline(self, now_ns: int) -> None:
        self.begin_turn(now_ns)
        self.send_due(now_ns)
        self._send_stop(now_ns, self._stop, self.forward, TIP, ", and no sample crosses")
        self._send_stop(now_ns, self._hand_stop, self.backward, HAND)
        if self._spans_machines and self.memory.questions.take(now_ns, 2 * self.memory.between.transit_ns):
            self._ask()
        self.report_if_due(now_ns)

    def capture(self) -> DelayNodeState:
        self.memory.engine = self.engine.capture()
        return self.memory

    def restore(self, state: DelayNodeState, find: FindInput) -> None:
        self.memory = state
        self.engine.restore(state.engine, find)
        self.offset.restore(state.clock)
        self._stop.restore(state.stop)
        self._hand_stop.restore(state.hand_stop)

    def further_outputs(self) -> dict[str, int]:
        """Return the number of forwarded messages by endpoint, and the sequence numbers at the slave's endpoint."""
        numbers = self.forward.outlet.sequence_numbers()
        return {**{output_name(topic, f"{LINK}@slave"): seq for topic, seq in numbers.items()}, **self._forwarded}

    def on_control(self, control: SessionControl) -> str:
        """Change the settings, or measure the line between two machines with a train of datagrams."""
        if control.command != "set" or dict(control.parameters) != {TRAIN: True}:
            return super().on_control(control)
        if self._send_train is None or not self._send_train():
            raise RefusedError("no train was sent: no datagrams cross, the line is full, or one was sent just before")
        return "a train of datagrams was sent each way: link/network has what the line carried"

    def publish_end(self, bus: NodeBus) -> None:
        """Publish at both sites the end of this endpoint, with the numbers up to which messages were sent on."""
        for way, publisher in ((self.backward, bus), (self.forward, self.forward.outlet)):
            newest = self._newest[way.endpoint].values()
            publish_end(publisher, way.endpoint, {(fate.topic, fate.src): fate.seq + 1 for fate in newest})

    def send(self, way: DirectionPath, releases: Sequence[Release]) -> None:
        if not releases:
            return
        declared, newest = self._declared(way), self._newest[way.endpoint]
        for release in releases:
            if way is self.forward and self._stop.identifier and self._is_void(release):
                continue
            if declared.changed_by(release):
                self._declare(way)
            way.outlet.send(release.topic, release.payload)
            newest[release.topic] = release.fate
        self._forwarded[way.endpoint] += len(releases)

    def _is_void(self, release: Release) -> bool:
        """Return whether a later stop cancels a delayed message, which is so for a command that starts a motion."""
        if release.topic != "session/control":
            return False
        try:
            return self._stop.holds_back(accept(release.topic, release.payload))
        except WireError:
            return False

    @property
    def kept_stop_for(self) -> str:
        """The node that is the target of a stop in the file of this process."""
        return TIP

    def has_taken_over(self, identifier: str) -> bool:
        """Return whether a stop of this id is kept already, or was the last one obeyed."""
        return self._stop.knows(identifier)

    def _send_stop(self, now_ns: int, stop: FarStop, way: DirectionPath, device: str, also: str = "") -> None:
        """Send a copy of the stop that is kept for a device if it is due; report once that the device does not answer.

        `also`: what else follows for the sentence of that report.
        """
        was_unreached = stop.is_unreached
        if (payload := stop.copy(now_ns, self.clock.now_ns())) is None:
            return
        way.outlet.send("session/control", payload)
        self._forwarded[way.endpoint] += 1
        if stop.is_unreached and not was_unreached:
            text = f"{device} has not answered an emergency stop: it is kept and sent until it has{also}"
            self.event("link", "warning", text)

    def _note_answer(self, event: SessionEvent) -> None:
        """Forget a kept stop whose device has obeyed it by this event; carry a stop of the instrument's site."""
        for device, stop in ((TIP, self._stop), (HAND, self._hand_stop)):
            was_unreached = stop.is_unreached
            if stop.note_event(event):
                if was_unreached:
                    self.event("link", "info", f"{device} has obeyed the emergency stop that was kept for it")
                if device == HAND:
                    self._report_obeyed(event.id)
        control = stop_in_answer(event) if event.src == TIP else None
        if control is not None and self._hand_stop.take_answer(control, encode(control), self.clock.monotonic_ns()):
            self._report_obeyed(control.id)

    def _report_obeyed(self, identifier: str) -> None:
        """Tell the instrument's site, to which answers of the hand do not cross, that the hand has obeyed a stop."""
        if self._spans_machines:
            facts = {"about_node": HAND, OBEYED: identifier}
            text = "has obeyed the emergency stop, as the link reports"
            event = {"id": "", "kind": "link", "level": "info", "text": text, "data": facts}
            self.forward.outlet.publish("session/event", **event)

    def _declared(self, way: DirectionPath) -> DeclaredDelay:
        return self.memory.forward_delay if way is self.forward else self.memory.backward_delay

    def _declare(self, way: DirectionPath) -> None:
        """Publish the delay of a direction at the master's site, and the forward delay at the slave's site too."""
        fields = {"direction": way.name, **self._declared(way).current._asdict()}
        if way is self.forward and self._knows_clocks:
            way.outlet.publish("link/delay", **fields, **self.memory.between.at_slave())
        self.backward.outlet.publish("link/delay", **fields, **self.memory.between.at_master())

    @property
    def _knows_clocks(self) -> bool:
        """Whether this process knows the lead of the slave's clock, without which a stale sample may look fresh there.

        Until the first exchange of a new process, readers at the slave's site keep what the process before has told.
        """
        return not self._spans_machines or self.offset.present.there is not None

    def _declare_forward(self) -> None:
        if self._spans_machines:
            self.memory.between = between_sites(self.offset)
            self._tell_change()
            self._tell_clock()
        self._declare(self.forward)

    def _tell_change(self) -> None:
        """Report a permanent change of the line's round trip, which the loop feels as delay."""
        if (changed := self.offset.present.take_change(self.clock.now_ns())) is None:
            return
        before_ms, after_ms, low_ms, high_ms = (1e-6 * value for value in changed[1:])
        word = "longer" if after_ms > before_ms else "shorter"
        self.event(
            "link",
            "info",
            f"the way between the sites has become {word}: the round trip was {before_ms:.3g} ms and is {after_ms:.3g}"
            f" ms ({low_ms:.3g} to {high_ms:.3g} ms)",
        )

    def _tell_clock(self) -> None:
        """Report that the clock of the other site was set; ages and time stamps are corrected for that from now on."""
        if (changed := self.offset.take_change()) is None:
            return
        before, now = (f"{one.offset_s:.6g} s ± {1e3 * one.uncertainty_s:.3g} ms" for one in changed)
        self.event(
            "link",
            "info",
            f"the clock of the other site was set: it was ahead of this one by {before}, and is now by {now}",
        )

    def _ask(self) -> None:
        """Start an exchange of time stamps with the other site."""
        self.memory.questions.ask(self.clock.monotonic_ns())
        self.forward.outlet.publish("clock/ping")

    def _take_answer(self, pong: ClockPong, received_ns: int) -> None:
        self.memory.answer = (pong.t_ns, received_ns)
        knew_clocks = self._knows_clocks
        is_longer = self.offset.record(pong.ping_t_ns, pong.received_ns, *self.memory.answer)
        in_doubt = self.offset.present.is_in_doubt
        self.memory.questions.answer(received_ns - self.clock.epoch_offset_ns, in_doubt=in_doubt, is_longer=is_longer)
        if self._spans_machines and (is_longer or knew_clocks != self._knows_clocks):
            # Tell the readers at once: until then their guards reject samples that the line or a clock makes older.
            self._declare_forward()
            self._declare(self.backward)

    def clock_status(self) -> dict[str, object]:
        answer = (
            {"answer_sent_ns": self.memory.answer[0], "answer_received_ns": self.memory.answer[1]}
            if self.memory.answer[1]
            else {}
        )
        return {"clock": self.offset.report(of_line=self._spans_machines), **answer}
