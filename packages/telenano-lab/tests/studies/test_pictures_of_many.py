"""Pictures of many sessions: a condition is a colour, a seed a thin line, and what diverges stretches no axis."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from telenano_lab.studies.comparison import ComparedSession, compare_figures, conditions_in
from telenano_lab.studies.figure_colours import looks

from telenano.analysis import SessionSeries
from telenano.wire import ConfigError

TIMES_S = np.linspace(0.0, 8.0, 801)


class Session:
    """A session with a force of so many newtons at the hand, which grows where it diverges."""

    def __init__(self, force_n: float, diverges: bool) -> None:
        self._force_n = force_n * (np.exp(TIMES_S) if diverges else np.ones_like(TIMES_S))

    def series(self) -> SessionSeries:
        force_n = self._force_n
        return SessionSeries(
            TIMES_S, np.ones_like(TIMES_S), TIMES_S * 1e-3, TIMES_S, TIMES_S * 1e-3, TIMES_S, force_n * 1e-8,
            np.linspace(1e-8, 0.0, 801), 1e8,
        )  # fmt: skip


def drawn(conditions: int, seeds: int, diverging: Sequence[int] = ()) -> list[Any]:
    """Return sessions of so many conditions with so many seeds; the conditions of some numbers diverge."""
    rows = []
    for number in range(conditions):
        for seed in range(seeds):
            verdict = "diverged" if number in diverging else "stable"
            scenario = {"controller": {"wave": {"gain": float(number)}}, "seed": seed}
            summary = {"verdict": verdict, "law": "wave", "link_round_trip_ms": 20.0}
            session: Any = Session(1.0 + 0.01 * number, number in diverging)
            rows.append(ComparedSession(f"{number}-{seed}", session, summary, scenario))
    return rows


def curves(axes: Axes) -> list[Any]:
    """Return the curves of a panel without the reference, the zero line and marks."""
    return [line for line in axes.lines if len(line.get_xdata()) == len(TIMES_S) and line.get_linewidth() < 2.0]


def test_each_condition_is_a_colour_and_its_seeds_share_it() -> None:
    (figure,) = compare_figures(drawn(6, 3))
    forces, position, paths = figure.axes[:6], figure.axes[6], figure.axes[7:]
    seen = [(line.get_color(), line.get_linestyle()) for line in curves(position)]
    assert len(seen) == 18
    assert len(set(seen)) == 6
    assert all(len(set(seen[place : place + 3])) == 1 for place in range(0, 18, 3))
    # A swing hides forces that rest, and force against distance lies on one curve: each condition has panels of them,
    # on the same axes.
    for panels in (forces, paths):
        assert [[line.get_color() for line in curves(panel)] for panel in panels] == [
            [colour] * 3 for colour, _ in seen[::3]
        ]
        assert len({(panel.get_xlim(), panel.get_ylim()) for panel in panels}) == 1
    named = [f"wave, 20 ms, gain {number}: 3 of 3 stable" for number in range(6)]
    assert [" ".join(panel.get_title(loc="left").split()) for panel in forces] == [
        f"({letter}) {name}" for letter, name in zip("abcdef", named, strict=True)
    ]
    (legend,) = figure.legends
    assert sorted(text.get_text() for text in legend.get_texts()) == sorted(["$F_m$", *named])


@pytest.mark.parametrize(("conditions", "figures"), [(7, [7]), (24, [24]), (30, [24, 6]), (49, [24, 24, 1])])
def test_each_of_more_than_six_conditions_has_a_panel_on_axes_that_all_share(
    conditions: int, figures: list[int]
) -> None:
    pages = compare_figures(drawn(conditions, 2))
    panels = [[panel for panel in page.axes if curves(panel)] for page in pages]
    assert [len(page) for page in panels] == figures
    titles = [panel.get_title(loc="left") for page in panels for panel in page]
    assert len(set(titles)) == conditions
    assert all(len(page.legends[0].get_texts()) == 2 for page in pages)
    for page in panels:
        assert len({panel.get_ylim() for panel in page}) == 1


@pytest.mark.parametrize("conditions", [4, 9])
def test_what_diverges_is_dotted_marked_and_does_not_stretch_the_axes(conditions: int) -> None:
    (figure,) = compare_figures(drawn(conditions, 1, diverging=[2]))
    panels = [panel for panel in figure.axes if curves(panel)]
    forces = panels[:conditions]
    assert all(panel.get_ylim()[1] < 2.0 for panel in forces)
    dotted = [line for panel in forces for line in curves(panel) if line.get_linestyle() == ":"]
    crosses = [line for panel in forces for line in panel.lines if line.get_marker() == "x"]
    assert len(dotted) >= 1
    assert len(crosses) == 1
    (place,) = crosses[0].get_xdata()
    left = next(line for line in dotted if np.max(line.get_ydata()) > 100.0)
    assert place == TIMES_S[np.argmax(left.get_ydata() > forces[0].get_ylim()[1])]


def test_sessions_that_all_diverge_are_drawn_whole() -> None:
    (figure,) = compare_figures(drawn(2, 1, diverging=[0, 1]))
    assert figure.axes[0].get_ylim()[1] > 1000.0


def test_conditions_without_repetitions_have_the_names_of_their_folders() -> None:
    assert [condition.label for condition in conditions_in(drawn(3, 1))] == ["0-0", "1-0", "2-0"]


def test_no_two_looks_are_alike_and_too_many_are_refused() -> None:
    assert len({(look.colour, look.style) for look in looks(36)}) == 36
    assert len({look.colour for look in looks(6)}) == len({look.style for look in looks(6)}) == 6
    with pytest.raises(ConfigError, match="37 curves are too many for one panel, which shows 36"):
        looks(37)
