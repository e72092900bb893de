"""The two sites of the closed loop in lockstep: states and steps of both halves, the hand and the instrument.

The steps are those that the nodes call; `telenano.lockstep.lockstep` calls them in the order of the bus.
"""

from typing import Any, NamedTuple

import numpy as np

from telenano.afm import safety as afm_safety
from telenano.afm.step import LONGEST_STEP_NS, AfmInputs, AfmOutputs, command_wait_ns
from telenano.afm.step import step as instrument_step
from telenano.extend.hands import MODE_OFF, MODE_POSITION
from telenano.extend.laws import (
    NO_SIGNAL,
    NO_TIP,
    HandSample,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
)
from telenano.hand.part import place_of
from telenano.hand.step import HapticInputs, HapticParams
from telenano.hand.step import HapticStepState as HapticChainState
from telenano.hand.step import step as haptic_step
from telenano.laws import integration
from telenano.laws.clamp import ClampParams, clamped
from telenano.laws.deadband import DeadbandParams, DeadbandState, deadband, initial_deadband_state
from telenano.laws.hand_limits import HandLimits, Trial, begun, cut, ends, free, let_through, tried, with_force
from telenano.laws.integration import MasterTiming, NewestSignal, SlaveDecision, SlaveTiming, TimingParams
from telenano.lockstep.across import AcrossPath, Array
from telenano.lockstep.dispatch import master_receive, master_send, master_start, slave_receive, slave_send, slave_start
from telenano.numerics.compiler import inlined
from telenano.wire.messages import DELAY_STEP_NS
from telenano.wire.topics import LOOP_DEADLINE_S

# A rate of the hand that is older than the deadline of the loop moves nothing [ns].
_RATE_NS = round(LOOP_DEADLINE_S * 1e9)


class Halves(NamedTuple):
    """Constants of the two halves: the law, the dead band, the clamp behind the slave half, and their timing."""

    law: Any
    band: DeadbandParams
    clamp: ClampParams
    master: TimingParams
    slave: TimingParams
    period_s: float
    hand: HandLimits


@inlined
def _tip_of(answer: AfmOutputs) -> TipMeasurement:
    """Return the part of the instrument's answer that the slave half uses."""
    sample, mode = answer.sample, answer.allowed.mode
    following = mode == afm_safety.MODE_FOLLOW or mode == afm_safety.MODE_HOLD
    return TipMeasurement(
        # A half gets the position that the base would have without the offset.
        base_position_m=sample.base_m + answer.allowed.offset_m if following else sample.base_m,
        force_n=sample.force_n,
        separation_m=sample.distance_m,
        separation_valid=True,
        in_contact=sample.in_contact,
        following=following,
        # The instrument carries out each command before the next one comes.
        outstanding_m=0.0,
    )


@inlined
def _latest(signal: PortSignal, heard: NewestSignal, now_ns: int, round_trip_s: float) -> PortSignal:
    """Return the newest signal with silence and round trip [s], which its receiver fills in."""
    if heard.received_ns < 0:
        return NO_SIGNAL
    return PortSignal(
        position_m=signal.position_m,
        velocity_m_per_s=signal.velocity_m_per_s,
        force_n=signal.force_n,
        wave_sqrt_w=signal.wave_sqrt_w,
        energy_j=signal.energy_j,
        separation_m=signal.separation_m,
        separation_valid=signal.separation_valid,
        in_contact=signal.in_contact,
        active=signal.active,
        silence_s=integration.silence_ns(heard, now_ns) * 1e-9,
        round_trip_s=round_trip_s,
    )


@inlined
def _reported_delay_ns(delay_ns: int) -> int:
    """Return the part of a delay that the link reports to the guards: whole steps [ns]."""
    return delay_ns - delay_ns % DELAY_STEP_NS


class HandCommand(NamedTuple):
    """A command to the haptic site: mode, x_mr [m], and the times from which its age counts [ns]; -1 for none."""

    mode: int
    position_m: float
    sent_ns: int
    hand_ns: int


class Master(NamedTuple):
    """State of the master half.

    signal: the newest one received; answered_ns: time of the sample that it answers plus the reported delays [ns];
    band: dead band of the signals that it sends; command: to the hand; rendered_n: force that the law attributes to the
    environment [N]; reference, tip_reference_m: newest references of hand and tip; stop: the force that the
    limits of the hand let through in the newest step.
    """

    timing: MasterTiming
    law: Any
    hand: HandSample
    signal: PortSignal
    answered_ns: int
    band: DeadbandState
    command: HandCommand
    rendered_n: float
    reference: MasterReference
    tip_reference_m: float
    stop: Trial


class Slave(NamedTuple):
    """The slave half: timing, law, newest signal, measurement of the instrument, and reference for it.

    hand_ns: time from which the age of its command counts: that of the hand's sample plus the reported delay [ns]; -1
    for none.
    """

    timing: SlaveTiming
    law: Any
    signal: PortSignal
    tip: TipMeasurement
    reference: SlaveReference
    hand_ns: int


class Lateral(NamedTuple):
    """The tip over the sample: position [m], speed [m/s] and the time until which that is valid [ns], and force [N]."""

    x_m: float
    y_m: float
    speed_x_m_per_s: float
    speed_y_m_per_s: float
    until_ns: int
    force_x_n: float
    force_y_n: float


class Instrument(NamedTuple):
    """The instrument: its state, times of its last step and of its next one without a command [ns], and its energy [J].

    base_m: position of the base [m]; placed: whether the base has reached its target; reason: reason for the last
    change of mode; withdrawn_s: time at which it last ceased to follow [s], NaN if it never did.
    """

    state: Any
    stepped_ns: int
    due_ns: int
    armed: bool
    base_m: float
    placed: bool
    mode: int
    energy_j: float
    reason: int
    withdrawn_s: float
    lateral: Lateral


@inlined
def hand_stepped(
    haptic: HapticParams, state: HapticChainState, command: HandCommand, now_ns: int, session_s: float, dt: float
) -> tuple[HapticChainState, HandSample]:
    """Step the haptic site at a tick with the newest command; return its state and the hand's sample."""
    asked = HapticInputs(
        command_mode=command.mode,
        position_reference_m=command.position_m,
        force_reference_n=0.0,
        command_age_s=np.inf if command.sent_ns < 0 else (now_ns - min(command.sent_ns, command.hand_ns)) * 1e-9,
        session_time_s=session_s,
        estop=False,
        arm_requested=False,
    )
    state, felt = haptic_step(haptic, state, asked, dt)
    hand = HandSample(
        felt.reading.position_m,
        felt.reading.velocity_m_per_s,
        felt.reading.operator_force_n,
        felt.applied.mode != MODE_OFF,
    )
    return state, hand


@inlined
def _master_settled(halves: Halves, m: Master, now_ns: int) -> Master:
    """Let the master half integrate the periods that are due, and command the hand."""
    if m.timing.due == 0:
        return m
    round_trip_s = integration.round_trip_periods(m.timing, halves.master) * halves.period_s
    signal = _latest(m.signal, m.timing.heard, now_ns, round_trip_s)
    dt, before_m = m.timing.due * halves.period_s, m.reference.position_m if m.reference.active else m.hand.position_m
    law, reference = master_receive(halves.law, m.law, m.hand, signal, dt)
    within = ends(halves.hand, m.hand, before_m, m.tip_reference_m, signal)
    trial = begun(halves.hand, within, reference, m.hand)
    while not trial.done:
        law, reference = master_receive(halves.law, m.law, with_force(m.hand, trial.next_n), signal, dt)
        trial = tried(halves.hand, within, trial, reference)
    reference = cut(halves.hand, trial, reference, before_m)
    mode = MODE_POSITION if reference.active else MODE_OFF
    return Master(
        timing=integration.master_settled(m.timing),
        law=law,
        hand=m.hand,
        signal=m.signal,
        answered_ns=m.answered_ns,
        band=m.band,
        command=HandCommand(mode, reference.position_m, now_ns, m.answered_ns),
        rendered_n=reference.force_n,
        reference=reference,
        tip_reference_m=m.tip_reference_m,
        stop=trial,
    )


@inlined
def master_with_sample(halves: Halves, m: Master, hand: HandSample, now_ns: int) -> tuple[Master, PortSignal, bool]:
    """Return the master half after a sample, the signal that it sends, and whether the dead band lets it through."""
    m = _master_settled(halves, m, now_ns)
    timing, step = integration.master_sampled(m.timing, halves.master, now_ns, False, False)
    law = master_start(halves.law, hand) if step.begins else m.law
    dt = step.periods * halves.period_s
    law, signal = master_send(halves.law, law, let_through(m.stop, hand), dt)
    band, sent = deadband(halves.band, m.band, signal, dt)
    after = Master(
        timing=timing,
        law=law,
        hand=hand,
        signal=m.signal,
        answered_ns=m.answered_ns,
        band=band,
        command=m.command,
        rendered_n=m.rendered_n,
        reference=m.reference,
        tip_reference_m=signal.position_m,
        stop=m.stop,
    )
    return after, signal, sent


@inlined
def master_with_answer(
    halves: Halves, m: Master, signal: PortSignal, hand_ns: int, there_ns: int, now_ns: int
) -> Master:
    """Return the master half after a signal that answers the sample of hand_ns, which reached the slave at there_ns.

    All times are in ns.
    """
    heard = Master(
        timing=integration.master_heard(m.timing, now_ns, hand_ns),
        law=m.law,
        hand=m.hand,
        signal=signal,
        answered_ns=hand_ns + _reported_delay_ns(there_ns - hand_ns) + _reported_delay_ns(now_ns - there_ns),
        band=m.band,
        command=m.command,
        rendered_n=m.rendered_n,
        reference=m.reference,
        tip_reference_m=m.tip_reference_m,
        stop=m.stop,
    )
    return _master_settled(halves, heard, now_ns)


@inlined
def slave_with_signal(halves: Halves, s: Slave, signal: PortSignal, hand_ns: int, now_ns: int) -> Slave:
    """Return the slave half after a signal that descends from the sample of hand_ns [ns], with a new command."""
    timing, tick = integration.slave_tick(s.timing, halves.slave, now_ns, now_ns, hand_ns, True, False)
    law = s.law
    if s.timing.heard.received_ns < 0:
        law = slave_start(halves.law, s.tip)
    elif tick.begins:
        law, _ = slave_receive(halves.law, law, NO_SIGNAL, s.tip, halves.period_s)
    reported_ns = hand_ns + _reported_delay_ns(now_ns - hand_ns)
    s = Slave(timing=timing, law=law, signal=signal, tip=s.tip, reference=s.reference, hand_ns=reported_ns)
    return _slave_stepped(halves, s, now_ns, timing.pacing.elapsed, True)


@inlined
def _slave_stepped(halves: Halves, s: Slave, now_ns: int, elapsed: int, answers: bool) -> Slave:
    """Step the slave half and command the instrument."""
    timing = integration.slave_stepped(s.timing, halves.slave, now_ns, elapsed)
    signal = _latest(s.signal, timing.heard, now_ns, 0.0)
    dt = timing.pacing.step * halves.period_s
    law, wanted = slave_receive(halves.law, s.law, signal, s.tip, dt)
    reference = clamped(halves.clamp, wanted, signal, s.tip)
    return Slave(
        timing=integration.slave_commanded(timing, timing.commands.newest + 1, answers),
        law=law,
        signal=s.signal,
        tip=s.tip,
        reference=reference,
        hand_ns=s.hand_ns,
    )


@inlined
def _instrument_stepped(
    params: Any, i: Instrument, s: Slave, period_ns: int, now_ns: int, commanded: bool
) -> tuple[Instrument, TipMeasurement]:
    """Step the instrument, on a command or by itself; return it and its measurement."""
    action = afm_safety.ACTION_POSITION if s.reference.active else afm_safety.ACTION_HOLD
    # The operator arms the instrument once, when commands come; a guard that trips later stays tripped.
    arm = commanded and not i.armed and s.reference.active
    age_s = np.inf if s.hand_ns < 0 else (now_ns - s.hand_ns) * 1e-9
    dt, lateral = min(max(now_ns - i.stepped_ns, 1), LONGEST_STEP_NS) * 1e-9, i.lateral
    x_m, y_m = lateral.x_m, lateral.y_m
    if i.armed and now_ns <= lateral.until_ns:
        x_m, y_m = x_m + lateral.speed_x_m_per_s * dt, y_m + lateral.speed_y_m_per_s * dt
    asked = AfmInputs(s.reference.position_m, age_s, action, arm, False, x_m, y_m, True)
    state, answer = instrument_step(params, i.state, asked, dt)
    felt, allowed = answer.sample, answer.allowed
    moved = felt.base_m - i.base_m if i.armed else 0.0
    tip = _tip_of(answer)
    after = Instrument(
        state=state,
        stepped_ns=now_ns,
        due_ns=now_ns + (command_wait_ns(period_ns) if commanded else period_ns),
        armed=i.armed or allowed.mode == afm_safety.MODE_FOLLOW,
        base_m=felt.base_m,
        placed=afm_safety.is_placed(allowed),
        mode=allowed.mode,
        energy_j=i.energy_j + 0.5 * (felt.force_n + s.tip.force_n) * moved,
        reason=allowed.reason,
        withdrawn_s=now_ns * 1e-9 if s.tip.following and not tip.following else i.withdrawn_s,
        lateral=Lateral(
            x_m=x_m,
            y_m=y_m,
            speed_x_m_per_s=lateral.speed_x_m_per_s,
            speed_y_m_per_s=lateral.speed_y_m_per_s,
            until_ns=lateral.until_ns,
            force_x_n=felt.lateral_x_n,
            force_y_n=felt.lateral_y_n,
        ),
    )
    return after, tip


@inlined
def driven(i: Instrument, lateral: Lateral) -> Instrument:
    """Return the instrument with another position or speed over the sample."""
    return Instrument(
        state=i.state,
        stepped_ns=i.stepped_ns,
        due_ns=i.due_ns,
        armed=i.armed,
        base_m=i.base_m,
        placed=i.placed,
        mode=i.mode,
        energy_j=i.energy_j,
        reason=i.reason,
        withdrawn_s=i.withdrawn_s,
        lateral=lateral,
    )


@inlined
def by_rate(was: Lateral, speed: Array, now_ns: int) -> Lateral:
    """Return the lateral state with a new speed [m/s], which is valid until the deadline of the loop."""
    return Lateral(was.x_m, was.y_m, speed[0], speed[1], now_ns + _RATE_NS, was.force_x_n, was.force_y_n)


@inlined
def put_answer(row: Array, lateral: Lateral) -> None:
    """Write lateral position [m] and force [N] of the tip into a row of an answer."""
    row[0], row[1], row[2], row[3] = lateral.x_m, lateral.y_m, lateral.force_x_n, lateral.force_y_n


@inlined
def counts(m: Master, path: AcrossPath, now_ns: int) -> bool:
    """Return whether the newest answer is recent enough to know the state of the tip."""
    heard = m.timing.heard
    return heard.received_ns >= 0 and m.signal.active and integration.silence_ns(heard, now_ns) * 1e-9 <= path.silence_s


@inlined
def continues(halves: Halves, s: Slave, signal: PortSignal, hand_ns: int, now_ns: int) -> tuple[bool, float]:
    """Return whether a signal continues the previous one and the instrument follows, and the time between them [s]."""
    timing, tick = integration.slave_tick(s.timing, halves.slave, now_ns, now_ns, hand_ns, True, False)
    follows = not tick.begins and s.timing.heard.received_ns >= 0 and signal.active and s.tip.following
    return follows, timing.pacing.elapsed * halves.period_s


@inlined
def carried_out(
    halves: Halves, params: Any, s: Slave, i: Instrument, now_ns: int
) -> tuple[Slave, Instrument, PortSignal]:
    """Let the instrument carry out the slave half's command, and the half account for it; also return the answer."""
    i, tip = _instrument_stepped(params, i, s, halves.slave.period_ns, now_ns, True)
    s, settled = _slave_measured(halves, s, tip, now_ns)
    law, signal = slave_send(halves.law, s.law, tip, settled.periods * halves.period_s)
    s = Slave(timing=s.timing, law=law, signal=s.signal, tip=tip, reference=s.reference, hand_ns=s.hand_ns)
    return s, i, signal


@inlined
def went_on(halves: Halves, params: Any, s: Slave, i: Instrument, now_ns: int) -> tuple[Slave, Instrument]:
    """Let the instrument step by itself; the slave half steps too if its last signal still counts."""
    i, tip = _instrument_stepped(params, i, s, halves.slave.period_ns, now_ns, False)
    s, settled = _slave_measured(halves, s, tip, now_ns)
    if settled.continues:
        s = _slave_stepped(halves, s, now_ns, 0, False)
        s, i, _ = carried_out(halves, params, s, i, now_ns)
    return s, i


@inlined
def _slave_measured(halves: Halves, s: Slave, tip: TipMeasurement, now_ns: int) -> tuple[Slave, SlaveDecision]:
    """Return the slave half after a measurement of the instrument, and its decision on it."""
    follows = s.signal.active and tip.following
    timing, settled = integration.slave_measured(
        s.timing, halves.slave, now_ns, s.timing.commands.newest, False, follows
    )
    s = Slave(timing=timing, law=s.law, signal=s.signal, tip=tip, reference=s.reference, hand_ns=s.hand_ns)
    return s, settled


@inlined
def instrument_at(state: Any, period_ns: int) -> Instrument:
    """Return the instrument before the first command."""
    return Instrument(
        state=state,
        stepped_ns=0,
        due_ns=period_ns,
        armed=False,
        base_m=0.0,
        placed=False,
        mode=afm_safety.MODE_RETRACTED,
        energy_j=0.0,
        reason=afm_safety.REASON_START,
        withdrawn_s=np.nan,
        lateral=Lateral(0.0, 0.0, 0.0, 0.0, -1, 0.0, 0.0),
    )


@inlined
def master_at(halves: Halves, haptic: HapticParams, haptic_state: HapticChainState) -> Master:
    """Return the master half before the first sample."""
    hand = HandSample(place_of(haptic.plant, haptic_state.plant)[0], 0.0, 0.0, False)
    return Master(
        timing=integration.master_begin(),
        law=master_start(halves.law, hand),
        hand=hand,
        signal=NO_SIGNAL,
        answered_ns=-1,
        band=initial_deadband_state(NO_SIGNAL),
        command=HandCommand(MODE_OFF, 0.0, -1, -1),
        rendered_n=0.0,
        reference=MasterReference(0.0, 0.0, 0.0, False),
        tip_reference_m=0.0,
        stop=free(),
    )


@inlined
def slave_at(halves: Halves) -> Slave:
    """Return the slave half before the first signal."""
    return Slave(
        timing=integration.slave_begin(),
        law=slave_start(halves.law, NO_TIP),
        signal=NO_SIGNAL,
        tip=NO_TIP,
        reference=SlaveReference(0.0, False),
        hand_ns=-1,
    )
