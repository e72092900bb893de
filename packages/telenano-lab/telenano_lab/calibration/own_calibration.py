"""Calibrations from measurements of the user's own instrument: thermal noise, or a curve on a hard sample.

*Thermal*: k = c k_B T / <zeta^2>, where <zeta^2> is the mean square of the first mode, from the area of the fitted
resonance. The factor c depends on the mode and on how the deflection is read (H.-J. Butt, M. Jaschke, Nanotechnology 6
(1995) 1): it is 1 for a point mass on a spring, and 0.971 for a rectangular lever whose displacement is read. If the
angle of its end is read, with a sensitivity from a curve on a hard sample, it is 0.971/1.09^2 = 0.817, because a freely
vibrating lever has another shape than a pressed one.

*Sader*: k = 0.1906 rho b^2 L Q Im(Gamma(w0)) w0^2 for a rectangular lever in a fluid (J. E. Sader, J. W. M. Chon,
P. Mulvaney, Rev. Sci. Instrum. 70 (1999) 3967), with the hydrodynamic function Gamma of a rectangular beam (J. E.
Sader, J. Appl. Phys. 84 (1998) 64). It needs no sensitivity.

*Sensitivity*: the slope of the displacement of the base over the voltage, in contact with a rigid sample.
"""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import constants, ndimage

from telenano.analysis import denied
from telenano.files import TextTable
from telenano.wire import ConfigError, NoEstimateError
from telenano_lab.calibration.hard_curves import Sensitivity as Sensitivity
from telenano_lab.calibration.hard_curves import curve_of as curve_of
from telenano_lab.calibration.hard_curves import require_usual as require_usual
from telenano_lab.calibration.hard_curves import sensitivities_of_file as sensitivities_of_file
from telenano_lab.calibration.hard_curves import sensitivity_of_curve as sensitivity_of_curve
from telenano_lab.calibration.resonance import OF_A_LIQUID, WIDENED, Resonance, fit_spectrum, periodogram
from telenano_lab.calibration.spectrum_files import TEXTS as TEXTS
from telenano_lab.calibration.spectrum_files import Spectrum as Spectrum
from telenano_lab.calibration.spectrum_files import spectrum_of as spectrum_of
from telenano_lab.calibration.spectrum_forms import DENSITIES as DENSITIES

Array = npt.NDArray[np.float64]

# The factor c of a lever whose angle is read, the usual kind.
BY_ANGLE = 0.971 / 1.09**2
# Density and viscosity of air at 20 degrees Celsius and 1013 hPa.
AIR_DENSITY_KG_PER_M3 = 1.204
AIR_VISCOSITY_PA_S = 1.825e-5
# Numerator and denominator of the correction of a rectangular beam, in powers of log10 of the Reynolds number.
_REAL = (
    (0.91324, -0.48274, 0.46842, -0.12886, 0.044055, -0.0035117, 0.00069085),
    (1.0, -0.56964, 0.48690, -0.13444, 0.045155, -0.0035862, 0.00069085),
)
_IMAGINARY = (
    (-0.024134, -0.029256, 0.016294, -0.00010961, 0.000064577, -0.000044510),
    (1.0, -0.59702, 0.55182, -0.18357, 0.079156, -0.014369, 0.0028361),
)
# The correction was fitted to Reynolds numbers in this range.
_REYNOLDS = (1e-6, 1e4)
# Plausible stiffness, from the softest levers of magnetic resonance to quartz resonators; else a unit is wrong.
_STIFFNESS = (1e-5, 1e7)  # [N/m]
# Plausible resonance, from large levers to the small ones of fast scanning, and needles and forks of quartz.
_RESONANCE_HZ = (500.0, 1e7)
# Plausible Q, from levers in honey-like liquids to those in ultra-high vacuum at 4 K.
_QUALITY = (0.2, 3e6)
# Plausible effective mass k / w0^2: 0.1 N/m at 1.5 MHz is 1e-15 kg, a fork of quartz 1e-7 kg.
_MASS_KG = (1e-16, 1e-5)
# Two values agree within this number of standard errors, as 95 in 100 equal values do.
_WITHIN = 1.96
# A resonance narrower than this number of lines is remarked on.
_FEW_ACROSS = 2.0
# The second mode of a rectangular lever lies at this multiple of the first one.
_SECOND_OVER_FIRST = 6.27
# Nominal sizes of a lever make a stiffness wrong by less than this factor; a greater one means a wrong unit.
_FARTHEST = 4.0
# What helps where a spectrum tells no stiffness.
_WOULD_TELL = (
    "What helps: a finer spectrum of more averages, from a hundredth of the resonance to ten times it; in a liquid"
    " rather the spectrum in air, whose peak is narrow, as the stiffness is the same"
)


class Stiffness(NamedTuple):
    """k [N/m] and its standard error; resonance [Hz], Q, floor of the read-out [m^2/Hz], and the factor c.

    standard_error_n_per_m: from the noise of the spectrum, and twice the relative error of the sensitivity where it is
    given. sader_n_per_m: k by Sader's method, None without width and length. sader_over_thermal: that over k, with the
    standard error from spectrum, sensitivity and size; agreement: sentence on whether they agree within it. averages:
    periodograms averaged per line, as given or from the scatter of the lines; deviance_ratio: deviance of the lines
    relative to thermal noise; residual_ratio: mean square of the residuals of blocks of lines, likewise;
    lines_left_out: lines that are too strong for thermal noise; influence: effect of the most influential line
    [standard errors of k]. band_hz: band of the fitted lines [Hz].
    """

    stiffness_n_per_m: float
    standard_error_n_per_m: float
    resonance_hz: float
    quality: float
    floor_m2_per_hz: float
    factor: float
    sader_n_per_m: float | None = None
    sader_over_thermal: float | None = None
    sader_over_thermal_error: float | None = None
    agreement: str | None = None
    averages: float = 1.0
    deviance_ratio: float = 1.0
    residual_ratio: float = 1.0
    lines_left_out: int = 0
    influence: float = 0.0
    band_hz: tuple[float, float] = (0.0, math.inf)
    remarks: tuple[str, ...] = ()


class Thermal(NamedTuple):
    """The inputs of a thermal calibration besides the measurement.

    sensitivity_m_per_v [m/V]; temperature_k [K]; factor: c; width_m, length_m: size of the lever, for Sader's method
    [m]; rate_hz: sampling rate of the deflection [Hz]; averages: periodograms averaged per line, None to estimate it
    from the scatter of the lines. sensitivity_error_m_per_v, size_error_m: standard errors of the sensitivity, and of
    width and length each. exclude_hz: bands whose lines are ignored. anyway: whether an implausible resonance, Q or
    mass is accepted. window: window of the segments of a spectrum, None if unknown.
    """

    sensitivity_m_per_v: float
    temperature_k: float = 295.0
    factor: float = BY_ANGLE
    width_m: float | None = None
    length_m: float | None = None
    rate_hz: float | None = None
    averages: float | None = 1.0
    sensitivity_error_m_per_v: float = 0.0
    size_error_m: float = 0.0
    exclude_hz: tuple[tuple[float, float], ...] = ()
    anyway: bool = False
    window: Any = None

    @property
    def sensitivity_share(self) -> float:
        """The relative standard error of a stiffness that is due to the sensitivity."""
        return 2.0 * self.sensitivity_error_m_per_v / abs(self.sensitivity_m_per_v)


def record_of(path: Path, unit: str = "") -> tuple[Array, tuple[str, ...]]:
    """Return the deflection of the free lever [V] from a text table, and remarks on how it was read.

    Raises:
        ConfigError: The file cannot be read, or its unit is no voltage; the message says how to give it.
    """
    table = TextTable.read(path)
    volts = [column for column in table.columns if (known := column.known) and known.powers == (("V", 1.0),)]
    column = volts[0] if volts else table.find("deflection", "defl", "volt", "signal") or table.columns[0]
    if not volts and len(table.columns) > 1 and column is table.columns[0]:
        raise ConfigError(f"{path}: has {len(table.columns)} columns, and none is named as a deflection in V")
    values = table.in_si(column, ("V",), unit, "--unit")
    remarks = table.remarks
    if values is None:
        values, remarks = column.values, (*remarks, "nothing names the unit of the deflection, which is taken as V")
    if len(table.columns) > 1:
        remarks = (*remarks, f"of its columns {column.title!r} is taken")
    if not np.isfinite(values).all():
        place = int(np.argmin(np.isfinite(values)))
        raise ConfigError(f"{path}, line {table.lines[place]}: has no number; a record has one in each line")
    return values, remarks


def stiffness_of_spectrum(frequency_hz: Array, density_v2_per_hz: Array, thermal: Thermal) -> Stiffness:
    """Return the stiffness from a thermal spectrum: lines [Hz] and one-sided density [V^2/Hz], shape (n,) each.

    Raises:
        ConfigError: The spectrum is invalid, or its fit ends at a bound, which the message names.
    """
    if np.any(np.diff(frequency_hz) <= 0.0) or np.any(density_v2_per_hz < 0.0):
        raise ConfigError("the spectrum needs frequencies that rise, and densities of 0 or more")
    rate_hz = thermal.rate_hz if thermal.rate_hz is not None else 2.0 * float(frequency_hz[-1])
    return _stiffness(
        thermal, frequency_hz, density_v2_per_hz * thermal.sensitivity_m_per_v**2, rate_hz, thermal.averages
    )


def stiffness_of_record(deflection_v: Array, thermal: Thermal) -> Stiffness:
    """Return the stiffness from a record of the free lever's deflection [V], shape (n,), at `thermal.rate_hz`.

    Raises:
        ConfigError: The rate is missing, or the fit ends at a bound, which the message names.
    """
    if thermal.rate_hz is None:
        raise ConfigError("--rate: a record needs the rate at which it was sampled [Hz]")
    rate_hz, deflection_m = thermal.rate_hz, deflection_v * thermal.sensitivity_m_per_v
    return _stiffness(thermal, *periodogram(deflection_m, rate_hz), rate_hz, 1.0)


def _stiffness(known: Thermal, lines: Array, power: Array, rate_hz: float, averages: float | None) -> Stiffness:
    kept = lines > 0.0
    for low, high in known.exclude_hz:
        kept &= (lines < low) | (lines > high)
    lines, power = lines[kept], power[kept]
    if len(lines) < 16:
        raise ConfigError(f"the spectrum has {len(lines)} lines that are not excluded: 16 are needed")
    # The greatest line may be a tone, and a narrow resonance may be a single line: try starts for both.
    smooth = ndimage.median_filter(power, 7)
    starts: list[tuple[float, float, float]] = []
    for one in (power, np.minimum(power, 30.0 * smooth), smooth):
        peak_hz, quality = _peak(lines, one)
        start = (float(np.sum(one[1:] * np.diff(lines))), peak_hz, quality)
        if not starts or all(abs(math.log(start[1] / other[1])) > 0.5 / start[2] for other in starts):
            starts.append(start)
    wide = _starts_without_peak(lines, power)
    try:
        peak: Resonance = fit_spectrum(lines, power, rate_hz, starts, averages, known.window, wide)
    except ValueError as error:
        raise NoEstimateError(f"{error}. {_WOULD_TELL}") from error
    k = known.factor * constants.Boltzmann * known.temperature_k / peak.mean_square_m2
    if not _STIFFNESS[0] <= k <= _STIFFNESS[1]:
        raise ConfigError(
            f"no cantilever has a stiffness of {k:.3g} N/m: check the unit of the density (--unit), or of a record, "
            "which is V, and the deflection per volt in nm/V (--sensitivity)"
        )
    if reason := denied("the stiffness", k, k * peak.share, "N/m"):
        raise NoEstimateError(f"{reason}: {_WOULD_TELL}")
    if not known.anyway:
        _ask_about(k, peak)
    deviation = k * math.hypot(peak.share, known.sensitivity_share)
    thermal = Stiffness(
        k, deviation, peak.resonance_hz, peak.quality, peak.floor_m2_per_hz, known.factor, averages=peak.averages,
        deviance_ratio=peak.deviance, residual_ratio=peak.mismatch, lines_left_out=peak.tones,
        influence=peak.influence, band_hz=peak.band_hz, remarks=_remarks_on(peak, averages, float(lines[0])),
    )  # fmt: skip
    if known.width_m is None or known.length_m is None:
        return thermal
    if peak.quality < OF_A_LIQUID:
        said = f"Sader's method is that of a lever in air, and a Q of {peak.quality:.2g} is that of a liquid: left out"
        return thermal._replace(agreement=said)
    by_sader, slopes = _sader_with_slopes(known.width_m, known.length_m, peak.resonance_hz, peak.quality)
    # By the thermal method log k is -log s^2 and a constant; s^2, f0 and Q come from the same spectrum.
    of_ratio = np.array([1.0, slopes["resonance"], 1.0])
    by_spectrum = float(of_ratio @ peak.covariance @ of_ratio)
    by_size = known.size_error_m * math.hypot(slopes["width"] / known.width_m, 1.0 / known.length_m)
    share = math.sqrt(by_spectrum + known.sensitivity_share**2 + by_size**2)
    ratio = by_sader / k
    words = _agreement(ratio, share, known)
    return thermal._replace(
        sader_n_per_m=by_sader, sader_over_thermal=ratio, sader_over_thermal_error=ratio * share, agreement=words
    )


def _ask_about(k: float, resonance: Resonance) -> None:
    """Raise ConfigError for an implausible resonance, Q or mass, and name the likely mistake."""
    f0, q = resonance.resonance_hz, resonance.quality
    mass_kg = k / (2.0 * math.pi * f0) ** 2
    asked = ""
    if f0 < _RESONANCE_HZ[0]:
        asked = f"a resonance of {f0:.4g} Hz: is the frequency in kHz? Give --frequency-unit kHz"
    elif f0 > _RESONANCE_HZ[1]:
        asked = (
            f"a resonance of {f0:.4g} Hz: is the frequency in Hz, and not in what its head says? --frequency-unit Hz"
        )
    elif not _QUALITY[0] <= q <= _QUALITY[1]:
        asked = f"Q of {q:.3g} at {f0:.6g} Hz: is the peak a tone or a hum? Leave it out by --exclude LOW HIGH"
    elif not _MASS_KG[0] <= mass_kg <= _MASS_KG[1]:
        asked = (
            f"{k:.3g} N/m at {f0:.6g} Hz, a mass of {mass_kg:.1g} kg: check the deflection per volt in nm/V and the"
            " unit of the density"
        )
    if asked:
        raise ConfigError(f"no ordinary cantilever has {asked}; --anyway accepts it")


def _remarks_on(resonance: Resonance, quality: float | None, first_hz: float) -> tuple[str, ...]:
    remarks = []
    if resonance.tones:
        remarks.append(
            f"{resonance.tones} lines that are no thermal noise (such as hum of the electronics) are left out"
        )
    if quality is None:
        remarks.append(f"by their scatter, each line is the mean of {resonance.averages:.3g} periodograms (--averages)")
    elif not 0.5 < resonance.deviance < 2.0:
        scatter = "more" if resonance.deviance > 1.0 else "less"
        remarks.append(f"its lines scatter {scatter} than those of {quality:g} averages: is --averages right?")
    if resonance.chance < WIDENED and not resonance.by_area:
        remarks.append(
            f"the standard error is widened {math.sqrt(resonance.mismatch):.2g} times by the residuals of the fit"
        )
    if resonance.by_window > 0.1 * resonance.share:
        remarks.append(
            f"the resonance is {resonance.lines_across:.2g} lines wide, and which window the segments had is not known:"
            " the standard error has it in it. A finer spectrum, or its window in the head, makes it smaller"
        )
    elif resonance.lines_across < _FEW_ACROSS:
        remarks.append(
            f"the resonance is {resonance.lines_across:.2g} lines wide, of which the standard error has account: a"
            " finer spectrum makes it smaller"
        )
    if first_hz > resonance.resonance_hz / _SECOND_OVER_FIRST:
        remarks.append(
            f"the lines begin at {first_hz:.6g} Hz, so that this may be the second mode of a lever whose first one lies"
            f" near {resonance.resonance_hz / _SECOND_OVER_FIRST:.6g} Hz: its stiffness is then not that of the lever"
        )
    if resonance.by_area:
        remarks.append(
            "no spring in white noise has this shape, as that of a lever that moves a liquid along: the area above the"
            " floor is taken (equipartition)"
        )
    remarks.append(f"lines from {resonance.band_hz[0]:.6g} to {resonance.band_hz[1]:.6g} Hz are taken")
    return tuple(remarks)


def _sader_with_slopes(
    width_m: float, length_m: float, resonance_hz: float, quality: float
) -> tuple[float, dict[str, float]]:
    """Return k by Sader's method [N/m], and the logarithmic derivatives of k by resonance and width."""
    more = 1.0 + 1e-4
    k = sader_n_per_m(width_m, length_m, resonance_hz, quality)
    wider = sader_n_per_m(more * width_m, length_m, resonance_hz, quality)
    faster = sader_n_per_m(width_m, length_m, more * resonance_hz, quality)
    return k, {"width": math.log(wider / k) / math.log(more), "resonance": math.log(faster / k) / math.log(more)}


def _agreement(ratio: float, share: float, thermal: Thermal) -> str:
    """Return a sentence on whether both methods agree within their errors, and which errors are not known."""
    apart = abs(math.log(ratio)) / share
    text = f"Sader's method gives {ratio:.3g} ± {ratio * share:.2g} times the thermal stiffness: "
    if apart <= _WITHIN:
        text += "they agree within their errors"
    elif max(ratio, 1.0 / ratio) > _FARTHEST:
        text += "a lever of this size cannot have it: the unit of the density, the sensitivity or the size is wrong"
    else:
        text += f"they differ by {apart:.1f} standard errors, so look at sensitivity, factor, width and length"
    unknown = [
        name
        for name, error in (("the sensitivity", thermal.sensitivity_error_m_per_v), ("the size", thermal.size_error_m))
        if not error
    ]
    return text + (f" (not counting that of {' and of '.join(unknown)}: not given)" if unknown else "")


def _peak(frequency_hz: Array, density: Array) -> tuple[float, float]:
    """Return the frequency of the greatest resonance [Hz] and a starting Q, from means of neighbouring lines.

    Below a hundredth of the band there is drift, so no resonance is sought there.
    """
    block = max(1, len(density) // 512)
    count = len(density) // block * block
    means = density[:count].reshape(-1, block).mean(axis=1)
    places = frequency_hz[:count].reshape(-1, block).mean(axis=1)
    means = np.where(places > 0.01 * places[-1], means, 0.0)
    top = int(np.argmax(means))
    half = np.flatnonzero(means < 0.5 * means[top])
    above = half[half > top]
    below = half[half < top]
    width = (places[above[0]] if len(above) else places[-1]) - (places[below[-1]] if len(below) else places[0])
    return float(places[top]), float(np.clip(places[top] / max(width, 1e-12), 0.6, 1e6))


def _starts_without_peak(frequency_hz: Array, density: Array) -> list[tuple[float, float, float]]:
    """Return two starts for a lever that hardly swings: mean square [m^2], resonance [Hz] and Q.

    The power of an octave, f S, is greatest near the resonance, peak or not, and at half of it at a Q of 0.4. White
    noise of the read-out would put it at the end, so the lowest density is taken off.
    """
    edges = np.unique(np.searchsorted(frequency_hz, np.geomspace(frequency_hz[0], frequency_hz[-1] * 1.01, 40)))
    blocks = [slice(low, high) for low, high in pairwise(edges)]
    places, means = (np.array([float(one[block].mean()) for block in blocks]) for one in (frequency_hz, density))
    octaves = np.where(places > 0.01 * places[-1], places * (means - means.min()), 0.0)
    area = float(np.sum((density[1:] - means.min()) * np.diff(frequency_hz)))
    place = float(places[int(np.argmax(octaves))])
    return [(max(area, 1e-300), times * place, 0.7) for times in (1.0, 2.0)]


def hydrodynamic(reynolds: float) -> complex:
    """Return Gamma of a rectangular beam at a Reynolds number rho w b^2 / (4 eta) of 1e-6 to 1e4 (Sader 1998)."""
    from scipy.special import kv

    if not _REYNOLDS[0] <= reynolds <= _REYNOLDS[1]:
        raise ConfigError(f"a Reynolds number of {reynolds:g} is outside of {_REYNOLDS[0]:g} to {_REYNOLDS[1]:g}")
    root = np.sqrt(1j * reynolds)
    circular = 1.0 + 4.0j * kv(1, -1j * root) / (root * kv(0, -1j * root))
    tau = math.log10(reynolds)

    def ratio(parts: tuple[tuple[float, ...], tuple[float, ...]]) -> float:
        above, below = (sum(factor * tau**power for power, factor in enumerate(part)) for part in parts)
        return above / below

    return complex(circular * complex(ratio(_REAL), ratio(_IMAGINARY)))


def sader_n_per_m(width_m: float, length_m: float, resonance_hz: float, quality: float) -> float:
    """Return the stiffness [N/m] of a rectangular lever in air from its size [m], its resonance [Hz] and its Q."""
    omega = 2.0 * math.pi * resonance_hz
    reynolds = AIR_DENSITY_KG_PER_M3 * omega * width_m**2 / (4.0 * AIR_VISCOSITY_PA_S)
    return 0.1906 * AIR_DENSITY_KG_PER_M3 * width_m**2 * length_m * quality * hydrodynamic(reynolds).imag * omega**2
