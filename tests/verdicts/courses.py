"""Make a labelled course of forces from a seed.

    recorded = course(7)
    recorded.time_s, recorded.tip_force_n, recorded.truth

A course is what a recording of a session would state, with the truth of the motion of its loop beside it. It is the
same on every processor but for the last bits of the elementary functions: nothing here sums in an order that a library
chooses. `plans.py` draws what happens; this file only turns it into samples.
"""

import math
from typing import NamedTuple

import distribution as d
import numpy as np
from numpy.typing import NDArray
from plans import Cause, Opening, Plan, Run, Truth, amplitude_n, plan, pressed_at_s

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

_GONE = 1e-6  # A mode that has decayed to this part of its amplitude is no longer computed.
_OCTAVES = 8  # How many octaves the 1/f noise spans.
_STEPS_IN_A_MEMORY = 10.0  # Steps of a random envelope within the time in which it forgets itself.
_LEAST_BANDWIDTH_PER_S = 1.0  # A random link excites a cycle or a growth in this band [1/s].


class Course(NamedTuple):
    """A session as its recording states it, and the truth of the motion of its loop. Arrays have one value a sample."""

    time_s: Floats  # Of the tip; it has a gap where no sample was recorded.
    hand_force_n: Floats  # Force of the hand as measured [N].
    tip_force_n: Floats  # Force of the tip at the scale of the hand [N].
    in_contact: Flags  # The tip touches, as the instrument states it.
    following: Flags  # The instrument follows the commands.
    held: Flags  # The base stands because commands are missing, or because the operator pauses.
    round_trip_s: float
    random_link: bool  # The link has jitter or loss.
    planned: tuple[tuple[float, float, float], ...]  # The holds: start [s], end [s], force of the hand [N].
    rest_force_n: (
        float | None
    )  # What the law rests at under the last of the holds; None for a law without a word on it.
    interruptions: tuple[tuple[float, float, Cause], ...]  # Last instant with the loop closed [s], end [s], cause.
    overruns: tuple[float, ...]  # When a machine was late [s].
    guard: tuple[float, str] | None  # When the instrument withdrew [s], and why.
    truth: Truth  # What the motion of the loop does after the first arrival.
    rate_per_s: float  # Real part of the pole that decides: the slowest that decays, or the one that grows; 0: a cycle.
    frequency_hz: float  # Its imaginary part over 2 pi; 0 for a real pole.
    tags: frozenset[str]  # What was put in; one begins with "no_truth:" where there is no truth.
    cell: str  # "rate/frequency/length", empty without truth.
    seed: int


def _octaves(generator: np.random.Generator, time_s: Floats, shortest_s: float) -> Floats:
    """Return 1/f noise of unit variance: lines between random values, a set for each octave of time."""
    noise: Floats = np.zeros(time_s.size)
    for octave in range(_OCTAVES):
        step_s = shortest_s * 2.0**octave
        values = generator.standard_normal(int(time_s[-1] / step_s) + 2)
        noise += np.interp(time_s, step_s * np.arange(values.size), values)
    noise *= math.sqrt(1.5 / _OCTAVES)  # a line between two normal values has 2/3 of their variance
    return noise


def _narrow_band(generator: np.random.Generator, time_s: Floats, frequency_hz: float, memory_s: float) -> Floats:
    """Return noise of about unit variance around a frequency, which forgets its amplitude and phase in memory_s."""
    step_s = memory_s / _STEPS_IN_A_MEMORY
    keep = math.exp(-1.0 / _STEPS_IN_A_MEMORY)
    count = int(time_s[-1] / step_s) + 2
    quadratures: list[Floats] = []
    for normals in generator.standard_normal((2, count)).tolist():
        values = [normals[0]]
        for normal in normals[1:]:
            values.append(keep * values[-1] + math.sqrt(1.0 - keep * keep) * normal)
        quadratures.append(np.interp(time_s, step_s * np.arange(count), np.array(values)))
    angle = 2.0 * math.pi * frequency_hz * time_s
    noise: Floats = quadratures[0] * np.cos(angle) + quadratures[1] * np.sin(angle)
    return noise


def _planned_force(drawn: Plan, time_s: Floats) -> Floats:
    """Return the force that the hand is planned to have, with the ramps between the holds [N]."""
    times, forces = [0.0], [0.0]
    for hold in drawn.holds:
        times += [hold.start_s - drawn.ramp_s, hold.start_s]
        forces += [forces[-1], hold.force_n]
    if drawn.released:
        times += [drawn.holds[-1].end_s, drawn.holds[-1].end_s + drawn.ramp_s]
        forces += [forces[-1], 0.0]
    return np.interp(time_s, times, forces)


def _disturbances(drawn: Plan, run: Run) -> list[tuple[float, float]]:
    """Return when something excites the modes within a run [s], and by which ratio to their amplitudes."""
    steps = [
        (hold.start_s, (hold.force_n - before.force_n) / drawn.hand_force_n)
        for before, hold in zip(drawn.holds, drawn.holds[1:], strict=False)
    ]
    late = [(at_s, drawn.overload_kick) for at_s in drawn.overruns if drawn.overload_kick]
    return sorted(pair for pair in steps + late if run.start_s < pair[0] < run.end_s)


def _decaying(drawn: Plan, mode: int, since_s: Floats, scale: float, turn: float) -> Floats:
    """Return one decaying mode over the time since its excitation [N]; a turn of 0 to 1 is its phase, or its sign."""
    rate_per_s, frequency_hz, first_n = drawn.modes[mode]
    envelope = np.exp(rate_per_s * since_s)
    if drawn.friction is not None:
        # dA/dt = -r A - c: the motion stops at a finite time, and not where the loop rests
        envelope = np.maximum((1.0 + drawn.friction) * envelope - drawn.friction, 0.0)
    sign = 1.0 if turn < 0.5 or frequency_hz else -1.0
    phase = 2.0 * math.pi * turn if frequency_hz else 0.0
    return scale * sign * first_n * envelope * np.cos(2.0 * math.pi * frequency_hz * since_s + phase)


def _excite(
    drawn: Plan, motion: Floats, time_s: Floats, run: Run, start_s: float, scale: float, turns: list[float]
) -> None:
    """Add every decaying mode to the motion, from an instant to the end of the run."""
    for mode, turn in enumerate(turns):
        rate_per_s = drawn.modes[mode].rate_per_s
        if rate_per_s >= 0.0:
            continue
        last_s = min(run.end_s, start_s + math.log(_GONE) / rate_per_s)
        first, last = np.searchsorted(time_s, [start_s, last_s])
        motion[first:last] += _decaying(drawn, mode, time_s[first:last] - start_s, scale, turn)


def _turns(drawn: Plan, generator: np.random.Generator, landing: bool) -> list[float]:
    """Return a random phase for each mode; a real one has the sign of its amplitude at the landing."""
    turns = [float(turn) for turn in generator.random(len(drawn.modes))]
    return [0.0 if landing and not mode.frequency_hz else turn for mode, turn in zip(drawn.modes, turns, strict=True)]


def _envelope(drawn: Plan, run: Run, time_s: Floats) -> Floats:
    """Return the amplitude of a main mode that does not decay [N]; a cycle has its own at once."""
    if drawn.motion in ("sustained", "bounces"):
        return np.full_like(time_s, drawn.modes[0].amplitude_n)
    sign = math.copysign(1.0, drawn.modes[0].amplitude_n)
    return sign * np.array([amplitude_n(drawn, run, at_s) for at_s in time_s.tolist()])


def _phase(drawn: Plan, generator: np.random.Generator, run: Run, time_s: Floats) -> Floats:
    """Return the phase of a main mode that does not decay [rad]; what disturbs the loop shifts it."""
    frequency_hz = drawn.modes[0].frequency_hz
    first = float(generator.random()) * 2.0 * math.pi if frequency_hz else 0.0
    if (pressed_s := pressed_at_s(drawn, run)) is not None:
        first = -2.0 * math.pi * frequency_hz * (pressed_s - run.start_s)
    phase = first + 2.0 * math.pi * frequency_hz * (time_s - run.start_s)
    for at_s, _ in _disturbances(drawn, run):
        shift = float(generator.uniform(-0.5, 0.5))
        if frequency_hz:
            phase = phase + np.where(time_s >= at_s, shift, 0.0)
    return phase


def _closed_loop(drawn: Plan, generator: np.random.Generator, time_s: Floats, rest_n: Floats) -> Floats:
    """Return the force of the tip where the loop is closed, as if the surface could pull without end [N]."""
    force = rest_n.copy()
    motion = np.zeros_like(time_s)
    if drawn.random_excitation_n:
        main = drawn.modes[0]
        memory_s = 1.0 / max(abs(main.rate_per_s), _LEAST_BANDWIDTH_PER_S)
        motion += drawn.random_excitation_n * _narrow_band(generator, time_s, main.frequency_hz, memory_s)
    for run in drawn.runs:
        first, last = np.searchsorted(time_s, [run.start_s, run.end_s])
        if last == first:
            continue
        _excite(drawn, motion, time_s, run, run.start_s, run.scale, _turns(drawn, generator, run is drawn.runs[0]))
        if drawn.motion == "decays":
            for at_s, ratio in _disturbances(drawn, run):
                _excite(drawn, motion, time_s, run, at_s, ratio, _turns(drawn, generator, False))
            continue
        there = time_s[first:last]
        phase = _phase(drawn, generator, run, there)
        if drawn.motion == "bounces":
            part = np.remainder(phase / (2.0 * math.pi), 1.0) / drawn.contact_fraction
            touch = np.where(part < 1.0, np.sin(math.pi * part), -1.0)
            peak_n = 0.5 * math.pi / drawn.contact_fraction * rest_n[first:last]
            force[first:last] = np.where(touch > 0.0, peak_n * touch, -2.0 * drawn.adhesion_n - 1e-3 * peak_n)
        else:
            motion[first:last] += _envelope(drawn, run, there) * np.cos(phase)
    return force + motion if drawn.motion != "bounces" else force


def _rest(drawn: Plan, time_s: Floats, planned_n: Floats) -> Floats:
    """Return what the loop would rest at [N]: a share of the force of the hand, an offset, drift and friction."""
    rest = drawn.rest_ratio * planned_n + drawn.rest_offset_n
    since = np.clip((time_s - drawn.landing_s) / (drawn.holds[-1].end_s - drawn.landing_s), 0.0, 1.0)
    rest = rest + drawn.drift_n * since
    if drawn.friction is not None:
        decayed = 1.0 - np.exp(drawn.modes[0].rate_per_s * np.maximum(time_s - drawn.landing_s, 0.0))
        rest = rest + drawn.friction_offset_n * decayed
    return rest


class _Trace:
    """The samples of a course while they are made."""

    def __init__(self, drawn: Plan, generator: np.random.Generator) -> None:
        self.drawn = drawn
        count = max(2, int(drawn.end_s * drawn.sample_rate_hz))
        jitter = drawn.stamp_jitter * generator.uniform(-0.5, 0.5, count)
        self.time_s = (np.arange(count) + 0.5 + jitter) / drawn.sample_rate_hz
        self.planned_n = _planned_force(drawn, self.time_s)
        self.hand_n = self.planned_n.copy()
        self.force_n = np.zeros(count)
        self.contact = np.zeros(count, dtype=np.bool_)
        self.following = np.ones(count, dtype=np.bool_)
        self.held = np.zeros(count, dtype=np.bool_)
        self.recorded = np.ones(count, dtype=np.bool_)
        self.guard: tuple[float, str] | None = None

    def span(self, start_s: float, end_s: float) -> slice:
        first, last = np.searchsorted(self.time_s, [start_s, end_s])
        return slice(int(first), int(last))

    def tremble(self, generator: np.random.Generator) -> Floats:
        """Add a person's tremor to the hand, and return what of it reaches the tip, half a round trip later [N]."""
        hand, drawn = self.drawn.hand, self.drawn
        if hand is None:
            return np.zeros_like(self.time_s)
        tremor = hand.tremor_n * _narrow_band(generator, self.time_s, hand.tremor_hz, d.TREMOR_BAND_S)
        pressing = self.planned_n / drawn.hand_force_n
        trembling = pressing * (tremor + hand.wander_n * _octaves(generator, self.time_s, 0.1))
        self.hand_n = self.planned_n + trembling
        return hand.gain * np.interp(self.time_s - 0.5 * drawn.round_trip_s, self.time_s, trembling)

    def approach(self) -> None:
        """Write the attractive dip before the arrival and the blows after it."""
        drawn = self.drawn
        if drawn.arrival_s is None:
            return
        if drawn.snap_in is not None:
            depth_n, length_s = drawn.snap_in
            dip = self.span(drawn.arrival_s - length_s, drawn.arrival_s)
            part = 1.0 - (drawn.arrival_s - self.time_s[dip]) / length_s
            self.force_n[dip] = -depth_n * part * part
        for blow in drawn.blows:
            touch = self.span(blow.start_s, blow.start_s + blow.length_s)
            self.force_n[touch] = blow.peak_n * np.sin(math.pi * (self.time_s[touch] - blow.start_s) / blow.length_s)
            self.contact[touch] = True

    def land(self, closed_n: Floats) -> None:
        """Write the motion of the loop; the surface does not pull more than its adhesion."""
        landed = self.span(self.drawn.landing_s, math.inf)
        touching = closed_n[landed] > -self.drawn.adhesion_n
        self.contact[landed] = touching
        self.force_n[landed] = np.where(touching, closed_n[landed], 0.0)

    def open(self, opening: Opening) -> None:
        """Hold the force where the loop is open, after it has moved on with the last command up to the deadline."""
        away = self.span(opening.start_s, opening.end_s)
        if away.start >= away.stop or away.start == 0:
            return
        deadline_s = 0.0 if opening.cause == "operator" else d.COMMAND_DEADLINE_S
        since_s = self.time_s[away] - opening.start_s
        force = self.force_n[away.start - 1] + opening.starved_n_per_s * np.minimum(since_s, deadline_s)
        touching = (force > 0.0) if opening.starved_n_per_s else np.full(force.shape, self.contact[away.start - 1])
        self.force_n[away] = np.where(touching, force, 0.0)
        self.contact[away] = touching
        self.held[away] = since_s >= deadline_s
        self.following[away] = since_s < deadline_s
        if not opening.sampled:
            self.recorded[away] = False

    def withdraw(self, at_s: float, reason: str) -> None:
        """Take the tip off the surface for the rest of the recording."""
        after = self.span(at_s, math.inf)
        if after.start >= self.time_s.size:
            return
        left = np.clip(1.0 - (self.time_s[after] - at_s) / d.WITHDRAWAL_S, 0.0, 1.0)
        force = np.maximum(self.force_n[max(after.start - 1, 0)], 0.0) * left
        self.force_n[after], self.contact[after] = force, force > 0.0
        self.following[after], self.held[after] = False, False
        self.guard = (at_s, reason)

    def release(self) -> None:
        """Let the tip leave the surface with the hand."""
        if self.drawn.released:
            gone = self.span(self.drawn.holds[-1].end_s + self.drawn.ramp_s, math.inf)
            leaving = self.span(self.drawn.holds[-1].end_s, math.inf)
            self.force_n[leaving] *= self.planned_n[leaving] / self.drawn.hand_force_n
            self.force_n[gone], self.contact[gone] = 0.0, False

    def guard_growth(self) -> None:
        """Withdraw where a growing force has passed the limit of the instrument."""
        above = np.flatnonzero(self.force_n > self.drawn.guard_limit_n)
        if self.drawn.motion == "grows" and above.size:
            self.withdraw(float(self.time_s[above[0]]), f"force above {self.drawn.guard_limit_n:.2f} N")

    def measure(self, generator: np.random.Generator) -> None:
        """Add the noise of the force sensor, or round the force to its steps."""
        noise_n, noise = self.drawn.noise_n, self.drawn.noise
        if noise == "white":
            self.force_n += noise_n * generator.standard_normal(self.time_s.size)
        elif noise == "pink":
            self.force_n += noise_n * _octaves(generator, self.time_s, 2.0 / self.drawn.sample_rate_hz)
        elif noise == "quantised" and noise_n:
            self.force_n = np.round(self.force_n / noise_n) * noise_n


def _fill(trace: _Trace, generator: np.random.Generator) -> None:
    """Write the samples of a plan into a trace."""
    drawn = trace.drawn
    if "nothing_moves" in drawn.tags:
        trace.force_n[:] = drawn.rest_ratio * drawn.hand_force_n
        trace.contact[:] = True
        return
    trembling = trace.tremble(generator)
    trace.approach()
    if drawn.arrival_s is not None:
        rest = _rest(drawn, trace.time_s, trace.planned_n) + trembling
        trace.land(_closed_loop(drawn, generator, trace.time_s, rest))
    trace.release()
    for opening in drawn.openings:
        trace.open(opening)
    if drawn.withdrawal_s is not None:
        longest_ms = 1e3 * (d.COMMAND_DEADLINE_S + d.HOLD_BEFORE_WITHDRAWAL_S)
        trace.withdraw(drawn.withdrawal_s, f"no command for {longest_ms:.0f} ms")
    trace.guard_growth()
    trace.measure(generator)


def course(seed: int) -> Course:
    """Return the course of a seed.

    Args:
        seed: a whole number, zero or more; `range(distribution.COURSES)` is the corpus.

    Raises:
        ValueError: the seed is negative.
    """
    drawn = plan(seed)
    generator = np.random.Generator(np.random.PCG64(seed))
    trace = _Trace(drawn, generator)
    _fill(trace, generator)
    kept, last_s = trace.recorded, trace.guard[0] if trace.guard else drawn.end_s
    return Course(
        time_s=trace.time_s[kept],
        hand_force_n=trace.hand_n[kept],
        tip_force_n=trace.force_n[kept],
        in_contact=trace.contact[kept],
        following=trace.following[kept],
        held=trace.held[kept],
        round_trip_s=drawn.round_trip_s,
        random_link=drawn.random_link,
        planned=tuple((hold.start_s, hold.end_s, hold.force_n) for hold in drawn.holds),
        rest_force_n=drawn.rest_ratio * drawn.hand_force_n if drawn.rest_stated else None,
        interruptions=tuple(
            (opening.start_s, min(opening.end_s, drawn.end_s), opening.cause)
            for opening in drawn.openings
            if opening.start_s < last_s
        ),
        overruns=drawn.overruns,
        guard=trace.guard,
        truth=drawn.truth,
        rate_per_s=drawn.rate_per_s,
        frequency_hz=drawn.frequency_hz,
        tags=drawn.tags,
        cell=drawn.cell,
        seed=seed,
    )
