"""What a force does beyond the noise of its read-out, where no mode explains it.

Each octave of a force that exceeds the noise that was measured in the free tip (`telenano.analysis.measured_noise`) is
a motion. What is not small and does not become less goes on, whether it is regular or not (`checked`).
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.envelope import WINDOWS, sizes_of, trend
from telenano.analysis.findings import Cause, Finding
from telenano.analysis.measured_noise import Noise, octaves_of
from telenano.analysis.modes import LEAST_SAMPLES, centred, noise_floor, rms
from telenano.analysis.motion_fit import Motion, Window
from telenano.analysis.swings import turning_points
from telenano.analysis.verdict_thresholds import (
    FEW_TURNS,
    LEAST_CHANGE,
    LEAST_TURNS,
    LIKELY_ERRORS,
    NOISE_AGREES,
    SMALL_SHARE,
    SURE_ERRORS,
)

Series = npt.NDArray[np.float64]
# Number of parts of a hold whose sizes are compared [1].
_PARTS = 10
# The sizes may turn these findings to one that the motion goes on.
_OPEN = (Cause.IRREGULAR_UNKNOWN, Cause.LIKE_NOISE, Cause.CHANGE_UNKNOWN)


class Parts(NamedTuple):
    """What moves beyond the noise, shape (n,) [N], and in equal parts of it: its size by its power, and its reach [N].

    turns: how often it goes there and back in the hold, by more than is small and half of its root mean square.
    """

    moved: Series
    sizes: list[float]
    reaches: list[float]
    turns: float


def noise_in(motion: Motion) -> Noise:
    """Return the noise that a hold may have: what was measured in the free tip, and no more white noise than it has.

    Without a measurement only the white noise of the hold itself is noise. A step that the read-out rounds to is
    a part of the white noise, as it is where it flickers for a fifth of the time.
    """
    own = noise_floor(motion.values) if len(motion.values) >= LEAST_SAMPLES else 0.0
    free = motion.free
    if free is not None:
        own = min(own, NOISE_AGREES * free.white_n)
    powers = () if free is None else tuple(NOISE_AGREES**2 * power for power in free.octaves_n2)
    return Noise(max(own, 0.4 * motion.step_n), powers, math.inf if free is None else free.samples)


def parts_of(values: Series, noise: Noise, small_n: float) -> Parts:
    """Return what moves beyond the noise in a force [N]: each octave of each tenth without the power of noise."""
    count = len(values)
    edges = np.linspace(0, count, _PARTS + 1).astype(int)
    moved = np.zeros(count)
    for octave, own in enumerate(octaves_of(values)):
        gains = []
        for first, last in pairwise(edges.tolist()):
            seen, (mean, most) = rms(own[first:last]) ** 2, noise.within(octave, last - first)
            gains.append(math.sqrt(1.0 - mean / seen) if seen > most else 0.0)
        moved = moved + np.repeat(gains, np.diff(edges)) * own
    turns = 0.5 * len(turning_points(moved.tolist(), range(count), max(small_n, 0.5 * rms(moved))))
    if turns >= 4 * _PARTS:
        edges = np.linspace(0, count, 2 * _PARTS + 1).astype(int)
    ends = list(pairwise(edges.tolist()))
    sizes = [2.0 * math.sqrt(2.0) * rms(moved[first:last]) for first, last in ends]
    return Parts(moved, sizes, [float(np.ptp(moved[first:last])) for first, last in ends], turns)


def unexplained(window: Window) -> Series:
    """Return the force of a last part without its modes [N], shape (n,)."""
    fit, many = window.fit, len(window.values)
    places = many - (np.arange(len(fit.left))[::-1] + 0.5) * (many / len(fit.left))
    return centred(window.values - np.interp(np.arange(many) + 0.5, places, fit.motion - fit.left))


def checked(found: Finding, motion: Motion, window: Window | None) -> Finding:
    """Return a finding that agrees with what moves beyond the noise.

    | the finding                              | what moves, and no dying mode explains          | is then |
    |---|---|---|
    | grows                                    | is small to the end                             | at rest |
    | is stable                                | goes on for ten turns                           | a cycle |
    | is stable                                | turns five times, and does not surely fall      | a doubt |
    | is a doubt about a change or about noise | goes on for ten turns, and noise was measured   | a cycle |
    | is anything else                         | is anything                                     | as said |

    window: the last part whose modes decided; None where the envelope has, or nothing. Where the noise was not measured
    a motion without a band is noise.
    """
    is_stable = found.kind == "stable"
    is_open = is_stable or found.kind == "diverged" or found.cause in _OPEN
    if len(motion.values) < LEAST_SAMPLES * _PARTS or not is_open:
        return found
    noise, small_n = noise_in(motion), max(motion.small_n, motion.answers_n)
    parts = parts_of(centred(motion.values), noise, small_n)
    end_n = max(parts.reaches[-len(parts.reaches) // _PARTS :])
    if found.kind == "diverged":
        return _still_small(found, motion) if max(end_n, found.size_n) <= SMALL_SHARE * motion.hand_n else found
    again, is_short = comes_again(parts, small_n), False
    if is_stable:
        found = found._replace(size_n=max(found.size_n, end_n))
        share = len(window.values) / len(motion.values) if window is not None else 1.0
        if found.cause is Cause.AT_REST and parts.turns >= 2.0 * FEW_TURNS > 2.0 * share * parts.turns:
            # The last part has fewer turns than show a rest, unless the motion was small before.
            is_short = not is_small(parts, small_n)
        if window is not None and len(window.values) >= LEAST_SAMPLES * _PARTS and not (again or is_short):
            parts = parts_of(unexplained(window), noise, small_n)
    elif motion.free is None:
        return found
    is_noise = motion.free is None and not has_band(parts.moved)
    # A motion that dies out by its modes may leave something until it has died.
    tenths = 2 if found.cause is Cause.DIES_OUT else 3
    is_quiet = not (again or is_short) and is_small(parts, small_n, tenths)
    if is_noise or is_quiet or parts.turns < (1.0 if is_stable else 2.0) * FEW_TURNS:
        return found
    goes_on, falls = _course(parts, small_n, again)
    if falls:
        return found
    # A motion that comes again may pause at the end.
    size_n = max(parts.reaches[-len(parts.reaches) // (2 if again else 5) :])
    told = Finding("cannot_say", Cause.IRREGULAR_UNKNOWN, size_n, None, size_n)
    if goes_on and parts.turns >= 2.0 * FEW_TURNS:
        return told._replace(kind="limit_cycle", cause=Cause.IRREGULAR, band_hz=_band_hz(parts.moved, motion.period_s))
    return told if is_stable else found


def _still_small(found: Finding, motion: Motion) -> Finding:
    """Return that a motion which grows is at rest, from when no other motion is large."""
    large = [k for k, size in enumerate(sizes_of(motion), start=1) if size > motion.small_n]
    rest_s = motion.end_s - motion.period_s * len(motion.values) * (1.0 - max(large, default=0) / WINDOWS)
    return found._replace(kind="stable", cause=Cause.GROWS_SMALL, rest_from_s=rest_s)


def _band_hz(moved: Series, period_s: float) -> tuple[float, float]:
    """Return the band that has four fifths of the power of a motion in its last six tenths [Hz]."""
    late = centred(moved[2 * len(moved) // 5 :])
    power = np.cumsum(np.abs(np.fft.rfft(late)) ** 2)
    low, high = (float(np.searchsorted(power, share * power[-1])) / (len(late) * period_s) for share in (0.1, 0.9))
    return low, high


def is_small(parts: Parts, small_n: float, tenths: int = 3) -> bool:
    """Return whether a motion is small in the last tenths."""
    ends = tenths * len(parts.sizes) // _PARTS
    reach_n, size_n = max(parts.reaches[-ends:]), max(parts.sizes[-ends:])
    return reach_n <= small_n or (reach_n <= 2.0 * small_n and size_n <= 0.5 * small_n)


def has_band(moved: Series) -> bool:
    """Return whether an octave has four times the power of all that are slower by two or more; noise has no such.

    1/f noise has the same power in each octave, of which three or more have to be slower.
    """
    powers = [rms(own) ** 2 for own in octaves_of(moved)]
    peak = int(np.argmax(powers))
    return len(powers) - peak > 4 and powers[peak] > 4.0 * math.fsum(powers[peak + 2 :])


def comes_again(parts: Parts, small_n: float) -> bool:
    """Return whether a motion began again and again after a rest, and its last pause is as the ones before."""
    begun, places, moves = 0, [0], True
    for k, reach in enumerate(parts.reaches):
        begun += reach > 2.0 * small_n and not moves
        moves = reach > (small_n if moves else 2.0 * small_n)
        places += [k] if moves else []
    pauses = [then - now for now, then in pairwise(places)]
    return begun > LEAST_TURNS and len(parts.sizes) - places[-1] <= 1.5 * max(pauses)


def _course(parts: Parts, small_n: float, again: bool) -> tuple[bool, bool]:
    """Return whether a motion goes on through the last six tenths, and whether it surely becomes less there."""
    count = len(parts.sizes)
    late = parts.sizes[2 * count // 5 :]
    change, sure = trend(late, small_n)
    half = len(late) // 2
    stays = rms(np.array(late[half:])) > 0.5 * rms(np.array(late[:half]))
    stays &= again or max(parts.sizes[-(count // _PARTS) :]) > max(late) / 3.0
    may_fall = change + LIKELY_ERRORS / SURE_ERRORS * sure < 0.0 and change < -LEAST_CHANGE
    return stays and not may_fall, change + sure < -LEAST_CHANGE
