"""The frontier of laws, a point a law: `python -m telenano_laws.frontier RUNS.CSV PICTURE.PNG`.

RUNS.CSV is what `telenano benchmark` writes. To the right is what follows worse, downwards what is softer; the colour
is the least energy at the ports, and the name has the share of the runs that were held.
"""

import argparse
import csv
import statistics
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")
from matplotlib.figure import Figure

from telenano.files import atomic_file

# over these the bar allows a tracking error of 0.35, over all others of 0.2
LONG_NETWORKS = frozenset({"satellite"})
# Every law is good without a delay, so these are left out.
PROMPT_NETWORKS = frozenset({"clean", "lan"})
BAR_STIFFNESS, BAR_TRACKING, BAR_LONG_TRACKING = 0.6, 0.2, 0.35
# energy below this is drawn in the deepest colour [mJ]
_LEAST_MJ = -2.0
# the greatest stiffness that is drawn
_TOP = 1.25


class Point(NamedTuple):
    """A law: medians of tracking error and stiffness ratio, least energy of any run [mJ], share of the runs held."""

    law: str
    tracking: float | None
    stiffness: float | None
    least_mj: float
    held: float


def points_of(rows: list[dict[str, str]], *, over_long: bool) -> list[Point]:
    """Return the points of the laws over the long networks or over the others; what was not held has no place."""
    rows_of: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        if row["network"] not in PROMPT_NETWORKS and (row["network"] in LONG_NETWORKS) == over_long:
            rows_of.setdefault(row["law"], []).append(row)
    return [_point(law, some) for law, some in sorted(rows_of.items())]


def _point(law: str, some: list[dict[str, str]]) -> Point:
    held = [row for row in some if row["verdict"] == "stable"]
    least = min(float(row["least_energy_mj"] or 0.0) for row in some)
    return Point(law, _median(held, "tracking_error"), _median(held, "stiffness_ratio"), least, len(held) / len(some))


def _median(rows: list[dict[str, str]], measure: str) -> float | None:
    numbers = [float(row[measure]) for row in rows if row[measure]]
    return statistics.median(numbers) if numbers else None


def frontier(rows: list[dict[str, str]]) -> Figure:
    """Return the figure: the long networks beside the others, with the corner that the bar asks for."""
    figure = Figure(figsize=(12.0, 4.8), layout="constrained")
    dots = None
    panels = figure.subplots(1, 2)
    for axes, over_long in zip(panels, (False, True), strict=True):
        bar = BAR_LONG_TRACKING if over_long else BAR_TRACKING
        axes.axvspan(0.0, bar, ymin=(BAR_STIFFNESS + 0.15) / (_TOP + 0.15), color="0.92", zorder=0)
        points = points_of(rows, over_long=over_long)
        shown = [point for point in points if point.tracking is not None and point.stiffness is not None]
        dots = axes.scatter(
            [point.tracking for point in shown],
            [_height(point) for point in shown],
            c=[max(point.least_mj, _LEAST_MJ) for point in shown],
            cmap="viridis",
            vmin=_LEAST_MJ,
            vmax=0.0,
            s=60,
            edgecolors="black",
        )
        # The names stand in a column, in the order of the points, so that none lies on another.
        level = _TOP
        for point in sorted(shown, key=_height, reverse=True):
            level = min(level - 0.075, _height(point) + 0.02)
            axes.annotate(
                f"{point.law} {point.held:.0%}",
                (point.tracking or 0.0, _height(point)),
                xytext=(1.02, level),
                fontsize=8,
                arrowprops={"arrowstyle": "-", "color": "0.7", "linewidth": 0.6},
            )
        nowhere = [f"{point.law} {point.held:.0%}" for point in points if point not in shown]
        held_none = f"\nheld nothing that is followed: {', '.join(nowhere)}" if nowhere else ""
        title = "round trips of 600 ms" if over_long else "round trips of 20 to 110 ms"
        axes.set_title(title + held_none, fontsize=9)
        axes.set(xlim=(0.0, 1.5), ylim=(-0.15, _TOP), xlabel="tracking error", ylabel="stiffness felt, of the true one")
    if dots is not None:
        figure.colorbar(dots, ax=panels, label=f"least energy at the ports [mJ], {_LEAST_MJ:g} or less")
    return figure


def _height(point: Point) -> float:
    return min(max(point.stiffness or 0.0, -0.1), _TOP)


def main() -> None:
    """Draw tracking against stiffness against energy, a point a law, from the ideal runs of a benchmark."""
    parser = argparse.ArgumentParser(prog="python -m telenano_laws.frontier", description=main.__doc__)
    parser.add_argument("runs", type=Path, help="runs.csv of a benchmark")
    parser.add_argument("picture", type=Path, help="file to write")
    options = parser.parse_args()
    with options.runs.open(encoding="utf-8", newline="") as file:
        # results of benchmark 2 have no such columns
        ideal = {"instrument": "ideal", "steadiness": "scripted"}
        rows = [row for row in csv.DictReader(file) if {key: row.get(key, ideal[key]) for key in ideal} == ideal]
    with atomic_file(options.picture) as part:
        frontier(rows).savefig(part, dpi=110, format=options.picture.suffix[1:] or "png")


if __name__ == "__main__":
    main()
