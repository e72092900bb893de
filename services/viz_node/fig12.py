"""The paper's Fig. 12 from the series of a session: forces, positions, and the force-distance path of the tip."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from services.viz_node.figure_style import (
    COLUMN_IN,
    HAND,
    ON_SCREEN,
    REFERENCE,
    TIP,
    FigureOptions,
    drawn,
    lettered,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Series = npt.NDArray[np.float64]

# a pause in a series of a sample a millisecond
_LONGEST_STEP_S = 0.05
# A distance that goes back by less than this share of its span has not turned back.
_TURN_SHARE = 0.05
# between two samples of a millisecond, in which the base of Fig. 12 goes 15 pm; and against the steps just before
_JUMP_M = 1e-10
_JUMP_RATIO = 4.0
# A jump to or off contact crosses most of the distance. A cantilever of 40 N/m does not: the meniscus that forms at 2.4
# nm draws its tip 0.12 nm nearer.
_CONTACT_SHARE = 0.5
_TO, _OFF = ("jump to contact", "meniscus forms"), ("jump off contact", "meniscus breaks")


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


def draw_fig12(series: SessionSeries, title: str, options: FigureOptions = ON_SCREEN) -> "Figure":
    """Draw the three panels of Fig. 12: F_m and alpha_f F_s, x_mr and x_m, and F_s against h.

    For paper it is one column wide and has no title, whose words belong in the caption.
    """
    # the numbers of a session are read without what draws them
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    paper = options.style == "paper"
    with styled(options):
        figure = Figure(figsize=(COLUMN_IN, 6.2) if paper else (7.2, 9.0), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(3, 1)
        _draw_forces(panels[0], series)
        _draw_positions(panels[1], series)
        _draw_path(panels[2], series)
        lettered(list(panels), options)
        if not paper:
            figure.suptitle(title, fontsize=11)
    return figure


def fig12_files(
    series: SessionSeries, title: str, options: FigureOptions = ON_SCREEN, origin: str = ""
) -> dict[str, bytes]:
    """Return the figure in its formats, by file name; each has in it what it was made from, in words."""
    return drawn(draw_fig12(series, title, options), "fig12", options, origin)


def _draw_forces(axes: "Axes", series: SessionSeries) -> None:
    scaled = series.force_scale * series.tip_force_n
    _shade_gaps(axes, series)
    axes.plot(
        *_broken(series, series.tip_time_s, scaled),
        color=TIP,
        lw=1.0,
        label=r"$\alpha_f F_s$ (tip)",
    )
    axes.plot(
        *_broken(series, series.hand_time_s, series.hand_force_n), color=HAND, lw=1.4, ls="--", label=r"$F_m$ (hand)"
    )
    axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
    axes.set(xlabel="time (s)", ylabel="force (N)", xlim=_span(series))
    _legend_above(axes)


def _draw_positions(axes: "Axes", series: SessionSeries) -> None:
    _shade_gaps(axes, series)
    reference = _broken(series, series.reference_time_s, 100.0 * series.reference_m)
    axes.plot(*reference, color=REFERENCE, lw=2.2, label=r"$x_{mr}$ (law)")
    hand = _broken(series, series.hand_time_s, 100.0 * series.hand_position_m)
    axes.plot(*hand, color=HAND, lw=1.0, ls="--", label=r"$x_m$ (device)")
    axes.set(xlabel="time (s)", ylabel="position (cm)", xlim=_span(series))
    _legend_above(axes)


def _draw_path(axes: "Axes", series: SessionSeries) -> None:
    time_s, separation_m = _broken(series, series.tip_time_s, series.separation_m)
    _, force_n = _broken(series, series.tip_time_s, series.tip_force_n)
    retracts = retracting(time_s, separation_m)
    for chosen, colour, style, label in ((~retracts, HAND, "-", "approach"), (retracts, TIP, "--", "retraction")):
        if not chosen.any():
            continue
        # a sample of the other branch ends a line, and is its last point
        inside = chosen | np.concatenate([[False], chosen[:-1]])
        distance_nm = np.where(inside, 1e9 * separation_m, np.nan)
        axes.plot(distance_nm, 1e9 * force_n, color=colour, ls=style, lw=0.9, label=label)
    axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
    _mark_jumps(axes, separation_m, force_n)
    axes.set(xlabel="tip-sample distance h (nm)", ylabel=r"$F_s$ (nN)")
    _legend_above(axes)


def retracting(time_s: Series, separation_m: Series) -> npt.NDArray[np.bool_]:
    """Return for each sample whether the tip is on its way from the sample: shape (n,), False before it first moves."""
    known = separation_m[np.isfinite(separation_m)]
    if known.size < 2:
        return np.zeros(len(separation_m), dtype=bool)
    least_m = _TURN_SHARE * float(np.ptp(known))
    away, turned_m, turn, found = False, float(known[0]), 0, np.zeros(len(separation_m), dtype=bool)
    for index, distance in enumerate(separation_m.tolist()):
        if not np.isfinite(distance):
            found[index] = away
            continue
        # the last extreme, and whether the tip has left it by more than noise and ripple
        if (distance >= turned_m) if away else (distance <= turned_m):
            turned_m, turn = distance, index
        if abs(distance - turned_m) > least_m:
            away = not away
            # it was on this way from the extreme on
            found[turn + 1 : index] = away
            turned_m, turn = distance, index
        found[index] = away
    return found


def _mark_jumps(axes: "Axes", separation_m: Series, force_n: Series) -> None:
    """Write beside the path where the tip jumps to the sample or its water takes hold of it, and where either ends."""
    steps_m = np.diff(separation_m)
    if not np.isfinite(steps_m).any():
        return
    to, off = int(np.nanargmin(steps_m)), int(np.nanargmax(steps_m))
    for place, size_m, names, below in ((to, -steps_m[to], _TO, -14), (off, steps_m[off], _OFF, 14)):
        before_m = np.abs(steps_m[max(0, place - 3) : place])
        usual_m = float(np.nanmax(before_m)) if np.isfinite(before_m).any() else 0.0
        if size_m > max(_JUMP_M, _JUMP_RATIO * usual_m):
            where = (1e9 * separation_m[place], 1e9 * force_n[place])
            ends_m = sorted(separation_m[place : place + 2].tolist())
            axes.annotate(
                names[ends_m[0] > _CONTACT_SHARE * ends_m[1]], where, xytext=(12, below), textcoords="offset points",
                fontsize=8, arrowprops={"arrowstyle": "->", "lw": 0.6},
            )  # fmt: skip


def _legend_above(axes: "Axes") -> None:
    """Put the legend over the panel, where it hides no data."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=8, frameon=False, borderaxespad=0.2)


def _shade_gaps(axes: "Axes", series: SessionSeries) -> None:
    for first_s, last_s in series.gaps_s:
        axes.axvspan(first_s, last_s, color="0.9", zorder=-1)


def _broken(series: SessionSeries, time_s: Series, values: Series) -> tuple[Series, Series]:
    """Return a series with NaN where it pauses, if the recording has gaps: no line is drawn across them."""
    if not series.gaps_s:
        return time_s, values
    places = np.flatnonzero(np.diff(time_s) > _LONGEST_STEP_S) + 1
    return np.insert(time_s, places, np.nan), np.insert(values, places, np.nan)


def _span(series: SessionSeries) -> tuple[float, float]:
    return 0.0, float(max(times[-1] for times in (series.hand_time_s, series.tip_time_s) if times.size))
