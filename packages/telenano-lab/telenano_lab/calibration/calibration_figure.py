"""Figures of calibrations: the data, the points that were left out, and the fit."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy import constants, special

from telenano.files import atomic_file
from telenano_lab.calibration.hard_curves import Sensitivity
from telenano_lab.calibration.own_calibration import Stiffness, Thermal
from telenano_lab.calibration.resonance import NOT_THERMAL, density

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

# Colours that all readers can tell apart, also in grey.
_TAKEN, _LEFT_OUT, _FIT = "#0072b2", "0.65", "#d55e00"


def draw(figure: "Figure", path: Path) -> None:
    """Write a figure in the format of its file name's suffix."""
    with atomic_file(path) as part:
        figure.savefig(part, dpi=130, format=path.suffix[1:])


def contact_figure(way_m: Array, volts: Array, found: Sensitivity) -> "Figure":
    """Draw a curve on a hard sample: its rows and parts, the line of contact, and its residuals."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    taken = np.zeros(len(way_m), dtype=bool) if found.rows is None else found.rows
    way_nm = 1e9 * way_m
    above.plot(way_nm[~taken], volts[~taken], ".", markersize=2, color=_LEFT_OUT, label="left out")
    above.plot(way_nm[taken], volts[taken], ".", markersize=3, color=_TAKEN, label="line of contact")
    slope, middle = _line(way_m[taken], volts[taken], found.m_per_v)
    ends = np.array([way_m[taken].min(), way_m[taken].max()])
    label = f"{1e9 * found.m_per_v:.4g} ± {1e9 * found.standard_error_m_per_v:.2g} nm/V"
    above.plot(1e9 * ends, middle[1] + slope * (ends - middle[0]), color=_FIT, label=label)
    for number, (name, start, end) in enumerate(found.parts):
        place = (start + end) // 2
        above.annotate(
            name,
            (way_nm[place], volts[place]),
            xytext=(4, 6 + 9 * (number % 3)),
            textcoords="offset points",
            fontsize=8,
        )
    # Leave room for the names of the parts.
    above.margins(y=0.15)
    above.set_ylabel("deflection [V]")
    above.legend()
    residual = volts[taken] - middle[1] - slope * (way_m[taken] - middle[0])
    below.plot(way_nm[taken], 1e3 * residual, ".", markersize=3, color=_TAKEN)
    below.axhline(0.0, color=_FIT, linewidth=0.8)
    below.set_ylabel("residual [mV]")
    below.set_xlabel("way of the base [nm]")
    return figure


def _line(way_m: Array, volts: Array, m_per_v: float) -> tuple[float, tuple[float, float]]:
    """Return the slope of the line with the sign of the data, and the point that it passes through."""
    covariance = float(np.sum((way_m - way_m.mean()) * (volts - volts.mean())))
    return float(np.sign(covariance)) / m_per_v, (float(way_m.mean()), float(volts.mean()))


def resonance_figure(frequency_hz: Array, density_per_hz: Array, found: Stiffness, thermal: Thermal) -> "Figure":
    """Draw a thermal spectrum: its lines, those that were left out, the fit, and the ratio of lines to fit.

    The density is one-sided, in metres or volts as the sensitivity implies.
    """
    from matplotlib.figure import Figure

    shown = frequency_hz > 0.0
    lines = frequency_hz[shown]
    power = density_per_hz[shown] * thermal.sensitivity_m_per_v**2
    rate_hz = thermal.rate_hz or 2.0 * float(lines[-1])
    square = found.factor * constants.Boltzmann * thermal.temperature_k / found.stiffness_n_per_m
    model = density(lines, rate_hz, square, found.resonance_hz, found.quality) + found.floor_m2_per_hz
    ratio = power / model
    thermal_lines = special.gammaincc(found.averages, found.averages * ratio) > NOT_THERMAL
    taken = (lines >= found.band_hz[0]) & (lines <= found.band_hz[1]) & thermal_lines
    for low, high in thermal.exclude_hz:
        taken &= (lines < low) | (lines > high)
    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.loglog(lines[~taken], power[~taken], ".", markersize=2, color=_LEFT_OUT, label="left out")
    above.loglog(lines[taken], power[taken], ".", markersize=2, color=_TAKEN, label="taken")
    label = f"{found.stiffness_n_per_m:.4g} ± {found.standard_error_n_per_m:.2g} N/m, Q = {found.quality:.3g}"
    above.loglog(lines, model, color=_FIT, label=label)
    above.set_ylabel("one-sided density [m²/Hz]")
    above.legend()
    below.semilogx(lines[taken], ratio[taken], ".", markersize=2, color=_TAKEN)
    below.axhline(1.0, color=_FIT, linewidth=0.8)
    below.set_ylabel("measured / fit")
    below.set_xlabel("frequency [Hz]")
    return figure
