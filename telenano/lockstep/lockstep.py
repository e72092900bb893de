"""The closed loop in one compiled function: hand, law, link and instrument, tick by tick, without processes or clock.

The steps and the state machines of the halves (`telenano.laws.integration`) are those of the nodes, and the order is
that of the bus. At the tick n of the hand, time n Ts:

1. The haptic site steps with its newest command (guard, device, hand).
2. The master half processes the sample: if nothing has answered the previous sample, it receives first, and then it
   sends, unless the dead band suppresses the signal.
3. Signals that reach their end of the link before the next tick act in the order of arrival. Of signals that arrive
   together a reader uses the newest, as on the bus, where they wait for it together (conflation). A forward signal
   passes the slave half, the instrument and the slave half again, and its answer enters the link. A backward signal
   goes to the master half. An instrument that receives nothing for a period and a half steps by itself, its guard
   judges the silence, and the slave half processes the measurement: with a local loop it commands another step.

Messages within a site take no time here, so the instrument carries out each command at once.
The guards judge the age of the hand's sample that a command descends from, minus the delay of the link in whole steps,
as in the nodes.

So a signal released between two ticks acts in the tick in which it arrives, as on the bus: a constant round trip of T
delays the loop by floor(T/Ts) Ts, and the hold of the law's integration adds half a period to that (`theory`).
The session begins when the tip is placed, as the instrument reports on the bus (`telenano.afm.safety.is_placed`).
"""

import logging
import math
from collections import Counter
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from telenano.afm.safety import REASON_NAMES
from telenano.afm.step import AfmParams, initial_afm_state
from telenano.extend.laws import NO_SIGNAL, TipMeasurement
from telenano.hand.step import HapticParams
from telenano.hand.step import HapticStepState as HapticChainState
from telenano.hand.step import initial_state as haptic_at_start
from telenano.laws.deadband import deadband, initial_deadband_state
from telenano.laws.lateral import hand_moves as moves_stage
from telenano.lockstep.across import (
    STAGE_X,
    WIDTH,
    AcrossPath,
    across_at_rest,
    across_heard,
    across_sampled,
    across_signalled,
    across_steered,
    guided,
)
from telenano.lockstep.link import Schedule
from telenano.lockstep.sites import (
    Halves,
    Instrument,
    Lateral,
    Master,
    by_rate,
    carried_out,
    continues,
    counts,
    driven,
    hand_stepped,
    instrument_at,
    master_at,
    master_with_answer,
    master_with_sample,
    put_answer,
    slave_at,
    slave_with_signal,
    went_on,
)
from telenano.lockstep.steering import hand_ends, hand_moves, hand_notes, hand_sees, hand_writes
from telenano.lockstep.trajectory import Series, Trajectory
from telenano.numerics.compiler import borrowed, compiled, compiled_call, inlined, is_compiled
from telenano.sections.controller_section import ControllerConfig
from telenano.sections.hand_section import HapticConfig
from telenano.wire.errors import ConfigError, RigError
from telenano.wire.lengths import in_nm

_NEVER_NS = 2**62
# Plain Python needs 70 microseconds of processor time for a tick, and the compiler 10 to 16 s for the loop of a law
# (docs/api.md). After this number of ticks of one kind, which took as long as compiling, the loop is compiled.
PLAIN_TICKS = 200_000
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


# Number of ticks that this process has run as plain Python, by the types for which a separate loop is compiled.
_plain_ticks: Counter[tuple[Any, ...]] = Counter()


@dataclass(frozen=True)
class Rig:
    """A rig ready to run: constants of halves, haptic site and instrument, and their first states; made by `Rig.of`."""

    halves: Halves
    haptic: HapticParams
    haptic_start: HapticChainState
    instrument: AfmParams
    instrument_start: Any

    @classmethod
    def of(
        cls, controller: ControllerConfig, haptic: HapticConfig, instrument: AfmParams, duration_s: float = 0.0
    ) -> Self:
        """Prepare a rig with the device off at its configured position, and the instrument retracted.

        Args:
            controller: The configuration of both halves of the law.
            haptic: The configuration of the haptic site.
            instrument: The constants of the instrument.
            duration_s: The length of the run [s], for which disturbances of the hand are drawn; 0 for none.
        """
        halves = Halves(
            law=controller.params(),
            band=controller.deadband.to_params(),
            clamp=controller.clamp_params(),
            master=controller.master_timing(),
            slave=controller.slave_timing(),
            period_s=controller.period_s,
            hand=controller.hand_params(),
        )
        site = haptic.to_params(math.ceil(duration_s / controller.period_s), controller.period_s)
        start = haptic_at_start(site.plant, haptic.device.start_position_m)
        return cls(halves, site, start, instrument, initial_afm_state(instrument))

    def over(self, plant: Any) -> Self:
        """Return the same rig with another plant in its instrument, which starts retracted."""
        instrument = self.instrument._replace(plant=plant)
        return replace(self, instrument=instrument, instrument_start=initial_afm_state(instrument))

    @property
    def period_s(self) -> float:
        """The period of the hand [s]."""
        return self.halves.period_s

    def run(
        self,
        schedule: Schedule,
        session_tick: int,
        hand: Any = None,
        path: AcrossPath | None = None,
        *,
        at_once: bool = True,
    ) -> "Trajectory":
        """Run the rig over a link, compiled or as plain Python, which give the same bits.

        Args:
            schedule: The arrivals of `Schedule.of`, whose number of ticks is the length of the run.
            session_tick: The earliest tick at which the operator's program starts (`AfmConfig.time_to_place_s`); it
                starts later if the tip is placed later.
            hand: A hand that also steers the tip over the sample, with the steps of its class
                (`telenano.lockstep.steering`); without `path` the run ends when it is done.
            path: The lateral path of the controller, through which the stylus or `hand` moves the tip; the run then
                takes all ticks.
            at_once: Whether to compile for the first run, for a study of many runs. Otherwise a stored compiled loop is
                used if there is one, and is compiled after PLAIN_TICKS ticks of its kind as plain Python.

        Raises:
            ValueError: `session_tick` is not within the run.
            RigError: The tip was not placed within the run.
            ConfigError: A model cannot be compiled; no tick has run.
        """
        if not 0 <= session_tick < schedule.ticks:
            raise ValueError(f"the session cannot start at tick {session_tick} of {schedule.ticks}")
        rows = np.empty((len(COLUMNS), schedule.ticks))
        states = self.haptic_start, self.instrument_start
        arguments = (self.halves, self.haptic, self.instrument, *states, schedule, session_tick, rows, hand, path)
        start, done = compiled_call(_run, arguments) if at_once else _run_as_it_pays(self, arguments)
        if start < 0:
            limits, newest = self.instrument.safety, dict(zip(COLUMNS, rows[:, -1].tolist(), strict=True))
            why = (
                f"its base is at {in_nm(newest['base_position_m'])}, from"
                f" {in_nm(limits.retract_position_m)} at no more than {1e9 * limits.base_speed_m_per_s:.4g} nm/s"
            )
            if math.isfinite(newest["withdrawn_s"]):
                why = f"its guard has withdrawn it ({REASON_NAMES[int(newest['instrument_reason'])]})"
            raise RigError(f"the tip was not placed within {schedule.ticks * self.period_s:.3g} s of arming: {why}")
        columns: dict[str, Any] = dict(zip(COLUMNS, rows[:, start:done], strict=True))
        for name in ("in_contact", "hand_following"):
            columns[name] = columns[name].astype(bool)
        for name in ("instrument_mode", "instrument_reason"):
            columns[name] = columns[name].astype(np.int64)
        columns["withdrawn_s"] = columns["withdrawn_s"] - start * self.period_s
        columns["begins_s"] = start * self.period_s
        columns["across"] = None if path is None else path.rows[start:done]
        return Trajectory(**columns)


def _run_as_it_pays(rig: Rig, arguments: tuple[Any, ...]) -> tuple[int, int]:
    """Run the loop compiled if that is stored or pays; otherwise run it as plain Python, and count the ticks."""
    kind = tuple(map(type, (rig.halves.law, rig.instrument.plant, *arguments)))
    if _plain_ticks[kind] >= PLAIN_TICKS or is_compiled(_run, arguments):
        try:
            counts: tuple[int, int] = compiled_call(_run, arguments)
            return counts
        # Continue as plain Python, because that has worked until now.
        except ConfigError as error:
            logging.getLogger("studies").warning("%s; it runs as plain Python", error)
            _plain_ticks[kind] = -_NEVER_NS
    _plain_ticks[kind] += arguments[5].ticks
    return _run(*arguments)


@inlined
def _at(times_ns: npt.NDArray[np.int64], index: int) -> int:
    return int(times_ns[index]) if index < len(times_ns) else _NEVER_NS


@inlined
def _taken_together(
    times_ns: npt.NDArray[np.int64], numbers: npt.NDArray[np.int64], sent: npt.NDArray[np.bool_], first: int
) -> tuple[int, int]:
    """Return the last arrival that comes together with the first, and the newest number of these that was sent, or -1.

    sent: whether each number was sent, modulo its length, which is a power of two.
    """
    mask, last, newest = len(sent) - 1, first, -1
    while True:
        if sent[numbers[last] & mask]:
            newest = numbers[last]
        if _at(times_ns, last + 1) != times_ns[first]:
            return last, newest
        last += 1


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
    steers: Any,
    path: AcrossPath | None,
) -> tuple[int, int]:
    """Fill `rows` (columns, ticks) with the closed loop, in the order of the module's docstring.

    Returns:
        The tick at which the session began, -1 if it never did, and the number of ticks that were run.
    """
    # `Rig.run` keeps all arrays until the end, so no call in here needs to count references to them.
    halves, haptic, instrument = borrowed((halves, haptic, instrument))
    haptic_state, instrument_state = borrowed((haptic_state, instrument_state))
    schedule, rows = borrowed((schedule, rows))
    # Unpack the fields once, because every access to the tuple counts references to its arrays.
    forward_ns, forward_of = schedule.forward_ns, schedule.forward_of
    backward_ns, backward_of = schedule.backward_ns, schedule.backward_of
    dt, period_ns = halves.period_s, halves.master.period_ns
    # The messages in flight, by the number of the sample (forward) or of its arrival (backward), modulo the window.
    window = schedule.window
    mask = window - 1
    forward = [NO_SIGNAL for _ in range(window)]
    backward = [NO_SIGNAL for _ in range(window)]
    # A sample that the dead band suppresses has a place in the schedule, but does not arrive.
    sent_forward, sent_backward = np.zeros(window, np.bool_), np.zeros(window, np.bool_)
    answered = np.zeros(window, np.int64)
    # The same for a hand that steers: speeds [m/s], and positions and forces of the answers [m, N].
    speeds, answers = np.zeros((window, 2)), np.zeros((window, 4))
    slave_band = initial_deadband_state(NO_SIGNAL)
    m, s = master_at(halves, haptic, haptic_state), slave_at(halves)
    i = instrument_at(instrument_state, period_ns)
    hand_energy_j, f, b, before = 0.0, 0, 0, m.hand
    across = across_at_rest()
    start = -1
    for n in range(schedule.ticks):
        now_ns = n * period_ns
        if start < 0 and n >= session_tick and i.placed:
            start = n
        # Tick of the session, negative before it.
        since = n - start if start >= 0 else n - schedule.ticks
        session_s = since * dt if start >= 0 else -1.0
        haptic_state, hand = hand_stepped(haptic, haptic_state, m.command, now_ns, session_s, dt)
        hand_energy_j += 0.5 * (hand.force_n + before.force_n) * (hand.position_m - before.position_m)
        before = hand
        if path is not None:
            own_n = (0.0, 0.0)
            if steers is not None:
                own_n = across_steered(path, across, hand_moves(steers, since))
            across = across_sampled(path, across, hand, counts(m, path, now_ns), n, session_s, dt, own_n)
            hand = guided(across, hand)
        elif steers is not None:
            if hand_ends(steers):
                return start, n
            speeds[n & mask, 0], speeds[n & mask, 1] = hand_moves(steers, since)
        m, forward[n & mask], sent_forward[n & mask] = master_with_sample(halves, m, hand, now_ns)
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
                    if path is not None:
                        follows, later_s = continues(halves, s, forward[tick & mask], tick * period_ns, event_ns)
                        was = i.lateral
                        across = across_signalled(path, across, tick, (was.x_m, was.y_m), follows, later_s)
                        if moves_stage(across.slave):
                            x_m, y_m = across.slave.x_m, across.slave.y_m
                            i = driven(i, Lateral(x_m, y_m, 0.0, 0.0, -1, was.force_x_n, was.force_y_n))
                    elif steers is not None:
                        i = driven(i, by_rate(i.lateral, speeds[tick & mask], event_ns))
                    s = slave_with_signal(halves, s, forward[tick & mask], tick * period_ns, event_ns)
                    s, i, signal = carried_out(halves, instrument, s, i, event_ns)
                    elapsed_s = s.timing.pacing.elapsed * dt
                    slave_band, sent_backward[f & mask] = deadband(halves.band, slave_band, signal, elapsed_s)
                    backward[f & mask], answered[f & mask] = signal, tick
                    if steers is not None:
                        across_n = (i.lateral.force_x_n, i.lateral.force_y_n)
                        hand_notes(steers, i.state.plant, i.state.force_n, across_n)
                        put_answer(answers[f & mask], i.lateral)
                    if path is not None:
                        put_answer(path.backward[f & mask], i.lateral)
                f += 1
            elif event_ns == returns_ns:
                b, answer = _taken_together(backward_ns, backward_of, sent_backward, b)
                if answer >= 0:
                    hand_ns, there_ns = answered[answer & mask] * period_ns, forward_ns[answer]
                    m = master_with_answer(halves, m, backward[answer & mask], hand_ns, there_ns, event_ns)
                    if steers is not None:
                        hand_sees(steers, answers[answer & mask])
                    if path is not None:
                        across = across_heard(path, across, answer)
                b += 1
            else:
                s, i = went_on(halves, instrument, s, i, event_ns)
        _record(rows[:, n], session_s, m, s.tip, hand_energy_j, i)
        if path is not None:
            put_answer(path.rows[n, STAGE_X:], i.lateral)
            if steers is not None:
                hand_writes(steers, path.rows[n, WIDTH:])
    return start, schedule.ticks


@inlined
def _record(row: Series, session_s: float, m: Master, tip: TipMeasurement, hand_energy_j: float, i: Instrument) -> None:
    """Write the values at the end of a tick, in the order of COLUMNS."""
    row[0], row[1], row[2], row[3] = session_s, m.hand.force_n, m.hand.position_m, m.command.position_m
    row[4], row[5], row[6], row[7] = m.rendered_n, i.base_m, tip.force_n, tip.separation_m
    row[8], row[9] = hand_energy_j, i.energy_j
    row[10], row[11], row[12] = int(tip.in_contact), i.mode, int(m.hand.following)
    row[13], row[14] = i.reason, i.withdrawn_s
