"""Faults in the layout of a figure: text cut off at its edge, overlapping labels, equal ticks."""

from collections.abc import Iterator
from itertools import combinations
from typing import Any, NamedTuple

# Tolerance for rounding to whole dots.
_SLACK_DOTS = 1.5


class Placed(NamedTuple):
    """A text or a legend of a figure: its description, its box in dots, and the legend that it belongs to."""

    what: str
    box: Any
    legend: Any = None


def faults(figure: Any) -> list[str]:
    """Return a sentence for each fault in the layout of a figure of matplotlib."""
    figure.draw_without_rendering()
    placed = [*_labels(figure), *_legends(figure)]
    found = [f"{one.what} is cut off by {_beyond(one.box, figure.bbox):.0f} dots" for one in placed
             if _beyond(one.box, figure.bbox) > _SLACK_DOTS]  # fmt: skip
    found += [
        f"{one.what} lies over {other.what}" for one, other in combinations(placed, 2) if _overlap(one.box, other.box)
    ]
    for axes in figure.axes:
        found += _across_frame(axes)
        for axis in (axes.xaxis, axes.yaxis):
            found += _ticks(axis)
    return found


def arrows(axes: Any) -> dict[str, tuple[float, float]]:
    """Return the place to which the arrow of each label of a panel points, by the lines of the labels."""
    return {line: tuple(map(float, text.xy)) for text in axes.texts for line in text.get_text().splitlines()}


def _across_frame(axes: Any) -> list[str]:
    """Return a sentence for each text in a panel that its frame crosses."""
    frame = axes.get_window_extent()
    shown = [text for text in axes.texts if text.get_visible() and text.get_text().strip()]
    boxes = [(text.get_text(), text.get_window_extent()) for text in shown]
    return [
        f"the frame goes through {name!r}"
        for name, box in boxes
        if _overlap(box, frame) and _beyond(box, frame) > _SLACK_DOTS
    ]


def _labels(figure: Any) -> Iterator[Placed]:
    """Yield titles and labels of the axes, and the texts of the figure."""
    texts = [*figure.texts, figure._suptitle, figure._supxlabel, figure._supylabel]
    for axes in figure.axes:
        if axes.get_visible() and axes.axison:
            texts += [axes.title, axes._left_title, axes._right_title, axes.xaxis.label, axes.yaxis.label]
            texts += [axis.get_offset_text() for axis in (axes.xaxis, axes.yaxis)]
    # A title of the figure is also one of its texts, so drop duplicates.
    for text in dict.fromkeys(texts):
        if text is not None and text.get_visible() and text.get_text().strip():
            yield Placed(repr(text.get_text()), text.get_window_extent())


def _legends(figure: Any) -> Iterator[Placed]:
    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes)]
    for legend in legends:
        if legend is not None and legend.get_visible():
            words = ", ".join(text.get_text() for text in legend.get_texts())
            yield Placed(f"the legend of {words[:60]}", legend.get_window_extent())
            for text in legend.get_texts():
                if _beyond(text.get_window_extent(), legend.get_window_extent()) > _SLACK_DOTS:
                    yield Placed(f"{text.get_text()!r} beyond its legend", figure.bbox.expanded(2.0, 2.0))


def _ticks(axis: Any) -> list[str]:
    """Return a sentence for each fault of the visible tick labels of an axis."""
    low, high = sorted(axis.get_view_interval())
    slack = 1e-9 * (high - low)
    labels = [
        tick.label1
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks())
        if low - slack <= tick.get_loc() <= high + slack and tick.label1.get_visible() and tick.label1.get_text()
    ]
    figure = axis.get_figure()
    found = [f"the tick {label.get_text()!r} is cut off" for label in labels
             if _beyond(label.get_window_extent(), figure.bbox) > _SLACK_DOTS]  # fmt: skip
    for one, other in combinations(labels, 2):
        if one.get_text() == other.get_text():
            found.append(f"two ticks read {one.get_text()!r}")
        elif _overlap(one.get_window_extent(), other.get_window_extent()):
            found.append(f"the tick {one.get_text()!r} lies over {other.get_text()!r}")
    return found


def _beyond(inner: Any, outer: Any) -> float:
    """Return the number of dots by which a box exceeds another; negative if it lies inside."""
    return float(max(outer.x0 - inner.x0, outer.y0 - inner.y0, inner.x1 - outer.x1, inner.y1 - outer.y1))


def _overlap(one: Any, other: Any) -> bool:
    width = min(one.x1, other.x1) - max(one.x0, other.x0)
    height = min(one.y1, other.y1) - max(one.y0, other.y0)
    return bool(width > _SLACK_DOTS and height > _SLACK_DOTS)
