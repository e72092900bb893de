"""The half of a law at the operator's site, as a node that runs when messages arrive.

A sample comes from `services/haptic_node/node.py`. `telenano/laws/integration.py` decides when the law steps, and the
signal goes to `services/delay_node/node.py`; the answer comes back from there, and its command goes to the hand.
"""

import math
from typing import Any, cast

import msgspec

from services.controller.half import ROUND_TRIP_UNKNOWN, ZERO_XY, ControllerHalf, HalfState
from telenano.extend.laws import EnergyAccount, HandSample, MasterReference
from telenano.laws import energy, integration
from telenano.laws.hand_limits import Trial, free, let_through, received_within
from telenano.laws.integration import MasterTiming, TimingParams
from telenano.laws.lateral import (
    DIRECT,
    LOST,
    MET,
    NO_NEWS,
    EnergyTank,
    LateralFar,
    LateralHand,
    LateralMasterState,
    lateral_at_rest,
    lateral_master_step,
)
from telenano.numerics.frames import to_paper_axis, to_site_frame
from telenano.runtime.loop.node import NodeContext
from telenano.sections.controller_section import ControllerConfig
from telenano.timing.freshness import DEADLINES_S
from telenano.wire.messages import HapticState, LawStatus, LinkDelay, TeleopBackward
from telenano.wire.received import Received

# States of the device with which the hand can follow; a simulated device reports None. The hand of a lost device counts
# as inactive.
_FOLLOWING_DEVICE = (None, "ok")
# Time without a fresh answer after which the hand counts as feeling nothing, and the tip stops following it [ns]. With
# the 50 ms for which an answer is fresh and the 50 ms after which the instrument holds, the tip stops within 0.5 s of
# the last answer, plus the round trip that the link reports.
UNANSWERED_NS = 350_000_000
# Time constant with which the hand comes to rest, like a free virtual mass, while this half waits for the other [s].
_COASTING_S = 0.005
# Drift of the sample that is worth a warning [m/s]: at a scale of 1.5e-6 it separates hand and tip by more than 0.1 mm
# in a quarter of a minute.
_LEAST_DRIFT_M_PER_S = 1e-11
# Lateral motion of the tip for which a signal is sent in any case [m].
_LEAST_SENT_M = 1e-10
_NEWS = {
    MET: "met: the tip has met something across the sample, {force:.3g} N",
    LOST: "lost: the tip has lost what it pushed, {force:.3g} N are left",
}


class MasterState(msgspec.Struct, array_like=True, kw_only=True):
    """The state of the master half.

    drifts: whether a warning of a drift is in force; across: state of the lateral path in the modes rate and position,
    and sent_m, its reference as last sent [m]; hand, reference: the newest sample and the newest reference;
    tip_reference_m: the tip's reference last sent to the slave [m]; switch_s: time since a change of law [s]; armed:
    whether the hand was armed in its newest sample and feels the tip; answered: number and time stamp [ns] of the
    hand's sample that the newest answer is about; felt_ns: time stamp of the newest sample in which the hand had a
    fresh answer [ns], 0 before the first, -1 if an older recording does not state it.
    """

    half: HalfState
    timing: MasterTiming
    hand: HandSample = HandSample(0.0, 0.0, 0.0, False)
    reference: MasterReference = MasterReference(0.0, 0.0, 0.0, False)
    tip_reference_m: float = 0.0
    switch_s: float = 0.0
    armed: bool = False
    answered: tuple[int, int] = (0, 0)
    slave_status: LawStatus | None = None
    across: LateralMasterState
    sent_m: tuple[float, float] = ZERO_XY
    drifts: bool
    felt_ns: int = -1
    stop: Trial = free()


class MasterController(ControllerHalf):
    """The half at the operator's site: haptic/state in, teleop/forward out; teleop/backward in, haptic/command out.

    It sends one command for each tick of the hand: when the answer to the tick arrives, or else at the next tick.

    Without answers the tip does not follow: the signals to the slave's site declare the hand armed only while it feels
    the tip. The hand reports the newest of its samples to which it has an answer, so their age is by its own clock.
    """

    inputs = ("haptic/state", "teleop/backward", "law/status", "link/delay", "session/control")
    state_kind = MasterState
    memory: MasterState
    # After this input the tick continues at the slave's site.
    idle_after = "haptic/state"

    def __init__(self, context: NodeContext, config: ControllerConfig) -> None:
        super().__init__(context, config)
        self.memory = MasterState(
            half=self.half, timing=integration.master_begin(), across=lateral_at_rest(), drifts=False, felt_ns=0
        )

    def started(self) -> Any:
        return self.law.master_start(self.params, self.memory.hand)

    def on_message(self, received: Received) -> None:
        memory = self.memory
        if self.rejects(received):
            return
        message = received.message
        if type(message) is HapticState:
            self._on_hand(message)
        elif type(message) is TeleopBackward:
            if understood := self.receive_signal(message):
                memory.timing = integration.master_heard(memory.timing, received.received_ns, message.hand_t_ns)
                if self.half.switching:
                    self._take_over()
            # An answer in another law is none, except to a hand that is held while the law changes.
            if understood or (self.half.switching and memory.reference.active):
                memory.answered = (message.hand_seq, message.hand_t_ns)
            self._settle()
        elif type(message) is LawStatus:
            memory.slave_status = message
        elif type(message) is LinkDelay:
            self.freshness.record(message)

    def timing_of(self, config: ControllerConfig) -> TimingParams:
        return config.master_timing()

    def forget(self) -> None:
        super().forget()
        self.memory.timing = integration.master_stalled(self.memory.timing)

    @property
    def touches(self) -> bool:
        return self.half.signal.active and self.half.signal.in_contact

    def retuned(self, old: Any, new: Any) -> Any:
        return self.law.retune(old, new, self.law_state)

    def energy_account(self) -> EnergyAccount:
        return cast(EnergyAccount, self.law.master_energy_account(self.params, self.law_state))

    def round_trip_s(self) -> tuple[float, bool]:
        if self.heard.received_ns < 0:
            return ROUND_TRIP_UNKNOWN
        return integration.round_trip_periods(self.memory.timing, self.timing_params) * self.config.period_s, True

    def _switch(self) -> None:
        memory = self.memory
        super()._switch()
        memory.timing = integration.master_silenced(memory.timing)
        memory.switch_s = 0.0
        if self.half.switching:
            self.law_state = self._resumed(memory.reference, memory.tip_reference_m)

    def _resumed(self, reference: MasterReference, tip_reference_m: float) -> Any:
        sample = HandSample(
            reference.position_m, reference.velocity_m_per_s, self.memory.hand.force_n, self.memory.hand.following
        )
        return self.law.master_resume(self.params, sample, tip_reference_m)

    def _take_over(self) -> None:
        """Continue with the new law from the hand's reference and from the base position that the slave reports."""
        half = self.half
        half.switching = False
        tip_m = half.signal.position_m if half.signal.active else self.memory.tip_reference_m
        self.law_state = self._resumed(self.memory.reference, tip_m)

    def _on_hand(self, message: HapticState) -> None:
        commanded, repeated = self._settle(), message.device == "stale"
        self.memory.timing, step = integration.master_sampled(
            self.memory.timing, self.timing_params, message.t_ns, repeated, commanded
        )
        if not repeated:
            self._take_sample(message, step.periods * self.config.period_s, begins=step.begins)
        if step.repeats:
            self._send_reference()
        if step.periods:
            self._send_signal(step.periods * self.config.period_s)

    def _take_sample(self, message: HapticState, dt_s: float, *, begins: bool) -> None:
        """Store a sample of the hand, dt_s [s] after the last one, and add the work done at the device in between.

        begins: the sequence of samples begins or begins again, so the work is counted from this sample on.
        """
        memory, half = self.memory, self.half
        half.hand_stamp = (message.seq, message.t_ns)
        memory.armed = self._feels(message) and message.armed is True
        following = memory.hand.following
        memory.hand = HandSample(
            to_paper_axis(message.position_m),
            to_paper_axis(message.velocity_m_per_s),
            to_paper_axis(message.operator_force_n),
            message.mode != "off" and message.device in _FOLLOWING_DEVICE,
        )
        x, y, _ = message.position_m
        if self.lateral.motion.mode != DIRECT:
            self._move_across(message, dt_s)
        elif x or y:
            scale = self.config.law_config().position_scale
            half.lateral_m = scale * x, scale * y
        else:
            half.lateral_m = ZERO_XY
        if self.law_state is None:
            self.law_state = self.law.master_start(self.params, memory.hand)
        if begins:
            half.port = energy.opened(memory.hand.position_m, memory.hand.force_n)
        # The force of a sample acted over the motion that ends at its position.
        counts = not begins and following and memory.hand.following and memory.reference.active
        count = energy.with_inflow if counts and not half.switching else energy.moved_to
        half.port = count(half.port, memory.hand.position_m, memory.hand.force_n)

    def _feels(self, message: HapticState) -> bool:
        """Return whether the hand had a fresh answer of the tip's site at a sample, or at most 350 ms before it.

        Warn once when an armed hand stops having one.
        """
        memory = self.memory
        age_s = self.freshness.answer_age_s(message.t_ns, message.answered_t_ns)
        if memory.felt_ns < 0 or age_s <= DEADLINES_S["teleop/backward"]:
            memory.felt_ns = message.t_ns
        feels = memory.felt_ns > 0 and 0 <= message.t_ns - memory.felt_ns <= UNANSWERED_NS
        if memory.armed and message.armed is True and not feels:
            silent_s = (message.t_ns - memory.felt_ns) * 1e-9
            text = f"no fresh answer has reached the hand for {silent_s * 1e3:.0f} ms: the tip does not follow it"
            self.event("fault", "warning", text, unanswered_s=silent_s)
        return feels

    def _send_signal(self, dt_s: float) -> None:
        memory = self.memory
        hand = let_through(memory.stop, self._guided_hand())
        if self.half.switching:
            hand = memory.hand._replace(following=False)
        self.law_state, signal = self.law.master_send(self.params, self.law_state, hand, dt_s)
        memory.tip_reference_m = signal.position_m
        # Lateral motion of the hand is sent even if the dead band holds the law's signal back.
        if self.passes_deadband(signal, dt_s) or self._has_moved_across():
            memory.sent_m = self.half.lateral_m
            force_n = to_site_frame(signal.force_n)
            self.publish("teleop/forward", **self.signal_fields(signal), force_n=force_n, hand_armed=memory.armed)
        self.steps += 1
        self._watch_drift()
        slave = memory.slave_status
        self.report_status(slave.port_energy_j if slave is not None and slave.law == self.law.name else None)

    def _watch_drift(self) -> None:
        """Warn once of a sample that drifts, with two standard errors of confidence, too fast for hand and tip."""
        memory = self.memory
        if self.law.sample_drift is None or self.half.switching or not self.touches:
            return
        speed, error = self.law.sample_drift(self.params, self.law_state)
        if memory.drifts:
            memory.drifts = abs(speed) + 2.0 * error > _LEAST_DRIFT_M_PER_S
        elif abs(speed) - 2.0 * error > _LEAST_DRIFT_M_PER_S:
            memory.drifts = True
            way = "recedes" if speed > 0.0 else "comes nearer"
            text = f"the sample {way} by {1e12 * abs(speed):.3g} ± {2e12 * error:.2g} pm/s: hand and tip may part"
            self.event("mode", "warning", text, drift_m_per_s=speed, error_m_per_s=error)

    def _move_across(self, message: HapticState, dt_s: float) -> None:
        """Step the lateral path of mode rate or position, dt_s [s] after the last sample; report news of a particle."""
        memory, half = self.memory, self.half
        if dt_s <= 0.0:
            return
        x, y, _ = message.position_m
        speed_x, speed_y, _ = message.velocity_m_per_s
        follows = memory.hand.following and not half.switching
        hand = LateralHand(
            x, y, memory.hand.position_m, speed_x, speed_y, memory.hand.velocity_m_per_s, following=follows
        )
        is_signal_current = half.signal.active and self._silence_s() <= self.config.law_config().silence_limit_s
        far = LateralFar(*half.far_lateral, *half.far_place, known=is_signal_current)
        memory.across = lateral_master_step(self.lateral, memory.across, hand, far, dt_s)
        travel = memory.across.travel
        half.lateral_m = travel.x_m, travel.y_m
        if memory.across.news != NO_NEWS:
            force_n = math.sqrt(half.far_lateral[0] ** 2 + half.far_lateral[1] ** 2)
            text = _NEWS[memory.across.news]
            self.event("mode", "info", text.format(force=force_n), lateral=text.split(":")[0], force_n=force_n)

    def _has_moved_across(self) -> bool:
        if self.lateral.motion.mode == DIRECT:
            return False
        (x, y), (sent_x, sent_y) = self.half.lateral_m, self.memory.sent_m
        return abs(x - sent_x) + abs(y - sent_y) >= _LEAST_SENT_M

    def _guided_hand(self) -> HandSample:
        """Return the hand's sample for the law, with the force of the depth hold added to that of the operator."""
        memory = self.memory
        force_n = memory.across.force_n[2]
        return memory.hand._replace(force_n=memory.hand.force_n + force_n) if force_n else memory.hand

    def lateral_account(self) -> EnergyTank:
        return self.memory.across.store

    def _lateral_force(self) -> tuple[float, float]:
        """Return the lateral force of the sample at the hand's scale [N]."""
        if self.lateral.motion.mode != DIRECT:
            return self.memory.across.force_n[:2]
        x, y = self.half.far_lateral
        scale = self.config.law_config().force_scale if x or y else 0.0
        return scale * x, scale * y

    def _settle(self) -> bool:
        """Send the command that is due, and return True; return False if none is due."""
        memory = self.memory
        dt_s = memory.timing.due * self.config.period_s
        if not dt_s:
            return False
        memory.timing = integration.master_settled(memory.timing)
        memory.reference = self._coasting(dt_s) if self.half.switching else self._step_law(dt_s)
        self.state = "running" if memory.reference.active else "safe"
        self._send_reference()
        return True

    def _send_reference(self) -> None:
        memory = self.memory
        self.publish(
            "haptic/command",
            mode="position" if memory.reference.active else "off",
            position_m=to_site_frame(memory.reference.position_m),
            velocity_m_per_s=to_site_frame(memory.reference.velocity_m_per_s),
            force_n=(*self._lateral_force(), memory.reference.force_n),
            hand_seq=memory.answered[0],
            hand_t_ns=memory.answered[1],
        )

    def _step_law(self, dt_s: float) -> MasterReference:
        """Step the law, with the part of the hand's force that the limits of the hand let through."""
        memory = self.memory
        self.law_state, reference, memory.stop = received_within(
            self.hand_limits,
            self.law.master_receive,
            self.params,
            self.law_state,
            self._guided_hand(),
            self.latest_signal(),
            dt_s,
            memory.reference,
            memory.tip_reference_m,
        )
        return reference

    def _coasting(self, dt_s: float) -> MasterReference:
        """Return the reference while this half waits for the other: it comes to rest, and the displayed force stays."""
        memory = self.memory
        memory.switch_s += dt_s
        last, fades = memory.reference, math.exp(-dt_s / _COASTING_S)
        active = last.active and memory.switch_s <= self.config.switch_limit_s
        position_m, velocity_m_per_s = memory.hand.position_m, 0.0
        if memory.hand.following:
            position_m = last.position_m + _COASTING_S * (1.0 - fades) * last.velocity_m_per_s
            velocity_m_per_s = fades * last.velocity_m_per_s
        return MasterReference(position_m, velocity_m_per_s, last.force_n, active)
