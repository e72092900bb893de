"""Figures of transparency for print: every law has its own colour of Okabe and Ito, mark and line."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from telenano.sections import LAWS, OWN_LAWS
from telenano_lab.studies.figure_colours import Look, looks
from telenano_lab.studies.loops.transparency import Spectrum

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# `model_mediated` has moved into a package and keeps its look.
_NAMED = tuple(dict.fromkeys((*OWN_LAWS, "model_mediated", *LAWS)))
LAW_LOOKS: dict[str, Look] = dict(zip(_NAMED, looks(len(_NAMED)), strict=True))


def impedance_figure(spectra: Sequence[Spectrum]) -> "Figure":
    """Draw rendered stiffness and free damping over frequency, with a row for each delay and a line for each law."""
    from matplotlib.figure import Figure

    delays = sorted({spectrum.round_trip_ms for spectrum in spectra})
    figure = Figure(figsize=(9.0, 1.0 + 2.5 * len(delays)), layout="constrained")
    axes = figure.subplots(len(delays), 2, squeeze=False, sharex=True)
    for row, delay in enumerate(delays):
        for spectrum in spectra:
            if spectrum.round_trip_ms == delay:
                _line(axes[row, 0], spectrum, spectrum.rendered_n_per_m)
                _line(axes[row, 1], spectrum, spectrum.free_n_s_per_m)
        axes[row, 0].set_ylabel("rendered stiffness\nRe(F_m/X_m) [N/m]", fontsize="small")
        axes[row, 1].set_ylabel("free damping\nRe(F_m/V_m) [N s/m]", fontsize="small")
        axes[row, 0].set_yscale("symlog", linthresh=100.0)
        axes[row, 0].axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
        for column in (0, 1):
            axes[row, column].set_title(f"round trip {delay:g} ms", loc="left", fontsize="small")
            axes[row, column].tick_params(which="both", labelsize="small")
    _finish(figure, axes, spectra)
    return figure


def hybrid_figure(spectra: Sequence[Spectrum]) -> "Figure":
    """Draw the magnitudes of the hybrid matrix's four entries over frequency at one delay, with a line for each law."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    titles = ("|h11|, impedance of free motion [N s/m]", "|h12|, force to the hand (ideal: 1)",
              "|h21|, motion to the tip (ideal: 1)", "|h22|, give of the held tip [m/(N s)]")  # fmt: skip
    for entry, (axis, title) in enumerate(zip(axes.flat, titles, strict=True)):
        for spectrum in spectra:
            _line(axis, spectrum, [None if hybrid is None else abs(hybrid[entry]) for hybrid in spectrum.hybrid])
        axis.set_title(title, loc="left", fontsize="small")
        axis.set_yscale("log")
        axis.tick_params(which="both", labelsize="small")
    # Smaller entries cannot be felt, and are only rounding errors in the sums of a run.
    axes[1, 1].set_ylim(bottom=1e-6)
    _finish(figure, axes, spectra)
    return figure


def _line(axis: "Axes", spectrum: Spectrum, values: Sequence[float | None]) -> None:
    colour, style, mark = LAW_LOOKS[spectrum.law]
    numbers = [np.nan if value is None else value for value in values]
    if not np.isnan(numbers).all():
        axis.plot(
            spectrum.frequencies_hz, numbers, mark, linestyle=style, color=colour, markersize=3.5, linewidth=1.2,
            label=spectrum.law.replace("_", " "),
        )  # fmt: skip


def _finish(figure: "Figure", axes: Any, spectra: Sequence[Spectrum]) -> None:
    frequencies = sorted({frequency for spectrum in spectra for frequency in spectrum.frequencies_hz})
    for axis in axes.flat:
        axis.set_xscale("log")
        axis.set_xlim(0.8 * frequencies[0], 1.25 * frequencies[-1])
        axis.set_xticks(frequencies, [f"{frequency:g}" for frequency in frequencies])
        axis.set_xticks([], minor=True)
        if not axis.get_legend_handles_labels()[0]:
            axis.text(0.5, 0.5, "no law holds here", transform=axis.transAxes, ha="center", fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("frequency [Hz]", fontsize="small")
    handles = {
        label: handle for axis in axes.flat for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    if handles:
        names = [law.replace("_", " ") for law in LAW_LOOKS if law.replace("_", " ") in handles]
        figure.legend([handles[name] for name in names], names, loc="outside upper center", ncols=6, fontsize="small")
