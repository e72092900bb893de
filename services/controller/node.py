"""The controller processes: each runs one half of a law on the arrival of messages."""

import math
from typing import Any, Literal, NamedTuple, cast

from proto.instrument import AfmProgram
from proto.messages import (
    AfmState,
    HapticState,
    LawStatus,
    LinkDelay,
    TeleopBackward,
    TeleopForward,
)
from services.controller import energy, integration
from services.controller.clamp import clamped
from services.controller.config import ControllerConfig
from services.controller.half import ROUND_TRIP_UNKNOWN, ZERO_XY, ControllerHalf, HalfState
from services.controller.integration import Heard, MasterTiming, Settled, SlaveTiming, TimingParams
from services.controller.lateral import (
    DIRECT,
    LOST,
    MET,
    NO_NEWS,
    LateralFar,
    LateralHand,
    LateralMasterState,
    LateralSlaveState,
    Store,
    hand_moves,
    lateral_at_rest,
    lateral_master_step,
    lateral_slave_at_rest,
    lateral_slave_step,
)
from services.controller.law import (
    NO_SIGNAL,
    NO_TIP,
    EnergyAccount,
    HandSample,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
)
from services.numerics.frames import to_paper_axis, to_site_frame
from services.runtime.bus.bus import Received
from services.runtime.loop.freshness import DEADLINES_S
from services.runtime.loop.node import NodeContext
from services.runtime.loop.node_state import FindInput

MASTER_INPUTS = ("haptic/state", "teleop/backward", "law/status", "link/delay", "session/control")
SLAVE_INPUTS = ("teleop/forward", "afm/state", "afm/program", "link/delay", "session/control")
# A program that is silent for so long is over [ns]: it reports ten times a second.
_PROGRAM_SILENCE_NS = 500_000_000
_NO_COMMAND = -2
# An instrument that is behind by more commands than this is taken to be at the oldest of them.
_MOST_OUTSTANDING = 7
# A hand whose device is lost counts as that of an inactive site; a simulated device reports nothing.
_FOLLOWING_DEVICE = (None, "ok")
# A hand that is lost is silent for so long [ns], which is more than a tip holds before it is withdrawn.
_LOST_NS = 1_000_000_000
# The hand comes to rest like a free virtual mass while this half waits for the other one.
_COASTING_S = 0.005
# A way of the tip across the sample that is worth a signal of its own [m].
_LEAST_SENT_M = 1e-10
_NEWS = {
    MET: "met: the tip has met something across the sample, {force:.3g} N",
    LOST: "lost: the tip has lost what it pushed, {force:.3g} N are left",
}


class MasterState(NamedTuple):
    """The state of the master half.

    across: the lateral path, where it has a mode of its own, and sent_m, its reference as it was sent last [m]; hand,
    reference: the newest sample, and the newest reference; tip_reference_m: the last one sent to the slave [m];
    switch_s: time since a change of law [s]; lost_ns: since when the hand's device is lost [ns], 0 while it is not;
    answered: number and time stamp [ns] of the sample of the hand that the newest answer descends from.
    """

    half: HalfState
    timing: MasterTiming
    hand: HandSample
    reference: MasterReference
    tip_reference_m: float
    switch_s: float
    lost_ns: int
    answered: tuple[int, int]
    slave_status: LawStatus | None
    across: LateralMasterState
    sent_m: tuple[float, float]


class SlaveState(NamedTuple):
    """The state of the slave half.

    tip, reference: the newest sample, and the newest reference; asked_m: the references of the newest commands, the
    newest first, and carried_out_m, that of the one which the instrument had carried out at its newest sample [m];
    lateral_n: force on the tip in x and y [N]; instrument_ns: time of the newest sample [ns]; occupied_until_ns: by a
    program of the instrument [ns].
    """

    half: HalfState
    timing: SlaveTiming
    tip: TipMeasurement
    reference: SlaveReference
    asked_m: tuple[float, ...]
    carried_out_m: float
    lateral_n: tuple[float, float]
    instrument_ns: int
    instrument_lost: bool
    occupied_until_ns: int
    across: LateralSlaveState


class MasterController(ControllerHalf):
    """The half at the operator's site: haptic/state in, teleop/forward out; teleop/backward in, haptic/command out.

    One command a tick of the hand: when the answer to the tick comes, or else at the next tick.
    """

    inputs, state_kind = MASTER_INPUTS, MasterState
    # After this the tick is at the slave's side.
    idle_after = "haptic/state"

    def __init__(self, context: NodeContext, config: ControllerConfig) -> None:
        super().__init__(context, config)
        self.hand = HandSample(0.0, 0.0, 0.0, False)
        self.reference = MasterReference(0.0, 0.0, 0.0, False)
        self._tip_reference_m = 0.0
        self._switch_s = 0.0
        self._lost_ns = 0
        self.timing = integration.master_begin()
        self._answered_hand_stamp = (0, 0)
        self._slave_status: LawStatus | None = None
        self._across = lateral_at_rest()
        self._sent_m = ZERO_XY

    def capture(self) -> MasterState:
        return MasterState(
            half=self.capture_half(),
            timing=self.timing,
            hand=self.hand,
            reference=self.reference,
            tip_reference_m=self._tip_reference_m,
            switch_s=self._switch_s,
            lost_ns=self._lost_ns,
            answered=self._answered_hand_stamp,
            slave_status=self._slave_status,
            across=self._across,
            sent_m=self._sent_m,
        )

    def restore(self, state: MasterState, find: FindInput) -> None:
        self.restore_half(state.half)
        self.timing, self.hand, self.reference = state.timing, state.hand, state.reference
        self._tip_reference_m, self._switch_s = state.tip_reference_m, state.switch_s
        self._lost_ns = state.lost_ns
        self._answered_hand_stamp, self._slave_status = state.answered, state.slave_status
        self._across, self._sent_m = state.across, state.sent_m

    def started(self) -> Any:
        return self.law.master_start(self.params, self.hand)

    def on_message(self, received: Received) -> None:
        if self.rejects(received):
            return
        message = received.message
        if type(message) is HapticState:
            self._on_hand(message)
        elif type(message) is TeleopBackward:
            if self.receive_signal(message):
                self.timing = integration.master_heard(self.timing, received.received_ns, message.hand_t_ns)
                if self.switching:
                    self._take_over()
            self._answered_hand_stamp = (message.hand_seq, message.hand_t_ns)
            self._settle()
        elif type(message) is LawStatus:
            self._slave_status = message
        elif type(message) is LinkDelay:
            self.freshness.record(message)

    @property
    def heard(self) -> Heard:
        return self.timing.heard

    def timing_of(self, config: ControllerConfig) -> TimingParams:
        return config.master_timing()

    def forget(self) -> None:
        super().forget()
        self.timing = integration.master_stalled(self.timing)

    def retuned(self, old: Any, new: Any) -> Any:
        """Carry the state over without a jump at the tip."""
        return self.law.retune(old, new, self.law_state)

    def energy_account(self) -> EnergyAccount:
        return cast(EnergyAccount, self.law.master_energy_account(self.params, self.law_state))

    def round_trip_s(self) -> tuple[float, bool]:
        if self.heard.received_ns < 0:
            return ROUND_TRIP_UNKNOWN
        return integration.round_trip_periods(self.timing, self.timing_params) * self.config.period_s, True

    def _switch(self) -> None:
        super()._switch()
        self.timing = integration.master_silenced(self.timing)
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
        if self._hand_is_lost(message):
            self.hand, self.state = self.hand._replace(following=False), "safe"
            return
        commanded, repeated = self._settle(), message.device == "stale"
        self.timing, found = integration.master_sampled(
            self.timing, self.timing_params, message.t_ns, repeated, commanded
        )
        if not repeated:
            self._take_sample(message, found.periods * self.config.period_s, begins=found.begins)
        if found.repeats:
            self._send_reference()
        if found.periods:
            self._send_signal(found.periods * self.config.period_s)

    def _hand_is_lost(self, message: HapticState) -> bool:
        """Return whether this half keeps silent: nobody is at the hand, as after its node was killed.

        The tip holds and withdraws meanwhile, by the deadlines of its own guard. After that this half goes on with an
        inactive hand, so that the tip can be armed.
        """
        if message.device != "lost":
            self._lost_ns = 0
            return False
        self._lost_ns = self._lost_ns or message.t_ns
        return message.t_ns - self._lost_ns < _LOST_NS

    def _take_sample(self, message: HapticState, dt_s: float, *, begins: bool) -> None:
        """Take up where the hand is, dt_s [s] after the last sample, and count the work that it did on its way."""
        self._hand_stamp = (message.seq, message.t_ns)
        following = self.hand.following
        self.hand = HandSample(
            to_paper_axis(message.position_m),
            to_paper_axis(message.velocity_m_per_s),
            to_paper_axis(message.operator_force_n),
            message.mode != "off" and message.device in _FOLLOWING_DEVICE,
        )
        x, y, _ = message.position_m
        if self.lateral.motion.mode != DIRECT:
            self._move_across(message, dt_s)
        elif x or y:
            self.lateral_m = self._at_the_tip(x, y)
        else:
            self.lateral_m = ZERO_XY
        if self.law_state is None:
            self.law_state = self.law.master_start(self.params, self.hand)
        if begins:
            self.port = energy.opened(self.hand.position_m, self.hand.force_n)
        # the sample's force acted over the way to the sample's position
        counts = not begins and following and self.hand.following and self.reference.active
        count = energy.with_inflow if counts and not self.switching else energy.moved_to
        self.port = count(self.port, self.hand.position_m, self.hand.force_n)

    def _send_signal(self, dt_s: float) -> None:
        hand = self.hand._replace(following=False) if self.switching else self._guided_hand()
        self.law_state, signal = self.law.master_send(self.params, self.law_state, hand, dt_s)
        self._tip_reference_m = signal.position_m
        # What the hand moves across is sent whether or not the dead band passes the law's signal.
        if self.passes_deadband(signal, dt_s) or self._has_moved_across():
            self._sent_m = self.lateral_m
            self.publish("teleop/forward", **self.signal_fields(signal), force_n=to_site_frame(signal.force_n))
        self.steps += 1
        slave = self._slave_status
        self.report_status(slave.port_energy_j if slave is not None and slave.law == self.law.name else None)

    def _at_the_tip(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return where a hand of three axes wants the tip over the sample [m]."""
        scale = self.config.law_config().position_scale
        return scale * x_m, scale * y_m

    def _move_across(self, message: HapticState, dt_s: float) -> None:
        """Take the hand's way across, in a mode of its own, and say what it has met or lost."""
        if dt_s <= 0.0:
            return
        x, y, _ = message.position_m
        speed_x, speed_y, _ = message.velocity_m_per_s
        follows = self.hand.following and not self.switching
        hand = LateralHand(x, y, self.hand.position_m, speed_x, speed_y, self.hand.velocity_m_per_s, following=follows)
        known = self.signal.active and self._silence_s() <= self.config.law_config().silence_limit_s
        far = LateralFar(*self.far_lateral, *self.far_place, known=known)
        self._across = lateral_master_step(self.lateral, self._across, hand, far, dt_s)
        travel = self._across.travel
        self.lateral_m = travel.x_m, travel.y_m
        if self._across.news != NO_NEWS:
            force_n = math.sqrt(self.far_lateral[0] ** 2 + self.far_lateral[1] ** 2)
            text = _NEWS[self._across.news]
            self.event("mode", "info", text.format(force=force_n), lateral=text.split(":")[0], force_n=force_n)

    def _has_moved_across(self) -> bool:
        if self.lateral.motion.mode == DIRECT:
            return False
        (x, y), (sent_x, sent_y) = self.lateral_m, self._sent_m
        return abs(x - sent_x) + abs(y - sent_y) >= _LEAST_SENT_M

    def _guided_hand(self) -> HandSample:
        """Return the hand with the force of the hold of its depth, as a law takes it."""
        force_n = self._across.force_n[2]
        return self.hand._replace(force_n=self.hand.force_n + force_n) if force_n else self.hand

    def lateral_account(self) -> Store:
        return self._across.store

    def _lateral_force(self) -> tuple[float, float]:
        """Return the lateral force of the sample at the hand's scale [N]."""
        if self.lateral.motion.mode != DIRECT:
            return self._across.force_n[:2]
        x, y = self.far_lateral
        scale = self.config.law_config().force_scale if x or y else 0.0
        return scale * x, scale * y

    def _settle(self) -> bool:
        """Send the command that is due; return whether one was."""
        dt_s = self.timing.due * self.config.period_s
        if not dt_s:
            return False
        self.timing = integration.master_settled(self.timing)
        self.reference = self._coasting(dt_s) if self.switching else self._step_law(dt_s)
        self.state = "running" if self.reference.active else "safe"
        self._send_reference()
        return True

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

    def _step_law(self, dt_s: float) -> MasterReference:
        signal = self.latest_signal()
        self.law_state, reference = self.law.master_receive(
            self.params, self.law_state, self._guided_hand(), signal, dt_s
        )
        return cast(MasterReference, reference)

    def _coasting(self, dt_s: float) -> MasterReference:
        """Return the reference while the other half is waited for: it comes to rest, and the force shown stays."""
        self._switch_s += dt_s
        last, fades = self.reference, math.exp(-dt_s / _COASTING_S)
        active = last.active and self._switch_s <= self.config.switch_limit_s
        position_m, velocity_m_per_s = self.hand.position_m, 0.0
        if self.hand.following:
            position_m = last.position_m + _COASTING_S * (1.0 - fades) * last.velocity_m_per_s
            velocity_m_per_s = fades * last.velocity_m_per_s
        return MasterReference(position_m, velocity_m_per_s, last.force_n, active)


class SlaveController(ControllerHalf):
    """The half at the instrument's site: teleop/forward in, afm/command out; afm/state in, teleop/backward out."""

    inputs, state_kind = SLAVE_INPUTS, SlaveState
    # After this the tick is in the link, which may share its processor.
    idle_after = "afm/state"

    def __init__(self, context: NodeContext, config: ControllerConfig) -> None:
        super().__init__(context, config)
        self.tip = NO_TIP
        self.reference = SlaveReference(0.0, True)
        self.timing = integration.slave_begin()
        self._clamp = config.clamp_params()
        self._instrument_ns = 0
        self._instrument_lost = False
        self._lateral_n = ZERO_XY
        self._asked_m: tuple[float, ...] = (0.0,)
        self._carried_out_m = 0.0
        # The instrument images or measures by itself until then, and obeys no hand.
        self._occupied_until_ns = 0
        self._across = lateral_slave_at_rest()

    def capture(self) -> SlaveState:
        return SlaveState(
            half=self.capture_half(),
            timing=self.timing,
            tip=self.tip,
            reference=self.reference,
            asked_m=self._asked_m,
            carried_out_m=self._carried_out_m,
            lateral_n=self._lateral_n,
            instrument_ns=self._instrument_ns,
            instrument_lost=self._instrument_lost,
            occupied_until_ns=self._occupied_until_ns,
            across=self._across,
        )

    def restore(self, state: SlaveState, find: FindInput) -> None:
        self.restore_half(state.half)
        self.timing, self.tip, self.reference = state.timing, state.tip, state.reference
        self._asked_m, self._carried_out_m = state.asked_m, state.carried_out_m
        self._lateral_n, self._instrument_ns = state.lateral_n, state.instrument_ns
        self._instrument_lost, self._occupied_until_ns = state.instrument_lost, state.occupied_until_ns
        self._across = state.across

    def started(self) -> Any:
        return self.law.slave_start(self.params, self.tip)

    def on_message(self, received: Received) -> None:
        if self.rejects(received):
            return
        message = received.message
        if type(message) is TeleopForward:
            self._on_forward(message, received.received_ns)
        elif type(message) is AfmState:
            self._instrument_ns = self.freshness.stamp_ns(message.t_ns, received.received_ns)
            self._on_instrument(message, received.received_ns)
        elif type(message) is AfmProgram:
            occupied = message.program != "tactile" and message.state in ("running", "paused")
            self._occupied_until_ns = received.received_ns + _PROGRAM_SILENCE_NS if occupied else 0
        elif type(message) is LinkDelay:
            self.freshness.record(message)

    @property
    def heard(self) -> Heard:
        return self.timing.heard

    def timing_of(self, config: ControllerConfig) -> TimingParams:
        return config.slave_timing()

    def forget(self) -> None:
        super().forget()
        self.timing = integration.slave_stalled(self.timing)
        if self.tip.following:
            self._lose_instrument()

    def energy_account(self) -> EnergyAccount:
        return cast(EnergyAccount, self.law.slave_energy_account(self.params, self.law_state))

    def _adopt(self, config: ControllerConfig) -> None:
        super()._adopt(config)
        self._clamp = config.clamp_params()

    def _switch(self) -> None:
        super()._switch()
        self.timing = integration.slave_silenced(self.timing)
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
        if self.timing.commands.waiting:
            # The instrument has not answered the last tick, so its newest sample is used for as long as it is fresh.
            self._doubt_instrument()
        early = self.law.local_loop and not self._instrument_lost and not self.switching
        self.timing, settled = integration.slave_unanswered(self.timing, early)
        self._settle(settled)
        self._hand_stamp = (message.hand_seq, message.hand_t_ns)
        understood = self.receive_signal(message)
        self.switching = self.switching and not (understood and message.active)
        self.timing, begins = integration.slave_signalled(
            self.timing, self.timing_params, received_ns, message.hand_t_ns, understood
        )
        if self.law_state is None:
            self.law_state = self.law.slave_start(self.params, self.tip)
        elif begins and not self.switching:
            self.law_state = self._interrupted()
        goes_on = not (begins or self._instrument_lost or self.switching)
        if self.lateral.motion.mode != DIRECT:
            follows = goes_on and understood and message.active and self.tip.following
            elapsed_s = self.timing.pacing.elapsed * self.config.period_s
            self._across = lateral_slave_step(
                self.lateral, self._across, self.far_lateral, self.lateral_m, follows, elapsed_s
            )
        if goes_on and integration.slave_passes_over(self.timing, self.timing_params, self.clock.now_ns()):
            self.timing = integration.slave_passed_over(self.timing)
        else:
            if self._instrument_lost:
                self.reference = SlaveReference(self.reference.position_m, False)
            elif not self.switching:
                self._receive(self.latest_signal(), self.timing.pacing.elapsed)
            self._publish_command(answers=True)
        self.steps += 1
        self.report_status(None)

    def _receive(self, signal: PortSignal, elapsed: int) -> None:
        """Step the half by what it is behind the hand; elapsed: periods that a signal has brought, 0 without one."""
        self.timing = integration.slave_stepped(self.timing, self.timing_params, self.clock.now_ns(), elapsed)
        dt_s = self.timing.pacing.step * self.config.period_s
        tip = TipMeasurement(*self.tip[:-1], self._asked_m[0] - self._carried_out_m)
        self.law_state, wanted = self.law.slave_receive(self.params, self.law_state, signal, tip, dt_s)
        self.reference = clamped(self._clamp, wanted, signal, tip)

    def _publish_command(self, *, answers: bool) -> None:
        mode: Literal["position", "hold"] = "position" if self.reference.active else "hold"
        is_direct = self.lateral.motion.mode == DIRECT
        moves = not is_direct and hand_moves(self._across)
        across = {"lateral_m": (self._across.x_m, self._across.y_m)} if moves else {}
        command = self.publish(
            "afm/command",
            mode=mode,
            base_position_m=(*(self.far_lateral if is_direct else ZERO_XY), 0.0 - self.reference.position_m),
            hand_seq=self._hand_stamp[0],
            hand_t_ns=self._hand_stamp[1],
            **across,
        )
        self.timing = integration.slave_commanded(self.timing, command.seq, answers)
        self._asked_m = (self.reference.position_m, *self._asked_m[:_MOST_OUTSTANDING])

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

    def _on_instrument(self, message: AfmState, now_ns: int) -> None:
        self.lateral_m, self._lateral_n = message.base_position_m[:2], message.tip_force_n[:2]
        self.tip = TipMeasurement(
            base_position_m=to_paper_axis(message.base_position_m),
            force_n=message.tip_force_n[2],
            separation_m=message.separation_m,
            separation_valid=message.separation_valid,
            in_contact=message.in_contact,
            following=message.mode in ("follow", "hold")
            and not (self._occupied_until_ns and self.clock.now_ns() < self._occupied_until_ns),
            outstanding_m=0.0,
        )
        self.state = "running" if self.tip.following else "safe"
        if self._instrument_lost:
            self._instrument_lost = False
            self.reference = SlaveReference(self.tip.base_position_m, True)
            self.law_state = self._standing()
        self._count_port_energy()
        follows = self.law_state is not None and self.signal.active and self.tip.following
        # an instrument that has no command yet names the first one
        number = message.command_seq if message.hand_t_ns > 0 else _NO_COMMAND
        later = max(self.timing.commands.newest - number, 0)
        self._carried_out_m = self._asked_m[min(later, len(self._asked_m) - 1)]
        self.timing, settled = integration.slave_measured(
            self.timing, self.timing_params, now_ns, number, self.switching, follows
        )
        self._settle(settled)

    def _count_port_energy(self) -> None:
        section = self.config.law_config()
        count = energy.with_outflow if self.tip.following else energy.moved_to
        self.port = count(
            self.port, self.tip.base_position_m / section.position_scale, section.force_scale * self.tip.force_n
        )

    def _settle(self, settled: Settled) -> None:
        """Carry out what is due after a state of the instrument, or where none came."""
        if settled.what not in (integration.NOTHING, integration.GO_ON):
            if settled.what == integration.ANSWER and self.switching:
                self.law_state = self._standing()
            dt_s = settled.periods * self.config.period_s
            state, signal = self.law.slave_send(self.params, self.law_state, self.tip, dt_s)
            if settled.what != integration.ANSWER_EARLY:
                self.law_state = state
            if settled.answers:
                self._publish_answer(signal)
        if settled.what == integration.GO_ON or settled.goes_on:
            self._receive(self.latest_signal(), 0)
            self._publish_command(answers=False)

    def _publish_answer(self, signal: PortSignal) -> None:
        if not self.passes_deadband(signal, self.timing.pacing.elapsed * self.config.period_s):
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
