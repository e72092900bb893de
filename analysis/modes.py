"""The modes of a hold: sums of exponentials fitted by a matrix pencil, each with its growth rate and how sure it is.

While a loop is linear its motion is a sum of c e^((g + 2 pi i f) t). The hold is looked at through narrow bands: one
around zero frequency and one around each of the strongest lines of its spectrum. A band is shifted to zero, filtered
and thinned to about BLOCKS complex samples, which are again a sum of a few exponentials. Their poles follow from the
rotational invariance of the signal subspace of the Hankel matrix (Hua and Sarkar, IEEE Trans. Acoustics, Speech, and
Signal Processing 38, 1990; R. Roy and T. Kailath, the same 37, 1989). So two lines that beat are two poles, and a
swing that is longer than the hold is a pole like any other.

White noise of the read-out is estimated from the data. The order of a fit is the lowest that leaves no more than noise,
and the standard error of a growth rate is that of the Cramer-Rao bound for what the fit leaves.

The linear algebra is written out (Jacobi rotations, Gauss elimination, sums in the order of time): no result depends on
which kernel a library chooses for a processor.
"""

import cmath
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

# A band is thinned to so many samples, and the Hankel matrix has so many columns.
BLOCKS = 32
_COLUMNS = 10
LEAST_SAMPLES = 2 * (BLOCKS + 5)
_MOST_POLES = 4
_MOST_LINES = 4
# a bin of the spectrum of white noise exceeds 20 times its mean once in 5e8
_LINE_OVER_NOISE = 20.0
# poles in the outer half of a band are those of a neighbour, or of noise
_BAND = 0.25
# Three moving averages leave noise that is alike in neighbouring samples, so that averaging reduces it less.
_CORRELATION = 1.8
# A fit explains a motion of which it leaves no more than this share.
_LEFT_SHARE = 0.1
# A band lets through this share of a line outside of it.
_LEAK = 1e-2
# least distance of two lines, and of a line from zero, whose band reaches to BAND * BLOCKS [1/length of the hold]
_LINE_CYCLES = 6.0


class Mode(NamedTuple):
    """One exponential of the motion: frequency [Hz], growth [1/s] and its standard error, size when the hold ends [N].

    end_n is half of what the motion is from peak to peak; of one without frequency, how far it has still to go, or
    has gone in the hold if that is less. explained: whether the fit that it belongs to leaves little but noise;
    explained_late: whether it does so in the later half of the hold as well, where a motion that grows is largest.
    """

    frequency_hz: float
    growth_per_s: float
    error_per_s: float
    end_n: float
    explained: bool
    explained_late: bool


class _Fit(NamedTuple):
    poles: list[complex]
    weights: list[complex]
    left: float
    size: float
    late_share: float


def _total(values: npt.NDArray[np.number]) -> complex:
    """Return the sum in the order of the samples, whatever the processor."""
    return complex(np.cumsum(values)[-1]) if len(values) else 0.0j


def noise_floor(values: Series) -> float:
    """Return the standard deviation of white noise in a series that is otherwise smooth, in bursts or in lines.

    The lesser of two estimates: the median of the third differences, which bursts do not raise, and the median of the
    upper half of the spectrum, which lines do not raise. Shape (n,), n >= 16.
    """
    third = np.abs(np.diff(values, 3))
    in_time = float(np.median(third)) / 0.6745 / math.sqrt(20.0)
    if in_time == 0.0:
        return 0.0
    power = spectrum(values)
    in_frequency = math.sqrt(float(np.median(power[len(power) // 2 :])) / math.log(2.0))
    return min(in_time, in_frequency)


def spectrum(values: Series) -> Series:
    """Return the periodogram of a series less its straight line, scaled so that white noise has its variance."""
    times = np.arange(len(values)) - 0.5 * (len(values) - 1)
    slope = (_total(times * values) / _total(times * times)).real
    bare = values - slope * times
    bare = bare - _total(bare).real / len(values)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(len(values)) + 0.5) / len(values))
    power = np.abs(np.fft.rfft(bare * window)) ** 2
    return np.asarray(power / float(_total(window * window).real), dtype=np.float64)


def lines(values: Series, noise_n: float, floor_n: float) -> list[int]:
    """Return the bins of the strongest lines that stand out of noise, outside of the band about zero."""
    power = spectrum(values)
    least = max(_LINE_OVER_NOISE * noise_n * noise_n, 0.25 * len(values) * floor_n * floor_n)
    top = (power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:]) & (power[1:-1] > least)
    bins = 1 + np.flatnonzero(top)
    found: list[int] = []
    for index in bins[np.argsort(-power[bins], kind="stable")]:
        if index >= _LINE_CYCLES and all(abs(index - other) >= _LINE_CYCLES for other in found):
            found.append(int(index))
        if len(found) == _MOST_LINES:
            break
    return found


def modes_of(values: Series, period_s: float, noise_n: float, floor_n: float) -> list[Mode]:
    """Return the modes of a hold sampled every period_s [s] that stand out of noise [N] and floor [N].

    Args:
        values: The samples of the hold [N], shape (n,), n >= LEAST_SAMPLES.
        period_s: The time between two samples [s].
        noise_n: The standard deviation of white noise [N].
        floor_n: The amplitude below which a mode does not count [N].
    """
    length_s = len(values) * period_s
    found = _slow_modes(values, period_s, noise_n, floor_n)
    bare = values - _total(values).real / len(values)
    for index in lines(values, noise_n, floor_n):
        found += _line_modes(bare, index / length_s, period_s, noise_n, floor_n)
    most = max((mode.end_n for mode in found), default=0.0)
    return [mode for mode in found if mode.end_n > _LEAK * most]


def _thinned(values: npt.NDArray[np.number], block: int) -> Complex:
    """Return a series after three moving averages, one sample a block, the last of them at its end."""
    for _ in range(3):
        sums = np.cumsum(values)
        values = np.concatenate([sums[block - 1 : block], sums[block:] - sums[:-block]]) / block
    return np.asarray(values[(len(values) - 1) % block :: block], dtype=np.complex128)


def _slow_modes(values: Series, period_s: float, noise_n: float, floor_n: float) -> list[Mode]:
    """Fit the steps between the samples of the band about zero: what stands still has none."""
    block = len(values) // (BLOCKS + 5)
    steps = np.diff(_thinned(values, block))
    noise = noise_n * _noise_passed(block) * math.sqrt(2.0)
    if float(np.abs(steps).max()) <= max(4.0 * noise, floor_n):
        return []
    fit = _fitted(steps, noise)
    found = []
    for pole, weight in zip(fit.poles, fit.weights, strict=True):
        if pole == 0.0 or pole.imag < 0.0 or abs(cmath.phase(pole)) > 2.0 * math.pi * _BAND:
            continue
        # Each step is (z - 1) times the motion itself.
        gain = min(1.0 / max(abs(pole - 1.0), 1e-12), BLOCKS)
        size = abs(weight) * (2.0 if pole.imag > 0.0 else 1.0)
        mode = _mode(fit, pole, size, 0.0, block * period_s, gain)
        # a swing of which the hold has less than two cycles is hard to tell from a drift that bends
        cycles = mode.frequency_hz * len(values) * period_s
        unsure = max(1.0, 2.0 / cycles) ** 2 if cycles > 0.0 else 1.0
        found.append(mode._replace(error_per_s=min(unsure, 100.0) * mode.error_per_s))
    least = max(2.0 * noise, floor_n)
    return [mode for mode in found if mode.end_n > least]


def _noise_passed(block: int) -> float:
    """Return the share of the standard deviation of white noise that three moving averages pass."""
    # the third power of a box of n: variance 11/20n for large n
    return 1.0 if block == 1 else math.sqrt(0.55 / block)


def _line_modes(values: Series, frequency_hz: float, period_s: float, noise_n: float, floor_n: float) -> list[Mode]:
    """Fit the complex envelope of a line: shifted to zero, filtered, thinned."""
    block = max(1, len(values) // (BLOCKS + 4))
    turns = frequency_hz * period_s * np.arange(len(values))
    envelope = _thinned(values * np.exp(-2j * np.pi * turns), block)
    noise = noise_n * _noise_passed(block)
    if float(np.abs(envelope).max()) <= max(3.0 * noise, floor_n):
        return []
    fit = _fitted(envelope, noise)
    step_s = block * period_s
    found = []
    for pole, weight in zip(fit.poles, fit.weights, strict=True):
        turned = cmath.phase(pole) / (2.0 * math.pi) if pole != 0.0 else 1.0
        if abs(turned) > _BAND or frequency_hz + turned / step_s <= 0.0:
            continue
        found.append(_mode(fit, pole, 2.0 * abs(weight), frequency_hz, step_s, 1.0))
    least = max(3.0 * noise, floor_n)
    return [mode for mode in found if mode.end_n > least]


def _mode(fit: _Fit, pole: complex, size: float, frequency_hz: float, step_s: float, gain: float) -> Mode:
    growth, turned = math.log(abs(pole)) / step_s, cmath.phase(pole) / (2.0 * math.pi)
    steps = BLOCKS - 1
    # the averages pass less at the edges of the band, and their middle is a block and a half before the end
    end = gain * size / float(np.sinc(turned)) ** 3 * _power(abs(pole), steps + 1.5)
    rms = size * math.sqrt(sum(_power(abs(pole), 2.0 * k) for k in range(BLOCKS)) / BLOCKS)
    error = _CORRELATION * math.sqrt(6.0 / BLOCKS) * fit.left / (max(rms, 1e-300) * BLOCKS * step_s)
    explained, late = fit.left <= _LEFT_SHARE * fit.size, fit.late_share <= _LEFT_SHARE
    return Mode(abs(frequency_hz + turned / step_s), growth, error, end, explained, late)


def _power(base: float, exponent: float) -> float:
    return math.exp(min(max(exponent * math.log(base), -700.0), 700.0))


def _fitted(samples: Complex, noise: float) -> _Fit:
    """Fit the lowest number of exponentials that leaves no more than noise, BLOCKS samples from the end backwards."""
    samples = samples[-BLOCKS:]
    size = _rms(samples)
    vectors = _signal_vectors(samples)
    best = _Fit([], [], size, size, 1.0)
    for order in range(1, _MOST_POLES + 1):
        poles = _poles(vectors[:order])
        weights = _weights(samples, poles)
        if weights is None:
            break
        times = np.arange(len(samples))
        rest = samples.copy()
        for weight, pole in zip(weights, poles, strict=True):
            rest -= weight * pole**times
        left = _rms(rest)
        if left < 0.7 * best.left:
            late = slice(len(samples) // 2, None)
            best = _Fit(poles, weights, left, size, _rms(rest[late]) / max(_rms(samples[late]), 1e-300))
        if left <= 1.5 * noise + 1e-4 * size:
            break
    return best


def _rms(samples: Complex) -> float:
    return math.sqrt(_total((samples * samples.conj()).real).real / len(samples))


def _signal_vectors(samples: Complex) -> list[list[complex]]:
    """Return the eigenvectors of the Hankel matrix's Gram matrix, that of the largest eigenvalue first."""
    n, rows = _COLUMNS, len(samples) - _COLUMNS + 1
    gram = [[0.0j] * n for _ in range(n)]
    for i in range(n):
        for j in range(i, n):
            gram[i][j] = _total(samples[i : i + rows] * samples[j : j + rows].conj())
            gram[j][i] = gram[i][j].conjugate()
    values, vectors = _jacobi(gram)
    order = sorted(range(n), key=lambda k: -values[k])
    return [[vectors[i][k] for i in range(n)] for k in order]


def _jacobi(matrix: list[list[complex]]) -> tuple[list[float], list[list[complex]]]:
    """Return eigenvalues and eigenvectors (columns) of a Hermitian matrix by cyclic Jacobi rotations."""
    n = len(matrix)
    vectors = [[1.0 + 0.0j if i == j else 0.0j for j in range(n)] for i in range(n)]
    scale = max(abs(matrix[i][i]) for i in range(n)) or 1.0
    for _ in range(12):
        off = 0.0
        for p in range(n - 1):
            for q in range(p + 1, n):
                a = abs(matrix[p][q])
                off = max(off, a)
                if a <= 1e-17 * scale:
                    continue
                turn = matrix[p][q] / a
                theta = (matrix[q][q].real - matrix[p][p].real) / (2.0 * a)
                t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                back = turn.conjugate()
                for k in range(n):
                    x, y = matrix[k][p], matrix[k][q]
                    matrix[k][p], matrix[k][q] = c * x - s * back * y, s * turn * x + c * y
                    x, y = vectors[k][p], vectors[k][q]
                    vectors[k][p], vectors[k][q] = c * x - s * back * y, s * turn * x + c * y
                for k in range(n):
                    x, y = matrix[p][k], matrix[q][k]
                    matrix[p][k], matrix[q][k] = c * x - s * turn * y, s * back * x + c * y
        if off <= 1e-15 * scale:
            break
    return [matrix[i][i].real for i in range(n)], vectors


def _solved(matrix: list[list[complex]], right: list[list[complex]]) -> list[list[complex]] | None:
    """Return the solution of a small linear system by elimination with pivots; None where it has none."""
    n = len(matrix)
    rows = [[*matrix[i], *right[i]] for i in range(n)]
    for i in range(n):
        pivot = max(range(i, n), key=lambda k: abs(rows[k][i]))
        if abs(rows[pivot][i]) < 1e-300:
            return None
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for k in range(n):
            if k != i:
                share = rows[k][i] / rows[i][i]
                rows[k] = [a - share * b for a, b in zip(rows[k], rows[i], strict=True)]
    return [[value / rows[i][i] for value in rows[i][n:]] for i in range(n)]


def _poles(vectors: list[list[complex]]) -> list[complex]:
    """Return the eigenvalues of the matrix that turns the upper rows of the signal subspace into the lower ones."""
    order, last = len(vectors), _COLUMNS - 1

    def product(shift: int) -> list[list[complex]]:
        return [[sum((a[k].conjugate() * b[k + shift] for k in range(last)), 0.0j) for b in vectors] for a in vectors]

    turn = _solved(product(0), product(1))
    return _eigenvalues(turn) if turn is not None else [0.0j] * order


def _eigenvalues(matrix: list[list[complex]]) -> list[complex]:
    """Return the eigenvalues of a small matrix: Faddeev and LeVerrier's polynomial, Durand and Kerner's roots."""
    n = len(matrix)
    coefficients, current = [1.0 + 0.0j], [[0.0j] * n for _ in range(n)]
    for k in range(1, n + 1):
        for i in range(n):
            current[i][i] += coefficients[-1]
        current = [[sum((matrix[i][m] * current[m][j] for m in range(n)), 0.0j) for j in range(n)] for i in range(n)]
        coefficients.append(-sum((current[i][i] for i in range(n)), 0.0j) / k)
    radius = 1.0 + max(abs(c) for c in coefficients[1:])
    roots = [radius * cmath.exp(2j * math.pi * (k + 0.3) / n) for k in range(n)]
    for _ in range(200):
        change = 0.0
        for i in range(n):
            value, below = 1.0 + 0.0j, 1.0 + 0.0j
            for c in coefficients[1:]:
                value = value * roots[i] + c
            for j in range(n):
                below *= roots[i] - roots[j] if j != i else 1.0
            step = value / below if below != 0.0 else 0.0j
            roots[i] -= step
            change = max(change, abs(step))
        if change < 1e-15 * radius:
            break
    return roots


def _weights(samples: Complex, poles: list[complex]) -> list[complex] | None:
    """Return the least-squares weights of exponentials; None where two of them are one."""
    if any(not 1e-6 < abs(pole) < 1e6 for pole in poles):
        return None
    times = np.arange(len(samples))
    # scaled to 1 at their greatest, so that fast growth does not drown the rest
    scales = [max(1.0, abs(pole) ** (len(samples) - 1)) for pole in poles]
    columns = [pole**times / scale for pole, scale in zip(poles, scales, strict=True)]
    gram = [[_total(a.conj() * b) for b in columns] for a in columns]
    right = [[_total(a.conj() * samples)] for a in columns]
    found = _solved(gram, right)
    return [row[0] / scale for row, scale in zip(found, scales, strict=True)] if found is not None else None
