"""Modes of a stretch of a force: a least-squares fit of exponentials, each with its growth and the error of that.

The motion of a linear loop is a constant, a drift, and a sum of e^(g t) (a cos w t + b sin w t). Modes are added one
after the other: each new mode starts where a search over growths and frequencies explains most of the residual, and
then all modes are fitted at once (Gauss-Newton with the linear part eliminated; G. Golub, V. Pereyra, SIAM J. Numer.
Anal. 10, 1973). A mode is accepted if it explains more than the largest line that white noise would show. So two lines
that beat are two modes, and a swing that is longer than the stretch is a mode like any other.

The standard error of a growth is the larger of two: that of white residuals, and that of residuals that are correlated
within a 24th of the stretch (the sandwich estimator of H. White, Econometrica 48, 1980, by blocks). So noise that is
not white, and a motion that is not a sum of exponentials, increase the error.

Long series are averaged over neighbours first, which keeps an exponential exponential. The linear algebra is written
out and sums follow the order of time, so that no result depends on the kernel that a library chooses for a processor.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

# numbers of samples to which a series is averaged, or up to twice as many [1]; the first that keeps its motion is used
_MOST_SAMPLES = (384, 1536)
# least number of samples to distinguish a mode from the constant and the drift, each of which has one unknown [1]
LEAST_SAMPLES = 16
_MOST_MODES = 4
_BLOCKS = 24
# growths at which a mode is searched [1/length of the series]
_GROWTHS = (0.0, -1.0, 1.0, -3.0, 3.0, -8.0, 8.0, -20.0, 20.0, -50.0, 50.0)
# power of a line over that of noise [1]: white noise has a line of 20 times its mean once in 5e8
LINE_OVER_NOISE = 20.0
_STEPS = 14
# share of a motion below which modes may be artefacts of a fit that has not fully converged [1]
_RESIDUE = 1e-3
# A swing that turns by less in its stretch may be an exponential [rad].
_REAL_TURN = math.pi
# Lines closer than three turns in the stretch cannot be separated in a third of it [rad].
_SEPARABLE_PHASE = 6.0 * math.pi
# lowest bin whose octave has enough bins for a median [1]
_LEAST_BIN = 4.0
# greatest growth, or decay, in a fit [1/length of the series]
_MOST_GROWTH = 400.0


class Mode(NamedTuple):
    """One exponential of the motion: frequency [Hz], growth [1/s] and its standard error [1/s], size [N].

    thirds_n: the amplitude at its frequency in each third of the stretch, without other lines [N]. begin_n and end_n:
    its peak-to-peak size at either end of the stretch [N]; for a mode of less than half a turn in the stretch, its
    range in either half. course: the mode itself in the samples of the fit [N], shape (m,).
    """

    frequency_hz: float
    growth_per_s: float
    error_per_s: float
    begin_n: float
    end_n: float
    thirds_n: tuple[float, ...]
    course: Series


class Fit(NamedTuple):
    """The modes of a stretch, and the residual of their fit.

    rest_n: the constant of the fit, at which its motion would end [N]; left: the residual, averaged like the motion
    [N], shape (m,); motion: the motion that is fitted, without its constant [N], shape (m,); noise_n: the standard
    deviation of white noise in both [N]; whole: whether no line stands out of the noise in the residual.
    """

    modes: list[Mode]
    rest_n: float
    left: Series
    motion: Series
    noise_n: float
    whole: bool


def rms(values: Series) -> float:
    """Return the root mean square, summed in the order of the samples."""
    return math.sqrt(_total(values * values) / max(1, len(values)))


def centred(values: Series) -> Series:
    """Return a series without its mean, which is summed in the order of the samples; shape (n,), n >= 1."""
    return values - _total(values) / len(values)


def noise_floor(values: Series) -> float:
    """Return the standard deviation of white noise in a series that is smooth except for bursts or lines.

    The series has shape (n,), n >= 16. The result is the smaller of two estimates: from the median of the third
    differences, which bursts do not raise, and from the median of the upper half of the spectrum, which lines do not.
    """
    third = np.abs(np.diff(values, 3))
    in_time = float(np.median(third)) / 0.6745 / math.sqrt(20.0)
    if in_time == 0.0:
        return 0.0
    count = len(values)
    bare = values - np.interp(np.arange(count), [0, count - 1], [values[0], values[-1]])
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count)
    power = np.abs(np.fft.rfft(bare * window)) ** 2 / _total(window * window)
    return min(in_time, math.sqrt(float(np.median(power[len(power) // 2 :])) / math.log(2.0)))


def averaged(values: Series) -> tuple[Series, int]:
    """Return a series averaged over blocks of neighbours, and the samples per block; the last block ends the series.

    The series is returned unchanged, with 1, if averaging would remove more than noise, or it is short.
    """
    noise = noise_floor(values)
    for most in _MOST_SAMPLES:
        block = len(values) // most
        if block < 2:
            continue
        whole = values[len(values) % block :].reshape(-1, block)
        means = whole[:, 0].copy()
        for column in whole.T[1:]:
            means = means + column
        means = means / block
        slow = np.interp(np.arange(whole.size), np.arange(len(means)) * block + 0.5 * (block - 1), means)
        if rms(whole.ravel() - slow) <= 1.5 * noise + 0.03 * rms(means - means[0]):
            return means, block
    return values, 1


def fitted(values: Series, period_s: float, floor_n: float) -> Fit:
    """Fit the modes of a series that is sampled every period_s [s].

    Args:
        values: The samples [N], shape (n,), n >= LEAST_SAMPLES.
        period_s: The time between two samples [s].
        floor_n: The amplitude below which nothing is a motion [N].
    """
    means, block = averaged(values)
    noise = noise_floor(means)
    times = np.arange(len(means)) / (len(means) - 1.0)
    length_s = period_s * block * (len(means) - 1)
    bare = means - means[-1]
    scale = float(np.abs(bare).max())
    if scale <= floor_n:
        return Fit([], float(means[-1]), bare, bare, noise, True)
    bare = bare / scale
    state = _solve(times, bare, [])
    motion = scale * state.left
    floor = max(floor_n, _RESIDUE * rms(motion)) / scale
    whole = False
    while len(state.poles) < _MOST_MODES:
        strongest = _strongest(times, state.left)
        # A slow swing is searched from several starts.
        growth, turn = strongest
        starts = [strongest] if turn > 2.0 * math.pi else [strongest, (0.0, 1.5), (0.0, 4.5), (growth, turn + 1.5)]
        start = min(starts, key=lambda one: _solve(times, bare, [*state.poles, one]).power)
        more = _refined(times, bare, [*state.poles, start])
        for place, (growth, turn) in enumerate(more.poles):
            if 0.0 < turn < _REAL_TURN:
                # Less than half a swing is mostly an exponential, which has two unknowns less.
                real = _refined(times, bare, [*more.poles[:place], (growth, 0.0), *more.poles[place + 1 :]])
                level = max(line_level(more.left, turn, not state.poles), floor**2, more.mean)
                more = real if real.power - more.power < 2.0 * LINE_OVER_NOISE * level else more
        level = max(line_level(more.left, more.poles[-1][1], not state.poles), floor**2)
        if state.power - more.power < 2.0 * LINE_OVER_NOISE * level or state.rms <= floor:
            whole = True
            break
        state = more
    rest_n = scale * state.weights[0] + float(means[-1])
    return Fit(_modes(times, bare, state, length_s, scale), rest_n, scale * state.left, motion, noise, whole)


def line_level(left: Series, turn: float, alone: bool) -> float:
    """Return the power by which a line at a turn [rad in the stretch] is measured; for white noise, its variance.

    An octave of few bins has little power by chance, but noise has no less at a low frequency than at a higher one. So
    the level is no less than the median of all bins, and for a line that is alone than that of an octave above. Beside
    other modes, an octave above may have the power of their motion.
    """
    medians = _medians(left, turn)
    return _at_turn(max(medians) if alone else max(medians[0], medians[-1]), medians[-1], turn)


def _level(left: Series, turn: float) -> float:
    """Return the power of a line of noise at a turn [rad in the stretch]; for white noise, this is its variance."""
    medians = _medians(left, turn)
    return _at_turn(medians[0], medians[-1], turn)


def _at_turn(median: float, white: float, turn: float) -> float:
    """Return the mean power at a turn [rad in the stretch] from the median of an octave and that of white noise.

    Below the fourth bin it continues as 1/f if the noise rises towards low frequencies.
    """
    rise = _LEAST_BIN / max(turn / (2.0 * math.pi), 0.5)
    return median / math.log(2.0) * max(1.0, min(rise, median / max(white, 1e-300)))


def _medians(left: Series, turn: float) -> list[float]:
    """Return the median of the power about a turn [rad in the stretch], of each octave above, and of all lines.

    Lines do not raise medians.
    """
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(len(left)) + 0.5) / len(left))
    power = np.abs(np.fft.rfft(left * window)) ** 2 / _total(window * window)
    first = min(max(turn / (2.0 * math.pi), _LEAST_BIN), len(power) / 1.5)
    middles = [first * 2.0**k for k in range(1 + int(math.log2(len(power) / 1.4 / first)))]
    octaves = [power[int(middle / math.sqrt(2.0)) : int(middle * math.sqrt(2.0)) + 2] for middle in middles]
    return [float(np.median(own)) for own in [*octaves, power]]


class _State(NamedTuple):
    """Growth and turn [rad] of each pole over the stretch, the weights of the columns, and their residual."""

    poles: list[tuple[float, float]]
    weights: list[float]
    left: Series

    @property
    def power(self) -> float:
        return _total(self.left * self.left)

    @property
    def mean(self) -> float:
        return self.power / len(self.left)

    @property
    def rms(self) -> float:
        return math.sqrt(self.mean)


def _total(values: Series) -> float:
    """Return the sum in the order of the samples, which is the same on every processor."""
    return float(np.cumsum(values)[-1]) if len(values) else 0.0


def _pair(times: Series, growth: float, turn: float) -> tuple[Series, Series, Series]:
    """Return e^(g t) cos w t, e^(g t) sin w t / min(w, 1), and the time t, which counts from the end where g > 0."""
    since = times - 1.0 if growth > 0.0 else times
    swell = np.exp(np.maximum(growth * since, -700.0))
    return swell * np.cos(turn * since), swell * np.sin(turn * since) / max(min(turn, 1.0), 1e-9), since


def _columns(times: Series, poles: list[tuple[float, float]]) -> list[Series]:
    """Return the constant column, and the columns of each pole: two, or one if its turn is 0."""
    columns = [np.ones_like(times)]
    for growth, turn in poles:
        columns += _pair(times, growth, turn)[: 2 if turn else 1]
    return columns


def _tangents(times: Series, state: _State) -> list[Series]:
    """Return the derivatives of the fit by the growth of each pole, and by its turn unless that is 0."""
    tangents: list[Series] = []
    place = 1
    for growth, turn in state.poles:
        cosine, sine, since = _pair(times, growth, turn)
        a = state.weights[place]
        if not turn:
            tangents.append(a * since * cosine)
            place += 1
            continue
        b, slow = state.weights[place + 1], min(turn, 1.0)
        turned = since * cosine if turn >= 1.0 else (since * cosine - sine) / turn
        tangents += [since * (a * cosine + b * sine), b * turned - a * slow * since * sine]
        place += 2
    return tangents


def _normal(columns: list[Series]) -> list[list[float]]:
    matrix = [[0.0] * len(columns) for _ in columns]
    for i, first in enumerate(columns):
        for j in range(i, len(columns)):
            matrix[i][j] = matrix[j][i] = _total(first * columns[j])
    return matrix


def _solve(times: Series, values: Series, poles: list[tuple[float, float]]) -> _State:
    """Return the least-squares weights of given poles, and the residual."""
    columns = _columns(times, poles)
    amplitudes = solved(_normal(columns), [[_total(column * values)] for column in columns])
    left = values
    for (weight,), column in zip(amplitudes, columns, strict=True):
        left = left - weight * column
    return _State(poles, [row[0] for row in amplitudes], left)


def solved(matrix: list[list[float]], right: list[list[float]]) -> list[list[float]]:
    """Return the solution of a small symmetric system by elimination with pivots; its diagonal is raised by 1e-12."""
    n = len(matrix)
    rows = [[*matrix[i], *right[i]] for i in range(n)]
    for i in range(n):
        rows[i][i] += 1e-12 * matrix[i][i] + 1e-280
    for i in range(n):
        pivot = max(range(i, n), key=lambda k: abs(rows[k][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for k in range(n):
            if k != i and rows[k][i] != 0.0:
                share = rows[k][i] / rows[i][i]
                rows[k] = [a - share * b for a, b in zip(rows[k], rows[i], strict=True)]
    return [[value / rows[i][i] for value in rows[i][n:]] for i in range(n)]


def _strongest(times: Series, left: Series) -> tuple[float, float]:
    """Return growth and turn of the mode that explains most of the residual, on a grid of half a cycle."""
    best, peak = -1.0, (0.0, 0.0)
    count = len(left)
    for growth in _GROWTHS:
        since = times - 1.0 if growth > 0.0 else times
        swell = np.exp(np.maximum(growth * since, -700.0))
        power = np.abs(np.fft.rfft(left * swell, 2 * count)) ** 2 / _total(swell * swell)
        index = int(np.argmax(power[:count]))
        if power[index] > best:
            best, peak = float(power[index]), (growth, math.pi * index * (count - 1.0) / count)
    return peak


def _refined(times: Series, values: Series, poles: list[tuple[float, float]], held: int = -1) -> _State:
    """Return the fit with all poles moved to the least residual (Levenberg-Marquardt).

    The growth of the pole at index `held`, if any, is kept.
    """
    state, damping = _solve(times, values, poles), 1e-4
    for _ in range(_STEPS):
        columns = _columns(times, state.poles)
        first = len(columns)
        columns += _tangents(times, state)
        matrix = _normal(columns)
        for i in range(len(columns)):
            matrix[i][i] *= 1.0 + damping
        step = iter(solved(matrix, [[_total(column * state.left)] for column in columns])[first:])
        tried = []
        for place, (growth, turn) in enumerate(state.poles):
            move = next(step)[0]
            if place != held:
                growth = min(max(growth + min(max(move, -5.0), 5.0), -_MOST_GROWTH), _MOST_GROWTH)
            tried.append((growth, abs(turn + min(max(next(step)[0], -3.0), 3.0)) + 1e-9 if turn else 0.0))
        after = _solve(times, values, tried)
        if not after.power < state.power:
            damping *= 30.0
            if damping > 1e3:
                break
            continue
        gained = state.power - after.power
        state, damping = after, max(0.1 * damping, 1e-7)
        if gained <= 1e-5 * state.power:
            break
    return state


def amplitude(times: Series, values: Series, growth: float, turn: float) -> float:
    """Return the amplitude of a pole's swing in the middle of a part of the stretch, fitted beside a constant."""
    cosine, sine, _ = _pair(times - 0.5 * float(times[0] + times[-1]), 0.0, max(turn, 1.0))
    swell = np.exp(growth * (times - 0.5 * float(times[0] + times[-1])))
    columns = [np.ones_like(times), swell * cosine, swell * sine]
    amplitudes = solved(_normal(columns), [[_total(column * values)] for column in columns])
    return math.hypot(amplitudes[1][0], amplitudes[2][0])


def _modes(times: Series, values: Series, state: _State, length_s: float, scale: float) -> list[Mode]:
    """Return the poles as modes in SI units, each with the standard error of its growth."""
    columns = _columns(times, state.poles)
    lines, place = [], 1
    for _, turn in state.poles:
        line = state.weights[place] * columns[place]
        lines.append(line + state.weights[place + 1] * columns[place + 1] if turn else line)
        place += 2 if turn else 1
    place, of_growth = 1, len(columns)
    columns += _tangents(times, state)
    n = len(columns)
    inverse = solved(_normal(columns), [[float(i == j) for j in range(n)] for i in range(n)])
    power = state.power / max(1, len(times) - n)
    # contribution of each block of the residual to the gradient by the unknowns
    edges = np.linspace(0, len(times), _BLOCKS + 1).astype(int)
    sums = [np.concatenate([[0.0], np.cumsum(column * state.left)])[edges].tolist() for column in columns]
    modes = []
    for number, (growth, turn) in enumerate(state.poles):
        row = inverse[of_growth]
        pulls = [sum(w * (own[b + 1] - own[b]) for w, own in zip(row, sums, strict=True)) for b in range(_BLOCKS)]
        alike = math.sqrt(sum(pull * pull for pull in pulls) * _BLOCKS / (_BLOCKS - 1.0))
        white = math.sqrt(max(row[of_growth], 1e-300) * power)
        error = max(alike, math.sqrt(max(row[of_growth], 0.0) * max(power, _level(state.left, turn))))
        if 2.0 * error < abs(growth) < 8.0 * error or growth < -1.0 < 0.0 < growth + 8.0 * error:
            # A growth far from 0 is surer than its standard error states: see how much the residual grows without it.
            without = _refined(
                times, values, [(0.0, t) if k == number else (g, t) for k, (g, t) in enumerate(state.poles)], number
            )
            surely = math.sqrt(max(without.power - state.power, 0.0) / max(power, 1e-300)) * white / error
            error = min(error, abs(growth) / max(surely, 1e-9))
        size = abs(state.weights[place])
        if turn:
            size = 2.0 * math.hypot(size, state.weights[place + 1] / min(turn, 1.0))
        shrunk = size * math.exp(-abs(growth))
        begin, end = (shrunk, size) if growth > 0.0 else (size, shrunk)
        if turn < _REAL_TURN:
            # The size at either end is the range in that half, or, if larger, the distance from the mode's own rest
            # there, but no more than the range in the whole stretch.
            cosine, sine, _ = _pair(np.linspace(0.0, 1.0, 33), growth, turn)
            course = state.weights[place] * cosine + (state.weights[place + 1] * sine if turn else 0.0)
            way = float(np.ptp(course))
            begin = max(float(np.ptp(course[:17])), min(abs(float(course[0])), way))
            end = max(float(np.ptp(course[16:])), min(abs(float(course[-1])), way))
            if not turn and growth < 0.0:
                end = min(abs(float(course[-1])), way)
        frequency_hz = turn / (2.0 * math.pi * length_s)
        # Lines that a third of the stretch cannot separate from the mode count as part of it.
        own = state.left
        for (_, other), line in zip(state.poles, lines, strict=True):
            own = own + line if abs(other - turn) < _SEPARABLE_PHASE else own
        edges = np.linspace(0, len(times), 4).astype(int).tolist()
        thirds = tuple(scale * amplitude(times[i:j], own[i:j], growth, turn) for i, j in pairwise(edges))
        sizes = (scale * begin, scale * end, thirds, scale * lines[number])
        modes.append(Mode(frequency_hz, growth / length_s, error / length_s, *sizes))
        place, of_growth = place + (2 if turn else 1), of_growth + (2 if turn else 1)
    return modes
