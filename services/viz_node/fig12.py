"""The paper's Fig. 12 from the series of a session: forces, positions, and the force-distance path of the tip."""

from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

Series = npt.NDArray[np.float64]

_DOTS_PER_INCH = 130
# a pause in a series of a sample a millisecond
_LONGEST_STEP_S = 0.05
_HAND, _TIP, _REFERENCE = "#1f4e79", "#c0392b", "#7f8c8d"


@dataclass(frozen=True)
class SessionSeries:
    """What Fig. 12 shows, each quantity on its own time axis [s], zero at the start of the session.

    hand_force_n F_m, hand_position_m x_m at hand_time_s; reference_m x_mr at reference_time_s; tip_force_n F_s,
    separation_m h at tip_time_s; force_scale is alpha_f; gaps_s are the spans of which the recording lacks samples.
    """

    hand_time_s: Series
    hand_force_n: Series
    hand_position_m: Series
    reference_time_s: Series
    reference_m: Series
    tip_time_s: Series
    tip_force_n: Series
    separation_m: Series
    force_scale: float
    gaps_s: tuple[tuple[float, float], ...] = ()


def draw_fig12(series: SessionSeries, title: str) -> Figure:
    """Draw the three panels of Fig. 12: F_m and alpha_f F_s, x_mr and x_m, and F_s against h."""
    figure = Figure(figsize=(7.2, 9.0), layout="constrained")
    FigureCanvasAgg(figure)
    forces, positions, path = figure.subplots(3, 1)
    _draw_forces(forces, series)
    _draw_positions(positions, series)
    _draw_path(path, series)
    figure.suptitle(title, fontsize=11)
    return figure


def save_fig12(series: SessionSeries, title: str, file: BinaryIO) -> None:
    """Write the figure as PNG."""
    draw_fig12(series, title).savefig(file, dpi=_DOTS_PER_INCH, format="png")


def _draw_forces(axes: Axes, series: SessionSeries) -> None:
    scaled = series.force_scale * series.tip_force_n
    _shade_gaps(axes, series)
    axes.plot(
        *_broken(series, series.tip_time_s, scaled),
        color=_TIP,
        lw=1.0,
        label=r"$\alpha_f F_s$ (tip, at the hand's scale)",
    )
    axes.plot(
        *_broken(series, series.hand_time_s, series.hand_force_n), color=_HAND, lw=1.4, ls="--", label=r"$F_m$ (hand)"
    )
    axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
    axes.set(xlabel="time (s)", ylabel="force (N)", xlim=_span(series))
    axes.legend(loc="upper left", fontsize=8, frameon=False)


def _draw_positions(axes: Axes, series: SessionSeries) -> None:
    _shade_gaps(axes, series)
    reference = _broken(series, series.reference_time_s, 100.0 * series.reference_m)
    axes.plot(*reference, color=_REFERENCE, lw=2.2, label=r"$x_{mr}$ (law)")
    hand = _broken(series, series.hand_time_s, 100.0 * series.hand_position_m)
    axes.plot(*hand, color=_HAND, lw=1.0, ls="--", label=r"$x_m$ (device)")
    axes.set(xlabel="time (s)", ylabel="position (cm)", xlim=_span(series))
    axes.legend(loc="lower right", fontsize=8, frameon=False)


def _draw_path(axes: Axes, series: SessionSeries) -> None:
    _, separation_m = _broken(series, series.tip_time_s, series.separation_m)
    _, force_n = _broken(series, series.tip_time_s, series.tip_force_n)
    axes.plot(1e9 * separation_m, 1e9 * force_n, color=_TIP, lw=0.9)
    axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
    axes.set(xlabel="tip-sample distance h (nm)", ylabel=r"$F_s$ (nN)")


def _shade_gaps(axes: Axes, series: SessionSeries) -> None:
    for first_s, last_s in series.gaps_s:
        axes.axvspan(first_s, last_s, color="0.9", zorder=-1)


def _broken(series: SessionSeries, time_s: Series, values: Series) -> tuple[Series, Series]:
    """Return a series with NaN where it pauses, if the recording has gaps: no line is drawn across them."""
    if not series.gaps_s:
        return time_s, values
    places = np.flatnonzero(np.diff(time_s) > _LONGEST_STEP_S) + 1
    return np.insert(time_s, places, np.nan), np.insert(values, places, np.nan)


def _span(series: SessionSeries) -> tuple[float, float]:
    return 0.0, float(max(series.hand_time_s[-1], series.tip_time_s[-1]))
