"""Fig. 12 draws what a recording states: where contact and meniscus begin and end, and the path under the hand."""

from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from figure_layout import arrows, faults
from matplotlib.axes import Axes
from matplotlib.path import Path as Line
from matplotlib.text import Text

from telenano.analysis import Session
from telenano.analysis.fig12 import SessionSeries, TipStates, draw_fig12, retracting
from telenano.analysis.figure_style import FigureOptions
from telenano.recording.multi_file import open_recordings

Series = npt.NDArray[np.float64]
DEMO = Path(__file__).resolve().parents[3] / "telenano" / "settings" / "demo.mcap"
BEGINS, ENDS = {"meniscus": "meniscus forms", "contact": "contact begins"}, {
    "meniscus": "meniscus breaks", "contact": "contact ends",
}  # fmt: skip


class Made(NamedTuple):
    """A session that was made, and what is true of it.

    changes: for each text the h [nm] of the samples between which the state first changes; times: how often; least_nm,
    greatest_nm: span of h under the hand; both_ways: whether the tip goes back, by the hand or a guard;
    None where it is by less than a tenth of its way.
    """

    series: SessionSeries
    changes: dict[str, tuple[float, float]]
    times: dict[str, int]
    least_nm: float
    greatest_nm: float
    both_ways: bool | None


def made(seed: int) -> Made:
    """Return a session of a tip that is lowered, or is in its place already, and then touches some times, or never."""
    random = np.random.default_rng(seed)
    rate_hz = float(random.choice([250.0, 500.0, 1000.0]))
    begins_nm, touches = random.uniform(4.0, 60.0), int(random.integers(0, 4))
    forms_nm, touch_nm = random.uniform(0.8, 3.5), random.uniform(0.1, 0.6)
    breaks_nm = forms_nm + random.uniform(0.3, 0.4 * begins_nm)
    wet, releases = bool(random.random() < 0.7), bool(random.random() < 0.7)
    heights = [begins_nm]
    for _ in range(touches):
        heights += [-random.uniform(0.5, 3.0)] * 2
        heights += [begins_nm] * 2 if releases else [-0.3, -0.3]
    heights += [heights[-1]] if touches else [0.6 * begins_nm]
    corners_s = np.concatenate([[0.0], np.cumsum(random.uniform(0.2, 0.5, len(heights) - 1))])
    time_s = np.arange(0.0, corners_s[-1], 1.0 / rate_hz)
    height_nm = np.interp(time_s, corners_s, heights) + random.normal(0.0, 0.002, time_s.size)
    limited = np.zeros(time_s.size, dtype=bool)
    led = np.ones(time_s.size, dtype=bool)
    # the base is lowered in the first part of the recording, and may be withdrawn in the last
    lowered = int(random.integers(0, 0.3 * corners_s[1] * rate_hz)) if random.random() < 0.7 else 0
    height_nm[:lowered] = np.linspace(begins_nm + 100.0, begins_nm + 2.0, lowered)
    limited[:lowered] = True
    if random.random() < 0.4:
        led[-20:], height_nm[-20:] = False, np.linspace(height_nm[-21], height_nm[-21] + 100.0, 20)
    contact, meniscus = np.zeros((2, time_s.size), dtype=bool)
    touching = held = False
    for index, h in enumerate(height_nm.tolist()):
        touching = h < touch_nm
        held = wet and (h < breaks_nm if held else h < forms_nm)
        contact[index], meniscus[index] = touching, held
    force_nn = np.where(contact, 12.0 * (touch_nm - height_nm), 0.0) - 5.0 * meniscus
    under = led & ~limited
    # a withdrawal is shown as far as the hand had the tip
    under |= ~led & (np.cumsum(~led & (height_nm > height_nm[under].max())) == 0)
    changes, times = {}, {}
    for name, state in (("meniscus", meniscus), ("contact", contact)):
        for words, step in ((BEGINS, 1), (ENDS, -1)):
            places = np.flatnonzero((np.diff(state.astype(int)) == step) & under[:-1] & under[1:])
            if places.size:
                changes[words[name]] = (float(height_nm[places[0]]), float(height_nm[places[0] + 1]))
                times[words[name]] = places.size
    press = np.clip(-height_nm, 0.0, 1.0)
    series = SessionSeries(
        time_s, press, 1e-2 * press, time_s, 1e-2 * press, time_s, 1e-9 * force_nn, 1e-9 * height_nm, 1e8,
        states=TipStates(led, limited, contact, meniscus),
    )  # fmt: skip
    shown_nm = height_nm[under]
    back_nm = float(np.ptp(height_nm[~led & under])) if (~led & under).any() else 0.0
    both_ways = True if touches or back_nm > 0.1 * float(np.ptp(shown_nm)) else None if back_nm > 0.0 else False
    return Made(series, changes, times, float(shown_nm.min()), float(shown_nm.max()), both_ways)


@pytest.mark.grid(seed=1)
@pytest.mark.parametrize("seed", range(8))
def test_labels_stand_where_the_states_change_and_the_panel_ends_where_the_path_does(seed: int) -> None:
    session = made(seed)
    options = FigureOptions.of("png", "paper" if seed % 2 else "screen")
    figure = draw_fig12(session.series, "title " * 40, options)
    path = figure.axes[2]
    expected = {
        f"{text} (first of {session.times[text]})" if session.times[text] > 1 else text: between
        for text, between in session.changes.items()
    }
    found = arrows(figure.axes[2])
    assert found.keys() == expected.keys()
    for text, (before_nm, after_nm) in expected.items():
        assert min(before_nm, after_nm) - 1e-9 <= found[text][0] <= max(before_nm, after_nm) + 1e-9
    low, high = path.get_xlim()
    room = 0.051 * (session.greatest_nm - session.least_nm)
    assert session.least_nm - room <= low <= session.least_nm
    assert session.greatest_nm <= high <= session.greatest_nm + room
    end_s = float(session.series.tip_time_s[-1])
    assert [axes.get_xlim() for axes in figure.axes[:2]] == [(0.0, end_s)] * 2
    named = [text.get_text() for text in path.get_legend().get_texts()]
    if session.both_ways is not None:
        assert named == (["approach", "retraction"] if session.both_ways else ["approach"])
    # a label of an axis is made when it is drawn, in the style of the figure
    with options.styled():
        assert faults(figure) == []
    frame = path.get_window_extent()
    boxes = [Text.get_window_extent(text) for text in path.texts]
    assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 for box in boxes)
    assert all(frame.y0 <= box.y0 and box.y1 <= frame.y1 for box in boxes)
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


def meetings(panel: Axes) -> list[tuple[str, str]]:
    """Return the pairs of labels of a drawn panel whose texts or arrows meet."""
    boxes = [Text.get_window_extent(text) for text in panel.texts]
    ways = [text.arrow_patch.get_path().transformed(text.arrow_patch.get_transform()) for text in panel.texts]
    return [
        (panel.texts[one].get_text(), panel.texts[other].get_text())
        for one, other in combinations(range(len(boxes)), 2)
        if boxes[one].overlaps(boxes[other])
        or ways[one].intersects_bbox(boxes[other], filled=False)
        or ways[other].intersects_bbox(boxes[one], filled=False)
        or lines_of(ways[one]).intersects_path(lines_of(ways[other]), filled=False)
    ]


def lines_of(way: Line) -> Line:
    """Return the line of an arrow without its head: two heads may lie over one another at one place of the curve."""
    return Line(way.vertices[:3])


# One column of a journal has no room for the four labels of the largest swing.
@pytest.mark.parametrize(
    ("swing_nm", "style"),
    [*product((0.5, 1.5, 2.5), ("screen", "paper")), (4.0, "screen")],
)
def test_no_arrow_or_text_meets_another_where_the_tip_swings(swing_nm: float, style: str) -> None:
    time_s = np.arange(0.0, 4.0, 1e-3)
    begin = np.linspace(10.0, 0.3, 1000)
    distance_nm = np.concatenate([begin, 0.3 + swing_nm * np.sin(2.0 * np.pi * 4.0 * time_s[:3000])])
    contact = distance_nm < 0.25
    # it forms at 2.4 nm and breaks at 3.2 nm
    wet = np.zeros(len(time_s), dtype=bool)
    for index, each_nm in enumerate(distance_nm):
        wet[index] = each_nm < (3.2 if index and wet[index - 1] else 2.4)
    force_n = 1e-9 * np.where(contact, -12.0 + 20.0 * np.abs(0.25 - distance_nm) ** 1.5, np.where(wet, -6.0, 0.0))
    states = TipStates(np.ones_like(wet), np.zeros_like(wet), contact, wet)
    still = np.zeros_like(time_s)
    series = SessionSeries(time_s, still, still, time_s, still, time_s, force_n, 1e-9 * distance_nm, 1e8, states=states)
    figure = draw_fig12(series, "a limit cycle", FigureOptions.of("png", style))
    figure.draw_without_rendering()
    assert len(figure.axes[2].texts) == (4 if swing_nm > 3.0 else 3)
    assert meetings(figure.axes[2]) == []


@pytest.mark.check("takes 0.5 s")
def test_the_recorded_demonstration_has_its_meniscus_at_2_4_nm_and_both_ways() -> None:
    series = Session.of(open_recordings([DEMO])).series()
    figure = draw_fig12(series, "title")
    path = figure.axes[2]
    found = arrows(figure.axes[2])
    assert found.keys() == {"meniscus forms", "contact begins"}
    assert found["meniscus forms"][0] == pytest.approx(2.4, abs=0.05)
    # Eq. 5 and 7 have the same force at 0.27 nm
    assert found["contact begins"][0] == pytest.approx(0.33, abs=0.1)
    assert path.get_xlim()[1] == pytest.approx(10.0, rel=0.06)
    assert path.get_xlim()[0] == pytest.approx(-1.2, abs=0.7)
    assert [axes.get_xlim()[1] for axes in figure.axes[:2]] == [pytest.approx(8.2, abs=0.02)] * 2
    assert [text.get_text() for text in path.get_legend().get_texts()] == ["approach", "retraction"]
    assert faults(figure) == []


@pytest.mark.check("takes 0.6 s")
def test_the_force_jumps_by_5_nn_where_the_meniscus_forms_and_the_tip_goes_an_eighth_of_a_nanometre() -> None:
    """README, the gallery and the tutorial say so."""
    import telenano

    tip = telenano.open(DEMO).table("afm/state")
    (at,) = np.flatnonzero(np.diff(np.asarray(tip["meniscus"]).astype(int)) == 1)
    assert np.diff(tip["tip_force_n.2"])[at] == pytest.approx(-5e-9, rel=0.05)
    assert np.diff(tip["deflection_m"])[at] == pytest.approx(-0.12e-9, rel=0.08)


def two_touches() -> SessionSeries:
    time_s = np.linspace(0.0, 4.0, 401)
    height_nm = 5.0 + 6.0 * np.cos(np.pi * time_s)
    contact = height_nm < 0.3
    return SessionSeries(
        time_s, time_s, time_s, time_s, time_s, time_s, 1e-9 * np.where(contact, 0.3 - height_nm, 0.0),
        1e-9 * height_nm, 1e8, states=TipStates(time_s >= 0.0, time_s < 0.0, contact, contact & False),
    )  # fmt: skip


def test_where_no_meniscus_is_stated_none_is_named_whatever_the_tip_does() -> None:
    assert arrows(draw_fig12(two_touches(), "title").axes[2]).keys() == {
        "contact begins (first of 2)",
        "contact ends (first of 2)",
    }
    # an instrument that states nothing of its tip, although it jumps
    silent = replace(two_touches(), states=None)
    jumps = replace(silent, separation_m=np.where(silent.separation_m < 3e-9, -1e-9, silent.separation_m))
    assert not draw_fig12(jumps, "title").axes[2].texts


def test_a_tip_that_is_lowered_again_in_a_session_is_under_the_hand_from_its_place_on() -> None:
    series = two_touches()
    assert series.states is not None
    away = (series.tip_time_s > 1.9) & (series.tip_time_s < 2.1)
    again = (series.tip_time_s >= 2.1) & (series.tip_time_s < 2.2)
    states = series.states._replace(led=~away, limited=again)
    # the guard withdraws it to 12 nm, and it has been at 11 nm
    withdrawn = replace(series, separation_m=np.where(away, 12e-9, series.separation_m), states=states)
    assert np.array_equal(np.isnan(withdrawn.tip_path().separation_m), away | again)
    # on the way back it is shown as far as the hand had it
    way = np.linspace(8e-9, 14e-9, int(away.sum()))
    withdrawn.separation_m[away] = way
    assert np.array_equal(np.isnan(withdrawn.tip_path().separation_m[away]), way > 11e-9)
    # a base that is too slow for its hand is in no place before the sample has the tip: the path begins there
    states = series.states._replace(limited=series.tip_time_s < 1.5)
    path = replace(series, states=states).tip_path()
    assert int(np.flatnonzero(np.isfinite(path.separation_m))[0]) == int(np.flatnonzero(states.in_contact)[0]) - 1
    # a limit that acts later, on a loop that swings, hides nothing
    states = series.states._replace(limited=series.tip_time_s > 0.5)
    assert np.isfinite(replace(series, states=states).tip_path().separation_m).all()


def test_an_instrument_without_a_distance_has_a_sentence_instead_of_a_path() -> None:
    figure = draw_fig12(replace(two_touches(), separation_m=np.full(401, np.nan)), "title")
    (text,) = figure.axes[2].texts
    assert text.get_text() == "no tip-sample distance is recorded\nwhile the tip follows the hand"
    assert faults(figure) == []


def test_a_change_that_the_recording_lacks_is_not_marked_and_what_is_before_the_session_not_drawn() -> None:
    series = two_touches()
    assert series.states is not None
    # without the samples from 0.6 to 0.9 s, in which the first contact begins
    kept = (series.tip_time_s < 0.6) | (series.tip_time_s > 0.9)
    cut = replace(
        series, tip_time_s=series.tip_time_s[kept], tip_force_n=series.tip_force_n[kept],
        separation_m=series.separation_m[kept], states=TipStates(*(each[kept] for each in series.states)),
        gaps_s=((0.6, 0.9),),
    )  # fmt: skip
    assert arrows(draw_fig12(cut, "title").axes[2]).keys() == {"contact begins", "contact ends (first of 2)"}
    early = replace(series, tip_time_s=series.tip_time_s - 1.2)
    assert np.array_equal(np.isfinite(early.tip_path().separation_m), early.tip_time_s >= 0.0)
    assert draw_fig12(early, "title").axes[0].lines[0].get_xdata()[0] >= 0.0  # type: ignore[index]


def test_the_ways_to_the_sample_and_from_it_are_told_apart_in_contact_as_well() -> None:
    # it comes from 10 nm, and is pressed by a fiftieth of that way less for a moment
    ways_nm = np.concatenate([np.linspace(10.0, -1.0, 551), np.linspace(-1.0, -0.8, 21)[1:]])
    away = retracting(1e-9 * ways_nm, ways_nm < 0.3)
    assert np.flatnonzero(away).tolist() == list(range(551, 571))
    # what ripples does not turn back
    ripple = 1e-9 * (ways_nm + 0.02 * np.sin(np.arange(571.0)))
    assert np.count_nonzero(np.diff(retracting(ripple, ways_nm < 0.3))) == 1
    # a path after a pause is a path of its own
    apart = 1e-9 * np.concatenate([np.linspace(5.0, 1.0, 50), [np.nan], np.linspace(5.0, 1.0, 50)])
    assert not retracting(apart, np.zeros(101, dtype=bool)).any()
    assert not retracting(np.full(9, np.nan), np.zeros(9, dtype=bool)).any()
