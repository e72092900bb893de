"""The closed loop in one compiled function: hand, law, link and instrument, tick by tick, no process and no clock.

The steps are those that the nodes call, and the order is that of the bus. At the tick n of the hand, time n Ts:

1. the haptic site steps with the newest command that it has (guard, device, hand);
2. if nothing answered the sample of the tick before, the master half receives now, with the newest signal and the time
   of silence since;
3. the master half sends, unless the dead band keeps the signal back;
4. what reaches its end of the link before the next tick acts in the order of arrival. A forward signal goes through the
   slave half, the instrument and the slave half again, and its answer enters the link. The first backward signal of the
   tick is received by the master half, which integrates one period; a later one is kept for the next.
   An instrument that receives nothing for a period and a half steps by itself, and its guard judges the silence; the
   slave half of a law with a local loop steps with it, with the newest signal and the force measured last, for as long
   as the silence limit.

The guards judge the age of the hand's sample behind a command, less the delay of the link in whole steps, as nodes do.

So a signal released between two ticks acts in the tick in which it arrives, as on the bus: a constant round trip of T
delays the loop by floor(T/Ts) Ts, and the hold of the law's integration adds half a period to that (`theory`).
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

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
from services.controller.deadband import DeadbandParams, deadband, initial_deadband_state
from services.controller.law import (
    NO_SIGNAL,
    NO_TIP,
    HandSample,
    PortSignal,
    TipMeasurement,
    longest_pause_periods,
    paced,
)
from services.haptic_node import safety as haptic_safety
from services.haptic_node.config import HapticConfig
from services.haptic_node.physics.step import HapticInputs, HapticParams
from services.haptic_node.physics.step import HapticStepState as HapticChainState
from services.haptic_node.physics.step import step as haptic_step
from services.numerics.compiled import compiled, compiled_form
from services.runtime.loop.freshness import DELAY_STEP_NS
from studies.loops.dispatch import (
    master_receive,
    master_send,
    master_start,
    slave_receive,
    slave_send,
    slave_start,
)
from studies.loops.link import Schedule

Series = npt.NDArray[np.float64]

_NEVER_NS = 2**62
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
)


class SlaveLoop(NamedTuple):
    """The clamp behind the slave half; whether the half goes on between signals, and for how long [ns, periods]."""

    clamp: ClampParams
    local: bool
    longest_ns: int
    longest_periods: int


@dataclass(frozen=True)
class Rig:
    """What is coupled, ready to run: constants of law, dead band, haptic site, instrument; made by `build_rig`."""

    law: Any
    band: DeadbandParams
    slave: "SlaveLoop"
    haptic: HapticParams
    haptic_start: HapticChainState
    instrument: AfmParams
    instrument_start: Any
    period_s: float


def build_rig(controller: ControllerConfig, haptic: HapticConfig, instrument: AfmParams) -> Rig:
    """Prepare a rig: the hand where its configuration puts it and off, the instrument retracted."""
    period_s, silence_s = controller.period_s, controller.law_config().silence_limit_s
    return Rig(
        controller.params(),
        controller.deadband.to_params(),
        SlaveLoop(
            controller.clamp_params(),
            controller.local_loop,
            round(silence_s * 1e9),
            longest_pause_periods(silence_s, period_s),
        ),
        haptic.to_params(),
        haptic.initial_state(),
        instrument,
        initial_afm_state(instrument),
        period_s,
    )


@dataclass(frozen=True)
class Trajectory:
    """What happened, one value a tick of the hand, each of shape (n,), from the start of the session on.

    hand_force_n, hand_position_m: F_m [N] on the device and x_m [m] at the tick. The rest is as it stands at the end of
    the tick: reference_m, x_mr [m]; rendered_force_n, the force that the law ascribes to the environment, at the hand's
    scale [N]; base_position_m, x_s [m]; tip_force_n, F_s [N]; separation_m, h [m];
    hand_energy_j, what the hand has put into its device [J], the integral of F_m dx_m; tip_energy_j, what the base has
    put into cantilever and sample [J], the integral of F_s dx_s; in_contact, instrument_mode (MODE_* of the AFM's
    safety chain), hand_following.
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


class _Times(NamedTuple):
    """Period of the hand [s] and [ns], and the tick at which the session starts."""

    period_s: float
    period_ns: int
    session_tick: int


def simulate(rig: Rig, schedule: Schedule, session_tick: int) -> Trajectory:
    """Run the rig over a link.

    Parameters: schedule, the arrivals of `link.schedule_of`, whose number of ticks is the length of the run;
    session_tick, the tick at which the operator's programme starts: before it the instrument is armed and comes to its
    reference.
    Raises: ValueError if no tick is left for the session.
    """
    if not 0 <= session_tick < schedule.ticks:
        raise ValueError(f"the session cannot start at tick {session_tick} of {schedule.ticks}")
    rows = np.empty((schedule.ticks, len(COLUMNS)))
    compiled_form(_run)(
        rig.haptic,
        rig.law,
        rig.band,
        rig.slave,
        rig.instrument,
        rig.haptic_start,
        rig.instrument_start,
        schedule,
        _Times(rig.period_s, round(rig.period_s * 1e9), session_tick),
        rows,
    )
    columns: dict[str, Any] = dict(zip(COLUMNS, np.ascontiguousarray(rows[session_tick:].T), strict=True))
    for name, kind in (("in_contact", bool), ("hand_following", bool), ("instrument_mode", np.int64)):
        columns[name] = columns[name].astype(kind)
    return Trajectory(**columns)


@compiled
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
    )


@compiled
def _as_received(signal: PortSignal, silence_s: float, round_trip_s: float) -> PortSignal:
    """Return a signal with the two figures that its receiver fills in."""
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
        silence_s=silence_s,
        round_trip_s=round_trip_s,
    )


@compiled
def _told(delay_ns: int) -> int:
    """Return the part of a delay that the link tells the guards [ns]."""
    return delay_ns - delay_ns % DELAY_STEP_NS


@compiled
def _at(times_ns: npt.NDArray[np.int64], index: int) -> int:
    return int(times_ns[index]) if index < len(times_ns) else _NEVER_NS


@compiled
def _run(
    haptic: HapticParams,
    law: Any,
    band: DeadbandParams,
    loop: SlaveLoop,
    instrument: Any,
    haptic_state: HapticChainState,
    instrument_state: Any,
    schedule: Schedule,
    times: _Times,
    rows: Series,
) -> None:
    """Fill `rows` (ticks, columns) with the closed loop; the module's text gives the order."""
    # taken out of the tuple once: every access costs a count of references to its arrays
    forward_ns, forward_of = schedule.forward_ns, schedule.forward_of
    backward_ns, backward_of = schedule.backward_ns, schedule.backward_of
    dt, period_ns = times.period_s, times.period_ns
    # what is in flight, by the number of the sample (forward) or of its arrival (backward), modulo the window
    window = schedule.window
    mask = window - 1
    forward = [NO_SIGNAL for _ in range(window)]
    backward = [NO_SIGNAL for _ in range(window)]
    # what the dead band keeps back has a place in the schedule, and arrives nowhere
    sent_forward, sent_backward = np.zeros(window, np.bool_), np.zeros(window, np.bool_)
    master_band, slave_band = initial_deadband_state(NO_SIGNAL), initial_deadband_state(NO_SIGNAL)

    hand = HandSample(haptic_state.plant.motor.position_m, 0.0, 0.0, False)
    master = master_start(law, hand)
    command_mode, command_m, command_ns = haptic_safety.MODE_OFF, 0.0, -1
    rendered_n = 0.0
    due = False
    answer, answer_ns, answered = NO_SIGNAL, -1, 0
    # when the sample behind the newest answer would have been back without the link, and that behind the command
    answer_hand_ns, command_hand_ns = -1, -1

    tip = NO_TIP
    slave = slave_start(law, tip)
    slave_tick, received, received_ns = -1, NO_SIGNAL, -1
    slave_behind, slave_dt = 0, dt
    # the time that a command counts from is that of the hand's sample, told delay included
    action, base_reference_m, base_hand_ns = afm_safety.ACTION_HOLD, 0.0, -1
    armed = False
    instrument_ns, own_ns = 0, period_ns
    mode = afm_safety.MODE_RETRACTED

    hand_energy, tip_energy = 0.0, 0.0
    f, b = 0, 0
    for n in range(len(rows)):
        now_ns = n * period_ns
        age_s = np.inf if command_ns < 0 else (now_ns - min(command_ns, command_hand_ns)) * 1e-9
        session_s = (n - times.session_tick) * dt if n >= times.session_tick else -1.0
        asked = HapticInputs(
            command_mode=command_mode,
            position_reference_m=command_m,
            force_reference_n=0.0,
            command_age_s=age_s,
            session_time_s=session_s,
            estop=False,
            arm_requested=False,
        )
        haptic_state, felt = haptic_step(haptic, haptic_state, asked, dt)

        if due:
            if answer_ns >= 0:
                # the sample of the tick before is the one that went unanswered
                answer = _as_received(answer, (now_ns - answer_ns) * 1e-9, (n - 1 - answered) * dt)
            master, reference = master_receive(law, master, hand, answer, dt)
            command_mode = haptic_safety.MODE_POSITION if reference.active else haptic_safety.MODE_OFF
            command_m, command_ns, rendered_n = reference.position_m, now_ns, reference.force_n
            command_hand_ns = answer_hand_ns
        before = hand
        hand = HandSample(
            felt.reading.position_m,
            felt.reading.velocity_m_per_s,
            felt.reading.operator_force_n,
            felt.applied.mode != haptic_safety.MODE_OFF,
        )
        hand_energy += 0.5 * (hand.force_n + before.force_n) * (hand.position_m - before.position_m)
        if n == 0:
            master = master_start(law, hand)
        master, signal = master_send(law, master, hand, dt)
        forward[n & mask] = signal
        master_band, sent_forward[n & mask] = deadband(band, master_band, signal, dt)
        due = True

        end_ns = now_ns + period_ns
        while True:
            arrives_ns, returns_ns = _at(forward_ns, f), _at(backward_ns, b)
            event_ns = min(arrives_ns, returns_ns, own_ns)
            if event_ns >= end_ns:
                break
            if event_ns == arrives_ns and not sent_forward[forward_of[f] & mask]:
                sent_backward[f & mask] = False
                f += 1
                continue
            if event_ns == returns_ns and returns_ns < arrives_ns:
                if not sent_backward[backward_of[b] & mask]:
                    b += 1
                    continue
                answered = forward_of[backward_of[b]]
                there_ns, sampled_ns = forward_ns[backward_of[b]], answered * period_ns
                answer_hand_ns = sampled_ns + _told(there_ns - sampled_ns) + _told(event_ns - there_ns)
                answer, answer_ns = _as_received(backward[backward_of[b] & mask], 0.0, (n - answered) * dt), event_ns
                b += 1
                if due:
                    master, reference = master_receive(law, master, hand, answer, dt)
                    command_mode = haptic_safety.MODE_POSITION if reference.active else haptic_safety.MODE_OFF
                    command_m, command_ns, rendered_n = reference.position_m, event_ns, reference.force_n
                    command_hand_ns = answer_hand_ns
                    due = False
                continue
            commanded = event_ns == arrives_ns
            if commanded:
                tick = forward_of[f]
                elapsed = tick - slave_tick
                if slave_tick < 0:
                    slave, elapsed, slave_behind = slave_start(law, tip), 1, 0
                elif elapsed > loop.longest_periods:
                    slave, _ = slave_receive(law, slave, NO_SIGNAL, tip, dt)
                    elapsed, slave_behind = 1, 0
                slave_tick, received, received_ns = tick, forward[tick & mask], event_ns
                base_hand_ns = tick * period_ns + _told(event_ns - tick * period_ns)
            # what the instrument steps by itself, the slave half goes along with, while its last signal counts
            local = loop.local and not commanded and received_ns >= 0 and event_ns - received_ns <= loop.longest_ns
            local = local and received.active and tip.following
            if commanded or local:
                silent = (event_ns - received_ns) // period_ns
                slave_behind, periods = paced(slave_behind, elapsed if commanded else 0, silent)
                slave_dt = periods * dt
                present = _as_received(received, (event_ns - received_ns) * 1e-9, 0.0)
                slave, wanted = slave_receive(law, slave, present, tip, slave_dt)
                wanted = clamped(loop.clamp, wanted, present, tip)
                action = afm_safety.ACTION_POSITION if wanted.active else afm_safety.ACTION_HOLD
                base_reference_m = wanted.position_m
            # the operator arms the instrument once, when commands are there; a guard that trips later stays tripped
            arm = commanded and not armed and action == afm_safety.ACTION_POSITION
            command_age_s = np.inf if base_hand_ns < 0 else (event_ns - base_hand_ns) * 1e-9
            step_s = min(max(event_ns - instrument_ns, 1), LONGEST_STEP_NS) * 1e-9
            asked_tip = AfmInputs(base_reference_m, command_age_s, action, arm, False, 0.0, 0.0)
            instrument_state, felt_tip = instrument_step(instrument, instrument_state, asked_tip, step_s)
            instrument_ns = event_ns
            moved = felt_tip.base_m - tip.base_position_m if armed else 0.0
            tip_energy += 0.5 * (felt_tip.force_n + tip.force_n) * moved
            tip = _tip_of(felt_tip)
            mode = felt_tip.mode
            armed = armed or mode == afm_safety.MODE_FOLLOW
            own_ns = event_ns + (command_wait_ns(period_ns) if commanded or local else period_ns)
            if commanded or local:
                slave, signal = slave_send(law, slave, tip, slave_dt)
            if commanded:
                backward[f & mask] = signal
                slave_band, sent_backward[f & mask] = deadband(band, slave_band, signal, elapsed * dt)
                f += 1
        row = rows[n]
        row[0], row[1], row[2], row[3] = session_s, hand.force_n, hand.position_m, command_m
        row[4], row[5], row[6], row[7] = rendered_n, tip.base_position_m, tip.force_n, tip.separation_m
        row[8], row[9] = hand_energy, tip_energy
        row[10], row[11], row[12] = int(tip.in_contact), mode, int(hand.following)
