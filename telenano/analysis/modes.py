"""Modes of a stretch of a force: a least-squares fit of exponentials, each with its growth and the error of that.

They are fitted where a motion turns too seldom for the sizes of its parts to be compared, goes one way, or is a sum of
lines that beat. Modes are added one after the other: each starts where a search over growths and frequencies explains
most of the residual, and then all are fitted at once (Gauss-Newton with the linear part eliminated; G. Golub, V.
Pereyra, SIAM J. Numer. Anal. 10, 1973). A mode is accepted if it explains more than the largest line of the noise.

The standard error of a growth is the larger of two: that of white residuals, and that of residuals that are correlated
within a 24th of the stretch (the sandwich estimator of H. White, Econometrica 48, 1980, by blocks). The linear algebra
is written out and sums follow the order of time, so that no result depends on the kernel that a library chooses for a
processor.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.read_out import centred, rms, total
from telenano.analysis.verdict_thresholds import LINE_OVER_NOISE

Series = npt.NDArray[np.float64]

MOST_MODES = 3
_BLOCKS = 24
# growths at which a mode is searched [1/length of the series]
_GROWTHS = (0.0, -1.0, 1.0, -3.0, 3.0, -8.0, 8.0, -20.0, 20.0)
_STEPS = 12
# share of a motion below which modes may be artefacts of a fit that has not fully converged [1]
_RESIDUE = 1e-3
# A swing that turns by less in its stretch may be an exponential [rad].
_REAL_TURN = math.pi
# greatest growth, or decay, in a fit [1/length of the series]
_MOST_GROWTH = 400.0


class Mode(NamedTuple):
    """One exponential of the motion: frequency [Hz], growth [1/s] and its standard error [1/s], size [N].

    begin_n and end_n: its peak-to-peak size at either end of the stretch [N]; for a mode of less than half a turn in
    the stretch, its range in either half.
    """

    frequency_hz: float
    growth_per_s: float
    error_per_s: float
    begin_n: float
    end_n: float


class Fit(NamedTuple):
    """The modes of a stretch, its length [s], the residual of their fit and the motion that is fitted [N], (m,)."""

    modes: list[Mode]
    length_s: float
    left: Series
    moved: Series

    def turns(self, mode: Mode) -> float:
        """Return how often a mode turns in the stretch."""
        return mode.frequency_hz * self.length_s


def averaged(values: Series, most: int) -> tuple[Series, int]:
    """Return means over blocks of neighbours, at least `most` of them, and the samples per block."""
    block = max(1, len(values) // most)
    whole = values[len(values) % block :].reshape(-1, block)
    means = whole[:, 0].copy()
    for column in whole.T[1:]:
        means = means + column
    return means / block, block


def fitted(means: Series, period_s: float, floor_n: float, noise_n: float) -> Fit:
    """Fit the modes of a series that is sampled every period_s [s].

    Args:
        means: The samples [N], shape (m,), m >= LEAST_SAMPLES.
        period_s: The time between two samples [s].
        floor_n: The amplitude below which nothing is a motion [N].
        noise_n: The standard deviation of white noise that has the density of the read-out's slowest noise [N].
    """
    times = np.arange(len(means)) / (len(means) - 1.0)
    length_s = period_s * (len(means) - 1)
    bare = means - means[-1]
    scale = float(np.abs(bare).max())
    if scale <= floor_n:
        return Fit([], length_s, bare, bare)
    bare = bare / scale
    state = _solve(times, bare, [])
    moved = scale * state.left
    floor = max(floor_n, _RESIDUE * rms(moved)) / scale
    while len(state.poles) < MOST_MODES and state.rms > floor:
        strongest = _strongest(times, state.left)
        # A slow swing is searched from several starts.
        growth, turn = strongest
        starts = [strongest] if turn > 2.0 * math.pi else [strongest, (0.0, 1.5), (0.0, 4.5), (growth, turn + 1.5)]
        start = min(starts, key=lambda one: _solve(times, bare, [*state.poles, one]).power)
        more = _refined(times, bare, [*state.poles, start])
        level = max(_level(more.left), (noise_n / scale) ** 2, floor**2)
        for place, (growth, turn) in enumerate(more.poles):
            if 0.0 < turn < _REAL_TURN:
                # Less than half a swing is mostly an exponential, which has two unknowns less.
                real = _refined(times, bare, [*more.poles[:place], (growth, 0.0), *more.poles[place + 1 :]])
                more = real if real.power - more.power < 2.0 * LINE_OVER_NOISE * max(level, more.mean) else more
        if state.power - more.power < 2.0 * LINE_OVER_NOISE * level:
            break
        state = more
    return Fit(_modes(times, state, length_s, scale), length_s, scale * state.left, moved)


def _level(left: Series) -> float:
    """Return the power of a line of white noise in what a fit leaves, by the median, which lines do not raise."""
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(len(left)) + 0.5) / len(left))
    power = np.abs(np.fft.rfft(centred(left) * window)) ** 2 / total(window * window)
    return float(np.median(power)) / math.log(2.0)


class _State(NamedTuple):
    """Growth and turn [rad] of each pole over the stretch, the weights of the columns, and their residual."""

    poles: list[tuple[float, float]]
    weights: list[float]
    left: Series

    @property
    def power(self) -> float:
        return total(self.left * self.left)

    @property
    def mean(self) -> float:
        return self.power / len(self.left)

    @property
    def rms(self) -> float:
        return math.sqrt(self.mean)


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
            matrix[i][j] = matrix[j][i] = total(first * columns[j])
    return matrix


def _solve(times: Series, values: Series, poles: list[tuple[float, float]]) -> _State:
    """Return the least-squares weights of given poles, and the residual."""
    columns = _columns(times, poles)
    amplitudes = solved(_normal(columns), [[total(column * values)] for column in columns])
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
        power = np.abs(np.fft.rfft(left * swell, 2 * count)) ** 2 / total(swell * swell)
        index = int(np.argmax(power[:count]))
        if power[index] > best:
            best, peak = float(power[index]), (growth, math.pi * index * (count - 1.0) / count)
    return peak


def _refined(times: Series, values: Series, poles: list[tuple[float, float]]) -> _State:
    """Return the fit with all poles moved to the least residual (Levenberg-Marquardt)."""
    state, damping = _solve(times, values, poles), 1e-4
    for _ in range(_STEPS):
        columns = _columns(times, state.poles)
        first = len(columns)
        columns += _tangents(times, state)
        matrix = _normal(columns)
        for i in range(len(columns)):
            matrix[i][i] *= 1.0 + damping
        step = iter(solved(matrix, [[total(column * state.left)] for column in columns])[first:])
        tried = []
        for growth, turn in state.poles:
            growth += min(max(next(step)[0], -5.0), 5.0)
            growth = min(max(growth, -_MOST_GROWTH), _MOST_GROWTH)
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


def _modes(times: Series, state: _State, length_s: float, scale: float) -> list[Mode]:
    """Return the poles as modes in SI units, each with the standard error of its growth."""
    columns = _columns(times, state.poles)
    place, of_growth = 1, len(columns)
    columns += _tangents(times, state)
    n = len(columns)
    inverse = solved(_normal(columns), [[float(i == j) for j in range(n)] for i in range(n)])
    power = max(state.power / max(1, len(times) - n), _level(state.left))
    # contribution of each block of the residual to the gradient by the unknowns
    edges = np.linspace(0, len(times), _BLOCKS + 1).astype(int)
    sums = [np.concatenate([[0.0], np.cumsum(column * state.left)])[edges].tolist() for column in columns]
    modes = []
    for growth, turn in state.poles:
        row = inverse[of_growth]
        pulls = [sum(w * (own[b + 1] - own[b]) for w, own in zip(row, sums, strict=True)) for b in range(_BLOCKS)]
        alike = math.sqrt(sum(pull * pull for pull in pulls) * _BLOCKS / (_BLOCKS - 1.0))
        error = max(alike, math.sqrt(max(row[of_growth], 0.0) * power))
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
        modes.append(
            Mode(turn / (2.0 * math.pi * length_s), growth / length_s, error / length_s, scale * begin, scale * end)
        )
        place, of_growth = place + (2 if turn else 1), of_growth + (2 if turn else 1)
    return modes
