"""The envelope of a motion, its size in eight windows, and what it does where no modes explain the motion."""

import math
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from telenano.analysis.findings import Cause, Finding, on_its_way
from telenano.analysis.modes import centred, rms
from telenano.analysis.motion_fit import Fate, Motion, coloured_share
from telenano.analysis.read_out import gone_of, moved_of, reach_of
from telenano.analysis.verdict_thresholds import ERROR_SHARE, LEAST_CHANGE, LEAST_TURNS, LEFT_SHARE, SURE_ERRORS

Series = npt.NDArray[np.float64]
WINDOWS = 8
# A motion that goes on is in its last window no less than this part of what it was [1]: a third of a turn goes as far
_LEAST_END = 1.0 / 3.0
# octaves of a spectrum that tell noise from a motion [1]
_OCTAVES = 4
# an octave with more than this of the density of white noise shows another motion [1]
_WHITE_OVER = 3.0
# fall of the density in an octave [1, logarithm] of noise whose density goes with the square of the frequency
_STEEPEST = 2.0 * math.log(2.0)
# chance makes a line over the density of noise, of its neighbours in the octave, less than once in e to this
_LINE_NATS = 7.0


def by_envelope(motion: Motion) -> Finding:
    """Judge a motion that no modes explain by its envelope, the size of the motion in eight windows.

    | the envelope                                                                           | is         |
    |---|---|
    | is that of a motion without a line whose spectrum is that of 1/f noise                 | UNSURE     |
    | is small in the last two windows, did not rise twice before, and the force has stopped | NEGLIGIBLE |
    | rose twice from rest, and is not smaller than before                                   | LASTING    |
    | is that of a motion of fewer than four turns, or one whose spectrum has no main octave | UNSURE     |
    | surely changes by less than 0.3 in its later half                                      | LASTING    |
    | surely grows, also in its later half                                                   | GROWING    |
    | surely dies out, also in its later half and there nearly as quickly                    | FALLING    |
    | is irregular, and as large in the later half as in the earlier                         | LASTING    |
    | is anything else                                                                       | UNSURE     |
    """
    values, small_n = motion.values, motion.small_n
    if len(values) < WINDOWS**2:
        return Finding("cannot_say", Cause.FEW_SAMPLES, float(np.ptp(values)), samples=len(values))
    sizes = sizes_of(motion)
    window_s = motion.period_s * len(values) / WINDOWS
    rate, end_n = trend(sizes, small_n)[0] / (window_s * WINDOWS), max(sizes[-2:])
    late = Finding("cannot_say", Cause.IRREGULAR_UNKNOWN, max(sizes[WINDOWS // 2 :]), rate, max(sizes[WINDOWS // 2 :]))
    if end_n > small_n and falls_as_noise(values, motion.noise_n):
        return late._replace(cause=Cause.LIKE_NOISE, size_n=max(sizes), decisive_n=max(sizes))
    if end_n <= small_n and not recurs(sizes, small_n):
        last = max((k for k, own in enumerate(sizes) if own > small_n), default=-1)
        rest_s = motion.end_s - (WINDOWS - 1 - last) * window_s
        rest = values[len(values) * (last + 1) // WINDOWS :]
        if len(rest) >= WINDOWS and (gone_n := gone_of(rest)) > ERROR_SHARE * motion.hand_n:
            # it is small in each window, and goes on from one to the next
            return on_its_way(late, gone_n, 4.0 * WINDOWS * window_s)
        return Finding("stable", Cause.AT_REST, sizes[-1], rate, sizes[-1], rest_from_s=rest_s)
    turns, is_motion = turns_of(values), coloured_share(values) < ERROR_SHARE
    is_known = turns >= 2.0 * LEAST_TURNS and is_motion
    fate = _fate(envelope_of(values, motion, turns), small_n) if is_known else Fate.UNSURE
    if fate is Fate.GROWING:
        return Finding("diverged", Cause.GROWS, sizes[-1], rate, sizes[-1])
    if fate is Fate.FALLING:
        return Finding("stable", Cause.DIES_OUT, sizes[-1], rate, sizes[-1])
    goes_on = fate is Fate.LASTING and sizes[-1] > _LEAST_END * late.size_n
    hidden_n = 2.0 * reach_of(motion.noise_n, len(values) // WINDOWS)
    if goes_on or (recurs(sizes, small_n, hidden_n) and max(sizes[-3:]) > 0.5 * max(sizes)):
        return late._replace(kind="limit_cycle", cause=Cause.IRREGULAR)
    return late


def _fate(sizes: list[float], small_n: float) -> Fate:
    """Return what an envelope does that is not small at its end: see `by_envelope`."""
    half = WINDOWS // 2
    (late, late_error), (whole, whole_error) = trend(sizes[half:], small_n), trend(sizes, small_n)
    earlier, later = max(sizes[half:-2]), max(sizes[-2:])
    if abs(late) + late_error < 2.0 * LEAST_CHANGE and -late < max(late_error, LEFT_SHARE * LEAST_CHANGE):
        return Fate.LASTING
    if whole - whole_error > LEAST_CHANGE and late > 0.0 and sizes[-1] > (1.0 - LEFT_SHARE) * max(sizes):
        return Fate.GROWING if late - late_error > LEAST_CHANGE or later > earlier else Fate.UNSURE
    early = trend(sizes[:half], small_n)[0]
    if whole + whole_error < -LEAST_CHANGE and late < 0.0:
        # A motion that falls to a swing that stays falls more slowly at the end.
        return Fate.FALLING if late + late_error < -LEAST_CHANGE and late < 0.6 * early else Fate.UNSURE
    stays = max(sizes[half:]) > 0.5 * max(sizes[:half]) and later > 0.5 * earlier
    # the later half and all of it, each in its own errors, together tell of a fall
    falls = late / max(late_error, 1e-9) + whole / max(whole_error, 1e-9) < -math.sqrt(2.0)
    return Fate.LASTING if stays and not falls and abs(late) < LEAST_TURNS * late_error else Fate.UNSURE


def trend(sizes: list[float], small_n: float) -> tuple[float, float]:
    """Return by how much sizes change over all their windows [1, logarithm], and SURE_ERRORS of its standard errors."""
    count = len(sizes)
    logs = [math.log(max(size, 1e-3 * small_n)) for size in sizes]
    middle, mean = 0.5 * (count - 1.0), math.fsum(logs) / count
    spread = math.fsum((k - middle) ** 2 for k in range(count))
    slope = math.fsum((k - middle) * (own - mean) for k, own in enumerate(logs)) / spread
    left = math.fsum((own - mean - slope * (k - middle)) ** 2 for k, own in enumerate(logs))
    return slope * count, SURE_ERRORS * count * math.sqrt(left / (count - 2.0) / spread)


def sizes_of(motion: Motion) -> list[float]:
    """Return how far the force goes in each of eight windows [N]: from end to end, or as a swing of its power does."""
    edges = np.linspace(0, len(motion.values), WINDOWS + 1).astype(int)
    return [_size(motion.values[first:last], motion) for first, last in pairwise(edges)]


def envelope_of(values: Series, motion: Motion, turns: float) -> list[float]:
    """Return how far the force goes about eight instants [N], in an eighth or in a turn if that is longer."""
    count = len(values)
    wide = math.ceil(count * max(1.0 / WINDOWS, 1.25 / turns))
    firsts = [round(min(max((k + 0.5) / WINDOWS * count - 0.5 * wide, 0.0), count - wide)) for k in range(WINDOWS)]
    return [_size(values[first : first + wide], motion) for first in firsts]


def _size(values: Series, motion: Motion) -> float:
    """Return how far a force goes [N], without what noise reaches, or adds to its power, or a step that flickers."""
    noise_n = max(motion.noise_n * math.sqrt(1.0 + SURE_ERRORS * math.sqrt(2.0 / len(values))), 0.5 * motion.step_n)
    power = rms(centred(values)) ** 2 - noise_n**2
    return max(moved_of(values, motion.noise_n), 2.0 * math.sqrt(2.0 * max(power, 0.0)))


def turns_of(values: Series) -> float:
    """Return how often the strongest line of a motion turns."""
    count = len(values)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count)
    return float(1 + np.argmax(np.abs(np.fft.rfft(centred(values) * window))[1:]))


def recurs(sizes: list[float], small_n: float, hidden_n: float = 0.0) -> bool:
    """Return whether a motion began at least twice after a rest, as a cycle of snaps does, and a landing does not.

    A window that noise hides in part, by so much [N], may seem to rest.
    """
    begun_n = 2.0 * max(small_n, hidden_n)
    return sum(before <= small_n and after > begun_n for before, after in pairwise(sizes)) >= LEAST_TURNS


def falls_as_noise(values: Series, noise_n: float) -> bool:
    """Return whether the density of a motion falls from octave to octave as 1/f noise does, and no line stands out.

    A cycle has a line, and one that is irregular has a band; the density of noise is greatest where it begins. It may
    come to the white noise of the read-out.
    """
    count = len(values)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count)
    power = np.abs(np.fft.rfft(centred(values) * window)) ** 2 / float(np.cumsum(window * window)[-1])
    octaves = [power[2**k : 2 ** (k + 1)] for k in range(1, int(math.log2(len(power))))]
    # The density of the white part is its variance.
    above = [own for own in octaves if float(own.mean()) > _WHITE_OVER * noise_n * noise_n]
    if len(above) < _OCTAVES or len(above) != len(octaves[: len(above)]):
        return False
    levels = [math.log(float(own.mean())) for own in above]
    steps = [before - after for before, after in pairwise(levels)]
    # the logarithms of the means of n and 2 n neighbours under this window differ by so much, by chance
    errors = [SURE_ERRORS * math.sqrt(3.0 / (len(own) - 0.5)) for own in above]
    falls = all(-error < step < _STEEPEST + error for step, error in zip(steps, errors, strict=False))
    slope = (levels[0] - levels[-1]) / (len(levels) - 1)
    return bool(falls and 0.25 * _STEEPEST < slope < _STEEPEST and not any(map(has_line, above)))


def has_line(power: Series) -> bool:
    """Return whether a line stands out of the density of an octave as noise makes it once in a thousand times."""
    at = int(np.argmax(power))
    others = np.concatenate([power[: max(at - 1, 0)], power[at + 2 :]])
    # this number of them are independent under this window
    count = len(others) / 1.5
    if count < 2.0:
        return False
    # the ratio of an exponential number to the mean of others exceeds x with the probability (1 + x / count)^-count
    most = count * ((len(power) * math.exp(_LINE_NATS)) ** (1.0 / count) - 1.0)
    # within an octave the density of 1/f noise differs from its mean by 1.4
    return bool(power[at] > 1.4 * most * others.mean())
