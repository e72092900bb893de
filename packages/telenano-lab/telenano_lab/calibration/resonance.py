"""The resonance of a cantilever in thermal noise: its density as sampled, and its fit by Whittle's likelihood.

A damped spring in white noise has the covariance (G. E. Uhlenbeck, L. S. Ornstein, Phys. Rev. 36 (1930) 823)

    R(t) = s^2 exp(-g |t|) (cos wd t + g / wd sin wd |t|),    g = w0 / 2Q,    wd = w0 sqrt(1 - 1 / 4Q^2),

and its samples have a density that is the sum over R at the sampling times, a geometric series that includes aliasing.
White noise of the read-out adds a floor. The periodogram of a long record has lines that are independent and
exponentially distributed about the density (P. Whittle, Ark. Mat. 2 (1953) 423), so that

    sum over lines of I / S + log S

is least at the parameters, and the inverse of their Fisher information is their covariance.

A line of a measured spectrum is the mean of periodograms of segments, and so sees the density smoothed by the kernel of
the window: with c(t) the autocorrelation of the window, c(0) = 1, it is the spectrum of R(t) c(t). If the peak is only
a few lines wide, this is far from the density at the line. The windows tried are then the rectangle, whose c falls
linearly to 0 over the segment, and Hann's; the likelihood decides.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import signal, special

from telenano.analysis import denied

Array = npt.NDArray[np.float64]

# Bands in units of the resonance; drift lies below, sampling effects above. Narrower ones are for spectra with more.
BANDS = ((0.1, 3.0), (0.4, 1.8), (0.7, 1.4))
# Least and greatest Q that are sought; below one half the spring does not swing.
QUALITIES = (0.15, 1e7)
# Below this Q the band is centred anew on a resonance that is off its begin by more than this difference of logarithms.
_WITHOUT_PEAK, _OFF_CENTRE = 1.5, 0.2
# Below this Q a lever moves its liquid along, which no spring in white noise does; its area then counts. A line counts
# up to this multiple of the fit, and the area may be smaller than that of the fit by this share.
OF_A_LIQUID = 8.0
_MOST_OF_MODEL, _OF_AREA = 5.0, 0.5
# The fit ends after at most this number of steps.
_MOST_STEPS = 60
# The fit has ended when a step lowers its cost, minus the logarithm of the likelihood, by less than this.
_ENOUGH = 1e-7
# The derivatives of the fit are differences over this step of a parameter.
_DIFFERENCE = 1e-5
# The window matters where the peak's width at half height is fewer lines than this.
_FEW_LINES = 2.0
# A window named by the file matters up to this number of its noise bandwidths; without one these windows are tried.
_FEW_LINES_OF_KNOWN = 5.0
_WINDOWS = ("boxcar", "hann")
# A window may have been used as well if its log likelihood is at most this much smaller.
_AS_LIKELY = 4.0
# A peak narrower at half height than this share of the line spacing looks like a tone.
_AS_A_TONE = 0.3
# A window spreads the area of a peak but preserves it; a fit with another area mistook the wings for the peak.
_SAME_AREA = math.log(1.5)
# Factors of the starting Q, of which a broadened peak tells least.
_STARTS_OF_Q = (1.0, 4.0, 16.0)
# A line that thermal noise would reach with less than this probability is not thermal.
NOT_THERMAL = 1e-6
# More rejected lines than this number, and than this share, are not tones.
_MOST_TONES = 40
_MOST_TONE_SHARE = 0.02
_MOST_ROUNDS = 12
_FEWEST_LINES = 16
# Number of parameters of the fit: log s^2, log f0, log Q and the floor.
_PARAMETERS = 4
# The interquartile range estimates the scatter as well as the squares of this share of the lines.
_OF_QUARTILES = 0.37
# Ratio of the averages seen in the scatter to the number of non-overlapping segments, if segments overlap by half.
_OVERLAP = 1.6
# Probabilities of the residuals by noise below which errors are widened, another band is tried, the fit is refused.
WIDENED = 0.05
_DOUBTFUL = 0.01
_IMPOSSIBLE = 1e-5
# Correlation of neighbouring lines above which a window is assumed, and the greatest variance factor of usual windows.
_LEAST_JOINED = 0.15
_MOST_JOINED = 12.0
# Lines farther apart than this are uncorrelated, even if each segment was zero-padded to four times its length.
_FARTHEST_JOINED = 8
# Greatest influence of a single line, in standard errors.
_MOST_INFLUENCE = 4.0
# A narrower band has at least this number of widths of the peak.
_BAND_WIDTHS = 4.0
# The peak extends this number of widths at half height to both sides; it and each side have at most so many blocks.
_PEAK_WIDTHS = 2.0
_BLOCKS = 20
Shape = Callable[[float, float, float], Array]


class Resonance(NamedTuple):
    """Mean square s^2 [m^2], resonance f0 [Hz], Q, one-sided floor [m^2/Hz], and the standard error of log s^2.

    covariance: of log s^2, log f0 and log Q, shape (3, 3). deviance: deviance of the lines relative to noise of
    `averages`. mismatch: mean square of the residuals of blocks of lines, relative to noise; chance: probability of as
    much by noise. tones: number of lines left out as not thermal. influence: shift of log s^2 by the most influential
    line, in standard errors. band_hz: band of the fitted lines. by_window: the part of `share` that comes from not
    knowing the window. lines_across: width of the peak at half height, in lines. by_area: whether the mean square is
    the area of the lines, because no spring has their shape.
    """

    mean_square_m2: float
    resonance_hz: float
    quality: float
    floor_m2_per_hz: float
    share: float
    covariance: Array
    deviance: float
    mismatch: float
    chance: float
    tones: int
    influence: float
    averages: float
    band_hz: tuple[float, float]
    by_window: float = 0.0
    lines_across: float = math.inf
    by_area: bool = False

    @property
    def is_peak(self) -> bool:
        """Whether it is a peak that stands above its floor."""
        return self.quality > _WITHOUT_PEAK and self.height_m2_per_hz > self.floor_m2_per_hz

    @property
    def height_m2_per_hz(self) -> float:
        """The density at the resonance, without the floor [m^2/Hz]."""
        return 2.0 * self.mean_square_m2 * self.quality / (math.pi * self.resonance_hz)


def density(frequency_hz: Array, rate_hz: float, mean_square: float, resonance_hz: float, quality: float) -> Array:
    """Return the one-sided density [m^2/Hz] of a spring sampled at a rate [Hz], with the mean square s^2 [m^2]."""
    dt = 1.0 / rate_hz
    total = np.ones(np.shape(frequency_hz), dtype=complex)
    for pole, share in _poles(resonance_hz, quality):
        kept = np.exp(pole * dt)
        for turn in (np.exp(2j * math.pi * dt * frequency_hz), np.exp(-2j * math.pi * dt * frequency_hz)):
            total += share * kept * turn / (1.0 - kept * turn)
    return np.asarray(2.0 * dt * mean_square * total.real)


def _poles(resonance_hz: float, quality: float) -> tuple[tuple[complex, complex], ...]:
    """Return the two poles [rad/s] of a spring, which are real where it does not swing, and their shares of R(0)."""
    omega = 2.0 * math.pi * resonance_hz
    damping = omega / (2.0 * quality)
    # At Q = 1/2 the poles are equal, and the shares of two that nearly are serve.
    square = 1.0 - 0.25 / quality**2
    swing = 1j * omega * np.sqrt(complex(square if abs(square) > 1e-9 else 1e-9))
    return (-damping + swing, 0.5 * (1.0 + damping / swing)), (-damping - swing, 0.5 * (1.0 - damping / swing))


def periodogram(values_m: Array, rate_hz: float) -> tuple[Array, Array]:
    """Return the lines [Hz] of a record sampled at a rate [Hz], and its one-sided density there [m^2/Hz]."""
    count = len(values_m)
    frequency = np.asarray(np.fft.rfftfreq(count, 1.0 / rate_hz), dtype=np.float64)
    power = np.abs(np.fft.rfft(values_m - values_m.mean())) ** 2 * (2.0 / (rate_hz * count))
    return frequency, power


def fit_spectrum(
    frequency_hz: Array,
    power: Array,
    rate_hz: float,
    starts: Sequence[tuple[float, float, float]],
    averages: float | None = 1.0,
    window: Any = None,
    without_peak: Sequence[tuple[float, float, float]] = (),
) -> Resonance:
    """Fit the resonance to a one-sided spectrum, whose lines are means of some periodograms, and check the fit.

    Lines that are not thermal under the fit are left out, and the others are fitted again until all are thermal. If the
    residuals of the widest band are systematic, narrower bands are tried, because disturbances (drift, other modes) lie
    far from the resonance. A peak in a single line, like that of a tone, is accepted only if no wider one fits as well.

    Args:
        frequency_hz: The lines [Hz], shape (n,), rising.
        power: The density there [m^2/Hz], shape (n,).
        rate_hz: The rate at which the deflection was sampled [Hz].
        starts: Starting values: mean square [m^2], resonance [Hz] and Q each.
        without_peak: Further starting values, which are tried where those before lead to no peak.
        averages: Number of periodograms averaged per line; None estimates it from the scatter of the lines.
        window: That of the segments, as `scipy.signal.get_window` takes it; None tries the rectangle and Hann's.

    Raises:
        ValueError: No fit describes the lines, the fit ends at a bound, the peak has too few lines, or the mean square
            is not known to a factor of e; the message says which and what may be wrong.
    """
    best: Resonance | None = None
    reason: ValueError | None = None
    spacing = float(np.median(np.diff(frequency_hz)))
    for band in BANDS:
        fits: list[Resonance] = [] if best is None else [best]
        for start in [*starts, *without_peak]:
            if start in without_peak and any(one.chance > _DOUBTFUL and one.is_peak for one in fits):
                continue
            try:
                one = _judged_fit(frequency_hz, power, rate_hz, start, averages, band, window)
                if one.quality < _WITHOUT_PEAK and abs(math.log(one.resonance_hz / start[1])) > _OFF_CENTRE:
                    start = (one.mean_square_m2, one.resonance_hz, one.quality)
                    one = _judged_fit(frequency_hz, power, rate_hz, start, averages, band, window)
                fits.append(one)
            except ValueError as error:
                reason = reason or error
        good = [one for one in fits if one.chance > _DOUBTFUL]
        # White noise has one level: a bump on a higher one is a part of what another fit describes as a whole.
        least = min((one.floor_m2_per_hz for one in good), default=0.0)
        good = [one for one in good if one.height_m2_per_hz > min(one.floor_m2_per_hz, 3.0 * least)] or good
        wide = [one for one in good if one.resonance_hz / one.quality > _AS_A_TONE * spacing]
        best = min(wide or good or fits, key=lambda one: one.mismatch, default=None)
        if good:
            break
    if best is None:
        raise reason or ValueError("no resonance is known from these lines")
    if best.chance < _IMPOSSIBLE and best.quality < OF_A_LIQUID:
        return _by_area(best, frequency_hz, power, rate_hz)
    if best.chance < _IMPOSSIBLE:
        raise ValueError(
            f"no resonance describes these lines: near {best.resonance_hz:.6g} Hz the residuals are {best.mismatch:.3g}"
            " times as large as noise makes them. Another mode, drift or electronics may be among the lines (leave them"
            " out by --exclude LOW HIGH), or --averages is too large"
        )
    if best.influence > _MOST_INFLUENCE:
        raise ValueError(
            f"a single line moves the mean square by {best.influence:.2g} of its standard errors: take a finer"
            " spectrum, or leave it out by --exclude LOW HIGH"
        )
    # Residuals in excess of noise widen the errors.
    widened = best.mismatch if best.chance < WIDENED else 1.0
    return best._replace(share=best.share * math.sqrt(widened), covariance=best.covariance * widened)


def _by_area(fit: Resonance, frequency_hz: Array, power: Array, rate_hz: float) -> Resonance:
    """Return a fit whose mean square is the area of the fitted lines above the floor, and the model's beyond them.

    A liquid moves along with a lever, and the more the slower: its spectrum has not the shape of a spring in white
    noise, while its area is k_B T / k for every shape (equipartition). What differs between both areas is in the error.
    """
    inside = (frequency_hz >= fit.band_hz[0]) & (frequency_hz <= fit.band_hz[1])
    lines = frequency_hz[inside]
    model = density(lines, rate_hz, fit.mean_square_m2, fit.resonance_hz, fit.quality)
    left = np.minimum(power[inside] - fit.floor_m2_per_hz, model * _MOST_OF_MODEL) - model
    moved = float(np.sum(left * np.gradient(lines))) / fit.mean_square_m2
    if not moved > -_OF_AREA:
        raise ValueError("no resonance describes these lines, nor does their area tell one")
    share = math.hypot(fit.share * math.sqrt(fit.mismatch), math.log1p(moved))
    return fit._replace(mean_square_m2=fit.mean_square_m2 * (1.0 + moved), share=share, by_area=True)


def _judged_fit(
    frequency_hz: Array,
    power: Array,
    rate_hz: float,
    start: tuple[float, float, float],
    averages: float | None,
    band: tuple[float, float],
    window: Any = None,
) -> Resonance:
    """Fit a band [units of the resonance] without lines that are not thermal, and check its fit to the rest."""
    low, high = band[0] * start[1], min(band[1] * start[1], 0.45 * rate_hz)
    chosen = (frequency_hz > low) & (frequency_hz < high)
    if chosen.sum() < _FEWEST_LINES:
        raise ValueError(
            f"the spectrum has {int(chosen.sum())} lines near {start[1]:.6g} Hz: {_FEWEST_LINES} are needed"
        )
    lines, values = frequency_hz[chosen], power[chosen]
    spacing = float(np.median(np.diff(frequency_hz)))
    kept = values > 0.0
    for _ in range(_MOST_ROUNDS):
        fit, shape, others = _fit_in_band(lines[kept], values[kept], rate_hz, start, spacing, window)
        places = np.rint(lines / spacing).astype(int)
        s2, f0, q = np.exp(np.clip(fit.place[:3], -200.0, 200.0)).tolist()
        if not low < f0 < high or s2 <= 0.0:
            raise ValueError(f"the fit of the resonance ends at the bound of its resonance, {start[1]:.6g} Hz")
        model = shape(lines, places, s2, f0, q) + fit.place[3] * fit.unit
        if not (np.isfinite(model).all() and (model[kept] > 0.0).all()):
            raise ValueError(f"no resonance is known from these lines near {start[1]:.6g} Hz")
        ratio = np.where(model > 0.0, values / np.where(model > 0.0, model, 1.0), 0.0)
        count = averages or _averages_of(ratio[kept])
        thermal = (special.gammaincc(count, count * ratio) > NOT_THERMAL) & (values > 0.0)
        if (thermal == kept).all():
            break
        kept = thermal
        if kept.sum() < _FEWEST_LINES:
            break
    tones = int((~kept & (values > 0.0)).sum())
    if tones > max(_MOST_TONES, _MOST_TONE_SHARE * len(lines)):
        raise ValueError(
            f"{tones} of {len(lines)} lines near {start[1]:.6g} Hz are far above any thermal noise: another mode or the"
            " electronics (leave them out by --exclude LOW HIGH), or --averages is too large"
        )
    least, free, slopes, unit = fit
    s2, f0, q = np.exp(free[:3]).tolist()
    if band != BANDS[0] and q * (band[1] - band[0]) < _BAND_WIDTHS:
        raise ValueError(f"the peak near {f0:.6g} Hz is too wide for a narrower band")
    reason = denied("the resonance", f0, 0.0, "Hz", ends=(low, high)) or denied("Q", q, 0.0, ends=QUALITIES)
    if reason:
        raise ValueError(reason)
    inverse = _inverse(slopes @ slopes.T)
    joined = _joined(ratio[kept] - 1.0)
    covariance = inverse[:3, :3] * joined / count
    # With a poorly determined mean square, rounding decides where the search ends.
    error = math.sqrt(covariance[0, 0]) if covariance[0, 0] > 0.0 else math.inf
    if reason := denied(f"the mean square near {f0:.6g} Hz", s2, s2 * error, "m^2"):
        raise ValueError(f"{reason}; a tone of the electronics has such a peak")
    share = math.sqrt(float(covariance[0, 0])) * (1.0 if averages else _by_scatter(int(kept.sum())))
    # A lever that rings longer than a segment has the same energy in neighbouring segments: over a record of the
    # time T its mean square is known to sqrt(Q / pi f0 T), however little the lines elsewhere scatter.
    segments = count / (1.0 if averages else _OVERLAP)
    if f0 / q < _FEW_LINES * spacing:
        share = math.hypot(share, math.sqrt(spacing * q / (math.pi * f0 * segments)))
    # Another window that the lines allow gives another area.
    allowed = [one for one in others if count / joined * (one.cost - least) < _AS_LIKELY]
    by_window = max((abs(float(one.place[0] - free[0])) for one in allowed), default=0.0)
    moved = inverse[0] @ slopes * (ratio[kept] - 1.0)
    mismatch, chance = _mismatch(ratio[kept], lines[kept], f0, q, count / joined)
    deviance = float(np.mean(ratio[kept] - 1.0 - np.log(ratio[kept]))) / _deviance_of(count)
    return Resonance(
        s2, f0, q, max(float(free[3]) * unit, 0.0), math.hypot(share, by_window), covariance, deviance, mismatch,
        chance, tones, float(np.abs(moved).max()) / share, count, (float(lines[0]), float(lines[-1])), by_window,
        f0 / q / spacing,
    )  # fmt: skip


def _fit_in_band(
    lines: Array, power: Array, rate_hz: float, start: tuple[float, float, float], spacing: float, window: Any
) -> tuple["_Fit", Callable[..., Array], list["_Fit"]]:
    """Return the best fit of some lines, its density as a function of lines, places, s^2, f0 and Q, and other fits.

    The other fits assume other windows; they exist only where the peak is so narrow that the window matters.
    """
    mean_square, resonance_hz, quality = start
    starts = [(mean_square, resonance_hz, quality * times) for times in _STARTS_OF_Q]

    def plain(at: Array, _: Any, s2: float, f0: float, q: float) -> Array:
        return density(at, rate_hz, s2, f0, q)

    fits: list[tuple[_Fit, Callable[..., Array]]] = [(_fit(partial(plain, lines, None), power, starts[0]), plain)]
    places = np.rint(lines / spacing).astype(int)
    is_even = np.abs(lines - places * spacing).max() < 0.1 * spacing
    least_lines = _FEW_LINES if window is None else _FEW_LINES_OF_KNOWN * noise_bandwidth_of(window)
    if is_even and fits[0][0].place[1] - math.log(least_lines * spacing) < fits[0][0].place[2]:
        count = round(rate_hz / spacing)
        kernels = [_autocorrelation(signal.get_window(one, count)) for one in ((window,) if window else _WINDOWS)]
        fits = [] if window else fits
        for kernel in kernels:

            def seen(_: Any, at: Any, s2: float, f0: float, q: float, kernel: Array = kernel) -> Array:
                return _seen_through(kernel, at, rate_hz, s2, f0, q)

            found = [(_fit(partial(seen, None, places), power, one), seen) for one in starts]
            found = [one for one in found if one[0].has_area_of(power, spacing)]
            fits += [min(found, key=lambda one: one[0].cost)] if found else []
        fits = [one for one in fits if one[0].has_area_of(power, spacing)]
        if not fits:
            raise ValueError(
                f"no resonance has the area of the peak, which has too few lines {spacing:.4g} Hz apart: take a finer "
                "spectrum, or --record"
            )
    best = min(fits, key=lambda one: one[0].cost)
    return *best, [one[0] for one in fits if one is not best and one[1] is not plain]


def noise_bandwidth_of(window: Any) -> float:
    """Return the noise bandwidth, in lines, of a window as `scipy.signal.get_window` takes it."""
    values = signal.get_window(window, 4096)
    return float(4096 * np.sum(values**2) / np.sum(values) ** 2)


def _deviance_of(averages: float) -> float:
    """Return the mean of r - 1 - log r, where r is the mean of `averages` exponential numbers of mean 1."""
    return float(math.log(averages) - special.digamma(averages))


def _averages_of(ratio: Array) -> float:
    """Estimate the number of periodograms averaged per line from the scatter about the fit."""
    # The quartiles are robust against tones and misfits.
    low, high = np.quantile(ratio, (0.25, 0.75))
    wanted = math.log(max(high / low, 1.0 + 1e-9)) if low > 0.0 else math.inf
    counts = np.geomspace(0.5, 1e5, 400)
    spreads = np.log(special.gammaincinv(counts, 0.75) / special.gammaincinv(counts, 0.25))
    found = float(np.interp(-wanted, -spreads, counts))
    # The parameters of the fit reduce the scatter.
    return max(found * max(len(ratio) - _PARAMETERS, 1) / len(ratio), 0.5)


def _by_scatter(lines: int) -> float:
    """Return the factor by which estimating the scatter from so few lines widens a 95 % interval."""
    return float(special.stdtrit(max(_OF_QUARTILES * (lines - _PARAMETERS), 1.0), 0.975)) / 1.96


def _joined(residual: Array) -> float:
    """Return the factor by which the correlation of neighbouring lines increases the variance of their sum.

    Hann's window correlates neighbours by 4/9 and next neighbours by 1/36; zero padding of a segment correlates as many
    lines as there are to one of the segment. A systematic course of the residuals affects all lags alike and is
    excluded.
    """
    square = float(residual @ residual)
    if len(residual) < 64 or square <= 0.0:
        return 1.0
    lags = range(1, 2 * _FARTHEST_JOINED + 1)
    correlations = np.array([float(residual[:-lag] @ residual[lag:]) / square for lag in lags])
    total, near = 0.0, 1.0
    for lag, here in enumerate(correlations[:_FARTHEST_JOINED]):
        # The correlation at twice the lag is that of a systematic course.
        near = float(here - correlations[max(2 * lag + 1, 2)])
        if near < _LEAST_JOINED:
            break
        total += near
    if not total:
        return 1.0
    return min(1.0 + 2.0 * (total + max(near, 0.0)), _MOST_JOINED)


def _mismatch(ratio: Array, lines: Array, resonance_hz: float, quality: float, averages: float) -> tuple[float, float]:
    """Return the mean square residual of blocks of lines relative to noise, and the probability of as much by noise.

    The blocks have equal numbers of lines within the peak, and within each of its sides.
    """
    width = max(_PEAK_WIDTHS * resonance_hz / quality, 4.0 * float(np.median(np.diff(lines))))
    edges = np.searchsorted(lines, (resonance_hz - width, resonance_hz + width))
    parts = [part for part in np.split(ratio - 1.0, edges) if len(part)]
    blocks = [block for part in parts for block in np.array_split(part, min(_BLOCKS, len(part)))]
    squares = [averages * float(block.sum()) ** 2 / len(block) for block in blocks]
    free = max(len(squares) - 4, 1)
    total = float(np.sum(squares))
    # A block of few periodograms has a longer tail than a normal distribution.
    excess = 1.0 + 3.0 / (averages * max(len(ratio) / max(len(squares), 1), 1.0))
    return total / free, float(special.chdtrc(free / excess, total / excess))


class _Fit(NamedTuple):
    """Least cost, its place (log s^2, log f0, log Q, floor in units), derivatives of log S there, unit of the floor."""

    cost: float
    place: Array
    slopes: Array
    unit: float

    def has_area_of(self, power: Array, spacing: float) -> bool:
        """Return whether the mean square agrees with the area of the lines above the floor."""
        area = spacing * float((power - self.place[3] * self.unit).sum())
        return area > 0.0 and abs(float(self.place[0]) - math.log(area)) < _SAME_AREA


def _fit(shape: Shape, power: Array, start: tuple[float, float, float]) -> _Fit:
    # All parameters are of order one: log s^2, log f0, log Q, floor in the mean density of the band.
    unit = float(power.mean())
    free = np.append(np.log(np.array(start)), 1e-3)

    def logs(point: Array) -> Array:
        s2, f0, q = np.exp(np.clip(point[:3], -200.0, 200.0)).tolist()
        total = shape(s2, f0, q) + point[3] * unit
        return np.log(np.where(total > 0.0, total, np.nan))

    def cost(log_density: Array) -> float:
        sum_of_terms = float((power * np.exp(-log_density) + log_density).sum())
        return sum_of_terms if math.isfinite(sum_of_terms) else math.inf

    present = logs(free)
    least = cost(present)
    slopes = np.zeros((4, len(power)))
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
        if not np.isfinite(move).all():
            # The density is not positive here, or a step away.
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
    return _Fit(least, free, slopes, unit)


def _inverse(information: Array) -> Array:
    try:
        return np.asarray(np.linalg.inv(information), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(information, np.inf)


def _seen_through(kernel: Array, places: npt.NDArray[np.int_], rate_hz: float, s2: float, f0: float, q: float) -> Array:
    """Return the mean periodogram at lines of a windowed segment; kernel: autocorrelation, shape (samples,)."""
    dt = 1.0 / rate_hz
    steps = np.arange(len(kernel))
    covariance = sum((share * np.exp(pole * dt * steps)).real for pole, share in _poles(f0, q))
    lines = np.fft.fft(kernel * covariance).real[places % len(kernel)]
    return np.asarray(2.0 * dt * s2 * (2.0 * lines - 1.0))


def _autocorrelation(window: Array) -> Array:
    """Return the autocorrelation of a window at shifts of 0 to its length, normalised to 1 at 0."""
    spectrum = np.abs(np.fft.rfft(window, 2 * len(window))) ** 2
    correlation = np.fft.irfft(spectrum)[: len(window)]
    return np.asarray(correlation / correlation[0])
