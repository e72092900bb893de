"""What becomes of the motion of a loop: does it die out, go on, or grow.

`judge` is given the force at the tip of one episode alone (`telenano.analysis.holds`): contact under a constant force
with the loop closed. It fits the modes of the motion (`telenano.analysis.modes`) to all of it, and where they do not
explain it, to its last half, quarter, and eighth: a blow, a landing and a motion that has reached its size come to be
before that. What no modes explain is judged by how far the force goes in eight windows.

A mode grows, or dies out, where its growth does so by SURE_ERRORS of its standard errors, and changes it by more than
LEAST_CHANGE over the stretch; it goes on where it is sure that it does neither. What is smaller than a twentieth of the
hand's force, and stays so for another such stretch, is rest. What cannot be told is not said, with what would decide.
"""

import math
from itertools import combinations, pairwise
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.modes import LEAST_SAMPLES, Fit, Mode, centred, fitted, noise_floor, rms

Series = npt.NDArray[np.float64]
Kind = Literal["stable", "limit_cycle", "diverged", "contact_lost", "guarded", "no_data", "cannot_say"]

# The thresholds of the verdicts, with those of `telenano.analysis.holds`; docs/studies.md has them in one table.
# share of the hand's greatest force [1]: what moves less from peak to peak is rest, and a force below it presses not
SMALL_SHARE = 0.05
# change of a motion over a stretch [1, logarithm]: half of the 0.3 below which growth cannot be told from decay
LEAST_CHANGE = 0.15
# the same of a motion without a swing [1]: a quarter of a slow swing, and a drift that bends, change by less
ONE_SIDED_CHANGE = 1.5
# standard errors of a growth [1]: chance exceeds them to one side once in 160 times
SURE_ERRORS = 2.5
# turns [1], or times: what is seen less often may be chance
LEAST_TURNS = 2.0
# what an instrument may err by, as a share of the hand's force [1]: drift in a hold, noise, two calibrations, and as a
# share of a hold: samples that it lacks
ERROR_SHARE = 0.1

# what modes may leave of a motion, as a share of its root mean square [1]: the wall of a contact leaves a tenth, and
# the instrument errs by as much
_LEFT_SHARE = 2.0 * ERROR_SHARE
# below this share of the hand's force [1] there are rounding errors
_FLOOR_SHARE = 1e-7
_ON_ITS_WAY = "the force was on its way"
_TAILS = (1.0, 0.5, 0.25, 0.125)
_WINDOWS = 8
# octaves of a spectrum that tell noise from a motion [1]
_OCTAVES = 4
# an octave with more than this of the density of white noise shows another motion [1]
_WHITE_OVER = 3.0
# fall of the density in an octave [1, logarithm] of noise whose density goes with the square of the frequency
_STEEPEST = 2.0 * math.log(2.0)
# chance makes a line over the density of noise, of its neighbours in the octave, less than once in e to this
_LINE_NATS = 7.0


class Verdict(NamedTuple):
    """What becomes of a motion.

    growth_per_s: of the mode that decides [1/s], None where nothing moves; peak_to_peak_n: of the motion that decides,
    at its end, without noise [N]; noise_n: standard deviation of the read-out's noise [N]; reason: the verdict in
    words; rest_from_s: from when on the force is at rest, None if it never is [s].
    """

    kind: Kind
    growth_per_s: float | None
    peak_to_peak_n: float
    noise_n: float
    reason: str
    rest_from_s: float | None = None


def judge(
    time_s: Series, force_n: Series, hand_force_n: float, rest_n: float | None = None, step_n: float | None = None
) -> Verdict:
    """Judge the motion of an episode.

    Args:
        time_s: The times of the samples [s], shape (n,), rising.
        force_n: alpha_f F_s at those times [N], shape (n,).
        hand_force_n: What is large beside it [N], > 0: the hand's greatest force.
        rest_n: The force that the law rests at [N], None if it does not say: an approach to it is one.
        step_n: The step of a read-out that rounds [N], as `rounding_of` finds it in the whole recording, 0 of one that
            does not; None finds it in the episode, where a motion between two values looks the same.

    Raises:
        ValueError: The hand's force is not positive.
    """
    if not hand_force_n > 0.0:
        raise ValueError(f"the hand's force in a hold is {hand_force_n} N, it must be > 0 N")
    finite = np.isfinite(force_n)
    size = float(np.ptp(force_n[finite])) if finite.any() else 0.0
    if not finite.all():
        return Verdict("diverged", None, size, 0.0, "the force is no number from some time on")
    if len(time_s) < LEAST_SAMPLES:
        words = f"{len(time_s)} samples were taken of it: {LEAST_SAMPLES} or more would decide"
        return Verdict("cannot_say", None, size, 0.0, words)
    values, period_s = _even(time_s, force_n)
    step = rounding_of(values) if step_n is None else step_n
    # one step of a read-out that rounds is no motion
    small, floor = max(SMALL_SHARE * hand_force_n, 1.5 * step), _FLOOR_SHARE * hand_force_n
    noise = noise_of(values, step)
    if noise > ERROR_SHARE * max(hand_force_n, float(np.ptp(values))):
        words = f"noise of {noise:.2g} N hides what moves: a read-out with less than {ERROR_SHARE * hand_force_n:.2g} N"
        return Verdict("cannot_say", None, 0.0, noise, f"{words} would decide")
    swings: list[Mode] = []
    doubt: Verdict | None = None
    for share in _TAILS:
        tail = values[len(values) - round(share * len(values)) :]
        if len(tail) < LEAST_SAMPLES:
            break
        fit = fitted(tail, period_s, floor)
        if share == 1.0:
            lasts = -LEAST_CHANGE / (period_s * len(tail))
            swings = [one for one in fit.modes if one.end_n > small and one.frequency_hz and one.growth_per_s > lasts]
        if _explains(fit, hand_force_n):
            least = (small, 1.5 * step, SMALL_SHARE * hand_force_n)
            ends_s = (period_s * len(tail), float(time_s[-1]))
            verdict = _by_modes(fit, ends_s, least, tail, noise)
            if verdict.kind == "stable" and not fit.modes and (gone_n := _gone(tail)) > ERROR_SHARE * hand_force_n:
                # that is no swing and no exponential, more than an instrument drifts, and does not come to rest
                words = f"{_ON_ITS_WAY}, {gone_n:.3g} N: a hold of {4.0 * ends_s[0]:.2g} s or more would decide"
                verdict = verdict._replace(kind="cannot_say", reason=words)
            if verdict.kind == "cannot_say" and rest_n is not None:
                verdict = _approaching(verdict, tail, rest_n)
            # a part in which a swing of the whole turns less than twice shows no rest of it
            hidden = any(mode.frequency_hz * period_s * len(tail) < LEAST_TURNS for mode in swings)
            if verdict.kind == "stable" and share < 1.0 and (hidden or _recurs(_sizes(values, noise), small)):
                break
            if verdict.kind != "cannot_say" and (doubt is None or _is_at_rest(verdict, doubt, fit)):
                return verdict
            doubt = doubt or verdict
            if doubt.reason.startswith(_ON_ITS_WAY):
                break
    if doubt is not None:
        return doubt
    if len(values) < _WINDOWS**2:
        words = f"{len(values)} samples were taken of a motion of {float(np.ptp(values)):.2g} N"
        return Verdict("cannot_say", None, float(np.ptp(values)), noise, f"{words}: a longer hold would decide")
    return _by_windows(values, period_s, noise, small, float(time_s[-1]))


def _is_at_rest(verdict: Verdict, doubt: Verdict, fit: Fit) -> bool:
    """Return whether a last part is at rest that would show a motion of the size that was in doubt."""
    shown_n = 2.0 * SURE_ERRORS * math.sqrt(2.0 / len(fit.left)) * rms(fit.left)
    return verdict.kind == "stable" and verdict.rest_from_s is not None and doubt.peak_to_peak_n > shown_n


def _explains(fit: Fit, hand_force_n: float) -> bool:
    """Return whether modes leave of the whole motion, and of its last quarter, noise alone or a small share."""
    for part in (slice(None), slice(-max(2, len(fit.left) // 4), None)):
        moved = rms(centred(fit.motion[part]))
        noise = max(1.5 * fit.noise_n, ERROR_SHARE * hand_force_n if fit.whole else 0.0)
        seen_n = SURE_ERRORS * (float(np.ptp(fit.motion[part])) + noise)
        left_n = max(noise, _LEFT_SHARE * moved, _LEFT_SHARE**2 * SMALL_SHARE * hand_force_n)
        # large modes that cancel are no motion
        if any(mode.end_n > seen_n for mode in fit.modes) or rms(fit.left[part]) > left_n:
            return False
    return True


def _by_modes(
    fit: Fit,
    stretch_s: tuple[float, float],
    least_n: tuple[float, float, float],
    values: Series,
    noise_n: float,
) -> Verdict:
    """Judge by the modes of a stretch [s] that they explain.

    stretch_s: its length and its end [s]; least_n: what is small, what rounding makes, and what is small without
    rounding [N].
    """
    length_s, end_s = stretch_s
    small_n, rounded_n, unrounded_n = least_n
    growing: list[Mode] = []
    lasting: list[Mode] = []
    unsure: list[Mode] = []
    left: list[Mode] = []
    left_n = rms(fit.left[-max(2, len(fit.left) // 4) :])
    for mode in fit.modes:
        if not fit.whole and mode.end_n < 2.0 * math.sqrt(2.0) * left_n:
            # below what the fit leaves it is a part of a motion that is no sum of exponentials
            left.append(mode)
            continue
        change, error = mode.growth_per_s * length_s, SURE_ERRORS * mode.error_per_s * length_s
        # of a growth there is to see what is over what is left
        seen = math.log(max(mode.end_n / max(SURE_ERRORS * left_n, 1e-300), 1.0))
        cycles = mode.frequency_hz * length_s * (min(seen / change, 1.0) if change > seen else 1.0)
        is_swing = cycles >= 0.5
        if 0.0 < mode.frequency_hz * length_s < 0.5:
            # less than half a swing looks like an exponential: what counts is how far it goes in either half
            change, error = 2.0 * math.log(max(mode.end_n, 1e-300) / max(mode.begin_n, 1e-300)), 0.0
        # of a swing that is seen once the growth has to be as clear on either side
        least = LEAST_CHANGE if cycles >= LEAST_TURNS else ONE_SIDED_CHANGE * (2.0 if is_swing else 1.0)
        falls_by = LEAST_CHANGE if is_swing or not mode.frequency_hz else ONE_SIDED_CHANGE
        if change - error > least:
            # A growth is seen over the residue, and from each part to the next if it turns often enough.
            rises = seen > least and (cycles < LEAST_TURNS or _rises(fit, mode, change))
            # what has been seen for two swings is said to go on for a stretch more
            own = values[-max(2, math.ceil(len(values) * min(1.0, max(cycles, 1.0) / change))) :]
            # in the time of its growth, or of a turn that is seen, it goes as far as more than half of what it is
            end_n = min(mode.end_n, 2.0 * float(np.ptp(own)))
            reaches = end_n * (math.exp(min(change, 50.0)) if cycles >= LEAST_TURNS else 1.0) > small_n
            is_seen = rises and reaches and end_n > max(2.0 * SURE_ERRORS * left_n, rounded_n)
            # what may only just be seen is not said to be at rest
            is_near = end_n > small_n or (rises and reaches and is_swing and end_n > rounded_n)
            (growing if is_seen else unsure if is_near else left).append(mode)
        elif change + (error if error > LEAST_CHANGE else 0.0) < -falls_by:
            left.append(mode)
        elif (
            cycles >= LEAST_TURNS
            and abs(change) + error + rounded_n / mode.end_n / 3.0 < 2.0 * LEAST_CHANGE
            and -change < max(error, _LEFT_SHARE * LEAST_CHANGE)
        ):
            # friction makes of one swing that dies out a swing that does, less one that stays
            falls = all(after < before * math.exp(-LEAST_CHANGE) for before, after in pairwise(mode.thirds_n))
            stays = mode.end_n > small_n and not falls
            (lasting if stays else unsure if mode.end_n > unrounded_n else left).append(mode)
        else:
            drifts = not is_swing and max(mode.begin_n, mode.end_n) < ERROR_SHARE * small_n / SMALL_SHARE
            # a swing within a step of the read-out may grow or die out unseen
            within_n = unrounded_n if cycles >= LEAST_TURNS else small_n
            is_over = is_swing or change < -2.0 * ONE_SIDED_CHANGE
            is_small = drifts or max(mode.end_n, 0.0 if is_over else mode.begin_n) <= within_n
            (left if is_small else unsure).append(mode)
    size = max((mode.end_n for mode in fit.modes), default=0.0)
    most_n = max((mode.end_n for mode in lasting), default=0.0)
    if growing and max(mode.end_n for mode in growing) >= most_n:
        mode = max(growing, key=lambda one: one.end_n)
        words = f"a motion of {_words(mode, length_s)} grows by {mode.growth_per_s:.3g}/s"
        return Verdict("diverged", mode.growth_per_s, mode.end_n, noise_n, words)
    if lasting:
        mode = max(lasting, key=lambda one: one.end_n)
        # harmonics make the motion another than its largest mode
        cycle = math.ceil(len(values) / (length_s * min(one.frequency_hz for one in lasting)))
        size = _moved(values[-cycle:], noise_n)
        size = size if size > 0.5 * mode.end_n else mode.end_n
        words = f"a motion of {size:.3g} N from peak to peak at {mode.frequency_hz:.3g} Hz neither grows nor dies out"
        return Verdict("limit_cycle", mode.growth_per_s, size, noise_n, words)
    if unsure:
        mode = max(unsure, key=lambda one: one.end_n)
        return Verdict("cannot_say", mode.growth_per_s, size, noise_n, _undecided(mode, length_s, fit))
    rate = max((mode.growth_per_s for mode in left if mode.end_n > 0.0), default=None)
    rest_s = end_s - length_s + max((_until(mode, small_n) for mode in left), default=0.0)
    rest_from_s = min(rest_s, end_s) if size <= small_n else None
    words = f"at rest but for {size:.2g} N from peak to peak"
    if size <= _FLOOR_SHARE * small_n / SMALL_SHARE or rate is None:
        words = "at rest"
    elif rate < 0.0:
        words = f"the motion dies out by {-rate:.3g}/s{_left(size)}"
    elif size > small_n:
        words = f"nothing swings, and the force moves by {size:.2g} N to one side"
    return Verdict("stable", rate, size, noise_n, words, rest_from_s)


def _rises(fit: Fit, mode: Mode, change: float) -> bool:
    """Return whether a line grows from each third of a stretch to the next by half of what its fit says."""
    least_n = max(SURE_ERRORS * rms(fit.left) * math.sqrt(12.0 / len(fit.left)), _LEFT_SHARE**2 * mode.thirds_n[-1])
    factor = math.exp(change / 6.0)
    return all(after >= before * factor or before <= least_n for before, after in pairwise(mode.thirds_n))


def _until(mode: Mode, small_n: float) -> float:
    """Return after which time a mode that dies out is small [s]."""
    if mode.growth_per_s >= 0.0 or mode.begin_n <= small_n:
        return 0.0
    return math.log(mode.begin_n / small_n) / -mode.growth_per_s


def _left(size_n: float) -> str:
    return f", {size_n:.2g} N are left" if size_n >= 1e-6 else ""


def _words(mode: Mode, length_s: float) -> str:
    swings = mode.frequency_hz * length_s >= 0.5
    return f"{mode.end_n:.3g} N" + (f" from peak to peak at {mode.frequency_hz:.3g} Hz" if swings else " to one side")


def _undecided(mode: Mode, length_s: float, fit: Fit) -> str:
    """Return what is not known of a mode, and what would decide it."""
    cycles = mode.frequency_hz * length_s
    if cycles < 1.0:
        need = 2.0 / mode.frequency_hz if cycles >= 0.25 else 4.0 * length_s
        return f"{_ON_ITS_WAY}, {mode.end_n:.3g} N: a hold of {need:.2g} s or more would decide"
    noise = f" or noise of less than {fit.noise_n / 2.0:.2g} N" if fit.noise_n > 0.1 * mode.end_n else ""
    words = f"a motion of {_words(mode, length_s)} changes by {mode.growth_per_s:.2g} ± {mode.error_per_s:.2g}/s"
    return f"{words}: a hold of {2.0 * length_s:.2g} s or more{noise} would decide"


def _by_windows(values: Series, period_s: float, noise_n: float, small: float, end_s: float) -> Verdict:
    """Judge a motion that no modes explain by how far the force goes in eight windows."""
    sizes = _sizes(values, noise_n)
    window_s = period_s * len(values) / _WINDOWS
    rises = [
        (math.log(max(sizes[j], 1e-9 * small) / max(sizes[i], 1e-9 * small)), j - i)
        for i, j in combinations(range(2, _WINDOWS), 2)
    ]
    slope = float(np.median([rise / apart for rise, apart in rises]))
    steps = list(pairwise(sizes[_WINDOWS // 2 :]))
    grows, falls = all(after > before for before, after in steps), all(after < before for before, after in steps)
    size, rate = sizes[-1], slope / window_s
    if max(sizes[-2:]) > small and _falls_as_noise(values, noise_n):
        size = max(sizes)
        words = f"a motion of {size:.3g} N from peak to peak has no line and falls with the frequency as 1/f noise does"
        return Verdict("cannot_say", rate, size, noise_n, f"{words}: a read-out and a hand with less would decide")
    if grows and slope * _WINDOWS > LEAST_CHANGE and size * math.exp(min(slope * _WINDOWS, 50.0)) > small:
        words = f"a motion of {size:.3g} N from peak to peak grows by {rate:.3g}/s"
        return Verdict("diverged", rate, size, noise_n, words)
    if max(sizes[-2:]) <= small and not _recurs(sizes, small):
        last = max((k for k, own in enumerate(sizes) if own > small), default=-1)
        rest = end_s - (_WINDOWS - 1 - last) * window_s
        return Verdict("stable", rate, size, noise_n, f"at rest but for {size:.2g} N from peak to peak", rest)
    if falls and slope * _WINDOWS < -LEAST_CHANGE:
        return Verdict("stable", rate, size, noise_n, f"the motion dies out by {-rate:.3g}/s{_left(size)}")
    size = max(sizes[_WINDOWS // 2 :])
    words = f"a motion of {size:.3g} N from peak to peak continues irregularly"
    # what goes on is of one size, or comes again and again
    if min(sizes[_WINDOWS // 2 :]) < 0.5 * size and not _recurs(sizes, small):
        return Verdict("cannot_say", rate, size, noise_n, f"{words}: a longer hold would decide")
    return Verdict("limit_cycle", rate, size, noise_n, words)


def rounding_of(values: Series) -> float:
    """Return the step of a read-out that rounds [N]; 0 of one that does not."""
    steps = np.abs(np.diff(values))
    moved = steps[steps > 0.0]
    return float(moved.min()) if len(moved) and len(np.unique(values)) < len(values) / 4 else 0.0


def _approaching(verdict: Verdict, values: Series, rest_n: float) -> Verdict:
    """Return a verdict that cannot say where the force goes, which is stable if it goes to the rest of the law."""
    part = max(1, len(values) // 20)
    off_n = [abs(float(np.cumsum(own)[-1]) / part - rest_n) for own in (values[:part], values[-part:])]
    if not verdict.reason.startswith(_ON_ITS_WAY) or off_n[1] > off_n[0] * math.exp(-2.0 * LEAST_CHANGE):
        return verdict
    return verdict._replace(kind="stable", reason=f"the force goes to the rest of the law, {off_n[1]:.2g} N are left")


def _sizes(values: Series, noise_n: float) -> list[float]:
    """Return how far the force goes in each of eight windows [N]."""
    edges = np.linspace(0, len(values), _WINDOWS + 1).astype(int)
    return [_moved(values[first:last], noise_n) for first, last in pairwise(edges)]


def _gone(values: Series) -> float:
    """Return how far the force goes [N] from eighth to eighth, if it goes farther in the later half; otherwise 0."""
    part = max(1, len(values) // _WINDOWS)
    middle = (len(values) - part) // 2
    first, then, last = (float(np.cumsum(values[k : k + part])[-1]) / part for k in (0, middle, len(values) - part))
    return abs(last - first) if (last - then) * (last - first) > 0.5 * (last - first) ** 2 else 0.0


def _falls_as_noise(values: Series, noise_n: float) -> bool:
    """Return whether the density of a motion falls from octave to octave as 1/f noise does, and no line stands out.

    A cycle has a line, and one that is irregular has a band; the density of noise is greatest where it begins. It may
    come to the white noise of the read-out.
    """
    count = len(values)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count)
    power = np.abs(np.fft.rfft(centred(values) * window)) ** 2 / float(np.cumsum(window * window)[-1])
    octaves = [power[2**k : 2 ** (k + 1)] for k in range(1, int(math.log2(len(power))))]
    # of the white part the density is the variance
    above = [own for own in octaves if float(own.mean()) > _WHITE_OVER * noise_n * noise_n]
    if len(above) < _OCTAVES or len(above) != len(octaves[: len(above)]):
        return False
    levels = [math.log(float(own.mean())) for own in above]
    steps = [before - after for before, after in pairwise(levels)]
    # the logarithms of the means of n and 2 n neighbours under this window differ by so much, by chance
    errors = [SURE_ERRORS * math.sqrt(3.0 / (len(own) - 0.5)) for own in above]
    falls = all(-error < step < _STEEPEST + error for step, error in zip(steps, errors, strict=False))
    slope = (levels[0] - levels[-1]) / (len(levels) - 1)
    return bool(falls and 0.25 * _STEEPEST < slope < _STEEPEST and not any(map(_has_line, above)))


def _has_line(power: Series) -> bool:
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


def _recurs(sizes: list[float], small_n: float) -> bool:
    """Return whether a motion began at least twice after a rest, as a cycle of snaps does, and a landing does not."""
    return sum(before <= small_n and after > 2.0 * small_n for before, after in pairwise(sizes)) >= LEAST_TURNS


def _moved(values: Series, noise_n: float) -> float:
    """Return how far a force goes [N], less what white noise of as many samples reaches once in a thousand times."""
    return max(float(np.ptp(values)) - 2.0 * reach_of(noise_n, len(values)), 0.0)


def reach_of(noise_n: float, count: int) -> float:
    """Return what white noise of a standard deviation [N] reaches to one side in a number of samples [N]."""
    return noise_n * (math.sqrt(2.0 * math.log(max(count, 2))) + 1.0)


def noise_of(values: Series, step_n: float) -> float:
    """Return the standard deviation of the noise of a read-out [N], of which a step that it rounds to is a part."""
    return max(noise_floor(values) if len(values) >= LEAST_SAMPLES else 0.0, step_n / math.sqrt(12.0))


def _even(time_s: Series, force_n: Series) -> tuple[Series, float]:
    """Return the force on an even grid of as many samples, and its period [s]; messages come when they come."""
    grid = np.linspace(time_s[0], time_s[-1], len(time_s))
    period_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if float(np.abs(time_s - grid).max()) <= 1e-6 * period_s:
        return np.asarray(force_n, dtype=np.float64), period_s
    return np.interp(grid, time_s, force_n), period_s
