"""The resonance of a cantilever in thermal noise: its spectral density as sampled, and its fit by Whittle's likelihood.

A damped spring in white noise has the covariance (G. E. Uhlenbeck, L. S. Ornstein, Phys. Rev. 36 (1930) 823)

    R(t) = s^2 exp(-g |t|) (cos wd t + g / wd sin wd |t|),    g = w0 / 2Q,    wd = w0 sqrt(1 - 1 / 4Q^2),

and samples of it have the density of the sum over R at the sampling times, a geometric series, in which aliasing is
counted. White noise of the read-out adds a floor. The periodogram of a long record has lines that are independent and
exponentially distributed about the density (P. Whittle, Ark. Mat. 2 (1953) 423), so that

    sum over lines of I / S + log S

is least at the parameters, and the inverse of their Fisher information is their covariance.

A line of a measured spectrum is the mean of periodograms of segments, and so that of the density about it, by the
kernel of the window: with c(t) the autocorrelation of the window, c(0) = 1, it is the spectrum of R(t) c(t). Where the
peak is but a few lines wide that is far from the density at the line. The windows that are tried then are the
rectangle, whose c falls evenly to 0 over the segment, and Hann's; the likelihood decides.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Of the resonance: drift is below, and what the sampling takes is above.
BAND = (0.1, 3.0)
# the least Q of a spring that swings, and the greatest that is looked for
QUALITIES = (0.5, 1e7)
_MOST_STEPS, _ENOUGH = 60, 1e-7
_DIFFERENCE = 1e-5
# Windows count where the peak has fewer lines within the width at half its height.
_FEW_LINES = 2.0
# A window spreads the area of a peak and leaves it as it is, so that a fit of another area took wings for the peak.
_SAME_AREA = math.log(1.5)
# Each line of a window is a fit for itself; Q is what a broadened peak tells least of.
_STARTS_OF_Q = (1.0, 4.0, 16.0)
# The standard error of log s^2 is smaller than this, or the fit tells nothing.
_KNOWN_TO = 1.0
_TURN = 2.0 * math.pi
Shape = Callable[[float, float, float], Array]


class Resonance(NamedTuple):
    """Mean square s^2 [m^2], resonance f0 [Hz], Q, one-sided floor [m^2/Hz], and the standard error of log s^2.

    covariance: of log s^2, log f0 and log Q, shape (3, 3).
    """

    mean_square_m2: float
    resonance_hz: float
    quality: float
    floor_m2_per_hz: float
    share: float
    covariance: Array


def density(frequency_hz: Array, rate_hz: float, mean_square: float, resonance_hz: float, quality: float) -> Array:
    """Return the one-sided density [m^2/Hz] of samples at a rate [Hz] of a spring with mean square s^2 [m^2]."""
    omega, dt = 2.0 * math.pi * resonance_hz, 1.0 / rate_hz
    damping = omega / (2.0 * quality)
    swing = omega * math.sqrt(max(1.0 - 0.25 / quality**2, 1e-12))
    pole = np.exp(complex(-damping, swing) * dt)
    turn = pole * np.exp(2j * math.pi * dt * frequency_hz)
    back = pole * np.exp(-2j * math.pi * dt * frequency_hz)
    series = complex(1.0, -damping / swing) * (turn / (1.0 - turn) + back / (1.0 - back))
    return np.asarray(2.0 * dt * mean_square * (1.0 + series.real))


def periodogram(values_m: Array, rate_hz: float) -> tuple[Array, Array]:
    """Return the lines [Hz] of a record at a rate [Hz], and its one-sided density there [m^2/Hz]."""
    count = len(values_m)
    frequency = np.asarray(np.fft.rfftfreq(count, 1.0 / rate_hz), dtype=np.float64)
    power = np.abs(np.fft.rfft(values_m - values_m.mean())) ** 2 * (2.0 / (rate_hz * count))
    return frequency, power


def fit_spectrum(
    frequency_hz: Array,
    power: Array,
    rate_hz: float,
    resonance_hz: float,
    quality: float,
    mean_square: float,
    averages: float = 1.0,
) -> Resonance:
    """Fit the resonance to a one-sided spectrum, whose lines are means of some periodograms.

    Args:
        frequency_hz: The lines [Hz], shape (n,).
        power: The density there [m^2/Hz], shape (n,).
        rate_hz: The rate at which the deflection was sampled [Hz].
        resonance_hz: The resonance, near which it is looked for [Hz].
        quality: Q, near which it is looked for.
        mean_square: The mean square of the motion, where the search begins [m^2].
        averages: How many periodograms each line is the mean of.

    Raises:
        ValueError: The fit ends at a bound, which the message names, the peak has too few lines, or the mean square
            is not known to a factor of e.
    """
    low, high = BAND[0] * resonance_hz, min(BAND[1] * resonance_hz, 0.45 * rate_hz)
    chosen = (frequency_hz > low) & (frequency_hz < high)
    power, lines = power[chosen], frequency_hz[chosen]
    starts = [(mean_square, resonance_hz, quality * times) for times in _STARTS_OF_Q]
    fits = [_fit(partial(density, lines, rate_hz), power, starts[0])]
    spacing = float(np.median(np.diff(frequency_hz)))
    places = np.rint(lines / spacing).astype(int)
    is_even = np.abs(lines - places * spacing).max() < 0.1 * spacing
    if is_even and fits[0].place[1] - math.log(_FEW_LINES * spacing) < fits[0].place[2]:
        count = round(rate_hz / spacing)
        for kernel in (
            1.0 - np.arange(count) / count,
            _autocorrelation(0.5 - 0.5 * np.cos(_TURN / count * np.arange(count))),
        ):
            shape = partial(_seen_through, kernel, places, rate_hz)
            fits += [_fit(shape, power, start) for start in starts]
        fits = [one for one in fits if one.has_area_of(power, spacing)]
        if not fits:
            raise ValueError(
                f"no resonance has the area of the peak, which has too few lines {spacing:.4g} Hz apart: take a finer "
                "spectrum, or --record"
            )
    _, free, information, unit = min(fits, key=lambda fit: fit.cost)
    s2, f0, q = np.exp(free[:3]).tolist()
    for name, value, bounds, form in (
        ("resonance", f0, (low, high), "{:.6g} Hz"),
        ("Q", q, QUALITIES, "{:g}"),
    ):
        for bound in bounds:
            if abs(math.log(value / bound)) < 1e-3 or not bounds[0] < value < bounds[1]:
                raise ValueError(f"the fit of the resonance ends at the bound of its {name}, {form.format(bound)}")
    covariance = _inverse(information)[:3, :3] / averages
    # Where the lines hardly tell, rounding decides where the search ends.
    if not 0.0 < covariance[0, 0] < _KNOWN_TO**2:
        raise ValueError(
            f"no resonance is known from these lines: the mean square near {f0:.6g} Hz has a standard error of more"
            " than a factor of e; a tone of the electronics has such a peak"
        )
    return Resonance(s2, f0, q, max(float(free[3]) * unit, 0.0), math.sqrt(float(covariance[0, 0])), covariance)


class _Fit(NamedTuple):
    """The least cost, where it is (log s^2, log f0, log Q, floor in units), the information there, and the unit."""

    cost: float
    place: Array
    information: Array
    unit: float

    def has_area_of(self, power: Array, spacing: float) -> bool:
        """Whether its mean square is the area of lines above its floor."""
        area = spacing * float((power - self.place[3] * self.unit).sum())
        return area > 0.0 and abs(float(self.place[0]) - math.log(area)) < _SAME_AREA


def _fit(shape: Shape, power: Array, start: tuple[float, float, float]) -> _Fit:
    # all in units of order one: log s^2, log f0, log Q, floor in the mean density of the band
    unit = float(power.mean())
    free = np.append(np.log(np.array(start)), 1e-3)

    def logs(point: Array) -> Array:
        s2, f0, q = np.exp(np.clip(point[:3], -200.0, 200.0)).tolist()
        total = shape(s2, f0, q) + point[3] * unit
        return np.log(np.where(total > 0.0, total, np.nan))

    def cost(log_density: Array) -> float:
        found = float((power * np.exp(-log_density) + log_density).sum())
        return found if math.isfinite(found) else math.inf

    present = logs(free)
    least = cost(present)
    information = np.eye(4)
    for _ in range(_MOST_STEPS):
        slopes = np.empty((4, len(power)))
        for i in range(4):
            step = np.zeros(4)
            step[i] = _DIFFERENCE
            slopes[i] = (logs(free + step) - present) / _DIFFERENCE
        information = slopes @ slopes.T
        try:
            move = np.linalg.solve(information, slopes @ (power * np.exp(-present) - 1.0))
        except np.linalg.LinAlgError:
            break
        share = 1.0
        while share > 1e-6:
            after = free + share * move
            after[2] = np.clip(after[2], *np.log(QUALITIES))
            tried = logs(after)
            if cost(tried) <= least:
                break
            share *= 0.5
        else:
            break
        gained, free, present, least = least - cost(tried), after, tried, cost(tried)
        if gained < _ENOUGH:
            break
    return _Fit(least, free, information, unit)


def _inverse(information: Array) -> Array:
    try:
        return np.asarray(np.linalg.inv(information), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(information, np.inf)


def _seen_through(kernel: Array, places: npt.NDArray[np.int_], rate_hz: float, s2: float, f0: float, q: float) -> Array:
    """Return the mean periodogram at lines of a segment, whose window has an autocorrelation, shape (samples,)."""
    omega, dt = 2.0 * math.pi * f0, 1.0 / rate_hz
    damping = omega / (2.0 * q)
    swing = omega * math.sqrt(max(1.0 - 0.25 / q**2, 1e-12))
    steps = np.arange(len(kernel))
    covariance = (complex(1.0, -damping / swing) * np.exp(complex(-damping, swing) * dt * steps)).real
    lines = np.fft.fft(kernel * covariance).real[places % len(kernel)]
    return np.asarray(2.0 * dt * s2 * (2.0 * lines - 1.0))


def _autocorrelation(window: Array) -> Array:
    """Return that of a window for shifts of 0 to its length, in units of that without a shift."""
    spectrum = np.abs(np.fft.rfft(window, 2 * len(window))) ** 2
    found = np.fft.irfft(spectrum)[: len(window)]
    return np.asarray(found / found[0])
