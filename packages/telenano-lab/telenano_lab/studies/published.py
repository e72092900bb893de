"""Points of published curves, to be drawn beneath those of a session, each with its reading error.

A file is a CSV table. Its first line is a comment with the source (authors, title, venue, year, figure); then come the
columns `panel,x,y,x_error,y_error` and, optionally, `note`. An error is the half width of the interval that holds the
value; an empty one is unknown.
"""

import csv
import importlib.resources
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis import Session
from telenano.files import read_regular
from telenano.wire import ConfigError

Series = npt.NDArray[np.float64]

# The panels of a comparison and the curves in them: y over x in the units of the axes.
PANELS = {
    "tip_force": "alpha_f F_s [N] over time [s]",
    "hand_force": "F_m [N] over time [s]",
    "hand_position": "x_m [cm] over time [s]",
    "tip_path": "F_s [nN] over h [nm]",
}
# The largest file: a hundred thousand points.
_LARGEST_BYTES = 1 << 23
_COLUMNS = ("panel", "x", "y", "x_error", "y_error")


class Point(NamedTuple):
    """A point of a published curve; an unknown error is NaN."""

    panel: str
    x: float
    y: float
    x_error: float
    y_error: float
    note: str


class PublishedPoints(NamedTuple):
    """The points of a file, and their source."""

    source: str
    points: tuple[Point, ...]

    def of(self, panel: str) -> tuple[Point, ...]:
        return tuple(point for point in self.points if point.panel == panel)


def paper_points() -> PublishedPoints:
    """Return the points of Fig. 12 that the paper states in its text."""
    with importlib.resources.as_file(importlib.resources.files("telenano.settings") / "paper" / "fig12.csv") as path:
        return read_published(path)


def read_published(path: Path) -> PublishedPoints:
    """Read a file of points.

    Raises:
        ConfigError: A line cannot be read; the message names file, line and the required form.
    """
    try:
        lines = read_regular(path, _LARGEST_BYTES).decode().splitlines()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    if not lines or not lines[0].startswith("#") or not lines[0].strip("# "):
        raise ConfigError(f"{path}: its first line must be a comment with the source: # authors, title, year, figure")
    rows = csv.DictReader(lines[1:])
    missing = [name for name in _COLUMNS if name not in (rows.fieldnames or ())]
    if missing:
        raise ConfigError(f"{path}: has no column {', '.join(missing)}; must have {', '.join(_COLUMNS)}")
    points = tuple(_point(row, f"{path}, line {number}") for number, row in enumerate(rows, start=3))
    return PublishedPoints(lines[0].strip("# "), points)


def _point(row: dict[str, Any], place: str) -> Point:
    if row["panel"] not in PANELS:
        raise ConfigError(f"{place}: panel {row['panel']!r} is unknown; one of {', '.join(PANELS)}")
    x, y = (_number(row[name], f"{place}: {name}") for name in ("x", "y"))
    x_error, y_error = (
        math.nan if not row[name] else _number(row[name], f"{place}: {name}", least=0.0)
        for name in ("x_error", "y_error")
    )
    return Point(row["panel"], x, y, x_error, y_error, row.get("note") or "")


def _number(text: str | None, place: str, least: float = -math.inf) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= least):
        raise ConfigError(
            f"{place}: {text!r} must be a number" + ("" if least == -math.inf else f" of at least {least:g}")
        )
    return value


def curve_of(session: Session, panel: str) -> tuple[Series, Series]:
    """Return x and y of a session's curve in a panel, in the units of PANELS."""
    series = session.series()
    if panel == "tip_force":
        return series.tip_time_s, series.force_scale * series.tip_force_n
    if panel == "hand_force":
        return series.hand_time_s, series.hand_force_n
    if panel == "hand_position":
        return series.hand_time_s, 100.0 * series.hand_position_m
    path = series.tip_path()
    return 1e9 * path.separation_m, 1e9 * path.force_n


def nearest(session: Session, point: Point) -> tuple[float, float]:
    """Return the point of a session's curve that is nearest to a published one; NaN if the curve has no point.

    Distances are in errors of the published point, or in spans of the curve if an error is unknown.
    """
    x, y = curve_of(session, point.panel)
    is_finite = np.isfinite(x) & np.isfinite(y)
    if not is_finite.any():
        return math.nan, math.nan
    x, y = x[is_finite], y[is_finite]
    scales = [
        error if error > 0.0 else float(np.ptp(values)) or 1.0
        for error, values in ((point.x_error, x), (point.y_error, y))
    ]
    at = int(np.argmin(((x - point.x) / scales[0]) ** 2 + ((y - point.y) / scales[1]) ** 2))
    return float(x[at]), float(y[at])
