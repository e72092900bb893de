"""Calibrations from what one's own instrument measured: a thermal spectrum or record, a curve on a hard sample.

*Thermal*: k = c k_B T / <zeta^2>, where <zeta^2> is the mean square of the first mode, by the area of the fitted
resonance. The factor c is that of the mode and of the way the deflection is read (H.-J. Butt, M. Jaschke,
Nanotechnology 6 (1995) 1): a point mass on a spring has 1, a rectangular lever whose deflection is read as a way 0.971.
One that is read by the angle of its end, with a sensitivity from a curve on a hard sample, has 0.971/1.09^2 = 0.817,
because a lever that swings freely has another shape than one that is pressed.

*Sader*: k = 0.1906 rho b^2 L Q Im(Gamma(w0)) w0^2 for a rectangular lever in a fluid (J. E. Sader, J. W. M. Chon,
P. Mulvaney, Rev. Sci. Instrum. 70 (1999) 3967), with the hydrodynamic function Gamma of a rectangular beam (J. E.
Sader, J. Appl. Phys. 84 (1998) 64). It needs no sensitivity.

*Sensitivity*: the slope of the way of the base over the voltage in contact with a sample that does not give way.
"""

import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from presets.regular_files import read_regular
from services.afm_node.physics.disturbances import BOLTZMANN_J_PER_K
from services.runtime.untrusted.file_readers import read_by_package
from telenano.extend.commands import ConfigError
from telenano_calibration.line_fit import regressed
from telenano_calibration.resonance import Resonance, fit_spectrum, periodogram

Array = npt.NDArray[np.float64]

# c for a lever that is read by its angle, the usual one
BY_ANGLE = 0.971 / 1.09**2
# air at 20 degrees Celsius and 1013 hPa
AIR_DENSITY_KG_PER_M3, AIR_VISCOSITY_PA_S = 1.204, 1.825e-5
_LARGEST_BYTES = 256_000_000
# Units of a density, as columns are named: of a power or of its root, in volts or in metres.
DENSITIES = ("V^2/Hz", "V/sqrt(Hz)", "m^2/Hz", "m/sqrt(Hz)")
_PREFIXES = {"": 1.0, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9, "p": 1e-12, "f": 1e-15}
_DENSITY = re.compile(
    r"(?<![\w/])([munpfµμ]?)([Vm])(\^2|²|\*\*2|2)?\s?/\s?(√|sqrt|rt)?\s?\(?Hz\)?(\^\(?(?:0?\.5|1/2)\)?)?(?!\w)"
)
# files with other names are those of an instrument, which packages read
TEXTS = ("", ".asc", ".csv", ".dat", ".tsv", ".txt")
# numerator and denominator of the correction of a rectangular beam, in powers of log10 of the Reynolds number
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
# From the softest levers of magnetic resonance to quartz resonators, with a margin; beyond it the units are wrong.
_STIFFNESS = (1e-5, 1e7)  # [N/m]
# Two values agree where they are no more standard errors apart: 95 in 100 of those that are the same.
_WITHIN = 1.96
# Sizes that a maker states make a stiffness wrong by less than this factor, so that more is another unit.
_FARTHEST = 4.0


class Stiffness(NamedTuple):
    """k [N/m] and its standard error; resonance [Hz], Q, floor of the read-out [m^2/Hz], and the factor c.

    standard_error_n_per_m: of the noise of the spectrum, and twice the share of the sensitivity's error where it is
    given. sader_n_per_m: by Sader's method, None without width and length. sader_over_thermal: that over k, with the
    standard error of the spectrum, the sensitivity and the size; agreement: in words whether they agree within it.
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


class Sensitivity(NamedTuple):
    """Way for a volt [m/V] with its standard error, the points in contact, and the scatter about the line [m]."""

    m_per_v: float
    standard_error_m_per_v: float
    points: int
    residual_m: float

    @property
    def share(self) -> float:
        """The standard error as a share, which counts twice in a stiffness."""
        return self.standard_error_m_per_v / abs(self.m_per_v)


class Thermal(NamedTuple):
    """What a thermal calibration needs beside the measurement.

    sensitivity_m_per_v [m/V]; temperature_k [K]; factor: c; width_m, length_m: of the lever, for Sader's method [m];
    rate_hz: at which the deflection was sampled [Hz]; averages: how many periodograms each line is the mean of.
    sensitivity_error_m_per_v, size_error_m: standard errors of the sensitivity, and of width and length each.
    """

    sensitivity_m_per_v: float
    temperature_k: float = 295.0
    factor: float = BY_ANGLE
    width_m: float | None = None
    length_m: float | None = None
    rate_hz: float | None = None
    averages: float = 1.0
    sensitivity_error_m_per_v: float = 0.0
    size_error_m: float = 0.0

    @property
    def sensitivity_share(self) -> float:
        """The standard error of a stiffness by that of the sensitivity, as a share."""
        return 2.0 * self.sensitivity_error_m_per_v / abs(self.sensitivity_m_per_v)


def columns_of(path: Path, count: int) -> Array:
    """Return the columns of numbers of a text file, shape (count, n); lines that are no numbers are a head.

    Raises:
        ConfigError: The file cannot be read, or has too few numbers; the message names it and the line.
    """
    try:
        text = read_regular(path, _LARGEST_BYTES).decode("utf-8", errors="replace")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.replace(",", " ").replace(";", " ").split()
        try:
            row = [float(word) for word in words[:count]]
        except ValueError:
            if rows and not line.lstrip().startswith("#"):
                raise ConfigError(f"{path}, line {number}: is no line of numbers, after {len(rows)} that are") from None
            continue
        if len(row) == count and all(map(math.isfinite, row)):
            rows.append(row)
        elif words:
            raise ConfigError(f"{path}, line {number}: has {len(words)} columns, {count} finite numbers are needed")
    if len(rows) < 16:
        raise ConfigError(f"{path}: has {len(rows)} lines of {count} numbers, 16 or more are needed")
    return np.array(rows).T


class Spectrum(NamedTuple):
    """A thermal spectrum: lines [Hz], their density, whether that is of metres and not of volts, and its averages."""

    frequency_hz: Array
    density_per_hz: Array
    is_of_metres: bool
    averages: float = 1.0


def spectrum_of(path: Path, unit: str = "") -> Spectrum:
    """Return a thermal spectrum, as density of a power.

    Args:
        path: A text file of two columns, whose head may name the unit of the density, such as V/sqrt(Hz), or a file of
            an instrument that an installed package reads.
        unit: The unit of the density, of any power of ten; empty takes that of the file.

    Raises:
        ConfigError: The file cannot be read, or its unit is not known; the message says how to give it.
    """
    averages = 1.0
    if path.suffix.lower() in TEXTS:
        frequency_hz, density = columns_of(path, 2)
        text = read_regular(path, _LARGEST_BYTES).decode("utf-8", errors="replace")
        head = "\n".join(line for line in text.splitlines()[:200] if not line[:1].isdigit())
    else:
        try:
            facts, (frequency_hz, density) = read_by_package(path, "spectrum")
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from error
        head, averages = facts["unit"], float(facts["averages"])
    found = [match for match in _DENSITY.finditer(unit or head) if bool(match[3]) is not bool(match[4] or match[5])]
    if len({match[0] for match in found}) != 1:
        known = f"one of {', '.join(DENSITIES)}, with a prefix such as p where it has one"
        if unit:
            raise ConfigError(f"--unit {unit}: must be {known}")
        several = f"names several units ({', '.join(match[0] for match in found)})" if found else "names no unit"
        raise ConfigError(f"{path}: its head {several} for the density: give --unit, {known}")
    prefix, base, is_power, *_ = found[0].groups()
    power = density * _PREFIXES[prefix] ** 2 if is_power else (density * _PREFIXES[prefix]) ** 2
    return Spectrum(frequency_hz, power, base == "m", averages)


def stiffness_of_spectrum(frequency_hz: Array, density_v2_per_hz: Array, known: Thermal) -> Stiffness:
    """Return the stiffness by a thermal spectrum: lines [Hz] and one-sided density [V^2/Hz], shape (n,) each.

    Raises:
        ConfigError: The spectrum is none, or its fit ends at a bound, which the message names.
    """
    if np.any(np.diff(frequency_hz) <= 0.0) or np.any(density_v2_per_hz < 0.0):
        raise ConfigError("the spectrum needs frequencies that rise, and densities of 0 or more")
    rate_hz = known.rate_hz if known.rate_hz is not None else 2.0 * float(frequency_hz[-1])
    density = density_v2_per_hz * known.sensitivity_m_per_v**2
    peak_hz, quality = _peak(frequency_hz, density)
    mean_square = float(np.sum(density[1:] * np.diff(frequency_hz)))
    return _stiffness(
        known, lambda: fit_spectrum(frequency_hz, density, rate_hz, peak_hz, quality, mean_square, known.averages)
    )


def stiffness_of_record(deflection_v: Array, known: Thermal) -> Stiffness:
    """Return the stiffness by a record of the free lever's deflection [V], shape (n,), at `known.rate_hz`.

    Raises:
        ConfigError: The rate is missing, or the fit ends at a bound, which the message names.
    """
    if known.rate_hz is None:
        raise ConfigError("--rate: a record needs the rate at which it was sampled [Hz]")
    rate_hz, deflection_m = known.rate_hz, deflection_v * known.sensitivity_m_per_v
    frequency, power = periodogram(deflection_m, rate_hz)
    peak_hz, quality = _peak(frequency[1:], power[1:])
    square = float(np.var(deflection_m))
    return _stiffness(known, lambda: fit_spectrum(frequency, power, rate_hz, peak_hz, quality, square))


def _stiffness(known: Thermal, fit: Any) -> Stiffness:
    try:
        found: Resonance = fit()
    except ValueError as error:
        raise ConfigError(str(error)) from error
    k = known.factor * BOLTZMANN_J_PER_K * known.temperature_k / found.mean_square_m2
    if not _STIFFNESS[0] <= k <= _STIFFNESS[1]:
        raise ConfigError(
            f"a stiffness of {k:.3g} N/m is that of no cantilever: look at the unit of the density (--unit), or of a "
            "record, which is V, and at the way for a volt in nm/V"
        )
    deviation = k * math.hypot(found.share, known.sensitivity_share)
    thermal = Stiffness(k, deviation, found.resonance_hz, found.quality, found.floor_m2_per_hz, known.factor)
    if known.width_m is None or known.length_m is None:
        return thermal
    by_sader, slopes = _sader_with_slopes(known.width_m, known.length_m, found.resonance_hz, found.quality)
    # log k is -log s^2 and a constant by the thermal method: the same spectrum gives s^2, f0 and Q
    of_ratio = np.array([1.0, slopes["resonance"], 1.0])
    by_spectrum = float(of_ratio @ found.covariance @ of_ratio)
    by_size = known.size_error_m * math.hypot(slopes["width"] / known.width_m, 1.0 / known.length_m)
    share = math.sqrt(by_spectrum + known.sensitivity_share**2 + by_size**2)
    ratio = by_sader / k
    words = _agreement(ratio, share, known)
    return thermal._replace(
        sader_n_per_m=by_sader, sader_over_thermal=ratio, sader_over_thermal_error=ratio * share, agreement=words
    )


def _sader_with_slopes(
    width_m: float, length_m: float, resonance_hz: float, quality: float
) -> tuple[float, dict[str, float]]:
    """Return the stiffness by Sader [N/m] and how its logarithm goes with those of the resonance and of the width."""
    more = 1.0 + 1e-4
    k = sader_n_per_m(width_m, length_m, resonance_hz, quality)
    wider = sader_n_per_m(more * width_m, length_m, resonance_hz, quality)
    faster = sader_n_per_m(width_m, length_m, more * resonance_hz, quality)
    return k, {"width": math.log(wider / k) / math.log(more), "resonance": math.log(faster / k) / math.log(more)}


def _agreement(ratio: float, share: float, known: Thermal) -> str:
    """Return in words whether both methods agree within their errors, and which errors those are."""
    apart = abs(math.log(ratio)) / share
    said = f"Sader's method gives {ratio:.3g} ± {ratio * share:.2g} times the thermal stiffness: "
    if apart <= _WITHIN:
        said += "they agree within their errors"
    elif max(ratio, 1.0 / ratio) > _FARTHEST:
        said += "a lever of this size cannot have it: the unit of the density, the sensitivity or the size is wrong"
    else:
        said += f"they differ by {apart:.1f} standard errors, so look at sensitivity, factor, width and length"
    unknown = [
        name
        for name, error in (("the sensitivity", known.sensitivity_error_m_per_v), ("the size", known.size_error_m))
        if not error
    ]
    return said + (f" (not counting that of {' and of '.join(unknown)}: not given)" if unknown else "")


def _peak(frequency_hz: Array, density: Array) -> tuple[float, float]:
    """Return where the greatest resonance is [Hz], and a Q to begin with, by means of neighbouring lines.

    What is below a hundredth of the band is drift, and no resonance is looked for there.
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


def hydrodynamic(reynolds: float) -> complex:
    """Return Gamma of a rectangular beam at a Reynolds number rho w b^2 / (4 eta), 1e-6 to 1e4 (Sader 1998)."""
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
    """Return the stiffness [N/m] of a rectangular lever by its size [m], its resonance [Hz] and its Q in a fluid."""
    omega = 2.0 * math.pi * resonance_hz
    reynolds = AIR_DENSITY_KG_PER_M3 * omega * width_m**2 / (4.0 * AIR_VISCOSITY_PA_S)
    return 0.1906 * AIR_DENSITY_KG_PER_M3 * width_m**2 * length_m * quality * hydrodynamic(reynolds).imag * omega**2


def sensitivity_of_curve(way_m: Array, volts: Array, low: float = 0.3, high: float = 0.95) -> Sensitivity:
    """Return the way for a volt in contact: of the points between two shares of the span of the voltage.

    Args:
        way_m: Way of the base towards the sample [m], shape (n,).
        volts: Deflection [V], shape (n,).
        low: Share of the span at which contact is sure.
        high: Share up to which the read-out is linear.

    Raises:
        ConfigError: Too few points lie there, or the voltage does not follow the way.
    """
    span = float(np.ptp(volts))
    # The free lever is where the base is farthest, whatever the sign of the read-out.
    shares = np.abs(volts - volts[np.argmin(way_m)]) / span if span > 0.0 else np.zeros(len(volts))
    chosen = (shares >= low) & (shares <= high)
    _require(int(chosen.sum()), low, high)
    # Points that are chosen by their voltage are chosen by its noise too: their line chooses the ways.
    slope, error, scatter = regressed(way_m[chosen], shares[chosen])
    if slope > 0.0:
        predicted = shares[chosen].mean() + slope * (way_m - way_m[chosen].mean())
        chosen = (predicted >= low) & (predicted <= high)
        _require(int(chosen.sum()), low, high)
        slope, error, scatter = (span * part for part in regressed(way_m[chosen], shares[chosen]))
    if not slope > 3.0 * error:
        raise ConfigError("the voltage does not follow the way there: this is no curve on a hard sample")
    return Sensitivity(1.0 / slope, error / slope**2, int(chosen.sum()), scatter / slope)


def sensitivities_of_file(path: Path, low: float = 0.3, high: float = 0.95) -> tuple[list[Sensitivity], int]:
    """Return the sensitivity by each curve of a file of curves, and how many of its curves are none on a hard sample.

    Of a force map or QI data with many curves it is the first block of them. `low` and `high` are those of
    `sensitivity_of_curve`.

    Raises:
        ConfigError: The file cannot be read, or no curve of it will do; the message names it and the reason.
    """
    try:
        _, (counts, heights, volts) = read_by_package(path, "deflections")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise ConfigError(f"{path}: is no file of curves: {error}") from error
    found, reason = [], ""
    ends = np.cumsum(counts)[:-1]
    for height, volt in zip(np.split(heights, ends), np.split(volts, ends), strict=True):
        try:
            # the height rises away from the sample
            found.append(sensitivity_of_curve(-height, volt, low, high))
        except ConfigError as error:
            reason = str(error)
    if not found:
        raise ConfigError(f"{path}: none of its {len(counts)} curves will do: {reason}")
    return found, len(counts) - len(found)


def _require(points: int, low: float, high: float) -> None:
    if points < 8:
        raise ConfigError(f"{points} points lie between {low:g} and {high:g} of the span: 8 are needed")
