"""Figures of the comparison for print: every law has a colour of Okabe and Ito, a mark and a line of its own."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from services.controller.config import LAWS
from telenano_studies.loops.merits import FIGURES, Merit
from telenano_studies.loops.transparency import Spectrum

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOOKS = (
    ("#000000", "o", "-"),
    ("#e69f00", "s", "--"),
    ("#0072b2", "^", "-."),
    ("#009e73", "D", ":"),
    ("#d55e00", "v", (0, (6, 1, 1, 1, 1, 1))),
    ("#cc79a7", "P", (0, (3, 1))),
)
LAW_LOOKS: dict[str, tuple[str, str, Any]] = {law: _LOOKS[n % len(_LOOKS)] for n, law in enumerate(LAWS)}
_HAND_LOOKS = {
    "force": ("#000000", "o"),
    "soft": ("#0072b2", "^"),
    "ordinary": ("#d55e00", "s"),
    "stiff": ("#009e73", "D"),
}
# A law that holds everything would have these values; there is none for some columns.
_IDEAL = {"force_ratio": 1.0, "apart_mm": 0.0, "drift_mm": 0.0, "lowest_energy_mj": 0.0, "guarded_percent": 0.0}
# The range that is drawn is at least this, so that rounding looks like nothing.
_LEAST_RANGE = {
    "peak_n": 0.1,
    "force_ratio": 0.1,
    "apart_mm": 0.02,
    "drift_mm": 0.02,
    "work_mj": 1.0,
    "lowest_energy_mj": 0.002,
    "guarded_percent": 1.0,
}
_NEVER_NEGATIVE = ("peak_n", "guarded_percent")
# The strip of the crosses, as a share of the range above it, and where they stand in the panel.
_STRIP = 0.16
_CROSS = 0.5 * _STRIP / (1.0 + _STRIP)
# what a name in the legend takes [inch]
_NAME_IN = 1.45


def merits_figure(merits: Sequence[Merit]) -> "Figure":
    """Draw each figure of merit over the laws, a row a figure and a column a network; runs that failed as crosses."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    networks = list(dict.fromkeys(merit.network for merit in merits))
    laws = list(dict.fromkeys(merit.law for merit in merits))
    hands = list(dict.fromkeys(merit.hand for merit in merits))
    figure = Figure(figsize=(2.6 + 2.4 * len(networks), 1.2 + 1.6 * len(FIGURES)), layout="constrained")
    axes = figure.subplots(len(FIGURES), len(networks), squeeze=False, sharex=True, sharey="row")
    for column, network in enumerate(networks):
        axes[0, column].set_title(str(network).replace(", loss", ",\nloss"), fontsize="small")
        shown = [merit for merit in merits if merit.network == network]
        for row, name in enumerate(FIGURES):
            _dots(axes[row, column], shown, laws, hands, name)
        axes[-1, column].set_xticks(
            range(len(laws)), [law.replace("_", " ") for law in laws], rotation=90, fontsize="small"
        )
    for row, (name, title) in enumerate(FIGURES.items()):
        _scaled(axes[row], name)
        axes[row, 0].set_ylabel(title.replace(" [", "\n["), fontsize="small")
    handles = [
        Line2D([], [], color=_HAND_LOOKS[hand][0], marker=_HAND_LOOKS[hand][1], linestyle="", label=_hand_words(hand))
        for hand in hands
    ]
    look: dict[str, Any] = {"color": "0.3", "marker": "o", "linestyle": ""}
    handles += [
        Line2D([], [], label="clamp on", **look),
        Line2D([], [], label="clamp off", markerfacecolor="none", **look),
        Line2D([], [], color="0.3", marker="x", linestyle="", label="a run is not stable"),
    ]
    # a narrow figure has room for fewer names beside one another
    columns = max(2, min(len(handles), int(figure.get_size_inches()[0] / _NAME_IN)))
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, fontsize="small")
    return figure


def _scaled(axes: "Sequence[Axes]", name: str) -> None:
    """Give a row of panels its range of values and, where runs failed, a grey strip below it, which no tick reads."""
    low, high = axes[0].get_ylim()
    missing = 0.5 * max(0.0, _LEAST_RANGE[name] - (high - low))
    low, high = low - missing, high + missing
    if name in _NEVER_NEGATIVE:
        low = max(low, -0.04 * high)
    has_crosses = any(line.get_marker() == "x" for axis in axes for line in axis.lines)
    strip = _STRIP * (high - low) if has_crosses else 0.0
    axes[0].set_ylim(low - strip, high)
    ticks = [
        tick for tick in axes[0].get_yticks() if low <= tick <= high and (tick >= 0.0 or name not in _NEVER_NEGATIVE)
    ]
    axes[0].set_yticks(ticks)
    if has_crosses:
        for axis in axes:
            axis.axhspan(low - strip, low, color="0.92", linewidth=0.0, zorder=-1)


def _hand_words(hand: str) -> str:
    return "constant force" if hand == "force" else f"{hand} arm"


def _dots(axis: "Axes", merits: Sequence[Merit], laws: Sequence[str], hands: Sequence[str], name: str) -> None:
    """Draw one figure of merit over the laws, the seeds' spread as a bar."""
    places = 2 * len(hands)
    for merit in merits:
        colour, mark = _HAND_LOOKS[merit.hand]
        place = 2 * hands.index(merit.hand) + merit.clamp
        x = laws.index(merit.law) + 0.8 * ((place + 0.5) / places - 0.5)
        spread = merit.figures[name]
        if spread is None and merit.stable == len(merit.results):
            # This hand does not have the figure.
            continue
        if merit.stable < len(merit.results) or spread is None:
            axis.plot([x], [_CROSS], "x", color=colour, markersize=4, transform=axis.get_xaxis_transform())
            continue
        axis.plot([x, x], [spread.least, spread.most], "-", color=colour, linewidth=1.0)
        face = colour if merit.clamp else "none"
        axis.plot([x], [spread.median], mark, color=colour, markerfacecolor=face, markersize=4)
    if name in _IDEAL:
        axis.axhline(_IDEAL[name], color="0.6", linewidth=0.8, zorder=0)
    for edge in range(len(laws) - 1):
        axis.axvline(edge + 0.5, color="0.9", linewidth=0.6, zorder=0)
    axis.set_xlim(-0.5, len(laws) - 0.5)
    axis.margins(y=0.18)
    axis.tick_params(which="both", labelsize="small")
    axis.ticklabel_format(axis="y", useOffset=False)


def impedance_figure(spectra: Sequence[Spectrum]) -> "Figure":
    """Draw rendered stiffness and free damping over frequency, a row a delay, a line a law."""
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
    """Draw the size of the four entries of the hybrid matrix over frequency at one delay, a line a law."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    titles = ("|h11|, impedance of free motion [N s/m]", "|h12|, force to the hand (ideal: 1)",
              "|h21|, motion to the tip (ideal: 1)", "|h22|, give of the held tip [m/(N s)]")  # fmt: skip
    for entry, (axis, title) in enumerate(zip(axes.flat, titles, strict=True)):
        for spectrum in spectra:
            _line(axis, spectrum, [None if found is None else abs(found[entry]) for found in spectrum.hybrid])
        axis.set_title(title, loc="left", fontsize="small")
        axis.set_yscale("log")
        axis.tick_params(which="both", labelsize="small")
    # Below what the hand can feel, the entries are only the rest of the sums of a run.
    axes[1, 1].set_ylim(bottom=1e-6)
    _finish(figure, axes, spectra)
    return figure


def _line(axis: "Axes", spectrum: Spectrum, values: Sequence[float | None]) -> None:
    colour, mark, style = LAW_LOOKS[spectrum.law]
    known = [np.nan if value is None else value for value in values]
    if not np.isnan(known).all():
        axis.plot(
            spectrum.frequencies_hz, known, mark, linestyle=style, color=colour, markersize=3.5, linewidth=1.2,
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
