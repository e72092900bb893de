"""Make a labelled course of a loop that something bounds, keeps up, changes or lets come again.

    recorded = nonlinear_course(7)
    recorded.time_s, recorded.tip_force_n, recorded.truth

`courses.py` has motions that are sums of exponentials; these are not: an amplitude that comes to a limit softly (van
der Pol) or at a clamp, two swings that beat, an amplitude that wanders or drifts, a delay that steps within a hold, a
tip that sticks and slips, two swings of which one dies, and rest. `nonlinear_distribution.py` has the ranges. The truth
is what the motion does at the end of the hold. It follows from what was drawn, never from the samples.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import distribution as d
import nonlinear_distribution as n
import numpy as np
from courses import Course, Floats, _narrow_band, _octaves
from plans import Truth, _Draw, cell_of

_RELAX = 1e-3  # Creep begins at this part of the hold; before it the logarithm has no place to begin.


class Motion(NamedTuple):
    """A motion from the arrival to the end of the hold, and what it does at its end.

    seen_s: how long it does that at the end; last_n: its amplitude there; rule: why that cannot be known, or None;
    quarter_n: its amplitude when the last quarter begins; rate_per_s: of what it does at the end.
    """

    force_n: Floats
    truth: Truth
    seen_s: float
    last_n: float
    frequency_hz: float
    rule: str | None = None
    quarter_n: float = 0.0
    rate_per_s: float = 0.0


class Setting(NamedTuple):
    """What a motion is drawn within: times since the arrival, their span, the hand's force, and what is visible."""

    since_s: Floats
    length_s: float
    hand_n: float
    visible_n: float


def _wave(draw: _Draw, amplitude: Floats, phase: Floats) -> Floats:
    """Return a swing of an amplitude and a phase, which may have a harmonic."""
    wave = amplitude * np.cos(phase)
    if draw.happens(n.HARMONICS_SHARE):
        order, size = (2.0 if draw.happens(0.5) else 3.0), draw.of(n.HARMONIC)
        wave = wave + size * amplitude * np.cos(order * phase + draw.between(0.0, 2.0 * math.pi))
    return wave


def _turned(draw: _Draw, frequency_hz: float, since_s: Floats) -> Floats:
    return 2.0 * math.pi * frequency_hz * since_s + draw.between(0.0, 2.0 * math.pi)


def _growth(at: Setting, motion: Motion) -> Motion:
    """Return a motion that grows until its end, with the time for which that is seen and the rule against it."""
    if motion.last_n <= at.visible_n:
        return motion._replace(rule="below_noise")
    seen_s = min(motion.seen_s, math.log(motion.last_n / at.visible_n) / motion.rate_per_s)
    change = motion.rate_per_s * seen_s
    few = motion.frequency_hz * seen_s < d.LEAST_PERIODS and change < d.ENOUGH_RATE_TIMES_LENGTH
    rule = "short" if change < d.LEAST_RATE_TIMES_LENGTH else "few_periods" if few else None
    return motion._replace(truth="grows", seen_s=seen_s, rule=rule)


def _cycle(at: Setting, motion: Motion) -> Motion:
    """Return a motion that goes on at its end, with the rule by which that cannot be known."""
    few = motion.frequency_hz * motion.seen_s < d.LEAST_PERIODS
    rule = motion.rule or ("below_noise" if motion.last_n < at.visible_n else "few_periods" if few else None)
    return motion._replace(truth="goes_on", rule=rule, quarter_n=motion.last_n)


def _irregular(at: Setting, motion: Motion, least: float) -> Motion:
    """Return a motion whose turns differ, and that goes on at its end, with the rule by which that cannot be known."""
    like = "like_excitation" if motion.last_n < least * at.hand_n else None
    few = "few_periods" if motion.frequency_hz * motion.seen_s < n.IRREGULAR_TURNS else None
    return _cycle(at, motion._replace(rule=motion.rule or like or few))


def _death(at: Setting, motion: Motion) -> Motion:
    """Return a motion that dies out for its last seconds at its rate, with the rule by which that cannot be known."""
    change = -motion.rate_per_s * motion.seen_s
    few = motion.frequency_hz * motion.seen_s < d.LEAST_PERIODS and change < d.ENOUGH_RATE_TIMES_LENGTH
    rule = motion.rule or ("short" if change < d.LEAST_RATE_TIMES_LENGTH else "few_periods" if few else None)
    quarter_n = motion.last_n * math.exp(min(-motion.rate_per_s * 0.25 * at.length_s, 50.0))
    if 0.25 * at.length_s > motion.seen_s:
        quarter_n = math.inf
    return motion._replace(truth="settles", rule=rule, quarter_n=quarter_n)


def _saturates(draw: _Draw, _: np.random.Generator, at: Setting) -> Motion:
    """dA/dt = r A (1 - A²/S²), which is van der Pol's amplitude."""
    frequency_hz, last_n = draw.of(n.FREQUENCY), at.hand_n * draw.of(n.LAST_AMPLITUDE)
    first = draw.of(n.FIRST_AMPLITUDE)
    rate = -math.log(first) / (draw.of(n.GROWN_AT) * at.length_s)
    size = last_n / np.sqrt(1.0 + (first**-2 - 1.0) * np.exp(-2.0 * rate * at.since_s))
    motion = Motion(
        _wave(draw, size, _turned(draw, frequency_hz, at.since_s)), "grows", at.length_s, last_n, frequency_hz
    )
    end_n = last_n / math.sqrt(1.0 + (first**-2 - 1.0) * math.exp(-2.0 * rate * at.length_s))
    if end_n < d.SATURATION_BEGINS * last_n:
        return _growth(at, motion._replace(last_n=end_n, rate_per_s=rate))
    level = 1.0 - d.SATURATED_WITHIN
    grown_s = max(0.0, 0.5 * math.log(max((first**-2 - 1.0) / (level**-2 - 1.0), 1e-9)) / rate)
    seen_s = at.length_s - grown_s
    rule = "turning" if seen_s < n.GROWN_PART * at.length_s else None
    return _cycle(at, motion._replace(seen_s=max(seen_s, 0.0), rule=rule))


def _clamped(draw: _Draw, _: np.random.Generator, at: Setting) -> Motion:
    """An exponential growth whose force is cut off at a clamp, on one side or both, and which that bounds."""
    frequency_hz, clamp_n = draw.of(n.FREQUENCY), at.hand_n * draw.of(n.LAST_AMPLITUDE)
    first, over = draw.of(n.FIRST_AMPLITUDE), draw.of(n.OVER_THE_CLAMP)
    rate = -math.log(first) / (draw.of(n.GROWN_AT) * at.length_s)
    size = clamp_n * np.minimum(first * np.exp(np.minimum(rate * at.since_s, 50.0)), over)
    wave = _wave(draw, size, _turned(draw, frequency_hz, at.since_s))
    sides = draw.choice(n.CLAMPED_SIDES)
    low_n, high_n = (-clamp_n if sides != "upper" else -math.inf), (clamp_n if sides != "lower" else math.inf)
    motion = Motion(np.clip(wave, low_n, high_n), "grows", at.length_s, clamp_n, frequency_hz, None, 0.0, rate)
    end = first * math.exp(min(rate * at.length_s, 50.0))
    if end < 1.0:
        return _growth(at, motion._replace(last_n=clamp_n * end))
    seen_s = at.length_s - math.log(over / first) / rate
    rule = "turning" if seen_s < n.GROWN_PART * at.length_s else None
    return _cycle(at, motion._replace(seen_s=max(seen_s, 0.0), rule=rule, rate_per_s=0.0))


def _beats(draw: _Draw, _: np.random.Generator, at: Setting) -> Motion:
    frequency_hz, last_n, depth = draw.of(n.FREQUENCY), at.hand_n * draw.of(n.LAST_AMPLITUDE), draw.of(n.DEPTH)
    beats, dies = draw.of(n.BEATS), draw.happens(n.DIES_SHARE)
    change = draw.of(n.RATE_TIMES_REST) if dies else 0.0
    other_hz = frequency_hz + beats / at.length_s
    fade = last_n * np.exp(-change * at.since_s / at.length_s)
    wave = _wave(draw, fade, _turned(draw, frequency_hz, at.since_s))
    wave = wave + _wave(draw, depth * fade, _turned(draw, other_hz, at.since_s))
    few = beats < n.LEAST_BEATS and change < d.ENOUGH_RATE_TIMES_LENGTH
    motion = Motion(wave, "goes_on", at.length_s, last_n, frequency_hz, "few_beats" if few else None)
    if not dies:
        return _irregular(at, motion, 0.0)
    return _death(at, motion._replace(last_n=last_n * math.exp(-change), rate_per_s=-change / at.length_s))


def _wanders(draw: _Draw, generator: np.random.Generator, at: Setting) -> Motion:
    frequency_hz, last_n, spread = draw.of(n.FREQUENCY), at.hand_n * draw.of(n.LAST_AMPLITUDE), draw.of(n.WANDER)
    memory, dies = draw.of(n.WANDER_MEMORY), draw.happens(n.DIES_SHARE)
    change = draw.of(n.RATE_TIMES_REST) if dies else 0.0
    wander = spread * _narrow_band(generator, at.since_s, 0.0, memory * at.length_s)
    size = np.clip(np.exp(wander), n.LEAST_WANDERED, n.MOST_WANDERED)
    fade = last_n * np.exp(-change * at.since_s / at.length_s)
    turning = draw.of(n.PHASE_WANDER) * math.sqrt(max(frequency_hz * at.length_s / max(1, at.since_s.size), 0.0))
    phase = _turned(draw, frequency_hz, at.since_s) + np.cumsum(turning * generator.standard_normal(at.since_s.size))
    slow = memory > n.MOST_MEMORY or (dies and change < d.ENOUGH_RATE_TIMES_LENGTH)
    motion = Motion(_wave(draw, size * fade, phase), "goes_on", at.length_s, last_n, frequency_hz)
    motion = motion._replace(rule="slow_wander" if slow else None)
    if not dies:
        return _irregular(at, motion, n.LEAST_IRREGULAR)
    ended = motion._replace(last_n=n.MOST_WANDERED * last_n * math.exp(-change), rate_per_s=-change / at.length_s)
    return _death(at, ended)


def _delay_step(draw: _Draw, _: np.random.Generator, at: Setting) -> Motion:
    """A loop with one pole before a step of its delay, and with another one after it."""
    fate, step_s = draw.choice(n.STEP_FATES), at.length_s * draw.of(n.STEP_AT)
    rest_s = at.length_s - step_s
    change = {"dies": -1.0, "grows": 1.0, "stays": 0.0}[fate] * draw.of(n.RATE_TIMES_REST)
    at_step_n = at.hand_n * draw.of(n.LAST_AMPLITUDE) * math.exp(-max(change, 0.0))
    before = draw.sign() * draw.of(n.RATE_TIMES_REST)
    # before the step the motion is no larger than five times the hand's force
    before = max(before, -math.log(max(5.0 * at.hand_n / at_step_n, 1.0)))
    first_hz = draw.of(n.FREQUENCY)
    last_hz = first_hz * draw.of(n.FREQUENCY_STEP)
    late = np.maximum(at.since_s - step_s, 0.0)
    early = np.minimum(at.since_s - step_s, 0.0)
    size = at_step_n * np.exp(before * early / step_s + change * late / rest_s)
    phase = 2.0 * math.pi * (first_hz * early + last_hz * late) + draw.between(0.0, 2.0 * math.pi)
    last_n = at_step_n * math.exp(change)
    motion = Motion(_wave(draw, size, phase), "goes_on", rest_s, last_n, last_hz, None, 0.0, change / rest_s)
    return {"dies": _death, "grows": _growth, "stays": _cycle}[fate](at, motion)


def _stick_slip(draw: _Draw, generator: np.random.Generator, at: Setting) -> Motion:
    """Load rises evenly until the tip slips; then what it has slipped by rings."""
    frequency_hz, last_n = draw.of(n.FREQUENCY), at.hand_n * draw.of(n.LAST_AMPLITUDE)
    slip, jitter, ringing = draw.of(n.SLIP_PART), draw.of(n.SLIP_JITTER), draw.of(n.SLIP_RINGING)
    turns, stops = draw.of(n.SLIP_RINGING_TURNS), draw.happens(n.DIES_SHARE)
    stop_s = at.length_s * draw.of(n.STOPS_AT) if stops else math.inf
    periods = (1.0 + jitter * generator.uniform(-1.0, 1.0, int(2.0 * frequency_hz * at.length_s) + 8)) / frequency_hz
    starts = np.concatenate([[0.0], np.cumsum(periods)])
    time_s = np.minimum(at.since_s, stop_s)
    index = np.clip(np.searchsorted(starts, time_s, side="right") - 1, 0, periods.size - 1)
    part = (time_s - starts[index]) / periods[index]
    load = np.where(part < 1.0 - slip, part / (1.0 - slip), (1.0 - part) / slip)
    ring = ringing * np.exp(-9.0 * part) * np.sin(2.0 * math.pi * turns * part) * (index > 0) * (at.since_s < stop_s)
    gone = np.exp(np.minimum(stop_s - at.since_s, 0.0) * frequency_hz / n.STOPPED_WITHIN)
    motion = Motion(last_n * (2.0 * load - 1.0 + ring) * gone, "goes_on", at.length_s, last_n, frequency_hz)
    if not stops:
        return _irregular(at, motion, n.LEAST_IRREGULAR)
    return motion._replace(
        truth="settles", seen_s=at.length_s - stop_s, quarter_n=0.0 if stop_s < 0.75 * at.length_s else math.inf
    )


def _drifts(draw: _Draw, _: np.random.Generator, at: Setting) -> Motion:
    frequency_hz, last_n = draw.of(n.FREQUENCY), at.hand_n * draw.of(n.LAST_AMPLITUDE)
    factor, shape, part = (
        draw.of(n.AMPLITUDE_DRIFT),
        draw.choice(n.DRIFT_SHAPES),
        np.minimum(at.since_s / at.length_s, 1.0),
    )
    sizes = {
        "line": 1.0 + (factor - 1.0) * part,
        "root": np.sqrt(1.0 + (factor * factor - 1.0) * part),
        "exponential": factor**part,
    }
    size = last_n / factor * sizes[shape]
    wave, change = _wave(draw, size, _turned(draw, frequency_hz, at.since_s)), math.log(factor)
    motion = Motion(wave, "goes_on", at.length_s, last_n, frequency_hz, None, 0.0, change / at.length_s)
    if abs(change) <= n.MOST_STEADY_CHANGE:
        return _cycle(at, motion)
    return _growth(at, motion) if change > 0.0 else _death(at, motion)._replace(quarter_n=math.inf)


def _one_dies(draw: _Draw, _: np.random.Generator, at: Setting) -> Motion:
    frequency_hz, last_n = draw.of(n.FREQUENCY), at.hand_n * draw.of(n.LAST_AMPLITUDE)
    other_n, other_hz = last_n * draw.of(n.OTHER_AMPLITUDE), frequency_hz * draw.of(n.OTHER_FREQUENCY)
    death, both = draw.of(n.DEATH), draw.happens(n.DIES_SHARE)
    change = draw.of(n.RATE_TIMES_REST) if both else 0.0
    # no swing begins with more than five times the hand's force
    other_n = min(other_n, 5.0 * at.hand_n)
    part = at.since_s / at.length_s
    wave = _wave(draw, last_n * np.exp(-change * part), _turned(draw, frequency_hz, at.since_s))
    wave = wave + _wave(draw, other_n * np.exp(-death * part), _turned(draw, other_hz, at.since_s))
    left_n = other_n * math.exp(-death)
    motion = Motion(wave, "goes_on", at.length_s, last_n, frequency_hz)
    if not both:
        larger = left_n > n.LEAST_SWING_OVER_OTHERS * last_n
        return _cycle(at, motion._replace(rule="others_larger" if larger else None))
    slowest = min(change, death)
    end_n = last_n * math.exp(-change) + left_n
    return _death(at, motion._replace(last_n=end_n, rate_per_s=-slowest / at.length_s))


def _rests(draw: _Draw, _: np.random.Generator, at: Setting) -> Motion:
    return Motion(np.zeros_like(at.since_s), "settles", at.length_s, 0.0, 0.0)


MAKERS: dict[str, Callable[[_Draw, np.random.Generator, Setting], Motion]] = {
    "saturates": _saturates,
    "clamped": _clamped,
    "beats": _beats,
    "wanders": _wanders,
    "delay_step": _delay_step,
    "stick_slip": _stick_slip,
    "drifts": _drifts,
    "one_dies": _one_dies,
    "rests": _rests,
}


def _landing(draw: _Draw, at: Setting, always: bool) -> tuple[Floats, float]:
    """Return a swing or an approach that dies out from the landing on, and its size when the last quarter begins."""
    lands = draw.happens(n.LANDING_SHARE) or always
    size_n, change, frequency_hz = at.hand_n * draw.of(n.LANDING), draw.of(n.LANDING_DEATH), draw.of(n.FREQUENCY)
    if draw.happens(d.REAL_POLE_SHARE):
        frequency_hz = 0.0
    phase = _turned(draw, frequency_hz, at.since_s) if frequency_hz else np.full_like(at.since_s, math.pi)
    landing = size_n * np.exp(-change * at.since_s / at.length_s) * np.cos(phase)
    return (landing, size_n * math.exp(-0.75 * change)) if lands else (np.zeros_like(landing), 0.0)


def nonlinear_course(seed: int) -> Course:
    """Return the course of a seed; the truth is that of the end of its hold.

    Raises:
        ValueError: the seed is negative.
    """
    if seed < 0:
        raise ValueError(f"the seed of a course is zero or more, and not {seed}")
    draw, generator = _Draw(seed), np.random.Generator(np.random.PCG64(seed))
    kind = draw.choice(n.MOTIONS)
    hand_n, ramp_s, start_s = draw.of(d.HAND_FORCE), draw.of(d.HAND_RAMP), draw.of(d.LEAD)
    start_s += ramp_s
    end_s = start_s + draw.of(d.HOLD)
    released, after_s = draw.happens(d.RELEASED_SHARE), draw.of(d.RELEASE)
    last_s = end_s + ramp_s + after_s if released else end_s
    rate_hz = max(draw.one(d.SAMPLE_RATES_HZ), 500.0 if draw.happens(0.6) else 0.0)
    jitter = draw.of(d.STAMP_JITTER) if draw.happens(d.RANDOM_LINK_SHARE) else 0.0
    count = max(2, int(last_s * rate_hz))
    time_s = (np.arange(count) + 0.5 + jitter * generator.uniform(-0.5, 0.5, count)) / rate_hz
    rest_n = hand_n / (1.0 + 1.0 / draw.of(d.FORCE_GAIN))
    arrival_s = start_s + draw.between(0.0, 0.6) * (end_s - start_s)
    noise, noise_n = draw.choice(d.NOISE_KINDS), hand_n * draw.of(d.NOISE)
    noise_n = 0.0 if noise == "none" else noise_n
    random_n = noise_n / math.sqrt(12.0) if noise == "quantised" else noise_n
    visible_n = max(d.VISIBLE_OVER_NOISE * random_n, d.VISIBLE_OVER_FORCE * hand_n)
    first, last = np.searchsorted(time_s, [arrival_s, end_s]).tolist()
    at = Setting(time_s[first:] - arrival_s, end_s - arrival_s, hand_n, visible_n)
    motion = MAKERS[kind](draw, generator, at)
    landing, landed_n = _landing(draw, at, kind == "rests")
    creep = hand_n * draw.of(n.CREEP) if draw.happens(n.CREEP_SHARE) else 0.0
    since = np.minimum(at.since_s / at.length_s, 1.0)
    creeping = creep * np.log1p(since / _RELAX) / math.log1p(1.0 / _RELAX)
    force_n, contact = np.zeros(count), np.zeros(count, dtype=np.bool_)
    closed = rest_n + motion.force_n + landing + creeping
    touches = closed > 0.0 if draw.happens(n.SURFACE_SHARE) else np.ones(closed.size, dtype=np.bool_)
    force_n[first:], contact[first:] = np.where(touches, closed, 0.0), touches
    hand = np.interp(
        time_s, [0.0, start_s - ramp_s, start_s, end_s, end_s + max(ramp_s, 1e-9)], [0.0, 0.0, 1.0, 1.0, 0.0]
    )
    hand_force_n = hand_n * hand
    force_n[last:] *= hand[last:]
    contact[last:] &= hand[last:] > 0.0
    if noise == "white":
        force_n += noise_n * generator.standard_normal(count)
    elif noise == "pink":
        force_n += noise_n * _octaves(generator, time_s, 2.0 / rate_hz)
    elif noise_n:
        force_n = np.round(force_n / noise_n) * noise_n
    rule = motion.rule
    if motion.truth != "settles" and rule is None and landed_n > motion.last_n:
        rule = "others_larger"
    if motion.truth != "settles" and motion.frequency_hz * 6.0 > rate_hz and rule is None:
        rule = "few_samples"
    tags = {kind, noise, f"{kind}:{motion.truth}"}
    if rule is None:
        still = 2.0 * (motion.quarter_n + landed_n) < n.AT_REST * hand_n
        tags |= {"at_rest"} if motion.truth == "settles" and still else set()
        many = motion.frequency_hz * motion.seen_s >= n.MANY_TURNS
        tags |= {"many_turns"} if motion.truth != "settles" and many else set()
    truth: Truth = motion.truth if rule is None else "no_truth"
    rate = 0.0 if truth == "goes_on" else motion.rate_per_s
    cell = "" if rule is not None else f"{truth}/{cell_of(rate, motion.frequency_hz, motion.seen_s)}"
    quiet = np.zeros(count, dtype=np.bool_)
    return Course(
        time_s=time_s,
        hand_force_n=hand_force_n,
        tip_force_n=force_n,
        in_contact=contact,
        following=~quiet,
        held=quiet,
        round_trip_s=0.0,
        random_link=jitter > 0.0,
        planned=((start_s, end_s, hand_n),),
        rest_force_n=rest_n if draw.happens(d.REST_STATED_SHARE) else None,
        interruptions=(),
        overruns=(),
        guard=None,
        truth=truth,
        rate_per_s=rate,
        frequency_hz=motion.frequency_hz,
        tags=frozenset(tags | ({f"no_truth:{rule}"} if rule is not None else set())),
        cell=cell,
        seed=seed,
    )
