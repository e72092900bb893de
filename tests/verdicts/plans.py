"""Draw what happens in a course, and decide its truth from that alone.

    plan(7).truth, plan(7).modes[0].rate_per_s

A plan is what a course is made from: the schedule, the poles, the interruptions and the disturbances. `courses.py`
turns it into samples. The truth follows from the poles and from how the course was constructed; no sample is looked at.
Everything is drawn by `random.Random(seed)` from the ranges of `distribution.py`.
"""

import math
import random
from itertools import pairwise
from typing import Literal, NamedTuple

import distribution as d
from nonlinear_distribution import AT_REST, MANY_TURNS

Truth = Literal["settles", "grows", "goes_on", "no_truth"]
Cause = Literal["link", "machine", "operator"]


class Mode(NamedTuple):
    """One summand of the motion: amplitude * exp(rate * t) * cos(2 pi * frequency * t + phase)."""

    rate_per_s: float
    frequency_hz: float  # Zero for a real pole.
    amplitude_n: float  # At the landing; negative only for a real pole, which has no phase.


class Opening(NamedTuple):
    """An interval in which the loop was open, from the last instant at which it was closed."""

    start_s: float
    end_s: float
    cause: Cause
    starved_n_per_s: float  # How fast the force changes up to the deadline of the commands; zero where it is held.
    sampled: bool  # Whether samples were recorded in it.


class Run(NamedTuple):
    """An interval with the loop closed throughout, which begins with an excitation of the modes."""

    start_s: float
    end_s: float
    scale: float  # The amplitudes at its start, as a ratio to those of the modes.


class Blow(NamedTuple):
    """One touch of a tip that strikes the surface and flies off again."""

    start_s: float
    length_s: float
    peak_n: float


class Hold(NamedTuple):
    """An interval in which the hand is planned to press with a constant force."""

    start_s: float
    end_s: float
    force_n: float


class Hand(NamedTuple):
    """How a person's hand departs from a constant force."""

    tremor_n: float  # RMS [N].
    tremor_hz: float
    wander_n: float  # RMS of a 1/f motion [N].
    gain: float  # How much of it the tip force follows.


class Plan(NamedTuple):
    """All that was drawn for a course, and its truth. Times are seconds from the start of the recording."""

    seed: int
    motion: str
    hand_force_n: float
    holds: tuple[Hold, ...]
    ramp_s: float
    end_s: float
    released: bool
    sample_rate_hz: float
    round_trip_s: float
    random_link: bool
    stamp_jitter: float
    rest_ratio: float  # What the loop rests at for each newton of the hand.
    rest_offset_n: float
    rest_stated: bool
    arrival_s: float | None
    landing_s: float  # When the motion of the loop begins: the arrival, or the end of the last flight after a blow.
    modes: tuple[Mode, ...]
    last_amplitude_n: float | None  # What bounds a growth that saturates.
    contact_fraction: float
    adhesion_n: float
    guard_limit_n: float
    snap_in: tuple[float, float] | None  # Depth [N] and length [s].
    blows: tuple[Blow, ...]
    openings: tuple[Opening, ...]
    runs: tuple[Run, ...]
    withdrawal_s: float | None  # When the instrument withdraws because commands are missing.
    overruns: tuple[float, ...]
    overload_kick: float  # What an overrun excites the modes by, as a ratio to their amplitudes.
    random_excitation_n: float  # RMS of the motion that a random link excites.
    friction: float | None  # Loss that does not shrink with the amplitude, as a part of the first one per 1/rate.
    friction_offset_n: float
    drift_n: float  # Change of the rest force from the landing to the end of the last hold.
    hand: Hand | None
    noise: str
    noise_n: float
    truth: Truth
    rate_per_s: float
    frequency_hz: float
    length_s: float  # Of the stretch by which the truth can be known.
    cell: str
    tags: frozenset[str]


class _Draw:
    """Draw from ranges and shares with a generator of its own."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)

    def of(self, interval: d.Range) -> float:
        if interval.logarithmic:
            return math.exp(self._random.uniform(math.log(interval.low), math.log(interval.high)))
        return self._random.uniform(interval.low, interval.high)

    def between(self, low: float, high: float) -> float:
        return self._random.uniform(low, high)

    def happens(self, share: float) -> bool:
        return self._random.random() < share

    def sign(self) -> float:
        return 1.0 if self.happens(0.5) else -1.0

    def choice(self, shares: tuple[d.Share, ...]) -> str:
        mark = self._random.random()
        for share in shares:
            mark -= share.probability
            if mark < 0.0:
                return share.value
        return shares[-1].value

    def one(self, values: tuple[float, ...]) -> float:
        return values[int(self._random.random() * len(values))]


def _holds(draw: _Draw, force_n: float, ramp_s: float) -> tuple[Hold, ...]:
    """Draw one hold or two; each begins when the hand has come to its force, `ramp_s` after it set out."""
    start_s, holds = draw.of(d.LEAD) + ramp_s, []
    if draw.happens(d.TWO_HOLDS_SHARE):
        end_s = start_s + draw.of(d.FIRST_HOLD)
        holds.append(Hold(start_s, end_s, force_n * draw.of(d.FIRST_FORCE)))
        start_s = end_s + ramp_s
    return (*holds, Hold(start_s, start_s + draw.of(d.HOLD), force_n))


def _blows(draw: _Draw, arrival_s: float, force_n: float) -> tuple[tuple[Blow, ...], float]:
    """Draw the touches of a tip that strikes, and the instant at which it has landed for good."""
    start_s, peak_n = arrival_s, force_n * draw.of(d.BLOW_PEAK)
    length_s, flight_s = draw.of(d.BLOW_LENGTH), draw.of(d.BLOW_FLIGHT)
    restitution, count, blows = draw.of(d.BLOW_RESTITUTION), int(draw.choice(d.BLOW_COUNTS)), []
    for _ in range(count):
        blows.append(Blow(start_s, length_s, peak_n))
        start_s += length_s + flight_s
        peak_n, flight_s = peak_n * restitution, flight_s * restitution
    return tuple(blows), start_s


def _main_mode(draw: _Draw, motion: str, rest_n: float) -> Mode:
    """Draw the slowest decaying mode, or the one that grows or is sustained."""
    magnitude, frequency_hz = draw.of(d.RATE), draw.of(d.FREQUENCY)
    if motion == "decays":
        if draw.happens(d.REAL_POLE_SHARE):
            sign = -1.0 if draw.happens(d.APPROACH_FROM_BELOW_SHARE) else 1.0
            return Mode(-magnitude, 0.0, sign * rest_n * draw.of(d.APPROACH_AMPLITUDE))
        return Mode(-magnitude, frequency_hz, rest_n * draw.of(d.DECAY_AMPLITUDE))
    if motion in ("grows", "saturates"):
        soft = draw.happens(d.SOFT_GROWTH_SHARE)
        amplitude_n = rest_n * draw.of(d.SOFT_GROWTH_AMPLITUDE if soft else d.GROWTH_AMPLITUDE)
        if motion == "grows" and draw.happens(d.REAL_POLE_SHARE):
            return Mode(magnitude, 0.0, amplitude_n * (1.0 if draw.happens(d.REAL_GROWTH_UP_SHARE) else -1.0))
        return Mode(magnitude, frequency_hz, amplitude_n)
    return Mode(0.0, frequency_hz, rest_n * draw.of(d.CYCLE_AMPLITUDE))


def _modes(draw: _Draw, motion: str, rest_n: float, friction: bool) -> tuple[Mode, ...]:
    """Draw the main mode and those beside it, all of which decay, and faster than the main one decays or grows."""
    main = _main_mode(draw, motion, rest_n)
    modes, count = [main], int(draw.choice(d.MODE_COUNTS))
    if friction or motion == "bounces":
        return (main,)
    for _ in range(count - 1):
        if main.rate_per_s:
            rate_per_s = -abs(main.rate_per_s) * draw.of(d.OTHER_RATE)
        else:
            rate_per_s = -draw.of(d.OTHER_RATE_SUSTAINED)
        near, frequency_hz = draw.happens(d.OTHER_IS_NEAR_SHARE), draw.of(d.FREQUENCY)
        if near and main.frequency_hz:
            frequency_hz = main.frequency_hz * draw.of(d.NEAR_FREQUENCY)
        modes.append(Mode(rate_per_s, frequency_hz, abs(main.amplitude_n) * draw.of(d.OTHER_AMPLITUDE)))
    return tuple(modes)


def _openings(draw: _Draw, first_s: float, last_s: float, force_n: float) -> tuple[Opening, ...]:
    """Draw the intervals with an open loop between two times, in their order; none begins within another one."""
    drawn = []

    def add(length: d.Range, cause: Cause, starved: bool, sampled: bool) -> None:
        start_s = draw.between(first_s, last_s)
        rate = draw.sign() * draw.of(d.STARVED_RATE) * force_n if starved else 0.0
        drawn.append(Opening(start_s, start_s + draw.of(length), cause, rate, sampled))

    if draw.happens(d.OUTAGE_SHARE):
        for _ in range(int(draw.choice(d.OUTAGE_COUNTS))):
            add(d.OUTAGE_LENGTH, "link", draw.happens(d.STARVED_SHARE), True)
    if draw.happens(d.STALL_SHARE):
        sampled = not draw.happens(d.STALL_WITHOUT_SAMPLES_SHARE)
        add(d.STALL_LENGTH, "machine", sampled and draw.happens(d.STARVED_SHARE), sampled)
    if draw.happens(d.PAUSE_SHARE):
        add(d.PAUSE_LENGTH, "operator", False, True)
    apart: list[Opening] = []
    for opening in sorted(drawn):
        if not apart or opening.start_s > apart[-1].end_s:
            apart.append(opening)
    return tuple(apart)


def _withdrawal_s(openings: tuple[Opening, ...], end_s: float) -> float | None:
    """Return when the instrument withdraws because commands were missing for too long, None where it does not."""
    longest_s = d.COMMAND_DEADLINE_S + d.HOLD_BEFORE_WITHDRAWAL_S
    for opening in openings:
        at_s = opening.start_s + longest_s
        if opening.cause != "operator" and opening.end_s > at_s and at_s < end_s:
            return at_s
    return None


def _runs(
    draw: _Draw, landing_s: float, end_s: float, openings: tuple[Opening, ...], main_n: float, rest_n: float
) -> tuple[Run, ...]:
    """Return the intervals with a closed loop from the landing on; each but the first begins with a restart."""
    runs, start_s, scale = [], landing_s, 1.0
    for opening in openings:
        runs.append(Run(start_s, min(opening.start_s, end_s), scale))
        start_s, scale = opening.end_s, draw.of(d.RESTART_KICK) * rest_n / abs(main_n)
    runs.append(Run(start_s, end_s, scale))
    return tuple(run for run in runs if run.end_s > run.start_s)


def _random_rms_n(plan: Plan) -> float:
    """Return the RMS of everything in the tip force that is random [N]."""
    noise_n = plan.noise_n / math.sqrt(12.0) if plan.noise == "quantised" else plan.noise_n
    hand = plan.hand
    parts = [noise_n, plan.random_excitation_n]
    if hand is not None:
        parts += [hand.gain * hand.tremor_n, hand.gain * hand.wander_n]
    return math.sqrt(math.fsum(part * part for part in parts))


def visible_n(plan: Plan) -> float:
    """Return the least amplitude [N] of a cycle or a growth that can be seen in the course."""
    return max(d.VISIBLE_OVER_NOISE * _random_rms_n(plan), d.VISIBLE_OVER_FORCE * plan.hand_force_n)


def stretches(plan: Plan) -> list[tuple[float, float, int]]:
    """Return start [s], end [s] and run of every stretch that nothing disturbs which the recording states."""
    found = []
    for hold in plan.holds:
        for index, run in enumerate(plan.runs):
            start_s, end_s = max(hold.start_s, run.start_s), min(hold.end_s, run.end_s)
            cuts = [start_s, *(at_s for at_s in plan.overruns if start_s < at_s < end_s), end_s]
            found += [(low, high, index) for low, high in pairwise(cuts) if high > low]
    return found


def amplitude_n(plan: Plan, run: Run, at_s: float, mode: int = 0) -> float:
    """Return the amplitude [N] that a mode has at a time of a run, without its sign."""
    rate_per_s, _, first_n = plan.modes[mode]
    first_n, spent_s = abs(first_n) * run.scale, at_s - run.start_s
    last_n = plan.last_amplitude_n
    if mode or last_n is None:
        return first_n * math.exp(min(rate_per_s * spent_s, 600.0))
    # weakly nonlinear growth: dA/dt = r A (1 - A^2 / A_last^2)
    return last_n / math.sqrt(1.0 + ((last_n / first_n) ** 2 - 1.0) * math.exp(-2.0 * rate_per_s * spent_s))


def seconds_to_n(plan: Plan, run: Run, level_n: float) -> float:
    """Return how long after the start of a run a main mode without a bound has grown to a level [s]."""
    main = plan.modes[0]
    return max(0.0, math.log(level_n / (abs(main.amplitude_n) * run.scale)) / main.rate_per_s)


def _saturated_after_s(plan: Plan, run: Run) -> float:
    """Return how long after the start of a run a bounded growth counts as a cycle [s]."""
    last_n, main = plan.last_amplitude_n or 0.0, plan.modes[0]
    level = 1.0 - d.SATURATED_WITHIN
    ratio = ((last_n / (abs(main.amplitude_n) * run.scale)) ** 2 - 1.0) / (1.0 / level**2 - 1.0)
    return max(0.0, 0.5 * math.log(max(ratio, 1e-9)) / main.rate_per_s)


def _short(rate_per_s: float, frequency_hz: float, length_s: float) -> str | None:
    """Return the rule by which a stretch is too short for a decay or a growth to be seen, None where it is not."""
    efolds = abs(rate_per_s) * length_s
    if efolds < d.LEAST_RATE_TIMES_LENGTH:
        return "short"
    if frequency_hz and frequency_hz * length_s < d.LEAST_PERIODS and efolds < d.ENOUGH_RATE_TIMES_LENGTH:
        return "few_periods"
    return None


def _growth(plan: Plan, start_s: float, end_s: float, run: Run) -> str | None:
    """Return the rule by which a growth cannot be known in a stretch, None where it can."""
    main = plan.modes[0]
    last_n, least_n = amplitude_n(plan, run, end_s), visible_n(plan)
    if last_n <= least_n:
        return "below_noise"
    seen_s = min(end_s - start_s, math.log(last_n / least_n) / main.rate_per_s)
    if (rule := _short(main.rate_per_s, main.frequency_hz, seen_s)) is not None:
        return "below_noise" if _short(main.rate_per_s, main.frequency_hz, end_s - start_s) is None else rule
    if not main.frequency_hz and main.rate_per_s * seen_s < d.LEAST_REAL_GROWTH:
        return "like_a_drift"
    others_n = math.fsum(amplitude_n(plan, run, end_s, mode) for mode in range(1, len(plan.modes)))
    return "others_larger" if last_n < d.MAIN_OVER_OTHERS * others_n else None


def _cycle(plan: Plan, start_s: float, end_s: float, amplitude_n: float) -> str | None:
    """Return the rule by which a cycle cannot be known in a stretch, None where it can."""
    if amplitude_n < visible_n(plan):
        return "below_noise"
    return "few_periods" if plan.modes[0].frequency_hz * (end_s - start_s) < d.LEAST_PERIODS else None


def _bounded_growth(plan: Plan, start_s: float, end_s: float, run: Run) -> tuple[Truth, float, str | None]:
    """Return truth, length and rule of a stretch of a growth that the surface bounds: a growth first, a cycle later."""
    last_n = plan.last_amplitude_n or 0.0
    if amplitude_n(plan, run, end_s) < d.SATURATION_BEGINS * last_n:
        return "grows", end_s - start_s, _growth(plan, start_s, end_s, run)
    from_s = max(start_s, run.start_s + _saturated_after_s(plan, run))
    if end_s - from_s < d.SATURATED_PART * (end_s - start_s):
        return "goes_on", end_s - start_s, "turning"
    return "goes_on", end_s - from_s, _cycle(plan, from_s, end_s, last_n)


def pressed_at_s(plan: Plan, run: Run) -> float | None:
    """Return when a growth without a bound presses most, so that the guard stops it [s]; None for any time.

    A motion with hardly a period before the guard's limit is drawn with the phase that presses there: with another one
    it could spend all of that time in air, where no force is seen to grow.
    """
    main = plan.modes[0]
    if plan.motion != "grows" or not main.frequency_hz:
        return None
    grown_s = seconds_to_n(plan, run, plan.guard_limit_n - plan.rest_ratio * plan.hand_force_n)
    few = main.frequency_hz * grown_s < d.LEAST_PERIODS
    return run.start_s + grown_s if few and run.start_s + grown_s < run.end_s else None


def _until_guarded(plan: Plan, end_s: float, run: Run) -> float:
    """Return when a growth without a bound has come to the guard's limit, or has left the surface for long [s]."""
    main, rest_n = plan.modes[0], plan.rest_ratio * plan.hand_force_n
    guarded_s = min(end_s, run.start_s + seconds_to_n(plan, run, plan.guard_limit_n - rest_n))
    left_s = min(end_s, run.start_s + seconds_to_n(plan, run, rest_n + plan.adhesion_n))
    if main.frequency_hz:
        few = main.frequency_hz * (guarded_s - run.start_s) < d.LEAST_PERIODS
        return left_s if few and pressed_at_s(plan, run) is None else guarded_s
    return left_s if main.amplitude_n < 0.0 else guarded_s


def _verdict(plan: Plan, start_s: float, end_s: float, run: Run) -> tuple[Truth, float, str | None]:
    """Return the truth of a stretch, the length by which it is known, and the rule by which it cannot be, or None."""
    main = plan.modes[0]
    if plan.motion == "decays":
        return "settles", end_s - start_s, _short(main.rate_per_s, main.frequency_hz, end_s - start_s)
    if plan.motion == "grows":
        guarded_s = _until_guarded(plan, end_s, run)
        if guarded_s <= start_s:
            return "grows", 0.0, "short"
        return "grows", guarded_s - start_s, _growth(plan, start_s, guarded_s, run)
    if plan.motion == "saturates":
        return _bounded_growth(plan, start_s, end_s, run)
    return "goes_on", end_s - start_s, _cycle(plan, start_s, end_s, cycle_amplitude_n(plan))


def cycle_amplitude_n(plan: Plan) -> float:
    """Return the amplitude [N] of a cycle: half its swing, where the tip bounces."""
    if plan.motion == "bounces":
        return 0.25 * math.pi / plan.contact_fraction * plan.rest_ratio * plan.hand_force_n
    return plan.modes[0].amplitude_n


def _class(value: float, bounds: tuple[float, ...], names: tuple[str, ...]) -> str:
    return names[sum(value >= bound for bound in bounds[1:-1])]


def cell_of(rate_per_s: float, frequency_hz: float, length_s: float) -> str:
    """Return the cell of the grid, as "rate/frequency/length"."""
    rate = _class(abs(rate_per_s), d.RATE_CLASSES_PER_S, ("slow", "middle", "fast")) if rate_per_s else "sustained"
    frequency = _class(frequency_hz, d.FREQUENCY_CLASSES_HZ, ("low", "middle", "high")) if frequency_hz else "real"
    return f"{rate}/{frequency}/{_class(length_s, d.LENGTH_CLASSES_S, ('short', 'middle', 'long'))}"


def _with_truth(plan: Plan) -> Plan:
    """Return the plan with its truth: that of the longest stretch in which it can be known."""
    main = plan.modes[0]
    plan = plan._replace(rate_per_s=main.rate_per_s, frequency_hz=main.frequency_hz)
    for special in ("never_arrives", "nothing_moves"):
        if special in plan.tags:
            return plan._replace(tags=plan.tags | {f"no_truth:{special}"})
    verdicts = [_verdict(plan, start_s, end_s, plan.runs[run]) for start_s, end_s, run in stretches(plan)]
    known = [(length_s, truth) for truth, length_s, rule in verdicts if rule is None]
    if not known:
        _, rule = max([(length_s, rule or "") for _, length_s, rule in verdicts], default=(0.0, "short"))
        return plan._replace(tags=plan.tags | {f"no_truth:{rule}"})
    length_s, truth = max(known)
    rate_per_s = 0.0 if truth == "goes_on" else main.rate_per_s
    cell = cell_of(rate_per_s, main.frequency_hz, length_s)
    plan = plan._replace(truth=truth, length_s=length_s, rate_per_s=rate_per_s, cell=cell)
    many = truth != "settles" and main.frequency_hz * length_s >= MANY_TURNS
    return plan._replace(
        tags=plan.tags | ({"many_turns"} if many else set()) | ({"at_rest"} if _rests(plan) else set())
    )


def _rests(plan: Plan) -> bool:
    """Return whether a motion that settles is small in the last quarter of each of its stretches."""
    if plan.truth != "settles":
        return False
    for start_s, end_s, run in stretches(plan):
        at_s = start_s + 0.75 * (end_s - start_s)
        sizes = [amplitude_n(plan, plan.runs[run], at_s, mode) for mode in range(len(plan.modes))]
        if 2.0 * math.fsum(sizes) >= AT_REST * plan.hand_force_n:
            return False
    return True


def _tags(plan: Plan) -> frozenset[str]:
    """Return what was put into a plan, as words."""
    main, arrival_s, rest_n = plan.modes[0], plan.arrival_s, plan.rest_ratio * plan.hand_force_n
    causes = {opening.cause for opening in plan.openings}
    pairs = {
        plan.motion: True,
        plan.noise: plan.noise != "none",
        "real": not main.frequency_hz,
        "slow_approach": not main.frequency_hz and main.rate_per_s < 0.0 and main.amplitude_n < 0.0,
        "several_modes": len(plan.modes) > 1,
        "lifts_off": plan.motion == "decays" and abs(main.amplitude_n) > rest_n,
        "two_holds": len(plan.holds) > 1,
        "released": plan.released,
        "random_link": plan.random_link,
        "delayed": plan.round_trip_s > 0.0,
        "rest_stated": plan.rest_stated,
        "never_arrives": arrival_s is None,
        "late_arrival": arrival_s is not None and arrival_s > 0.5 * (plan.holds[0].start_s + plan.holds[0].end_s),
        "snap_in": plan.snap_in is not None and arrival_s is not None,
        "blow": bool(plan.blows),
        "outage": "link" in causes,
        "stall": "machine" in causes,
        "pause": "operator" in causes,
        "starved": any(opening.starved_n_per_s for opening in plan.openings),
        "withdrawn": plan.withdrawal_s is not None,
        "overload": bool(plan.overload_kick),
        "friction": plan.friction is not None,
        "drift": bool(plan.drift_n),
        "tremor": plan.hand is not None,
    }
    return frozenset(name for name, holds in pairs.items() if holds)


def plan(seed: int) -> Plan:
    """Return the plan of a course with its truth.

    Args:
        seed: a whole number, zero or more; the same seed gives the same plan.

    Raises:
        ValueError: the seed is negative.
    """
    if seed < 0:
        raise ValueError(f"the seed of a course is zero or more, and not {seed}")
    draw = _Draw(seed)
    motion = draw.choice(d.MOTIONS)
    force_n, ramp_s = draw.of(d.HAND_FORCE), draw.of(d.HAND_RAMP)
    holds = _holds(draw, force_n, ramp_s)
    held_s = holds[-1].end_s
    released, after_s = draw.happens(d.RELEASED_SHARE), draw.of(d.RELEASE)
    end_s = held_s + ramp_s + after_s if released else held_s
    rest_ratio = 1.0 / (1.0 + 1.0 / draw.of(d.FORCE_GAIN))
    rest_n = rest_ratio * force_n

    arrives, still = not draw.happens(d.NEVER_ARRIVES_SHARE), draw.happens(d.NOTHING_MOVES_SHARE)
    arrival_s = holds[0].start_s + draw.of(d.ARRIVAL) * (holds[0].end_s - holds[0].start_s)
    struck, landing_s = draw.happens(d.BLOW_SHARE), arrival_s
    blows: tuple[Blow, ...] = ()
    some_blows, after_blows_s = _blows(draw, arrival_s, force_n)
    if struck and arrives and motion == "decays" and after_blows_s < holds[0].end_s:
        blows, landing_s = some_blows, after_blows_s
    friction = draw.happens(d.FRICTION_SHARE) and motion == "decays"
    modes = _modes(draw, motion, rest_n, friction)

    openings = _openings(draw, landing_s, held_s, force_n) if arrives and not still else ()
    withdrawal_s = _withdrawal_s(openings, end_s)
    if withdrawal_s is not None:
        openings = tuple(opening for opening in openings if opening.start_s < withdrawal_s)
    runs = _runs(draw, landing_s, withdrawal_s or end_s, openings, modes[0].amplitude_n, rest_n) if arrives else ()
    overruns = [opening.end_s for opening in openings if opening.cause == "machine" and opening.end_s < end_s]
    overload, count, kick = draw.happens(d.OVERLOAD_SHARE), round(draw.of(d.OVERLOAD_COUNT)), draw.of(d.OVERLOAD_KICK)
    if overload:
        overruns += [draw.between(0.0, end_s) for _ in range(count)]
    random_link, jitter, excitation = (
        draw.happens(d.RANDOM_LINK_SHARE),
        draw.of(d.STAMP_JITTER),
        draw.of(d.RANDOM_EXCITATION),
    )
    hand = Hand(
        tremor_n=force_n * draw.of(d.TREMOR),
        tremor_hz=draw.of(d.TREMOR_FREQUENCY),
        wander_n=force_n * draw.of(d.WANDER),
        gain=draw.of(d.TREMOR_GAIN),
    )
    saturated_n = rest_n * draw.of(d.SATURATED_AMPLITUDE)
    snap_in = (rest_n * draw.of(d.SNAP_IN_DEPTH), draw.of(d.SNAP_IN_LENGTH))
    noise = draw.choice(d.NOISE_KINDS)
    noise_n = 0.0 if noise == "none" else force_n * draw.of(d.NOISE)
    drawn = Plan(
        seed=seed,
        motion=motion,
        hand_force_n=force_n,
        holds=holds,
        ramp_s=ramp_s,
        end_s=end_s,
        released=released,
        sample_rate_hz=draw.one(d.SAMPLE_RATES_HZ),
        round_trip_s=0.0 if draw.happens(d.NO_DELAY_SHARE) else draw.of(d.ROUND_TRIP),
        random_link=random_link,
        stamp_jitter=jitter if random_link else 0.0,
        rest_ratio=rest_ratio,
        rest_offset_n=force_n * draw.of(d.REST_OFFSET),
        rest_stated=draw.happens(d.REST_STATED_SHARE),
        arrival_s=arrival_s if arrives else None,
        landing_s=landing_s,
        modes=modes,
        last_amplitude_n=saturated_n if motion == "saturates" else None,
        contact_fraction=draw.of(d.CONTACT_FRACTION),
        adhesion_n=rest_n * draw.of(d.ADHESION),
        guard_limit_n=force_n * draw.of(d.GUARD_LIMIT),
        snap_in=snap_in if draw.happens(d.SNAP_IN_SHARE) else None,
        blows=blows,
        openings=openings,
        runs=runs,
        withdrawal_s=withdrawal_s,
        overruns=tuple(sorted(overruns)),
        overload_kick=kick * rest_n / abs(modes[0].amplitude_n) if overload else 0.0,
        random_excitation_n=force_n * excitation if random_link else 0.0,
        friction=draw.of(d.FRICTION) if friction else None,
        friction_offset_n=rest_n * draw.of(d.FRICTION_OFFSET) if friction else 0.0,
        drift_n=force_n * draw.of(d.DRIFT) if draw.happens(d.DRIFT_SHARE) else 0.0,
        hand=hand if draw.happens(d.TREMOR_SHARE) else None,
        noise=noise,
        noise_n=noise_n,
        truth="no_truth",
        rate_per_s=0.0,
        frequency_hz=0.0,
        length_s=0.0,
        cell="",
        tags=frozenset({"nothing_moves"}) if still and arrives else frozenset(),
    )
    return _with_truth(drawn._replace(tags=drawn.tags | _tags(drawn)))
