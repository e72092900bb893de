"""Published points: read with source and error, laid beneath sessions, and refused where they say nothing."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.comparison import ComparedSession, beside, compare_figures
from telenano_lab.studies.published import nearest, paper_points, read_published

from telenano.analysis import SessionSeries
from telenano.wire import ConfigError

TIMES_S = np.linspace(0.0, 8.0, 801)
HEAD = "# Authors, Title, 1998, Fig. 12\n"
COLUMNS = "panel,x,y,x_error,y_error\n"


class Session:
    """A session in which the hand presses from 0.8 s to 4.6 s, over a tip that goes from 10 nm to 0."""

    def series(self) -> SessionSeries:
        pressed = np.where((TIMES_S > 0.8) & (TIMES_S < 4.6), 1.0, 0.0)
        return SessionSeries(
            TIMES_S, pressed, TIMES_S * 1e-3, TIMES_S, TIMES_S * 1e-3, TIMES_S, pressed * 1e-8,
            np.linspace(1e-8, 0.0, 801), 1e8,
        )  # fmt: skip


SESSIONS: Any = [ComparedSession("ours", Session(), {"verdict": "stable"}, {})]  # type: ignore[arg-type]


def test_what_the_paper_says_of_its_figure_is_met_by_a_hand_of_the_scenario() -> None:
    published = paper_points()
    assert "IROS 1998" in published.source
    assert "Fig. 12" in published.source
    found = beside(SESSIONS, published)
    assert [row["nearest"]["ours"] for row in found["points"]] == [
        {"x": pytest.approx(0.8), "y": 0.0}, {"x": pytest.approx(4.6), "y": 0.0}, {"x": pytest.approx(10.0), "y": 0.0},
    ]  # fmt: skip
    assert found["points"][0]["x_error"] == 0.05
    assert found["points"][0]["y_error"] is None


def test_the_points_are_in_the_figure_with_their_errors(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(HEAD + COLUMNS + "hand_position,2.0,0.3,0.05,0.02\ntip_path,5.0,-3.0,,\n")
    (figure,) = compare_figures(SESSIONS, published=[read_published(path)])
    forces, positions, distances = (panel.containers for panel in figure.axes)
    assert not forces
    data, _, bars = positions[0]
    assert data.get_xydata().tolist() == [[2.0, 0.3]]
    assert [bar.get_segments()[0].tolist() for bar in bars] == [
        [[1.95, pytest.approx(0.3)], [2.05, pytest.approx(0.3)]],
        [[2.0, pytest.approx(0.28)], [2.0, pytest.approx(0.32)]],
    ]  # fmt: skip
    assert distances[0][0].get_xydata().tolist() == [[5.0, -3.0]]
    assert all(low <= x <= high for panel, x in zip(figure.axes[1:], (2.0, 5.0), strict=True)
               for low, high in [panel.get_xlim()])  # fmt: skip
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["$F_m$", "ours: stable", "published"]


def test_the_nearest_point_counts_in_errors() -> None:
    point = paper_points().points[0]
    # F_m is 0 before 0.8 s: within 10 s of error the next sample with 0.5 N or more is near enough in time
    far = point._replace(y=1.0, x=0.5, x_error=10.0, y_error=0.01)
    assert nearest(Session(), far) == (pytest.approx(0.81), 1.0)
    close = point._replace(y=1.0, x=0.5, x_error=0.01, y_error=10.0)
    assert nearest(Session(), close) == (pytest.approx(0.5), 0.0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "must be a comment with the source"),
        (COLUMNS, "must be a comment with the source"),
        ("#\n" + COLUMNS, "must be a comment with the source"),
        (HEAD + "panel,x,y\n", "has no column x_error, y_error"),
        (HEAD + COLUMNS + "tip_force,1,2,,\nforce,1,2,,\n", "line 4: panel 'force' is unknown; one of tip_force"),
        (HEAD + COLUMNS + "tip_force,1,nan,,\n", "line 3: y: 'nan' must be a number"),
        (HEAD + COLUMNS + "tip_force,1,2,-1,\n", "line 3: x_error: '-1' must be a number of at least 0"),
        (HEAD + COLUMNS + "tip_force,1\n", "line 3: y: None must be a number"),
    ],
)
def test_a_file_that_says_less_than_is_needed_is_refused(text: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=reason):
        read_published(path)
    assert math.isnan(paper_points().points[0].y_error)
