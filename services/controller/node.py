"""The controller processes: each runs one half of a law on the arrival of messages."""

import math
from typing import Any, Literal, cast

from proto.instrument import AfmProgram
from proto.messages import (
    AfmState,
    HapticState,
    LawStatus,
    LinkDelay,
    SessionControl,
    TeleopBackward,
    TeleopForward,
)
from services.controller import energy
from services.controller.clamp import clamped
from services.controller.config import ControllerConfig
from services.controller.half import ROUND_TRIP_UNKNOWN, ZERO_XY, ControllerHalf
from services.controller.law import (
    NO_SIGNAL,
    NO_TIP,
    EnergyAccount,
    HandSample,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
    longest_pause_periods,
    paced,
)
from services.numerics.frames import to_paper_axis, to_site_frame
from services.runtime.bus.bus import Received
from services.runtime.loop.freshness import DEADLINES_S
from services.runtime.loop.node import NodeContext

MASTER_INPUTS = ("haptic/state", "teleop/backward", "law/status", "link/delay", "session/control")
SLAVE_INPUTS = ("teleop/forward", "afm/state", "afm/program", "link/delay", "session/control")
# a program that says nothing for so long is over [ns]: it reports ten times a second
_PROGRAM_SILENCE_NS = 500_000_000
# a hand whose device is lost is that of an inactive site; a simulated device says nothing
_FOLLOWING_DEVICE = (None, "ok")
# while the other half is waited for, the hand comes to rest like a virtual mass that is left alone
_COASTING_S = 0.005


class MasterController(ControllerHalf):
    """The half at the operator's site: haptic/state in, teleop/forward out; teleop/backward in, haptic/command out.

    One command a tick of the hand: when the answer to the tick comes, or else at the next tick.
    """

    inputs = MASTER_INPUTS
    # the tick then is with the slave's side
    idle_after = "haptic/state"

    def __init__(self, context: NodeContext, config: ControllerConfig) -> None:
        super().__init__(context, config)
        self.hand = HandSample(0.0, 0.0, 0.0, False)
        self.reference = MasterReference(0.0, 0.0, 0.0, False)
        self._tip_reference_m = 0.0
        self._switch_s = 0.0
        self._dt_s = config.period_s
        self._command_due = False
        self._answered_hand_stamp = (0, 0)
        self._slave_status: LawStatus | None = None

    def on_message(self, received: Received) -> None:
        if self.rejects(received):
            return
        message = received.message
        if type(message) is HapticState:
            self._on_hand(message)
        elif type(message) is TeleopBackward:
            if self.receive_signal(message, received.received_ns) and self.switching:
                self._take_over()
            self._answered_hand_stamp = (message.hand_seq, message.hand_t_ns)
            if self._command_due:
                self._publish_command()
        elif type(message) is LawStatus:
            self._slave_status = message
        elif type(message) is LinkDelay:
            self.freshness.record(message)

    def forget(self) -> None:
        super().forget()
        self._command_due = False

    def retuned(self, old: Any, new: Any) -> Any:
        """Carry the state over without a jump at the tip."""
        return self.law.retune(old, new, self.law_state)

    def energy_account(self) -> EnergyAccount:
        return cast(EnergyAccount, self.law.master_energy_account(self.params, self.law_state))

    def round_trip_s(self) -> tuple[float, bool]:
        if self._signal_ns is None:
            return ROUND_TRIP_UNKNOWN
        return max(
            0, round((self._hand_stamp[1] - self._signal_hand_ns) / self._period_ns)
        ) * self.config.period_s, True

    def _switch(self) -> None:
        super()._switch()
        self._switch_s = 0.0
        if self.switching:
            self.law_state = self._resumed(self.reference, self._tip_reference_m)

    def _resumed(self, reference: MasterReference, tip_reference_m: float) -> Any:
        sample = HandSample(reference.position_m, reference.velocity_m_per_s, self.hand.force_n, self.hand.following)
        return self.law.master_resume(self.params, sample, tip_reference_m)

    def _take_over(self) -> None:
        """Run the new law from the position of the hand and from where the slave reports the base."""
        self.switching = False
        tip_m = self.signal.position_m if self.signal.active else self._tip_reference_m
        self.law_state = self._resumed(self.reference, tip_m)

    def _on_hand(self, message: HapticState) -> None:
        unanswered = self._command_due
        if unanswered:
            self._publish_command()
        elif message.device == "stale" and self._hand_stamp[1]:
            self._send_reference()
        if message.device == "stale":
            # a sample that is repeated is none: the law does not step, and the next one bridges the gap. To join the
            # old position anew would leave tip and hand apart by the way in between, for the rest of the session
            return
        elapsed = self.elapsed_s(message.t_ns, self._hand_stamp[1])
        self._hand_stamp = (message.seq, message.t_ns)
        following = self.hand.following
        self.hand = HandSample(
            to_paper_axis(message.position_m),
            to_paper_axis(message.velocity_m_per_s),
            to_paper_axis(message.operator_force_n),
            message.mode != "off" and message.device in _FOLLOWING_DEVICE,
        )
        x, y, _ = message.position_m
        self.lateral_m = self._at_the_tip(x, y) if x or y else ZERO_XY
        if self.law_state is None:
            self.law_state = self.law.master_start(self.params, self.hand)
        if elapsed is None:
            self.port = energy.opened(self.hand.position_m, self.hand.force_n)
        # the sample's force acted over the way to the sample's position
        counts = elapsed is not None and following and self.hand.following and self.reference.active
        count = energy.with_inflow if counts and not self.switching else energy.moved_to
        self.port = count(self.port, self.hand.position_m, self.hand.force_n)
        if elapsed == 0.0:
            # the sample before was late, and its step was that of both: a step more would be a period too many
            if not unanswered:
                self._send_reference()
            return
        # after a pause the law goes on from its own state: a hand that was restarted is off, and a law stays with an
        # off hand, while one that was only held up finds its reference where it was
        self._dt_s = elapsed if elapsed is not None else self.config.period_s
        hand = self.hand._replace(following=False) if self.switching else self.hand
        self.law_state, signal = self.law.master_send(self.params, self.law_state, hand, self._dt_s)
        self._tip_reference_m = signal.position_m
        if self.passes_deadband(signal, self._dt_s):
            self.publish("teleop/forward", **self.signal_fields(signal), force_n=to_site_frame(signal.force_n))
        self.steps += 1
        self._command_due = True
        slave = self._slave_status
        self.report_status(slave.port_energy_j if slave is not None and slave.law == self.law.name else None)

    def _at_the_tip(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return where a hand of three axes wants the tip over the sample [m]."""
        scale = self.config.law_config().position_scale
        return scale * x_m, scale * y_m

    def _lateral_force(self) -> tuple[float, float]:
        """Return the lateral force of the sample at the hand's scale [N]."""
        x, y = self.far_lateral
        scale = self.config.law_config().force_scale if x or y else 0.0
        return scale * x, scale * y

    def _publish_command(self) -> None:
        self._command_due = False
        self.reference = self._coasting() if self.switching else self._step_law()
        self.state = "running" if self.reference.active else "safe"
        self._send_reference()

    def _send_reference(self) -> None:
        self.publish(
            "haptic/command",
            mode="position" if self.reference.active else "off",
            position_m=to_site_frame(self.reference.position_m),
            velocity_m_per_s=to_site_frame(self.reference.velocity_m_per_s),
            force_n=(*self._lateral_force(), self.reference.force_n),
            hand_seq=self._answered_hand_stamp[0],
            hand_t_ns=self._answered_hand_stamp[1],
        )

    def _step_law(self) -> MasterReference:
        signal = self.latest_signal()
        self.law_state, reference = self.law.master_receive(self.params, self.law_state, self.hand, signal, self._dt_s)
        return cast(MasterReference, reference)

    def _coasting(self) -> MasterReference:
        """Return the reference while the other half is waited for: it comes to rest, and the force shown stays."""
        self._switch_s += self._dt_s
        last, fades = self.reference, math.exp(-self._dt_s / _COASTING_S)
        active = last.active and self._switch_s <= self.config.switch_limit_s
        position_m, velocity_m_per_s = self.hand.position_m, 0.0
        if self.hand.following:
            position_m = last.position_m + _COASTING_S * (1.0 - fades) * last.velocity_m_per_s
            velocity_m_per_s = fades * last.velocity_m_per_s
        return MasterReference(position_m, velocity_m_per_s, last.force_n, active)


class SlaveController(ControllerHalf):
    """The half at the instrument's site: teleop/forward in, afm/command out; afm/state in, teleop/backward out."""

    inputs = SLAVE_INPUTS
    # the tick then goes through the link, which may share its processor
    idle_after = "afm/state"

    def __init__(self, context: NodeContext, config: ControllerConfig) -> None:
        super().__init__(context, config)
        self.tip = NO_TIP
        self.reference = SlaveReference(0.0, True)
        self._dt_s = config.period_s
        # periods that the half is behind the hand, and the length of its last step
        self._behind, self._step_s = 0, config.period_s
        # commands that the instrument has not carried out yet, each with the length of its step [s]
        self._outstanding: list[tuple[int, float]] = []
        self._awaited_command_seq: int | None = None
        self._command_answers_signal = (
            True  # whether the awaited command belongs to a signal, and not to the local loop
        )
        self._last_command_seq: int | None = None
        self._clamp = config.clamp_params()
        self._local = config.local_loop
        self._instrument_ns = 0
        self._instrument_lost = False
        self._lateral_n = ZERO_XY
        # until when the instrument images or measures by itself, and obeys no hand
        self._occupied_until_ns = 0

    def on_message(self, received: Received) -> None:
        if self.rejects(received):
            return
        message = received.message
        if type(message) is TeleopForward:
            self._on_forward(message, received.received_ns)
        elif type(message) is AfmState:
            self._instrument_ns = self.freshness.stamp_ns(message.t_ns, received.received_ns)
            self._on_instrument(message)
        elif type(message) is AfmProgram:
            occupied = message.program != "tactile" and message.state in ("running", "paused")
            self._occupied_until_ns = received.received_ns + _PROGRAM_SILENCE_NS if occupied else 0
        elif type(message) is LinkDelay:
            self.freshness.record(message)

    def forget(self) -> None:
        super().forget()
        self._awaited_command_seq = None
        self._outstanding.clear()
        if self.tip.following:
            self._lose_instrument()

    def energy_account(self) -> EnergyAccount:
        return cast(EnergyAccount, self.law.slave_energy_account(self.params, self.law_state))

    def on_control(self, control: SessionControl) -> str:
        done = super().on_control(control)
        self._clamp, self._local = self.config.clamp_params(), self.config.local_loop
        return done

    def longest_pause_periods(self) -> int:
        """Return what the last signal counts for: until then the half has gone on by itself."""
        return longest_pause_periods(self.config.law_config().silence_limit_s, self.config.period_s)

    def _switch(self) -> None:
        super()._switch()
        if self.switching:
            self.law_state = self._standing()

    def _standing(self) -> Any:
        """Return the state of a half that begins at the last reference of the base."""
        return self.law.slave_start(self.params, self.tip._replace(base_position_m=self.reference.position_m))

    def _interrupted(self) -> Any:
        """Return the state of a half that takes the signals up anew.

        What it counts goes on: a master that has not noticed would take lower counters for those of old signals.
        """
        return self.law.slave_receive(self.params, self.law_state, NO_SIGNAL, self.tip, self.config.period_s)[0]

    def _on_forward(self, message: TeleopForward, received_ns: int) -> None:
        if self._awaited_command_seq is not None:
            # the instrument has not answered the last tick: its newest sample has to do, for as long as it is fresh
            self._doubt_instrument()
            if self.law.local_loop and not self._instrument_lost and not self.switching:
                self._answer_early()
            else:
                self._send_answer()
        elapsed = self.elapsed_s(message.hand_t_ns, self._hand_stamp[1])
        self._hand_stamp = (message.hand_seq, message.hand_t_ns)
        if self.receive_signal(message, received_ns) and message.active:
            self.switching = False
        if self.law_state is None:
            self.law_state = self.law.slave_start(self.params, self.tip)
        elif elapsed is None and not self.switching:
            self.law_state, self._behind = self._interrupted(), 0
        self._dt_s = elapsed if elapsed is not None else self.config.period_s
        if self._instrument_lost:
            self.reference = SlaveReference(self.reference.position_m, False)
        elif not self.switching:
            self._receive(self.latest_signal(), round(self._dt_s / self.config.period_s))
        self._publish_command(answers=True)
        self.steps += 1
        self.report_status(None)

    def _receive(self, signal: PortSignal, elapsed: int) -> None:
        """Step the half by what it is behind the hand; elapsed: periods that a signal has brought, 0 without one."""
        period_s = self.config.period_s
        self._behind, periods = paced(self._behind, elapsed, round(1e9 * signal.silence_s) // round(1e9 * period_s))
        self._step_s = periods * period_s
        self.law_state, wanted = self.law.slave_receive(self.params, self.law_state, signal, self.tip, self._step_s)
        self.reference = clamped(self._clamp, wanted, signal, self.tip)

    def _publish_command(self, *, answers: bool) -> None:
        mode: Literal["position", "hold"] = "position" if self.reference.active else "hold"
        command = self.publish(
            "afm/command",
            mode=mode,
            base_position_m=(*self.far_lateral, 0.0 - self.reference.position_m),
            hand_seq=self._hand_stamp[0],
            hand_t_ns=self._hand_stamp[1],
        )
        self._awaited_command_seq = self._last_command_seq = command.seq
        self._command_answers_signal = answers
        self._outstanding.append((command.seq, self._step_s))

    def _doubt_instrument(self) -> None:
        """Mark an instrument that has been silent for too long as not following, whatever it published last."""
        silence_s = (self.clock.now_ns() - self._instrument_ns) * 1e-9
        if self.tip.following and silence_s > DEADLINES_S["afm/state"]:
            self._lose_instrument()
            text = f"the AFM has been silent for {silence_s * 1e3:.0f} ms: the hand is let go"
            self.event("fault", "warning", text, silence_s=silence_s)

    def _lose_instrument(self) -> None:
        """Hold the base where it was last commanded to be, until the instrument says where it is."""
        self.tip = self.tip._replace(following=False)
        self.state = "safe"
        self._instrument_lost = True

    def _on_instrument(self, message: AfmState) -> None:
        self.lateral_m, self._lateral_n = message.base_position_m[:2], message.tip_force_n[:2]
        self.tip = TipMeasurement(
            base_position_m=to_paper_axis(message.base_position_m),
            force_n=message.tip_force_n[2],
            separation_m=message.separation_m,
            separation_valid=message.separation_valid,
            in_contact=message.in_contact,
            following=message.mode in ("follow", "hold")
            and not (self._occupied_until_ns and self.clock.now_ns() < self._occupied_until_ns),
        )
        self.state = "running" if self.tip.following else "safe"
        if self._instrument_lost:
            self._instrument_lost = False
            self.reference = SlaveReference(self.tip.base_position_m, True)
            self.law_state = self._standing()
        self._count_port_energy()
        if (
            self._awaited_command_seq is not None
            and message.command_seq == self._awaited_command_seq
            and message.hand_t_ns > 0
        ):
            self._send_answer()
        elif self._awaited_command_seq is None and message.command_seq == self._last_command_seq:
            self._step_locally()
        elif message.hand_t_ns > 0 and not self.switching:
            self._account_for(message.command_seq)

    def _step_locally(self) -> None:
        """Go on with the force of a step that the instrument made by itself, while the last signal still counts."""
        if not self._local or self.switching or self.law_state is None or self._signal_ns is None:
            return
        signal = self.latest_signal()
        if signal.active and signal.silence_s <= self.config.law_config().silence_limit_s and self.tip.following:
            self._receive(signal, 0)
            self._publish_command(answers=False)

    def _count_port_energy(self) -> None:
        section = self.config.law_config()
        count = energy.with_outflow if self.tip.following else energy.moved_to
        self.port = count(
            self.port, self.tip.base_position_m / section.position_scale, section.force_scale * self.tip.force_n
        )

    def _send_answer(self) -> None:
        """Let the half account for what its command did, and send the answer if it was to a signal."""
        self._awaited_command_seq = None
        if self.switching:
            self.law_state = self._standing()
        self.law_state, signal = self._sent(len(self._outstanding))
        if self._command_answers_signal:
            self._publish_answer(signal)

    def _account_for(self, command_seq: int) -> None:
        """Let the half account for a command that the instrument has carried out after a later one was sent."""
        for commands, (seq, _) in enumerate(self._outstanding, start=1):
            if seq == command_seq:
                self.law_state, _ = self._sent(commands)
                return

    def _answer_early(self) -> None:
        """Answer with the newest sample and account for nothing: the instrument has not carried the command out yet.

        To a half that accounts for energy the tip would have stood for this step and moved twice as fast in the next,
        which takes twice the energy for the same way.
        """
        if self._command_answers_signal:
            self._publish_answer(self.law.slave_send(self.params, self.law_state, self.tip, 0.0)[1])

    def _sent(self, commands: int) -> tuple[Any, PortSignal]:
        """Return state and signal of the half after the first of the outstanding commands, whose steps add up."""
        dt_s = sum(step_s for _, step_s in self._outstanding[:commands])
        del self._outstanding[:commands]
        return cast(tuple[Any, PortSignal], self.law.slave_send(self.params, self.law_state, self.tip, dt_s))

    def _publish_answer(self, signal: PortSignal) -> None:
        if not self.passes_deadband(signal, self._dt_s):
            return
        self.publish(
            "teleop/backward",
            **self.signal_fields(signal),
            force_n=(*self._lateral_n, signal.force_n),
            separation_m=signal.separation_m,
            separation_valid=signal.separation_valid,
            in_contact=signal.in_contact,
        )


def half_of_site(context: NodeContext, config: ControllerConfig) -> ControllerHalf:
    """Return the half of the law that belongs to the node's site."""
    half = MasterController if context.key.endswith("@master") else SlaveController
    return cast(ControllerHalf, half(context, config))
