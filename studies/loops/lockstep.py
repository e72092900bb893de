"""The closed loop in one compiled function: hand, law, link and instrument, tick by tick, no process and no clock.

The steps are those that the nodes call, the state machines of the halves (`services.controller.integration`) are those
that the nodes run, and the order is that of the bus. At the tick n of the hand, time n Ts:

1. the haptic site steps with the newest command that it has (guard, device, hand);
2. the master half takes the sample: it receives first, if nothing has answered the sample before, and then sends,
   unless the dead band keeps the signal back;
3. what reaches its end of the link before the next tick acts in the order of arrival. Of signals that arrive together a
   reader takes the newest, as on the bus, where they wait for it together (conflation). A forward signal goes through
   the slave half, the instrument and the slave half again, and its answer enters the link. A backward signal goes to
   the master half. An instrument that receives nothing for a period and a half steps by itself, its guard judges the
   silence, and the slave half takes up what it measured: with a local loop it commands a step of its own.

What passes on a site takes no time here, so the instrument carries out at once what it is asked for.
The guards judge the age of the hand's sample behind a command, less the delay of the link in whole steps, as nodes do.

So a signal released between two ticks acts in the tick in which it arrives, as on the bus: a constant round trip of T
delays the loop by floor(T/Ts) Ts, and the hold of the law's integration adds half a period to that (`theory`).
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from proto.topics import LOOP_DEADLINE_S
from services.afm_node import safety as afm_safety
from services.afm_node.physics.step import (
    LONGEST_STEP_NS,
    AfmInputs,
    AfmOutputs,
    AfmParams,
    command_wait_ns,
    initial_afm_state,
)
from services.afm_node.physics.step import step as instrument_step
from services.controller.clamp import ClampParams, clamped
from services.controller.config import ControllerConfig
from services.controller.deadband import DeadbandParams, DeadbandState, deadband, initial_deadband_state
from services.controller.integration import (
    GO_ON,
    Heard,
    MasterTiming,
    Settled,
    SlaveTiming,
    TimingParams,
    master_begin,
    master_heard,
    master_sampled,
    master_settled,
    round_trip_periods,
    silence_ns,
    slave_begin,
    slave_commanded,
    slave_measured,
    slave_signalled,
    slave_stepped,
)
from services.controller.lateral import hand_moves as moves_stage
from services.controller.law import (
    NO_SIGNAL,
    NO_TIP,
    HandSample,
    PortSignal,
    SlaveReference,
    TipMeasurement,
)
from services.haptic_node import safety as haptic_safety
from services.haptic_node.config import HapticConfig
from services.haptic_node.physics.step import HapticInputs, HapticParams, found
from services.haptic_node.physics.step import HapticStepState as HapticChainState
from services.haptic_node.physics.step import step as haptic_step
from services.numerics.compiled import compiled, compiled_form, inlined
from services.runtime.loop.freshness import DELAY_STEP_NS
from studies.loops.across import (
    STAGE_X,
    AcrossPath,
    across_at_rest,
    across_heard,
    across_sampled,
    across_signalled,
    guided,
)
from studies.loops.dispatch import (
    master_receive,
    master_send,
    master_start,
    slave_receive,
    slave_send,
    slave_start,
)
from studies.loops.link import Schedule
from studies.loops.push_hand import DONE, PEAK_ACROSS, PEAK_ALONG, PHASE, TRUE_X, TRUE_Y, Hand, hand_moves

Series = npt.NDArray[np.float64]

_NEVER_NS = 2**62
# a rate of the hand that is older than the deadline of the loop moves nothing
_RATE_NS = round(LOOP_DEADLINE_S * 1e9)
COLUMNS = (
    "time_s",
    "hand_force_n",
    "hand_position_m",
    "reference_m",
    "rendered_force_n",
    "base_position_m",
    "tip_force_n",
    "separation_m",
    "hand_energy_j",
    "tip_energy_j",
    "in_contact",
    "instrument_mode",
    "hand_following",
    "instrument_reason",
    "withdrawn_s",
)


class Halves(NamedTuple):
    """Constants of the two halves: the law, the dead band, the clamp behind the slave half, and their timing."""

    law: Any
    band: DeadbandParams
    clamp: ClampParams
    master: TimingParams
    slave: TimingParams
    period_s: float


@dataclass(frozen=True)
class Rig:
    """What is coupled, ready to run: constants of halves, haptic site and instrument; made by `build_rig`."""

    halves: Halves
    haptic: HapticParams
    haptic_start: HapticChainState
    instrument: AfmParams
    instrument_start: Any

    @property
    def period_s(self) -> float:
        """Return the period of the hand [s]."""
        return self.halves.period_s


def build_rig(controller: ControllerConfig, haptic: HapticConfig, instrument: AfmParams) -> Rig:
    """Prepare a rig: the hand where its configuration puts it and off, the instrument retracted."""
    halves = Halves(
        law=controller.params(),
        band=controller.deadband.to_params(),
        clamp=controller.clamp_params(),
        master=controller.master_timing(),
        slave=controller.slave_timing(),
        period_s=controller.period_s,
    )
    return Rig(halves, haptic.to_params(), haptic.initial_state(), instrument, initial_afm_state(instrument))


@dataclass(frozen=True)
class Trajectory:
    """What happened, one value a tick of the hand, each of shape (n,), from the start of the session on.

    hand_force_n, hand_position_m: F_m [N] on the device and x_m [m] at the tick. The rest is as it stands at the end of
    the tick: reference_m, x_mr [m]; rendered_force_n, the force that the law ascribes to the environment, at the hand's
    scale [N]; base_position_m, x_s [m]; tip_force_n, F_s [N]; separation_m, h [m];
    hand_energy_j, what the hand has put into its device [J], the integral of F_m dx_m; tip_energy_j, what the base has
    put into cantilever and sample [J], the integral of F_s dx_s; in_contact, instrument_mode (MODE_* of the AFM's
    safety chain), hand_following; instrument_reason, why that mode last changed (REASON_*); withdrawn_s, when the
    instrument last ceased to follow [s], negative before the session and NaN if it never did; across, shape (n, 10),
    the course of the path across (`studies.loops.across`), where there was one.
    """

    time_s: Series
    hand_force_n: Series
    hand_position_m: Series
    reference_m: Series
    rendered_force_n: Series
    base_position_m: Series
    tip_force_n: Series
    separation_m: Series
    hand_energy_j: Series
    tip_energy_j: Series
    in_contact: npt.NDArray[np.bool_]
    instrument_mode: npt.NDArray[np.int64]
    hand_following: npt.NDArray[np.bool_]
    instrument_reason: npt.NDArray[np.int64]
    withdrawn_s: Series
    across: Series | None = None


def simulate(
    rig: Rig, schedule: Schedule, session_tick: int, hand: Hand | None = None, path: AcrossPath | None = None
) -> Trajectory:
    """Run the rig over a link.

    Args:
        rig: The rig.
        schedule: The arrivals of `link.schedule_of`, whose number of ticks is the length of the run.
        session_tick: The tick at which the operator's programme starts. The instrument is armed and comes to its
            reference before it.
        hand: Moves the tip over the sample as well, where the instrument has a particle; the run ends when it is done.
        path: A hand that moves it by the lateral path of the controller.

    Raises:
        ValueError: No tick is left for the session.
    """
    if not 0 <= session_tick < schedule.ticks:
        raise ValueError(f"the session cannot start at tick {session_tick} of {schedule.ticks}")
    rows = np.empty((schedule.ticks, len(COLUMNS)))
    start = rig.haptic_start, rig.instrument_start
    run = compiled_form(_run)
    done = run(rig.halves, rig.haptic, rig.instrument, *start, schedule, session_tick, rows, hand, path)
    rows = rows[:done]
    columns: dict[str, Any] = dict(zip(COLUMNS, np.ascontiguousarray(rows[session_tick:].T), strict=True))
    for name in ("in_contact", "hand_following"):
        columns[name] = columns[name].astype(bool)
    for name in ("instrument_mode", "instrument_reason"):
        columns[name] = columns[name].astype(np.int64)
    columns["withdrawn_s"] = columns["withdrawn_s"] - session_tick * rig.period_s
    columns["across"] = None if path is None else path.rows[session_tick:done]
    return Trajectory(**columns)


@inlined
def _tip_of(answer: AfmOutputs) -> TipMeasurement:
    """Return the part of the instrument's answer that the slave half uses."""
    following = answer.mode == afm_safety.MODE_FOLLOW or answer.mode == afm_safety.MODE_HOLD
    return TipMeasurement(
        base_position_m=answer.base_m,
        force_n=answer.force_n,
        separation_m=answer.distance_m,
        separation_valid=True,
        in_contact=answer.in_contact,
        following=following,
        # the instrument carries out each command before the next one comes
        outstanding_m=0.0,
    )


@inlined
def _latest(signal: PortSignal, heard: Heard, now_ns: int, round_trip_s: float) -> PortSignal:
    """Return the newest signal with the two figures that its receiver fills in."""
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
        silence_s=silence_ns(heard, now_ns) * 1e-9,
        round_trip_s=round_trip_s,
    )


@inlined
def _told(delay_ns: int) -> int:
    """Return the part of a delay that the link tells the guards [ns]."""
    return delay_ns - delay_ns % DELAY_STEP_NS


class HandCommand(NamedTuple):
    """What the haptic site obeys: mode, x_mr [m], and the times from which its age counts [ns]; -1 for none."""

    mode: int
    position_m: float
    sent_ns: int
    hand_ns: int


class Master(NamedTuple):
    """The master half: timing, law, hand, newest signal and when its sample would have been back without the link [ns].

    band, of the signals that it sends; command, to the hand; rendered_n, the force that the law ascribes to the
    environment [N].
    """

    timing: MasterTiming
    law: Any
    hand: HandSample
    signal: PortSignal
    answered_ns: int
    band: DeadbandState
    command: HandCommand
    rendered_n: float


class Slave(NamedTuple):
    """The slave half: timing, law, newest signal, what the instrument measured, and what it is to do.

    hand_ns, the time that its command counts from: that of the hand's sample, told delay included [ns]; -1 for none.
    """

    timing: SlaveTiming
    law: Any
    signal: PortSignal
    tip: TipMeasurement
    reference: SlaveReference
    hand_ns: int


class Lateral(NamedTuple):
    """The tip over the sample: place [m], speed [m/s] and until when that counts [ns], force on the tip [N]."""

    x_m: float
    y_m: float
    speed_x_m_per_s: float
    speed_y_m_per_s: float
    until_ns: int
    force_x_n: float
    force_y_n: float


class Instrument(NamedTuple):
    """The instrument: its state, when it stepped last, when it steps by itself [ns], and its energy [J].

    reason: why its mode last changed; withdrawn_s: when it last ceased to follow [s], NaN if it never did.
    """

    state: Any
    stepped_ns: int
    due_ns: int
    armed: bool
    mode: int
    energy_j: float
    reason: int
    withdrawn_s: float
    lateral: Lateral


@inlined
def _hand_stepped(
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
        felt.applied.mode != haptic_safety.MODE_OFF,
    )
    return state, hand


@inlined
def _master_settled(halves: Halves, m: Master, now_ns: int) -> Master:
    """Let the master half integrate what is due, and command the hand."""
    if m.timing.due == 0:
        return m
    round_trip_s = round_trip_periods(m.timing, halves.master) * halves.period_s
    signal = _latest(m.signal, m.timing.heard, now_ns, round_trip_s)
    law, reference = master_receive(halves.law, m.law, m.hand, signal, m.timing.due * halves.period_s)
    mode = haptic_safety.MODE_POSITION if reference.active else haptic_safety.MODE_OFF
    return Master(
        timing=master_settled(m.timing),
        law=law,
        hand=m.hand,
        signal=m.signal,
        answered_ns=m.answered_ns,
        band=m.band,
        command=HandCommand(mode, reference.position_m, now_ns, m.answered_ns),
        rendered_n=reference.force_n,
    )


@inlined
def _master_sampled(halves: Halves, m: Master, hand: HandSample, now_ns: int) -> tuple[Master, PortSignal, bool]:
    """Return the master half after a sample, the signal that it sends, and whether the dead band lets it through."""
    m = _master_settled(halves, m, now_ns)
    timing, found = master_sampled(m.timing, halves.master, now_ns, False, False)
    law = master_start(halves.law, hand) if found.begins else m.law
    dt = found.periods * halves.period_s
    law, signal = master_send(halves.law, law, hand, dt)
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
    )
    return after, signal, sent


@inlined
def _master_heard(halves: Halves, m: Master, signal: PortSignal, hand_ns: int, there_ns: int, now_ns: int) -> Master:
    """Return the master half after a signal that answers the sample of hand_ns, which was there at there_ns [ns]."""
    heard = Master(
        timing=master_heard(m.timing, now_ns, hand_ns),
        law=m.law,
        hand=m.hand,
        signal=signal,
        answered_ns=hand_ns + _told(there_ns - hand_ns) + _told(now_ns - there_ns),
        band=m.band,
        command=m.command,
        rendered_n=m.rendered_n,
    )
    return _master_settled(halves, heard, now_ns)


@inlined
def _slave_signalled(halves: Halves, s: Slave, signal: PortSignal, hand_ns: int, now_ns: int) -> Slave:
    """Return the slave half after a signal that descends from the sample of hand_ns [ns], with a new command."""
    timing, begins = slave_signalled(s.timing, halves.slave, now_ns, hand_ns, True)
    law = s.law
    if s.timing.heard.received_ns < 0:
        law = slave_start(halves.law, s.tip)
    elif begins:
        law, _ = slave_receive(halves.law, law, NO_SIGNAL, s.tip, halves.period_s)
    told_ns = hand_ns + _told(now_ns - hand_ns)
    s = Slave(timing=timing, law=law, signal=signal, tip=s.tip, reference=s.reference, hand_ns=told_ns)
    return _slave_stepped(halves, s, now_ns, timing.pacing.elapsed, True)


@inlined
def _slave_stepped(halves: Halves, s: Slave, now_ns: int, elapsed: int, answers: bool) -> Slave:
    """Step the slave half and command the instrument."""
    timing = slave_stepped(s.timing, halves.slave, now_ns, elapsed)
    signal = _latest(s.signal, timing.heard, now_ns, 0.0)
    law, wanted = slave_receive(halves.law, s.law, signal, s.tip, timing.pacing.step * halves.period_s)
    return Slave(
        timing=slave_commanded(timing, timing.commands.newest + 1, answers),
        law=law,
        signal=s.signal,
        tip=s.tip,
        reference=clamped(halves.clamp, wanted, signal, s.tip),
        hand_ns=s.hand_ns,
    )


@inlined
def _instrument_stepped(
    params: Any, i: Instrument, s: Slave, period_ns: int, now_ns: int, commanded: bool
) -> tuple[Instrument, TipMeasurement]:
    """Step the instrument, on a command or by itself; return it with what it measured."""
    action = afm_safety.ACTION_POSITION if s.reference.active else afm_safety.ACTION_HOLD
    # the operator arms the instrument once, when commands are there; a guard that trips later stays tripped
    arm = commanded and not i.armed and s.reference.active
    age_s = np.inf if s.hand_ns < 0 else (now_ns - s.hand_ns) * 1e-9
    dt, lateral = min(max(now_ns - i.stepped_ns, 1), LONGEST_STEP_NS) * 1e-9, i.lateral
    x_m, y_m = lateral.x_m, lateral.y_m
    if i.armed and now_ns <= lateral.until_ns:
        x_m, y_m = x_m + lateral.speed_x_m_per_s * dt, y_m + lateral.speed_y_m_per_s * dt
    asked = AfmInputs(s.reference.position_m, age_s, action, arm, False, x_m, y_m)
    state, felt = instrument_step(params, i.state, asked, dt)
    moved = felt.base_m - s.tip.base_position_m if i.armed else 0.0
    tip = _tip_of(felt)
    after = Instrument(
        state=state,
        stepped_ns=now_ns,
        due_ns=now_ns + (command_wait_ns(period_ns) if commanded else period_ns),
        armed=i.armed or felt.mode == afm_safety.MODE_FOLLOW,
        mode=felt.mode,
        energy_j=i.energy_j + 0.5 * (felt.force_n + s.tip.force_n) * moved,
        reason=felt.reason,
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
def _driven(i: Instrument, lateral: Lateral) -> Instrument:
    """Return the instrument that is elsewhere over the sample, or goes on from there."""
    return Instrument(
        state=i.state,
        stepped_ns=i.stepped_ns,
        due_ns=i.due_ns,
        armed=i.armed,
        mode=i.mode,
        energy_j=i.energy_j,
        reason=i.reason,
        withdrawn_s=i.withdrawn_s,
        lateral=lateral,
    )


@inlined
def _by_rate(was: Lateral, speed: Series, now_ns: int) -> Lateral:
    """Return the way at a speed [m/s], until its deadline."""
    return Lateral(was.x_m, was.y_m, speed[0], speed[1], now_ns + _RATE_NS, was.force_x_n, was.force_y_n)


@inlined
def _answered(row: Series, lateral: Lateral) -> None:
    """Put what is known of the tip across into an answer."""
    row[0], row[1], row[2], row[3] = lateral.x_m, lateral.y_m, lateral.force_x_n, lateral.force_y_n


@inlined
def _counts(m: Master, path: AcrossPath, now_ns: int) -> bool:
    """Return whether the newest answer tells where the tip is."""
    heard = m.timing.heard
    return heard.received_ns >= 0 and m.signal.active and silence_ns(heard, now_ns) * 1e-9 <= path.silence_s


@inlined
def _goes_on(halves: Halves, s: Slave, signal: PortSignal, hand_ns: int, now_ns: int) -> tuple[bool, float]:
    """Return whether a signal follows the one before while the instrument follows, and how much later it is [s]."""
    timing, begins = slave_signalled(s.timing, halves.slave, now_ns, hand_ns, True)
    follows = not begins and s.timing.heard.received_ns >= 0 and signal.active and s.tip.following
    return follows, timing.pacing.elapsed * halves.period_s


@inlined
def _noted(state: Series, i: Instrument) -> None:
    """Write down the largest forces on the tip [N], and where its particle really is [m]."""
    across = np.sqrt(i.lateral.force_x_n * i.lateral.force_x_n + i.lateral.force_y_n * i.lateral.force_y_n)
    state[PEAK_ACROSS], state[PEAK_ALONG] = max(state[PEAK_ACROSS], across), max(state[PEAK_ALONG], i.state.force_n)
    state[TRUE_X], state[TRUE_Y] = i.state.plant.moving[0, 0], i.state.plant.moving[0, 1]


@inlined
def _carried_out(
    halves: Halves, params: Any, s: Slave, i: Instrument, now_ns: int
) -> tuple[Slave, Instrument, PortSignal]:
    """Let the instrument carry out the command of the slave half, and that account for it; return its answer."""
    i, tip = _instrument_stepped(params, i, s, halves.slave.period_ns, now_ns, True)
    s, settled = _slave_measured(halves, s, tip, now_ns)
    law, signal = slave_send(halves.law, s.law, tip, settled.periods * halves.period_s)
    s = Slave(timing=s.timing, law=law, signal=s.signal, tip=tip, reference=s.reference, hand_ns=s.hand_ns)
    return s, i, signal


@inlined
def _went_on(halves: Halves, params: Any, s: Slave, i: Instrument, now_ns: int) -> tuple[Slave, Instrument]:
    """Let the instrument step by itself, and the slave half with it, where its last signal still counts."""
    i, tip = _instrument_stepped(params, i, s, halves.slave.period_ns, now_ns, False)
    s, settled = _slave_measured(halves, s, tip, now_ns)
    if settled.what == GO_ON:
        s = _slave_stepped(halves, s, now_ns, 0, False)
        s, i, _ = _carried_out(halves, params, s, i, now_ns)
    return s, i


@inlined
def _slave_measured(halves: Halves, s: Slave, tip: TipMeasurement, now_ns: int) -> tuple[Slave, Settled]:
    """Return the slave half after what the instrument measured, and what it does about that."""
    follows = s.signal.active and tip.following
    timing, settled = slave_measured(s.timing, halves.slave, now_ns, s.timing.commands.newest, False, follows)
    s = Slave(timing=timing, law=s.law, signal=s.signal, tip=tip, reference=s.reference, hand_ns=s.hand_ns)
    return s, settled


@inlined
def _at(times_ns: npt.NDArray[np.int64], index: int) -> int:
    return int(times_ns[index]) if index < len(times_ns) else _NEVER_NS


@inlined
def _taken_together(
    times_ns: npt.NDArray[np.int64], numbers: npt.NDArray[np.int64], sent: npt.NDArray[np.bool_], first: int
) -> tuple[int, int]:
    """Return the last of the arrivals that come together with the first, and the newest number that was sent, or -1.

    sent: by number, modulo its length, which is a power of two.
    """
    mask, last, newest = len(sent) - 1, first, -1
    while True:
        if sent[numbers[last] & mask]:
            newest = numbers[last]
        if _at(times_ns, last + 1) != times_ns[first]:
            return last, newest
        last += 1


@inlined
def _instrument_at(state: Any, period_ns: int) -> Instrument:
    """Return the instrument before the first command."""
    return Instrument(
        state=state,
        stepped_ns=0,
        due_ns=period_ns,
        armed=False,
        mode=afm_safety.MODE_RETRACTED,
        energy_j=0.0,
        reason=afm_safety.REASON_START,
        withdrawn_s=np.nan,
        lateral=Lateral(0.0, 0.0, 0.0, 0.0, -1, 0.0, 0.0),
    )


@compiled
def _run(
    halves: Halves,
    haptic: HapticParams,
    instrument: Any,
    haptic_state: HapticChainState,
    instrument_state: Any,
    schedule: Schedule,
    session_tick: int,
    rows: Series,
    steers: Hand | None,
    path: AcrossPath | None,
) -> int:
    """Fill `rows` (ticks, columns) with the closed loop, and return how many; the module's text gives the order."""
    # The fields are taken out of the tuple once, because every access costs a count of references to its arrays.
    forward_ns, forward_of = schedule.forward_ns, schedule.forward_of
    backward_ns, backward_of = schedule.backward_ns, schedule.backward_of
    dt, period_ns = halves.period_s, halves.master.period_ns
    # The messages in flight, by the number of the sample (forward) or of its arrival (backward), modulo the window.
    window = schedule.window
    mask = window - 1
    forward = [NO_SIGNAL for _ in range(window)]
    backward = [NO_SIGNAL for _ in range(window)]
    # A sample that the dead band keeps back has a place in the schedule, and arrives nowhere.
    sent_forward, sent_backward = np.zeros(window, np.bool_), np.zeros(window, np.bool_)
    answered = np.zeros(window, np.int64)
    slave_band = initial_deadband_state(NO_SIGNAL)
    m, s = _master_at(halves, haptic, haptic_state), _slave_at(halves)
    i = _instrument_at(instrument_state, period_ns)
    hand_energy_j, f, b, before = 0.0, 0, 0, m.hand
    across = across_at_rest()
    for n in range(len(rows)):
        now_ns = n * period_ns
        session_s = (n - session_tick) * dt if n >= session_tick else -1.0
        haptic_state, hand = _hand_stepped(haptic, haptic_state, m.command, now_ns, session_s, dt)
        hand_energy_j += 0.5 * (hand.force_n + before.force_n) * (hand.position_m - before.position_m)
        before = hand
        if path is not None:
            across = across_sampled(path, across, hand, _counts(m, path, now_ns), n, session_s, dt)
            hand = guided(across, hand)
        m, forward[n & mask], sent_forward[n & mask] = _master_sampled(halves, m, hand, now_ns)
        if steers is not None:
            if steers.state[PHASE] == DONE:
                return n
            steers.forward[n & mask, 0], steers.forward[n & mask, 1] = hand_moves(steers, n - session_tick)
        end_ns = now_ns + period_ns
        while True:
            arrives_ns, returns_ns = _at(forward_ns, f), _at(backward_ns, b)
            event_ns = min(arrives_ns, returns_ns, i.due_ns)
            if event_ns >= end_ns:
                break
            if event_ns == arrives_ns:
                f, tick = _taken_together(forward_ns, forward_of, sent_forward, f)
                sent_backward[f & mask] = False
                if tick >= 0:
                    if steers is not None:
                        i = _driven(i, _by_rate(i.lateral, steers.forward[tick & mask], event_ns))
                    if path is not None:
                        follows, later_s = _goes_on(halves, s, forward[tick & mask], tick * period_ns, event_ns)
                        was = i.lateral
                        across = across_signalled(path, across, tick, (was.x_m, was.y_m), follows, later_s)
                        if moves_stage(across.slave):
                            x_m, y_m = across.slave.x_m, across.slave.y_m
                            i = _driven(i, Lateral(x_m, y_m, 0.0, 0.0, -1, was.force_x_n, was.force_y_n))
                    s = _slave_signalled(halves, s, forward[tick & mask], tick * period_ns, event_ns)
                    s, i, signal = _carried_out(halves, instrument, s, i, event_ns)
                    elapsed_s = s.timing.pacing.elapsed * dt
                    slave_band, sent_backward[f & mask] = deadband(halves.band, slave_band, signal, elapsed_s)
                    backward[f & mask], answered[f & mask] = signal, tick
                    if steers is not None:
                        _noted(steers.state, i)
                        _answered(steers.backward[f & mask], i.lateral)
                    if path is not None:
                        _answered(path.backward[f & mask], i.lateral)
                f += 1
            elif event_ns == returns_ns:
                b, answer = _taken_together(backward_ns, backward_of, sent_backward, b)
                if answer >= 0:
                    hand_ns, there_ns = answered[answer & mask] * period_ns, forward_ns[answer]
                    m = _master_heard(halves, m, backward[answer & mask], hand_ns, there_ns, event_ns)
                    if steers is not None:
                        steers.seen[:] = steers.backward[answer & mask]
                    if path is not None:
                        across = across_heard(path, across, answer)
                b += 1
            else:
                s, i = _went_on(halves, instrument, s, i, event_ns)
        _record(rows[n], session_s, m, s.tip, hand_energy_j, i)
        if path is not None:
            _answered(path.rows[n, STAGE_X:], i.lateral)
    return len(rows)


@inlined
def _master_at(halves: Halves, haptic: HapticParams, haptic_state: HapticChainState) -> Master:
    """Return the master half before the first sample."""
    hand = HandSample(found(haptic.plant, haptic_state.plant)[0], 0.0, 0.0, False)
    return Master(
        timing=master_begin(),
        law=master_start(halves.law, hand),
        hand=hand,
        signal=NO_SIGNAL,
        answered_ns=-1,
        band=initial_deadband_state(NO_SIGNAL),
        command=HandCommand(haptic_safety.MODE_OFF, 0.0, -1, -1),
        rendered_n=0.0,
    )


@inlined
def _slave_at(halves: Halves) -> Slave:
    """Return the slave half before the first signal."""
    return Slave(
        timing=slave_begin(),
        law=slave_start(halves.law, NO_TIP),
        signal=NO_SIGNAL,
        tip=NO_TIP,
        reference=SlaveReference(0.0, False),
        hand_ns=-1,
    )


@inlined
def _record(row: Series, session_s: float, m: Master, tip: TipMeasurement, hand_energy_j: float, i: Instrument) -> None:
    """Write down what stands at the end of a tick, in the order of COLUMNS."""
    row[0], row[1], row[2], row[3] = session_s, m.hand.force_n, m.hand.position_m, m.command.position_m
    row[4], row[5], row[6], row[7] = m.rendered_n, tip.base_position_m, tip.force_n, tip.separation_m
    row[8], row[9] = hand_energy_j, i.energy_j
    row[10], row[11], row[12] = int(tip.in_contact), i.mode, int(m.hand.following)
    row[13], row[14] = i.reason, i.withdrawn_s
