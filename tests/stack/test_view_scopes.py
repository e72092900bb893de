"""The scopes of the page, over a recording: dragged, laid over one another, as spectra, with ranges, and kept."""

import math
import os
from collections.abc import Iterator

import pytest
from browser_page import Page, View, browser, needs_browser, open_page
from made_sessions import Made

pytestmark = [pytest.mark.browser, pytest.mark.endurance, needs_browser]

SWING_HZ, SWING_N = 3.125, 0.5
TITLES = "telenano.scopes.specs.map((spec) => spec.title)"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """Return the page of a recording in which the tip swings, read as a whole."""
    made = Made(tip_n=lambda time_s: SWING_N * math.sin(2.0 * math.pi * SWING_HZ * time_s))
    view = View(dict(os.environ), str(made.write(tmp_path_factory.mktemp("scopes"))))
    try:
        with browser() as chromium:
            found = open_page(chromium, view.operator)
            found.until("telenano.cockpit.document.about?.read === 1", "a recording that was read")
            yield found
            assert found.faults == []
    finally:
        view.close()


def drag(page: Page, scope: int, onto: int, share: float) -> None:
    """Drag a scope by its name to a place in another one, at a share of its width."""
    names, plots = page.page.locator(".plot .name b"), page.page.locator(".plot")
    box = plots.nth(onto).bounding_box()
    place = {"x": share * box["width"], "y": 0.6 * box["height"]}
    names.nth(scope).drag_to(plots.nth(onto), target_position=place)


def test_a_scope_is_dragged_before_another_and_onto_it(page: Page) -> None:
    page.choose("#layout", "Loop")
    before = page.value(TITLES)
    drag(page, 2, 0, 0.1)
    page.until(f"{TITLES}[0] === {before[2]!r}", "the third scope at the beginning")
    assert page.value(TITLES) == [before[2], before[0], before[1], *before[3:]]
    # the hand's position beside the energies: two units, two axes
    drag(page, 5, 2, 0.8)
    page.until(f"{TITLES}.length === 5", "one scope less")
    drawn = page.value("telenano.scopes.specs[2].curves.map((curve) => curve.stream)")
    assert drawn == ["hand", "hand", "law_master", "law_slave", "law_master"]
    assert page.page.locator(".plot").nth(2).locator(".u-axis").count() == 3
    # a third unit has no axis, and nothing changes
    drag(page, 0, 2, 0.8)
    page.until("/two axes/.test(document.querySelector('#answers').textContent)", "why not")
    assert len(page.value(TITLES)) == 5


def test_the_spectrum_of_a_force_has_its_swing(page: Page) -> None:
    page.choose("#layout", "Tip")
    page.choose("#span", "5")
    page.value("telenano.cockpit.document.seek(4)")
    page.click(".plot:nth-child(1) .more")
    page.choose("#scope-kind", "spectrum")
    page.until("telenano.scopes.specs[0].kind === 'spectrum'", "a spectrum")
    page.until("telenano.scopes.plots[0].data[1]?.length > 100", "its values")
    hertz, amplitude = page.value("telenano.scopes.plots[0].data.slice(0, 2).map((found) => [...found])")
    peak = max(range(len(hertz)), key=lambda i: amplitude[i])
    assert hertz[peak] == pytest.approx(SWING_HZ, abs=2.0 * (hertz[1] - hertz[0]))
    # alpha_f F_s of 0.5 N is 5 nN at the tip
    assert amplitude[peak] == pytest.approx(5.0, rel=0.25)
    page.click("#scope-close")


def test_a_range_is_fixed_and_wrong_ones_are_said_at_the_field(page: Page) -> None:
    page.choose("#layout", "Touch")
    page.click(".plot:nth-child(1) .more")
    page.fill("#scope-low", "2")
    page.fill("#scope-high", "-2")
    page.click("#scope-fix")
    page.until("document.querySelector('#scope-high-fault').textContent.includes('above')", "what is wrong")
    page.fill("#scope-low", "-2")
    page.fill("#scope-high", "2")
    page.click("#scope-fix")
    scale = "telenano.scopes.plots[0].plot.scales.y0"
    page.until(f"{scale}.min === -2 && {scale}.max === 2", "the range on the axis")
    page.click("#scope-auto")
    page.until(f"{scale}.max < 2 || {scale}.min > -2", "an automatic one")
    page.click("#scope-close")


def test_a_layout_is_kept_in_the_browser_under_a_name(page: Page) -> None:
    page.choose("#layout", "Touch")
    drag(page, 2, 0, 0.1)
    mine = page.value(TITLES)
    page.click("#layout-save")
    page.fill("#layout-name", "mine")
    page.click("#layout-save")
    page.choose("#layout", "Loop")
    page.page.reload()
    page.until("window.telenano?.store.streams.size", "a page that was loaded again")
    page.choose("#layout", "mine")
    assert page.value(TITLES) == mine
    page.click("#layout-remove")
    names = page.value("[...document.querySelector('#layout').options].map((option) => option.value)")
    assert "mine" not in names
    assert page.value("document.querySelector('#layout').value") == "Loop"


def test_one_scope_is_enlarged_and_the_others_come_back(page: Page) -> None:
    page.click(".plot:nth-child(2) .enlarge")
    page.until("[...document.querySelectorAll('.plot')].filter((plot) => !plot.hidden).length === 1", "one scope alone")
    page.click(".plot:nth-child(2) .enlarge")
    page.until("[...document.querySelectorAll('.plot')].every((plot) => !plot.hidden)", "all of them")
