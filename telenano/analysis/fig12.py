"""The paper's Fig. 12 from the series of a session: forces, positions, and the force-distance path of the tip."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.figure_style import HAND, ON_SCREEN, TIP, FigureOptions

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Series = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# A longer step [s] is a pause in a series with a sample per millisecond.
_LONGEST_STEP_S = 0.05
# The tip has turned once it went back by more than this share of its range, in contact and off it separately [1].
_TURN_SHARE = 0.05
# labels for the begin and the end of a state of the tip, as the recording states them
_WORDS = {"meniscus": ("meniscus forms", "meniscus breaks"), "in_contact": ("contact begins", "contact ends")}
# distances from its point [pt] and directions [degree] in which a label is tried
_LABEL_PT = (22.0, 30.0, 40.0, 56.0, 72.0, 90.0, 120.0)
_LABEL_DEGREES = (-35.0, 35.0, -145.0, 145.0, 0.0, 180.0, -80.0, 80.0, -60.0, 60.0, -120.0, 120.0, -15.0, 15.0)
# number of letters of a title that fit the width of the figure
_TITLE_WIDTH = 88


class TipStates(NamedTuple):
    """States of the tip from the instrument, each of shape (n,), at the times of `SessionSeries.tip_time_s`.

    led: the tip follows the hand, or holds its place for it (modes follow and hold); limited: a limit of speed or
    travel acts on the base; in_contact, meniscus: as in afm/state, all False if the instrument cannot know.
    """

    led: Flags
    limited: Flags
    in_contact: Flags
    meniscus: Flags


class TipPath(NamedTuple):
    """The path of the tip while the hand moves it, each of shape (n,); h [m] and F_s [N] are NaN elsewhere."""

    separation_m: Series
    force_n: Series
    in_contact: Flags
    meniscus: Flags


@dataclass(frozen=True)
class SessionSeries:
    """The series of Fig. 12, each quantity on its own time axis [s], zero at the start of the session.

    hand_force_n F_m, hand_position_m x_m at hand_time_s; reference_m x_mr at reference_time_s; tip_force_n F_s,
    separation_m h at tip_time_s, NaN where the instrument does not know it; force_scale is alpha_f; gaps_s are the
    spans [s] in which samples are missing from the recording; states are those of the tip, None if not known. Forces
    are in N, positions in m.
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
    states: TipStates | None = None

    def tip_path(self) -> TipPath:
        """Return the path of the tip while the hand moves it, and on its return after a guard withdrew it.

        It leaves out the lowering of the tip to the hand, and a withdrawal beyond the greatest distance under the hand.
        """
        states = self.states
        if states is None:
            no = np.zeros(len(self.tip_time_s), dtype=bool)
            states = TipStates(~no, no, no, no)
        shown = _under_the_hand(states) & (self.tip_time_s >= 0.0)
        separation_m = np.where(shown, self.separation_m, np.nan)
        reach_m = float(np.nanmax(separation_m, initial=-math.inf))
        for index in np.flatnonzero(shown[:-1] & ~states.led[1:] & (self.tip_time_s[1:] >= 0.0)).tolist():
            way_m = self.separation_m[index + 1 :]
            beyond = states.led[index + 1 :] | ~(way_m <= reach_m)
            count = int(np.argmax(beyond)) if beyond.any() else len(way_m)
            separation_m[index + 1 : index + 1 + count] = way_m[:count]
        pauses = self._pauses(self.tip_time_s)
        flags = (np.insert(each, pauses, False) for each in (states.in_contact, states.meniscus))
        return TipPath(np.insert(separation_m, pauses, np.nan), np.insert(self.tip_force_n, pauses, np.nan), *flags)

    def broken(self, time_s: Series, values: Series) -> tuple[Series, Series]:
        """Return a series from the start of the session on, with NaN at its pauses if the recording has gaps."""
        time_s, values = time_s[time_s >= 0.0], values[time_s >= 0.0]
        pauses = self._pauses(time_s)
        return np.insert(time_s, pauses, np.nan), np.insert(values, pauses, np.nan)

    def _pauses(self, time_s: Series) -> npt.NDArray[np.int64]:
        return np.flatnonzero(np.diff(time_s) > _LONGEST_STEP_S) + 1 if self.gaps_s else np.empty(0, np.int64)


def draw_fig12(series: SessionSeries, title: str, options: FigureOptions = ON_SCREEN) -> "Figure":
    """Draw the three panels of Fig. 12: F_m and alpha_f F_s, x_mr and x_m, and F_s against h.

    In the style for paper, the figure is one column wide and has no title, which belongs in the caption.
    """
    # imported here, so that the numbers of a session can be read without matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    paper = options.style == "paper"
    with options.styled():
        figure = Figure(figsize=(FigureOptions.COLUMN_IN, 6.2) if paper else (7.2, 9.0), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(3, 1)
        _draw_forces(panels[0], series)
        _draw_positions(panels[1], series)
        _draw_path(panels[2], series)
        options.lettered(list(panels))
        if not paper:
            figure.suptitle("\n".join(fill(line, _TITLE_WIDTH) for line in title.splitlines()), fontsize=11)
        _mark_states(panels[2], series.tip_path())
    return figure


def draw_columns(
    time_s: npt.NDArray[np.float64], columns: Mapping[str, tuple[npt.NDArray[Any], str]], title: str
) -> "Figure":
    """Draw columns over the time [s], each given with its unit: one panel per column, one below the other."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with ON_SCREEN.styled():
        figure = Figure(figsize=(7.2, 1.2 + 2.2 * len(columns)), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (name, (values, unit)) in zip(panels, columns.items(), strict=True):
            axes.plot(time_s, values, color=HAND, lw=1.0)
            axes.set_ylabel(f"{name.removesuffix(f'_{unit.lower()}')} ({unit})" if unit else name)
        panels[-1].set_xlabel("time (s)")
        figure.suptitle(fill(title, _TITLE_WIDTH), fontsize=11)
    return figure


def fig12_files(
    series: SessionSeries, title: str, options: FigureOptions = ON_SCREEN, origin: str = ""
) -> dict[str, bytes]:
    """Return the figure in its formats, by file name; each file contains its origin in words."""
    return options.drawn(draw_fig12(series, title, options), "fig12", origin)


def _draw_forces(axes: "Axes", series: SessionSeries) -> None:
    scaled = series.force_scale * series.tip_force_n
    _shade_gaps(axes, series)
    axes.plot(
        *series.broken(series.tip_time_s, scaled),
        color=TIP,
        lw=1.0,
        label=r"$\alpha_f F_s$ (tip)",
    )
    axes.plot(
        *series.broken(series.hand_time_s, series.hand_force_n), color=HAND, lw=1.4, ls="--", label=r"$F_m$ (hand)"
    )
    axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
    axes.set(xlabel="time (s)", ylabel="force (N)", xlim=_span(series))
    _legend_above(axes)


def _draw_positions(axes: "Axes", series: SessionSeries) -> None:
    _shade_gaps(axes, series)
    reference = series.broken(series.reference_time_s, 100.0 * series.reference_m)
    axes.plot(*reference, color=FigureOptions.REFERENCE, lw=2.2, label=r"$x_{mr}$ (law)")
    hand = series.broken(series.hand_time_s, 100.0 * series.hand_position_m)
    axes.plot(*hand, color=HAND, lw=1.0, ls="--", label=r"$x_m$ (device)")
    axes.set(xlabel="time (s)", ylabel="position (cm)", xlim=_span(series))
    _legend_above(axes)


def _draw_path(axes: "Axes", series: SessionSeries) -> None:
    path = series.tip_path()
    retracts = retracting(path.separation_m, path.in_contact)
    for chosen, colour, style, label in ((~retracts, HAND, "-", "approach"), (retracts, TIP, "--", "retraction")):
        # The last point of a line is the first sample of the other branch, so that both join.
        inside = chosen | np.concatenate([[False], chosen[:-1]])
        distance_nm = np.where(inside, 1e9 * path.separation_m, np.nan)
        if np.isfinite(distance_nm[chosen]).any():
            axes.plot(distance_nm, 1e9 * path.force_n, color=colour, ls=style, lw=0.9, label=label)
    axes.set(xlabel="tip-sample distance h (nm)", ylabel=r"$F_s$ (nN)")
    if not axes.lines:
        text = "no tip-sample distance is recorded\nwhile the tip follows the hand"
        axes.text(0.5, 0.5, text, ha="center", va="center", fontsize=8, transform=axes.transAxes)
        axes.set(xticks=[], yticks=[])
        return
    axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
    _legend_above(axes)


def _under_the_hand(states: TipStates) -> Flags:
    """Return for each sample whether the hand moves the tip.

    An armed base first moves from its withdrawn place to the hand's reference at its speed limit, which is stated as
    `limited`. The hand moves the tip once that is over, or once the tip touches the sample, whichever is first.
    """
    shown = np.zeros(len(states.led), dtype=bool)
    reached = states.in_contact | states.meniscus
    placed = False
    for index in range(len(shown)):
        if not states.led[index]:
            placed = False
        elif not placed and (reached[index] or not states.limited[index]):
            placed = True
            # The path to the place of the first touch starts one sample earlier.
            if reached[index] and index and states.led[index - 1]:
                shown[index - 1] = True
        shown[index] = placed
    return shown


def retracting(separation_m: Series, in_contact: Flags) -> Flags:
    """Return for each sample whether the tip is moving away from the sample.

    Args:
        separation_m: The distance h [m], shape (n,). NaN separates one path from the next.
        in_contact: Whether the tip touches, shape (n,). In contact the tip turns within a fraction of a nanometre.

    Returns:
        Shape (n,), False before the tip first moves.
    """
    is_retracting = np.zeros(len(separation_m), dtype=bool)
    is_finite = np.isfinite(separation_m)
    least_m = np.zeros(len(separation_m))
    for touching in (is_finite & in_contact, is_finite & ~in_contact):
        if touching.any():
            least_m[touching] = _TURN_SHARE * float(np.ptp(separation_m[touching]))
    ends = np.flatnonzero(np.diff(is_finite, prepend=False, append=False))
    for first, last in zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True):
        is_retracting[first:last] = _away(separation_m[first:last].tolist(), least_m[first:last].tolist())
    return is_retracting


def _away(distances_m: Sequence[float], least_m: Sequence[float]) -> list[bool]:
    """Return for each sample of one path whether it leads away; a new direction counts from its extreme on."""
    is_away = [False] * len(distances_m)
    away, turned_m, turn = False, distances_m[0], 0
    for index, distance in enumerate(distances_m):
        # Keep the last extreme; below, the tip has turned once it left that by more than noise and ripple.
        if (distance >= turned_m) if away else (distance <= turned_m):
            turned_m, turn = distance, index
        if abs(distance - turned_m) > least_m[index]:
            away = not away
            is_away[turn + 1 : index] = [away] * (index - turn - 1)
            turned_m, turn = distance, index
        is_away[index] = away
    return is_away


def _mark_states(axes: "Axes", path: TipPath) -> None:
    """Label the first begin and the first end of meniscus and contact on the path, as the instrument states them.

    An arrow points at the last sample before the change, from which the tip jumps.
    """
    is_finite = np.isfinite(path.separation_m)
    seen = is_finite[:-1] & is_finite[1:]
    words: dict[int, list[str]] = {}
    for name, texts in _WORDS.items():
        steps = np.diff(getattr(path, name).astype(int))
        for text, step in zip(texts, (1, -1), strict=True):
            places = np.flatnonzero(seen & (steps == step)).tolist()
            if places:
                words.setdefault(places[0], []).append(f"{text} (first of {len(places)})" if places[1:] else text)
    labels = [(1e9 * float(path.separation_m[at]), 1e9 * float(path.force_n[at]), texts) for at, texts in words.items()]
    _write_labels(axes, sorted(labels, key=lambda label: -label[1]))


def _write_labels(axes: "Axes", labels: Sequence[tuple[float, float, Sequence[str]]]) -> None:
    """Write texts near their points, inside the panel and clear of its curves, each with an arrow to its point.

    No arrow crosses another one or a text where the panel has room for that.
    """
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    if not labels:
        return
    # The layout, which determines the size of the panel, is made while drawing.
    figure: Any = axes.get_figure()
    figure.draw_without_rendering()
    frame, per_point = axes.get_window_extent(), figure.dpi / 72.0
    curves = np.concatenate([line.get_transform().transform(line.get_xydata()) for line in axes.lines])
    shares = np.arange(0.0, 1.0, 0.125)[:, None, None]
    between = (curves[:-1] + shares * np.diff(curves, axis=0)).reshape(-1, 2)
    # Points within one pixel count once.
    between = np.unique(np.round(between[np.isfinite(between).all(axis=1)]), axis=0)
    tried, written = [], []
    for x_nm, force_nn, texts in labels:
        label = axes.annotate(
            "\n".join(texts), (x_nm, force_nn), xytext=(0, 0), textcoords="offset points", ha="center", va="center",
            fontsize=8, arrowprops={"arrowstyle": "->", "lw": 0.6, "shrinkB": 1.0},
        )  # fmt: skip
        written.append(label)
        size, point = Text.get_window_extent(label), axes.transData.transform((x_nm, force_nn))

        def beside(distance_pt: float, degrees: float, size: Bbox = size, point: Series = point) -> _Place:
            # The box is beyond the distance sideways, and centred above or below the point.
            across, up = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
            x = point[0] + per_point * distance_pt * across + 0.5 * size.width * (across - 1.0)
            y = point[1] + per_point * distance_pt * up - 0.5 * size.height
            box = Bbox.from_bounds(x, y, size.width, size.height).padded(2.0)
            outside = box.x0 < frame.x0 or box.x1 > frame.x1 or box.y0 < frame.y0 or box.y1 > frame.y1
            return _Place(outside, box.count_contains(between), box, point)

        tried.append([beside(*place) for place in product(_LABEL_PT, _LABEL_DEGREES)])
    for label, place in zip(written, _arranged(tried), strict=True):
        away = place.box.get_points().mean(axis=0) - place.point
        label.set_position(tuple((away / per_point).tolist()))


@dataclass(frozen=True, eq=False)
class _Place:
    """A place of a label [pixel]: whether it is outside, what it hides of curves, its box, the point of its arrow."""

    outside: bool
    hidden: int
    box: Any
    point: Series

    def arrow(self) -> Series:
        """Return points along the arrow, shape (33, 2)."""
        middle = self.box.get_points().mean(axis=0)
        return np.asarray(middle + np.linspace(0.0, 1.0, 33)[:, None] * (self.point - middle))

    def meets(self, other: "_Place") -> bool:
        """Return whether text or arrow of two labels meet."""
        own, others = self.arrow(), other.arrow()
        return bool(
            self.box.overlaps(other.box)
            or self.box.count_contains(others)
            or other.box.count_contains(own)
            or _cross(own[[0, -1]], others[[0, -1]])
        )


def _arranged(tried: Sequence[Sequence[_Place]]) -> list[_Place]:
    """Return a place for each label, of those that are tried for it, the nearest first.

    The first arrangement in which no two labels meet is taken: one that hides no curve, else one inside the panel.
    Where there is none, each label has the place with the fewest faults beside those before it.
    """
    meets = cache(_Place.meets)

    def beside(chosen: list[_Place], allowed: Sequence[Sequence[_Place]]) -> list[_Place] | None:
        if len(chosen) == len(allowed):
            return chosen
        free = (place for place in allowed[len(chosen)] if not any(meets(place, other) for other in chosen))
        return next((found for place in free if (found := beside([*chosen, place], allowed)) is not None), None)

    inside = [[place for place in places if not place.outside] for places in tried]
    for allowed in ([[place for place in places if not place.hidden] for places in inside], inside):
        if (found := beside([], allowed)) is not None:
            return found
    chosen: list[_Place] = []
    for places in tried:
        faults = [
            (
                place.outside,
                sum(place.box.overlaps(other.box) for other in chosen),
                sum(meets(place, other) for other in chosen),
                place.hidden,
            )
            for place in places
        ]
        chosen.append(places[faults.index(min(faults))])
    return chosen


def _cross(one: Series, other: Series) -> bool:
    """Return whether two lines between points, shape (2, 2), cross; a point in common does not count."""

    def side(line: Series, point: Series) -> float:
        (x, y), (x_end, y_end) = line
        return float(np.sign((x_end - x) * (point[1] - y) - (y_end - y) * (point[0] - x)))

    parted = side(one, other[0]) * side(one, other[1]), side(other, one[0]) * side(other, one[1])
    return max(parted) < 0.0


def _legend_above(axes: "Axes") -> None:
    """Put the legend over the panel, where it hides no data."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=8, frameon=False, borderaxespad=0.2)


def _shade_gaps(axes: "Axes", series: SessionSeries) -> None:
    for first_s, last_s in series.gaps_s:
        axes.axvspan(first_s, last_s, color="0.9", zorder=-1)


def _span(series: SessionSeries) -> tuple[float, float]:
    return 0.0, float(max(times[-1] for times in (series.hand_time_s, series.tip_time_s) if times.size))
