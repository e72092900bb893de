"""Modes of a part of a motion: whether they explain it, and the fate of each.

`Motion.last` fits the modes of the last share of a motion (`telenano.analysis.modes`). `explains` tells whether the fit
is accepted: its residual is noise, or a small share of the motion, and no mode bends away from its exponential.
`classify` returns the fate of one mode, and `decided_by_modes` the finding on the part, by the largest mode of the
first fate that occurs: it grows, goes on, or is unknown. Otherwise the force is at rest.
"""

import math
from enum import Enum, auto
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.findings import Cause, Finding, Kind, on_its_way
from telenano.analysis.measured_noise import Noise
from telenano.analysis.modes import LEAST_SAMPLES, Fit, Mode, amplitude, centred, fitted, rms
from telenano.analysis.read_out import moved_of, noise_of
from telenano.analysis.verdict_thresholds import (
    ERROR_SHARE,
    FLOOR_SHARE,
    LEAST_CHANGE,
    LEAST_TURNS,
    LEFT_SHARE,
    ONE_SIDED_CHANGE,
    SMALL_SHARE,
    SURE_ERRORS,
)

Series = npt.NDArray[np.float64]


class Fate(Enum):
    """Course of a mode, or of an envelope."""

    GROWING = auto()
    LASTING = auto()
    FALLING = auto()
    NEGLIGIBLE = auto()
    UNSURE = auto()


MAY_LAST = (Fate.LASTING, Fate.GROWING, Fate.UNSURE)


class Window(NamedTuple):
    """A last part of a motion, with its fit.

    length_s, end_s: its length and end [s]; small_n: greatest size of a small motion [N]; rounded_n: 1.5 steps of the
    read-out [N]; unrounded_n: as small_n without rounding [N]; values: the force [N]; fit: the fit of its modes;
    left_n: the root mean square of the residual in the last quarter [N].
    """

    length_s: float
    end_s: float
    small_n: float
    rounded_n: float
    unrounded_n: float
    values: Series
    fit: Fit

    @property
    def left_n(self) -> float:
        return rms(self.fit.left[-max(2, len(self.fit.left) // 4) :])

    @property
    def last(self) -> Series:
        """The force in the last quarter [N]."""
        return self.values[-max(2, len(self.values) // 4) :]

    @property
    def noise_n(self) -> float:
        """The noise of the read-out [N], including that of rounding to a step."""
        return max(self.fit.noise_n, self.rounded_n / 1.5 / math.sqrt(12.0))

    def cycles(self, mode: Mode) -> float:
        """Return the number of turns of a mode within the window while it stands out of the residual."""
        change, seen = mode.growth_per_s * self.length_s, self.seen(mode)
        return mode.frequency_hz * self.length_s * (min(seen / change, 1.0) if change > seen else 1.0)

    def seen(self, mode: Mode) -> float:
        """Return the logarithm of the ratio of a mode's size at the end to SURE_ERRORS residuals there, at least 0."""
        return math.log(max(mode.end_n / max(SURE_ERRORS * self.left_n, 1e-300), 1.0))


class Motion(NamedTuple):
    """The force of an episode [N] at even times, with the period [s] and the end of these.

    hand_n: the hand's greatest force [N]; step_n, noise_n: step and noise of the read-out [N]; rest_n: the force at
    which the law rests [N], None if unknown; free: the noise of the free tip, None if it was not measured; answers_n:
    the size of what may answer the trembling of the hand [N].
    """

    values: Series
    period_s: float
    end_s: float
    hand_n: float
    step_n: float
    noise_n: float
    rest_n: float | None
    free: Noise | None = None
    answers_n: float = 0.0

    @property
    def small_n(self) -> float:
        # A change by one step of a read-out that rounds is not a motion.
        return max(SMALL_SHARE * self.hand_n, 1.5 * self.step_n)

    def last(self, share: float) -> Window | None:
        """Return the last share of the motion with its fit; None if it has too few samples."""
        tail = self.values[len(self.values) - round(share * len(self.values)) :]
        if len(tail) < LEAST_SAMPLES:
            return None
        fit = fitted(tail, self.period_s, FLOOR_SHARE * self.hand_n)
        least = (self.small_n, 1.5 * self.step_n, SMALL_SHARE * self.hand_n)
        return Window(self.period_s * len(tail), self.end_s, *least, tail, fit)


def classify(mode: Mode, window: Window) -> Fate:
    """Return the fate of a mode in a window, by its change (growth times length) and 2.5 standard errors of that.

    | the mode                                                                            | is         |
    |---|---|
    | is below the residual of a fit that still has a line in it                          | NEGLIGIBLE |
    | surely grows by more than the least change, is seen to, and is or becomes large     | GROWING    |
    | surely grows, is large or may become so, and is not seen to                         | UNSURE     |
    | surely grows and neither is nor becomes large                                       | NEGLIGIBLE |
    | surely dies out by more than the least change                                       | FALLING    |
    | turns twice, surely changes by less than 0.3, is large and falls not in each third  | LASTING    |
    | the same, and small only beside the step of the read-out                            | UNSURE     |
    | is small, or drifts by less than an instrument errs                                 | NEGLIGIBLE |
    | is anything else                                                                    | UNSURE     |

    The least change is LEAST_CHANGE for a mode that turns twice; otherwise ONE_SIDED_CHANGE, or twice that for a swing.
    """
    if not window.fit.whole and mode.end_n < 2.0 * math.sqrt(2.0) * window.left_n:
        return Fate.NEGLIGIBLE
    change, error, cycles = *_change(mode, window), window.cycles(mode)
    is_swing = cycles >= 0.5
    # The growth of a swing that is seen once has to be clear on both sides.
    least = LEAST_CHANGE if cycles >= LEAST_TURNS else ONE_SIDED_CHANGE * (2.0 if is_swing else 1.0)
    falls_by = LEAST_CHANGE if is_swing or not mode.frequency_hz else ONE_SIDED_CHANGE
    if change - error > least:
        return _growing(mode, window, change, cycles, least)
    if change + error < -falls_by:
        return Fate.FALLING
    if (
        cycles >= LEAST_TURNS
        and abs(change) + error + window.rounded_n / mode.end_n / 3.0 < 2.0 * LEAST_CHANGE
        and -change < max(error, LEFT_SHARE * LEAST_CHANGE)
    ):
        # With friction, a dying swing may be fitted as the difference of a dying and a lasting one.
        falls = all(after < before * math.exp(-LEAST_CHANGE) for before, after in pairwise(mode.thirds_n))
        if mode.end_n > window.small_n and not falls:
            return Fate.LASTING
        return Fate.UNSURE if mode.end_n > window.unrounded_n else Fate.NEGLIGIBLE
    drifts = not is_swing and max(mode.begin_n, mode.end_n) < ERROR_SHARE * window.small_n / SMALL_SHARE
    # A swing within a step of the read-out may grow or die out unnoticed.
    within_n = window.unrounded_n if cycles >= LEAST_TURNS else window.small_n
    is_over = is_swing or change < -2.0 * ONE_SIDED_CHANGE
    is_small = drifts or max(mode.end_n, 0.0 if is_over else mode.begin_n) <= within_n
    return Fate.NEGLIGIBLE if is_small else Fate.UNSURE


def _change(mode: Mode, window: Window) -> tuple[float, float]:
    """Return the change of a mode over a window, and SURE_ERRORS of its standard errors [1, natural logarithm]."""
    if 0.0 < mode.frequency_hz * window.length_s < 0.5:
        # Less than half a swing looks like an exponential, so its ranges in both halves are compared.
        return 2.0 * math.log(max(mode.end_n, 1e-300) / max(mode.begin_n, 1e-300)), 0.0
    return mode.growth_per_s * window.length_s, SURE_ERRORS * mode.error_per_s * window.length_s


def _growing(mode: Mode, window: Window, change: float, cycles: float, least: float) -> Fate:
    """Return the fate of a mode whose fit surely grows."""
    # A growth must exceed the residual, and rise from third to third if the mode turns often enough.
    is_rising = window.seen(mode) > least and (
        cycles < LEAST_TURNS or (rises(window.fit, mode, change) and rises_where_seen(window, mode))
    )
    # A motion that was seen for two turns is extrapolated by the length of the window.
    own = window.values[-max(2, math.ceil(len(window.values) * min(1.0, max(cycles, 1.0) / change))) :]
    # Within the time of its growth, or of a visible turn, a real mode covers more than half of its size.
    end_n = min(mode.end_n, 2.0 * float(np.ptp(own)))
    reaches = end_n * (math.exp(min(change, 50.0)) if cycles >= LEAST_TURNS else 1.0) > window.small_n
    if is_rising and reaches and end_n > max(2.0 * SURE_ERRORS * window.left_n, window.rounded_n):
        return Fate.GROWING
    # A motion that is only just visible does not count as rest.
    within_n = window.unrounded_n if cycles >= LEAST_TURNS else window.small_n
    is_near = end_n > within_n or (is_rising and reaches and cycles >= 0.5 and end_n > window.rounded_n)
    return Fate.UNSURE if is_near else Fate.NEGLIGIBLE


def rises(fit: Fit, mode: Mode, change: float) -> bool:
    """Return whether a line grows from each third of a stretch to the next by at least half of the fitted growth."""
    least_n = max(SURE_ERRORS * rms(fit.left) * math.sqrt(12.0 / len(fit.left)), LEFT_SHARE**2 * mode.thirds_n[-1])
    factor = math.exp(change / 6.0)
    return all(after >= before * factor or before <= least_n for before, after in pairwise(mode.thirds_n))


def rises_where_seen(window: Window, mode: Mode) -> bool:
    """Return whether the motion rises with a growing mode in the last part, where this stands out of the residual.

    A late pulse is fitted as modes that grow and cancel one another after it. So the residual and all growing modes
    together have to rise from each third of the part to the next by half of the fitted growth, and to be half as large
    as the mode in the last, but for their errors. The part has two turns or more.
    """
    left, change, cycles = window.fit.left, mode.growth_per_s * window.length_s, mode.frequency_hz * window.length_s
    count, times = len(left), np.linspace(0.0, 1.0, len(left))
    hidden = np.flatnonzero(mode.end_n * np.exp(change * (times - 1.0)) <= SURE_ERRORS * np.abs(left))
    least = max(math.ceil(count * min(LEAST_TURNS / cycles, 1.0)), LEAST_SAMPLES)
    first = min(int(hidden[-1]) + 1 if len(hidden) else 0, count - least)
    grown = left + sum(own.course for own in window.fit.modes if own.growth_per_s > 0.0)
    edges = np.linspace(first, count, 4).astype(int).tolist()
    thirds_n = [amplitude(times[i:j], grown[i:j], change, 2.0 * math.pi * cycles) for i, j in pairwise(edges)]
    error_n = SURE_ERRORS * rms(left[first:]) * math.sqrt(12.0 / (count - first))
    factor = math.exp(change * float(1.0 - times[first]) / 6.0)
    own_n = 0.5 * mode.end_n * math.exp(-change * float(1.0 - times[first]) / 6.0)
    is_there = thirds_n[-1] + error_n >= 0.5 * own_n
    return is_there and all(after + error_n >= before * factor for before, after in pairwise(thirds_n))


def time_until(mode: Mode, small_n: float) -> float:
    """Return the time from the start until a dying mode is small [s]; 0 if it does not die out or is small at once."""
    if mode.growth_per_s >= 0.0 or mode.begin_n <= small_n:
        return 0.0
    return math.log(mode.begin_n / small_n) / -mode.growth_per_s


def decided_by_modes(window: Window) -> Finding:
    """Decide by the largest mode of the first fate that occurs: growing, lasting, unsure; else the force is at rest.

    A growing mode must be as large as a lasting one, and an unsure mode counts first if it is more than twice as large.
    """
    modes = sorted(window.fit.modes, key=lambda one: one.end_n, reverse=True)
    fates = [(classify(mode, window), mode) for mode in modes]
    first = {fate: next((mode for own, mode in fates if own is fate), None) for fate in Fate}
    growing, lasting, unsure = first[Fate.GROWING], first[Fate.LASTING], first[Fate.UNSURE]
    is_doubt = unsure is not None and growing is not None and unsure.end_n > 2.0 * growing.end_n
    if growing is not None and (lasting is None or growing.end_n >= lasting.end_n) and not is_doubt:
        return _finding("diverged", Cause.GROWS, growing, window)
    if lasting is not None and (unsure is None or unsure.end_n < 2.0 * lasting.end_n):
        lowest_hz = min(mode.frequency_hz for fate, mode in fates if fate is Fate.LASTING)
        return _finding("limit_cycle", Cause.GOES_ON, lasting, window)._replace(
            size_n=_cycle_size_n(lasting, lowest_hz, window)
        )
    if unsure is not None:
        return undecided(unsure, window, modes[0].end_n)
    return _at_rest(modes, window)


def _finding(kind: Kind, cause: Cause, mode: Mode, window: Window) -> Finding:
    turns = mode.frequency_hz if mode.frequency_hz * window.length_s >= 0.5 else 0.0
    return Finding(kind, cause, mode.end_n, mode.growth_per_s, mode.end_n, mode.error_per_s, turns)


def _cycle_size_n(mode: Mode, lowest_hz: float, window: Window) -> float:
    """Return the peak-to-peak size of a cycle [N], which harmonics make different from that of its largest mode."""
    values, noise_n = window.values, noise_of(window.values, window.rounded_n / 1.5)
    size_n = moved_of(values[-math.ceil(len(values) / (window.length_s * lowest_hz)) :], noise_n)
    return size_n if size_n > 0.5 * mode.end_n else mode.end_n


def undecided(mode: Mode, window: Window, size_n: float) -> Finding:
    """Return the finding on a mode of unknown fate, with the length of a hold and the noise that would decide."""
    found, cycles = _finding("cannot_say", Cause.CHANGE_UNKNOWN, mode, window), mode.frequency_hz * window.length_s
    if cycles < 1.0:
        need_s = LEAST_TURNS / mode.frequency_hz if cycles >= 0.25 else 4.0 * window.length_s
        return on_its_way(found._replace(size_n=size_n), mode.end_n, need_s)
    noise_n = window.fit.noise_n / 2.0 if window.fit.noise_n > ERROR_SHARE * mode.end_n else 0.0
    return found._replace(size_n=size_n, needs_s=2.0 * window.length_s, needs_noise_n=noise_n)


def _at_rest(modes: list[Mode], window: Window) -> Finding:
    """Return the finding on a force at rest, or coming to rest, because its modes die out or are small."""
    size_n = max((mode.end_n for mode in modes), default=0.0)
    rate = max((mode.growth_per_s for mode in modes if mode.end_n > 0.0), default=None)
    rest_s = window.end_s - window.length_s + max((time_until(mode, window.small_n) for mode in modes), default=0.0)
    rest_from_s = min(rest_s, window.end_s) if size_n <= window.small_n else None
    nothing = size_n <= FLOOR_SHARE * window.unrounded_n / SMALL_SHARE or rate is None
    is_dying, is_large = rate is not None and rate < 0.0, size_n > window.small_n
    cause = Cause.DIES_OUT if is_dying and not nothing else Cause.MOVED if is_large and not nothing else Cause.AT_REST
    decisive_n = 0.0 if nothing else size_n
    return Finding("stable", cause, size_n, rate, decisive_n, rest_from_s=rest_from_s)


def explains(window: Window, hand_force_n: float) -> bool:
    """Return whether no mode bends, and the residual, also in the last quarter, is noise or a small share."""
    fit = window.fit
    for part in (slice(None), slice(-max(2, len(fit.left) // 4), None)):
        moved = rms(centred(fit.motion[part]))
        noise = 1.5 * fit.noise_n
        coloured_n = hand_force_n if fit.whole else 0.0
        seen_n = SURE_ERRORS * (float(np.ptp(fit.motion[part])) + max(noise, ERROR_SHARE * coloured_n))
        left_n = max(
            noise, coloured_share(fit.left) * coloured_n, LEFT_SHARE * moved, LEFT_SHARE**2 * SMALL_SHARE * hand_force_n
        )
        # Large modes that cancel one another are artefacts of the fit.
        if any(mode.end_n > seen_n for mode in fit.modes) or rms(fit.left[part]) > left_n:
            return False
    return leaves_noise(window) or not any(_bends(mode, window) for mode in fit.modes)


def coloured_share(left: Series) -> float:
    """Return the share of the hand's force [1] up to which a residual is noise: smaller if an octave has most of it."""
    power = np.abs(np.fft.rfft(centred(left))) ** 2
    octaves = [float(np.cumsum(power[2**k : 2 ** (k + 1)])[-1]) for k in range(int(math.log2(len(power))))]
    return SMALL_SHARE if max(octaves[:-1], default=0.0) > 0.5 * math.fsum(octaves) else ERROR_SHARE


def cancels(window: Window) -> bool:
    """Return whether two large modes are less than a turn apart, so that one of their growths is not known alone."""
    large = sorted(
        (mode.frequency_hz, SURE_ERRORS * mode.error_per_s * window.length_s)
        for mode in window.fit.modes
        if max(mode.begin_n, mode.end_n) > window.small_n and mode.frequency_hz * window.length_s > LEAST_TURNS
    )
    return any(
        above - below < 1.0 / window.length_s and max(*errors) > LEAST_CHANGE
        for (below, *first), (above, *then) in pairwise(large)
        for errors in [(*first, *then)]
    )


def _bends(mode: Mode, window: Window) -> bool:
    """Return whether the amplitude of a large swing differs in a third from that of its exponential."""
    if mode.frequency_hz * window.length_s < 3.0 * LEAST_TURNS or mode.end_n <= window.small_n:
        return False
    error_n = SURE_ERRORS * rms(window.fit.left) * math.sqrt(12.0 / len(window.fit.left))
    least_n = LEFT_SHARE * max(mode.thirds_n) + error_n
    factor = math.exp(min(max(mode.growth_per_s * window.length_s / 3.0, -50.0), 50.0))
    first_n, middle_n, last_n = mode.thirds_n
    return abs(middle_n - first_n * factor) > least_n or abs(last_n - middle_n * factor) > least_n * max(factor, 1.0)


def leaves_noise(window: Window) -> bool:
    """Return whether the residual is only white noise of the read-out, or a very small part of the motion."""
    moved_n = rms(centred(window.fit.motion[-max(2, len(window.fit.motion) // 4) :]))
    return window.left_n <= max(1.5 * window.noise_n, LEFT_SHARE**2 * moved_n)


def fits_to_the_end(window: Window) -> bool:
    """Return whether the residual of the last quarter is white noise, or small noise without a line."""
    return leaves_noise(window) or (window.fit.whole and window.left_n <= window.unrounded_n)


def modes_near(window: Window, frequency_hz: float, apart_hz: float) -> list[Mode]:
    """Return the modes that are less than apart_hz [Hz] from a frequency [Hz]."""
    return [mode for mode in window.fit.modes if abs(mode.frequency_hz - frequency_hz) < apart_hz]
