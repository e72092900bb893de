"""What a motion does: its size beside the noise first, then what its size does, and modes only where that is not seen.

1. The force is taken apart into octaves. In each tenth of the hold an octave that does not exceed the noise of the
   read-out is taken off; what is left, and what moves slowly, is the motion.
2. A motion that is small in the last parts, by its power and from peak to peak, rests, unless it comes again and again.
3. Otherwise the trend of the sizes of the last six tenths, with an error from their own scatter, tells whether it grows
   or dies out. What surely does neither goes on, regular or not.
4. A motion of few turns or to one side, and a trend that is in doubt, is decided by modes, if they explain all of it.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.findings import Cause, Finding, on_its_way
from telenano.analysis.modes import Fit, Mode, averaged, fitted
from telenano.analysis.read_out import Noise, centred, octaves_of, power_within, rms, total, white_share
from telenano.analysis.verdict_thresholds import (
    ERROR_SHARE,
    FEW_TURNS,
    FLOOR_SHARE,
    IRREGULAR_CHANGE,
    LEAST_CHANGE,
    LEAST_SAMPLES,
    LEAST_TURNS,
    LEFT_SHARE,
    LIKELY_ERRORS,
    ONE_SIDED_CHANGE,
    PARTS,
    SMALL_SHARE,
    SURE_ERRORS,
    WAY_TRIPS,
)

Series = npt.NDArray[np.float64]
# samples to which a motion is averaged for a fit, at least and at most, and those for a turn [1]
_FIT_SAMPLES, _MOST_FIT_SAMPLES, _TURN_SAMPLES = 96, 768, 12


class Motion(NamedTuple):
    """The force of an episode [N] at even times, with the period [s] and the end of these.

    hand_n: the hand's greatest force [N]; step_n, noise: step and noise of the read-out; is_measured: whether the noise
    was measured beside the episode; rest_n: the force at which the law rests [N], None if unknown; trip_s: the round
    trip [s].
    """

    values: Series
    period_s: float
    end_s: float
    hand_n: float
    step_n: float
    noise: Noise
    is_measured: bool
    rest_n: float | None
    trip_s: float

    @property
    def small_n(self) -> float:
        return SMALL_SHARE * self.hand_n

    @property
    def length_s(self) -> float:
        return self.period_s * len(self.values)


class Parts(NamedTuple):
    """What moves beyond the noise: quickly, shape (n,) [N], its size in equal parts, and slowly, shape (n,) [N].

    swell: the amplitude at each sample, shape (n,) [N]; sizes: by the power of each part, from peak to peak; reaches:
    how far the force goes in each [N]; turns: how often the motion turns in the hold.
    """

    moved: Series
    slow: Series
    swell: Series
    sizes: list[float]
    reaches: list[float]
    turns: float


def parts_of(motion: Motion) -> Parts:
    """Return the parts of a motion: see `decide`."""
    values, count = motion.values, len(motion.values)
    edges = np.linspace(0, count, PARTS + 1).astype(int)
    moved, slow = np.zeros(count), values
    for octave, (own, means) in enumerate(octaves_of(values)):
        gains = []
        for first, last in pairwise(edges.tolist()):
            seen = rms(own[first:last]) ** 2
            mean, most = power_within(motion.noise, octave, last - first)
            gains.append(math.sqrt(1.0 - mean / seen) if seen > most else 0.0)
        moved, slow = moved + np.repeat(gains, np.diff(edges)) * own, means
    late = moved[2 * count // 5 :]
    turns = _turns(late) / 0.6
    swell, power = np.abs(moved), moved**2
    if FEW_TURNS <= turns < 8 * PARTS:
        # A part of a turn has the power of the whole turn where the speed counts as well.
        speed = np.gradient(moved) ** 2
        wide = max(1, round(count / turns))
        ratio = total(power) / max(total(speed), 1e-300)
        near = _means(power, wide) / np.maximum(_means(speed, wide), 1e-300)
        swell = np.sqrt(power + speed * np.clip(near, 0.25 * ratio, 4.0 * ratio))
        power = 0.5 * swell**2
    if turns >= 2 * PARTS:
        edges = np.linspace(0, count, 2 * PARTS + 1).astype(int)
    ends = list(pairwise(edges.tolist()))
    sizes = [2.0 * math.sqrt(2.0 * total(power[first:last]) / (last - first)) for first, last in ends]
    return Parts(moved, slow, swell, sizes, [float(np.ptp(moved[first:last])) for first, last in ends], turns)


def _means(values: Series, wide: int) -> Series:
    """Return the mean of a series over a width to either side of each sample."""
    sums, places = np.concatenate([[0.0], np.cumsum(values)]), np.arange(len(values))
    first, last = np.maximum(places - wide, 0), np.minimum(places + wide + 1, len(values))
    return np.asarray((sums[last] - sums[first]) / (last - first))


def _turns(moved: Series) -> float:
    """Return how often a motion goes from one side to the other and back, by more than a quarter of its size."""
    clear = moved[np.abs(moved) > 0.25 * rms(moved)]
    return 0.5 * np.count_nonzero(np.diff(clear > 0.0))


def decide(motion: Motion) -> Finding:
    """Judge a motion by its parts, and by its modes where these leave it open."""
    parts = parts_of(motion)
    way_n = _way(motion, parts.slow)
    if is_quiet(parts, motion.small_n, 3 * PARTS // 10):
        return _at_rest(motion, parts) if not way_n else _by_modes(motion, parts, way_n, 0.0)
    found = _of_moving(motion, parts, way_n)
    # What is small for a fifth of the hold, and may go on by its trend alone, rests.
    if found.kind == "cannot_say" and not way_n and is_quiet(parts, motion.small_n, PARTS // 5):
        return _at_rest(motion, parts)
    reach_n = max(parts.reaches[-3:])
    if found.kind in ("limit_cycle", "cannot_say") and motion.small_n < reach_n <= 1.5 * motion.step_n:
        return found._replace(kind="cannot_say", cause=Cause.WITHIN_A_STEP, needs_noise_n=motion.small_n)
    return found


def _of_moving(motion: Motion, parts: Parts, way_n: float) -> Finding:
    """Judge what does not rest: by its parts where it turns often, by its modes otherwise, and where these are open."""
    if parts.turns >= 2.0 * FEW_TURNS:
        found = by_parts(motion, parts)
        if found.kind == "stable" and way_n:
            return _by_modes(motion, parts, way_n, 0.5 * FEW_TURNS)
        if found.kind != "cannot_say":
            return found
    found = _by_modes(motion, parts, way_n, math.inf)
    late_n = max(parts.reaches[-(3 * len(parts.reaches) // 10) :])
    if (
        found.kind == "cannot_say"
        and _begins(parts, motion.small_n)[0] >= LEAST_TURNS
        and late_n > 0.5 * max(parts.reaches)
    ):
        _, band_hz = line_of(parts.moved, motion.period_s)
        return Finding("limit_cycle", Cause.IRREGULAR, late_n, None, late_n, band_hz=band_hz)
    is_open = found.kind == "cannot_say" and found.cause is Cause.IRREGULAR_UNKNOWN
    # Modes that hardly change, with a large error, leave it to the sizes as well.
    changes = abs(found.growth_per_s or 0.0) * motion.length_s
    is_open |= found.cause is Cause.CHANGE_UNKNOWN and changes < LEAST_CHANGE and parts.turns >= FEW_TURNS
    return by_parts(motion, parts, is_open=False) if is_open else found


def is_quiet(parts: Parts, small_n: float, tenths: int) -> bool:
    """Return whether a motion rests at its end: it is small in the last tenths, and does not come again and again."""
    count, ends = len(parts.sizes), tenths * len(parts.sizes) // PARTS
    reach_n = float(np.ptp(parts.moved[-max(2, tenths * len(parts.moved) // PARTS) :]))
    if (reach_n > small_n and max(parts.sizes[-ends:]) > 0.5 * small_n) or reach_n > 2.0 * small_n:
        return False
    begun, places = _begins(parts, small_n)
    pauses = [then - now for now, then in pairwise(places)]
    return begun <= LEAST_TURNS or count - places[-1] > 1.5 * max(pauses)


def _begins(parts: Parts, small_n: float) -> tuple[int, list[int]]:
    """Return how often a motion began after a rest, and the first part and those in which it moves."""
    begun, places, moves = 0, [0], True
    for k, reach in enumerate(parts.reaches):
        begun += reach > 2.0 * small_n and not moves
        moves = reach > (small_n if moves else 2.0 * small_n)
        places += [k] if moves else []
    return begun, places


def _way(motion: Motion, slow: Series) -> float:
    """Return how far the force goes slowly in its last quarter [N], or has gone in all, if that is no rest; else 0."""
    noise_n = 3.0 * math.sqrt(2.0 * motion.noise.in_octave(len(motion.noise.octaves_n2)))
    last_n = float(np.ptp(slow[-max(2, len(slow) // 4) :])) - noise_n
    if last_n > motion.small_n:
        return last_n
    first, middle, last = (float(slow[k]) for k in (len(slow) // 16, len(slow) // 2, len(slow) - 1))
    gone_n = abs(last - first) - noise_n
    return gone_n if gone_n > ERROR_SHARE * motion.hand_n and abs(last - middle) > 0.5 * abs(last - first) else 0.0


def trend(sizes: list[float], floor_n: float) -> tuple[float, float, float]:
    """Return by how much sizes change from one to the next [1, logarithm], the standard error, and their scatter.

    The error grows with what neighbours have in common, and is that of a normal number where they are many.
    """
    count = len(sizes)
    logs = [math.log(max(size, floor_n)) for size in sizes]
    middle, mean = 0.5 * (count - 1.0), math.fsum(logs) / count
    spread = math.fsum((k - middle) ** 2 for k in range(count))
    slope = math.fsum((k - middle) * (own - mean) for k, own in enumerate(logs)) / spread
    left = [own - mean - slope * (k - middle) for k, own in enumerate(logs)]
    power = math.fsum(own * own for own in left)
    alike = math.fsum(one * other for one, other in pairwise(left)) / power if power > 0.0 else 0.0
    alike, degrees = min(max(alike, 0.0), 0.6), count - 2.0
    error = math.sqrt(power / degrees / spread * (1.0 + alike) / (1.0 - alike)) * (1.0 + 2.5 / degrees)
    return slope, error, math.sqrt(power / degrees)


def by_parts(motion: Motion, parts: Parts, is_open: bool = True) -> Finding:
    """Judge a motion of many turns by the trend of its sizes over the last six tenths.

    is_open: whether modes are asked where the trend is in doubt.
    """
    sizes, count, length_s = parts.sizes, len(parts.sizes), motion.length_s
    late = sizes[2 * count // 5 :]
    floor_n = 0.02 * max(late)
    slope, error, scatter = trend(late, floor_n)
    size_n = max(parts.reaches[-(count // 5) :])
    hz, band_hz = line_of(parts.moved[2 * len(parts.moved) // 5 :], motion.period_s)
    found = Finding(
        "cannot_say", Cause.CHANGE_UNKNOWN, size_n, slope * count / length_s, size_n, error * count / length_s
    )
    found = found._replace(frequency_hz=hz, band_hz=band_hz, needs_s=2.0 * length_s)
    # It grows, or has since it was least, and at its end by as much as at a limit it does not.
    least = min(range(count - 3), key=lambda k: (max(sizes[k], floor_n), -k))
    ends = 5.0 * math.log(max(sizes[-1], floor_n) / max(sizes[-1 - count // 5], floor_n))
    fifths = [rms(np.array(own)) for own in np.array_split(np.array(sizes), 5)]
    grows = all(then > 1.05 * now for now, then in pairwise(fifths)) and fifths[-1] > 1.5 * fifths[0]
    grows |= (slope - SURE_ERRORS * error) * count > IRREGULAR_CHANGE and sizes[-1] > 0.7 * max(sizes)
    rising = slope
    for own in (sizes[least:], late):
        rate, unsure, uneven = trend(own, floor_n)
        if (rate - SURE_ERRORS * unsure) * count > LEAST_CHANGE and rate * len(own) > 8.0 * uneven:
            grows, rising = True, rate
    if grows and ends > max(0.25 * rising * count, 0.5 * LEAST_CHANGE) and sizes[-1] > 0.8 * max(sizes[-3:]):
        if is_open and sizes[-1] < 0.98 * max(sizes):
            # It was as large before, as lines that beat are.
            return found
        clear = max((k for k, size in enumerate(sizes[:-3]) if size <= 1e-3 * max(late)), default=-1) + 1
        rate = trend(sizes[max(clear, least) :], 1e-3 * max(late))[0] if min(sizes) <= floor_n else rising
        return found._replace(kind="diverged", cause=Cause.GROWS, growth_per_s=rate * count / length_s)
    change, later = slope * count, trend(late[len(late) // 2 :], floor_n)
    is_even, errors = scatter < LEAST_CHANGE, SURE_ERRORS * error * count
    falls = change + errors < -LEAST_CHANGE if is_even else change + 1.4 * errors < -IRREGULAR_CHANGE
    # What falls to a swing that stays falls more slowly at its end.
    slows = later[0] > 0.6 * min(slope, trend(sizes[: count // 2], floor_n)[0])
    if falls and not slows and later[0] + LIKELY_ERRORS * later[1] < 0.0:
        return found._replace(kind="stable", cause=Cause.DIES_OUT)
    if is_open and sum(size > floor_n for size in sizes) < 4:
        return found
    if not motion.is_measured and hz is None and _falls_as_noise(motion):
        return found._replace(cause=Cause.LIKE_NOISE)
    half, may_be = len(late) // 2, LIKELY_ERRORS * error * count
    stays = rms(np.array(late[half:])) > 0.5 * rms(np.array(late[:half]))
    fading = trend(sizes[min(sizes.index(max(late)), count - 4) :], floor_n)
    may_fall = fading[0] + SURE_ERRORS * fading[1] < 0.0 and fading[0] * count < -2.0 * LEAST_CHANGE
    may_fall &= scatter < 2.0 * LEAST_CHANGE or (sizes[-1] < 0.5 * max(late) and -fading[0] * count > 8.0 * fading[2])
    may_fall = falls or may_fall or (change + may_be < 0.0 and change < -LEAST_CHANGE)
    is_steady = hz is None or abs(change) + errors < 2.0 * LEAST_CHANGE
    if later[0] * count > -LEAST_CHANGE and (abs(later[0]) + SURE_ERRORS * later[1]) * count < 2.0 * LEAST_CHANGE:
        # What it has fallen to stays.
        is_steady, may_fall = True, False
    # What may die out slowly is a doubt; where no modes explain it, within its error.
    may_last = is_steady or (not is_open and change > -max(2.0 * LEAST_CHANGE, error * count))
    if stays and not may_fall and may_last:
        return found._replace(kind="limit_cycle", cause=Cause.IRREGULAR if hz is None else Cause.GOES_ON)
    return found if hz is not None else found._replace(cause=Cause.IRREGULAR_UNKNOWN)


def line_of(moved: Series, period_s: float) -> tuple[float | None, tuple[float, float]]:
    """Return the frequency of a line with most of the power [Hz], None without one, and the band of 80 % of it."""
    count = len(moved)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count)
    power = np.abs(np.fft.rfft(centred(moved) * window)) ** 2
    power[0] = 0.0
    peak, share = int(np.argmax(power)), np.cumsum(power) / max(total(power), 1e-300)
    near = power[max(peak - 2, 1) : peak + 3]
    place = total(near * np.arange(max(peak - 2, 1), max(peak - 2, 1) + len(near))) / max(total(near), 1e-300)
    low, high = (float(np.searchsorted(share, part)) / (count * period_s) for part in (0.1, 0.9))
    is_line = total(near) > 0.5 * total(power)
    return (place / (count * period_s) if is_line else None), (low, high)


def _falls_as_noise(motion: Motion) -> bool:
    """Return whether the power of the octaves does not fall towards slow ones, as that of 1/f noise does not."""
    half = motion.values[len(motion.values) // 2 :]
    powers = [rms(own) ** 2 - motion.noise.white_n**2 * white_share(k) for k, (own, _) in enumerate(octaves_of(half))]
    slow = powers[-4:]
    return len(slow) == 4 and min(slow) > 0.0 and slow[-1] > 0.4 * max(powers)


def _rest_from(motion: Motion, parts: Parts) -> float:
    """Return when a motion that rests has become small [s]."""
    off = (2.0 * parts.swell > motion.small_n) | (np.abs(parts.slow - parts.slow[-1]) > motion.small_n)
    last = int(np.flatnonzero(off).max(initial=-1))
    return motion.end_s - motion.length_s + motion.period_s * (last + 1)


def _at_rest(motion: Motion, parts: Parts) -> Finding:
    """Return the finding on a force at rest, with the rate at which its motion died out, or grows while it is small."""
    size_n = max(parts.reaches[-1], float(np.ptp(parts.slow[-max(2, len(parts.slow) // PARTS) :])))
    found = Finding("stable", Cause.AT_REST, size_n, rest_from_s=_rest_from(motion, parts))
    largest, count = max(parts.sizes), len(parts.sizes)
    if largest <= FLOOR_SHARE * motion.hand_n:
        return found._replace(size_n=0.0)
    seen = next(
        (k for k, size in enumerate(parts.sizes) if size < 3e-3 * largest and k > parts.sizes.index(largest)), count
    )
    slope, error, _ = trend(parts.sizes[max(0, seen - 6) : seen] if seen > 2 else [largest] * 3, 1e-3 * largest)
    rate = slope * count / motion.length_s
    found = found._replace(growth_per_s=rate, decisive_n=size_n, error_per_s=error * count / motion.length_s)
    if (
        (slope - SURE_ERRORS * error) * count > LEAST_CHANGE
        and parts.sizes[-1] > 0.7 * largest
        and parts.turns >= FEW_TURNS
    ):
        return found._replace(cause=Cause.GROWS_SMALL)
    dies = slope + SURE_ERRORS * error < 0.0 and largest > motion.small_n
    return found._replace(cause=Cause.DIES_OUT) if dies else found


def _by_modes(motion: Motion, parts: Parts, way_n: float, most_turns: float) -> Finding:
    """Judge a motion by the modes of all of it, or of its last half, if these explain it.

    Modes of more turns than `most_turns` are known to rest.
    """
    way_n = way_n or parts.reaches[-1]
    open_ = on_its_way(Finding("cannot_say", Cause.ON_ITS_WAY, way_n), way_n, 4.0 * motion.length_s)
    if parts.turns >= FEW_TURNS and most_turns:
        open_ = open_._replace(cause=Cause.IRREGULAR_UNKNOWN, size_n=parts.reaches[-1])
    for share in (1.0, 0.5, 0.25):
        tail = motion.values[len(motion.values) - round(share * len(motion.values)) :]
        most = max(_FIT_SAMPLES, math.ceil(_TURN_SAMPLES * share * parts.turns))
        is_short = share < 0.5 and share * parts.turns < FEW_TURNS
        if len(tail) < LEAST_SAMPLES or most > _MOST_FIT_SAMPLES or is_short:
            break
        means, block = averaged(tail, most)
        slowest = len(motion.noise.octaves_n2)
        noise_n2 = motion.noise.white_n**2 / block
        lines_n = math.sqrt(noise_n2 + motion.noise.in_octave(slowest) / white_share(slowest) / block)
        noise_n2 += math.fsum(
            motion.noise.in_octave(k) for k in range(int(math.log2(block)), int(math.log2(len(tail))))
        )
        fit = fitted(means, block * motion.period_s, FLOOR_SHARE * motion.hand_n, lines_n)
        fit = fit._replace(modes=[mode for mode in fit.modes if fit.turns(mode) <= max(most_turns, 0.5 * FEW_TURNS)])
        # Large modes that cancel one another are artefacts of the fit.
        last = fit.moved[
            -max(2, math.ceil(len(fit.moved) * min(1.0, max(0.25, 1.0 / max(parts.turns * share, 1.0))))) :
        ]
        if any(mode.end_n > 1.6 * float(np.ptp(last)) + motion.small_n for mode in fit.modes):
            continue
        most_n = max(1.3 * math.sqrt(noise_n2), LEFT_SHARE * rms(fit.moved), 0.2 * motion.small_n)
        if max(rms(fit.left), rms(fit.left[-max(2, len(fit.left) // 4) :])) <= most_n:
            found = of_modes(fit, motion, parts)
            if found.kind != "cannot_say":
                return found
            open_ = found if share == 1.0 else open_
    if motion.rest_n is not None and open_.cause is Cause.ON_ITS_WAY and max(parts.sizes[-2:]) <= motion.small_n:
        return _approaching(open_, motion.values, motion.rest_n)
    return open_


def of_modes(fit: Fit, motion: Motion, parts: Parts) -> Finding:
    """Decide by the largest mode of the first fate that occurs: it grows, lasts, or is unsure; else the force rests."""
    first: dict[str, Mode] = {}
    for mode in sorted(fit.modes, key=lambda one: -one.end_n):
        first.setdefault(fate_of(mode, fit, motion), mode)
    growing, lasting, unsure = (first.get(name) for name in ("grows", "lasts", "unsure"))
    if unsure is not None and unsure.end_n > 2.0 * max(own.end_n if own else 0.0 for own in (growing, lasting)):
        growing = lasting = None
    if growing is not None and (lasting is None or growing.end_n >= lasting.end_n):
        return _seen(_of_mode("diverged", Cause.GROWS, growing, fit), growing, fit, motion, parts)
    if lasting is not None:
        found = _of_mode("limit_cycle", Cause.GOES_ON, lasting, fit)
        return found._replace(size_n=max(*parts.reaches[-2:], 0.5 * lasting.end_n))
    if unsure is not None:
        found = _of_mode("cannot_say", Cause.CHANGE_UNKNOWN, unsure, fit)
        turns = fit.turns(unsure)
        if turns < 1.0:
            needs_s = LEAST_TURNS / unsure.frequency_hz if turns >= 0.25 else 4.0 * fit.length_s
            return on_its_way(found, unsure.end_n, needs_s)
        return found._replace(needs_s=2.0 * fit.length_s)
    size_n = max((mode.end_n for mode in fit.modes), default=0.0)
    rate = max((mode.growth_per_s for mode in fit.modes), default=None)
    rests = size_n <= motion.small_n
    cause = Cause.DIES_OUT if rate is not None and rate < 0.0 else Cause.AT_REST if rests else Cause.MOVED
    found = Finding("stable", cause, size_n, rate, size_n)
    if rests:
        return found._replace(rest_from_s=_rest_from(motion, parts))
    return _seen(found, max(fit.modes, key=lambda mode: mode.end_n), fit, motion, parts)


def _seen(found: Finding, mode: Mode, fit: Fit, motion: Motion, parts: Parts) -> Finding:
    """Return what a mode says if the force changes as it does, by a quarter at least: others may cancel it."""
    part = max(2, round(0.3 * fit.length_s / motion.length_s * len(parts.reaches)))
    factor = math.exp(min(mode.growth_per_s * motion.length_s * part / len(parts.reaches), 50.0))
    seen = max(parts.reaches[-part:]) / max(*parts.reaches[-2 * part : -part], 1e-300) - 1.0
    if fit.turns(mode) < LEAST_TURNS or seen / (factor - 1.0) > 0.25:
        return found
    return found._replace(kind="cannot_say", cause=Cause.IRREGULAR_UNKNOWN)


def _of_mode(kind: str, cause: Cause, mode: Mode, fit: Fit) -> Finding:
    hz = mode.frequency_hz if fit.turns(mode) >= 0.5 else 0.0
    return Finding(kind, cause, mode.end_n, mode.growth_per_s, mode.end_n, mode.error_per_s, hz)  # type: ignore[arg-type]


def fate_of(mode: Mode, fit: Fit, motion: Motion) -> str:
    """Return whether a mode `grows`, `lasts`, `falls`, is `small`, or `unsure`, by its change and its errors."""
    turns, change = fit.turns(mode), mode.growth_per_s * fit.length_s
    error = SURE_ERRORS * mode.error_per_s * fit.length_s
    if 0.0 < turns < 0.5:
        # Less than half a swing looks like an exponential, so its ranges in both halves are compared.
        change, error = 2.0 * math.log(max(mode.end_n, 1e-300) / max(mode.begin_n, 1e-300)), 0.0
    is_large, is_seen = mode.end_n > motion.small_n, mode.end_n > 2.0 * SURE_ERRORS * rms(fit.left)
    least = LEAST_CHANGE if turns >= LEAST_TURNS else ONE_SIDED_CHANGE * (2.0 if turns >= 0.5 else 1.0)
    if change - error > least and is_large:
        is_way = turns < 0.5 and motion.length_s < WAY_TRIPS * motion.trip_s
        return "grows" if is_seen and not is_way else "unsure"
    if change + error < -(LEAST_CHANGE if turns >= 0.5 or not turns else ONE_SIDED_CHANGE):
        return "falls"
    if turns >= LEAST_TURNS and abs(change) + error < 2.0 * LEAST_CHANGE and is_large:
        return "lasts" if change > -max(error, 0.2 * LEAST_CHANGE) else "unsure"
    drifts = turns < 0.5 and max(mode.begin_n, mode.end_n) < ERROR_SHARE * motion.hand_n
    return "unsure" if is_large and not drifts else "small"


def _approaching(found: Finding, values: Series, rest_n: float) -> Finding:
    """Return a finding that a force is on its way, which is stable if it goes to the rest of the law."""
    part = max(1, len(values) // 20)
    off_n = [abs(total(own) / part - rest_n) for own in (values[:part], values[-part:])]
    if off_n[1] > off_n[0] * math.exp(-2.0 * LEAST_CHANGE):
        return found
    return found._replace(kind="stable", cause=Cause.TO_THE_REST, decisive_n=off_n[1])
