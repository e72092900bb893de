"""The five first tasks of the help on the page, on a real rig, by what its buttons and numbers say and no document.

Each step uses what is written there: the filled button, the hand, a field or a number by its name.
"""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_page import BESIDE_A_BROWSER, FILLED, PATIENCE_S, Page, View, needs_browser, open_page, until
from commands import COMMANDS
from page_walks import step
from stack_rig import Rig

pytestmark = [pytest.mark.browser, pytest.mark.endurance, needs_browser]

STIFFNESS = "afm_node.cantilever.stiffness_n_per_m=4"
TOUCH_NN = 10.0


# The highest place of the image [nm], and where it is in the picture from above [px], as an eye finds it.
_HIGHEST = """(() => {
  const { surface, flat } = telenano.view;
  const { shown, rows, columns } = surface.grid();
  const { x, y, width, depth } = surface.extent;
  let best = shown.findIndex((height) => !Number.isNaN(height));
  shown.forEach((height, i) => { if (height > shown[best]) best = i; });
  const [column, row] = [best % columns, Math.floor(best / columns)];
  const at = [x - width / 2 + (width * (column + 0.5)) / columns, y - depth / 2 + (depth * (row + 0.5)) / rows];
  return [...at, ...flat.toCanvas(surface.extent, ...at)];
})()"""
# Stiffness of a sample through its cantilever, by the x of three places on it [nm], [N/m].
PLACES = {-30.0: 3.0, 0.0: 1.5, 30.0: 2.0}


@contextmanager
def opened(chromium: Any, folder: Path, *settings: str, scenario: str = "image") -> Iterator[Page]:
    """Open the page of a rig of its own."""
    rig = Rig(folder)
    try:
        rig.start("--duration", "600", "--no-view", *settings, *BESIDE_A_BROWSER, scenario=scenario)
        rig.wait_until(rig.running, "a running session")
        view = View(rig.environment)
        try:
            page = open_page(chromium, view.operator, viewport={"width": 1366, "height": 768})
            page.until("telenano.store.rings.get('tip')?.length > 200", "curves on the page")
            yield page
            assert page.faults == []
        finally:
            view.close()
    finally:
        rig.close()


@pytest.fixture
def page(chromium: Any, tmp_path: Path) -> Iterator[Page]:
    with opened(chromium, tmp_path, "--set", STIFFNESS) as found:
        yield found


def shown(page: Page, name: str) -> float:
    """Return a number by the name that stands beside it on the page; NaN for none."""
    large = {"You press": "#hand-force", "You feel": "#felt-force"}
    text = page.page.locator(large.get(name, f"#hand dt:text-is('{name}') + dd")).inner_text()
    return float(text.split()[0]) if text != "–" else float("nan")


def lead(page: Page, label: str) -> None:
    """Press what is filled until the filled button has a label."""
    found = page.page.locator("button.go")

    def arrived() -> bool:
        if not found.count():
            return False
        text = found.inner_text()
        if text == label:
            return True
        if found.is_enabled():
            found.dispatch_event("click")
            page.page.wait_for_timeout(1000.0)
        return False

    until(arrived, f"the filled button {label}")


def hold(page: Page) -> None:
    lead(page, "Hold the hand")
    page.page.locator("button.go").dispatch_event("click")
    page.until("telenano.cockpit.hand.isHeld", "a hand that is held")


def press_until(page: Page, what: str, least: float) -> None:
    """Press the arrow on the hand, again and again, until a number on the page is at least so large."""
    for _ in range(90):
        if shown(page, what) >= least:
            return
        # a machine that is held up may lose the hand for a moment, and the page says what to do then
        if not page.value("telenano.cockpit.hand.isHeld"):
            hold(page)
        page.page.locator("#hand-pad").focus()
        page.page.keyboard.press("ArrowDown")
        page.page.wait_for_timeout(500.0)
    raise AssertionError(f"{what} is {shown(page, what)}, and {page.page.inner_text('#next-says')!r}")


def let_go(page: Page) -> None:
    page.page.locator("#let-go").dispatch_event("click")
    page.until("!telenano.cockpit.hand.isHeld", "a hand that is let go")


def test_a_first_operator_touches_and_holds_by_what_the_page_says(page: Page) -> None:
    with step("touch with 10 nN"):
        hold(page)
        press_until(page, "Force on the tip", TOUCH_NN)
        assert "You press" in page.page.inner_text("#next-says")
    with step("hold for 5 s"):
        # a hand that has just arrived swings, and a machine that is held up may let it go: then it is held again
        for _ in range(5):
            press_until(page, "Force on the tip", 0.7 * TOUCH_NN)
            page.page.wait_for_timeout(2000.0)
            forces = []
            for _ in range(10):
                page.page.wait_for_timeout(500.0)
                forces.append(shown(page, "Force on the tip"))
            if min(forces) > 0.5 * max(forces):
                break
        assert min(forces) > 0.5 * max(forces) > 0.0, forces
        let_go(page)


def map_of_places(folder: Path) -> Path:
    """Make a recorded map whose stiffness goes from one of the places to the next, and return its file."""
    x, y = np.linspace(-40e-9, 40e-9, 17), np.linspace(-40e-9, 40e-9, 9)
    z = np.linspace(-20e-9, 40e-9, 601)
    stiffness = np.interp(x, [1e-9 * at for at in PLACES], list(PLACES.values()))
    curve = np.where(z > 0.0, 0.0, -z)
    value = stiffness[:, None, None] * np.ones((y.size, 1)) * curve
    plain, found = folder / "places.npz", folder / "map.npz"
    np.savez(plain, value=value, x=x, y=y, z=z, length_unit="m", unit="N", axis="base", sign=1)
    arguments = ("sample", "import", str(plain), "--set", "stiffness_n_per_m=40.0", "--out", str(found))
    done = COMMANDS.run(arguments, os.environ, PATIENCE_S)
    assert done.returncode == 0, done.stderr
    return found


def test_a_first_operator_finds_the_softest_of_three_places_by_what_the_page_says(
    chromium: Any, tmp_path: Path
) -> None:
    settings = ("--set", f"afm_node.sample.map={map_of_places(tmp_path)}")
    with opened(chromium, tmp_path, *settings, scenario="touch") as page:
        deeper_mm = {}
        for place in PLACES:
            with step(f"the place {place:g} nm"):
                lead(page, "Hold the hand")
                page.fill("#tip-x", f"{place:g}")
                page.fill("#tip-y", "0")
                page.obeyed(lambda: page.click("#tip-go"))
                hold(page)
                read = []
                for felt_n in (0.5, 1.0):
                    press_until(page, "You feel", felt_n)
                    page.page.wait_for_timeout(1500.0)
                    read.append(shown(page, "Hand"))
                let_go(page)
                until(
                    lambda: not page.value("telenano.store.fact('afm/state/slave', 'in_contact')"), "a tip that is off"
                )
                deeper_mm[place] = read[1] - read[0]
        assert max(deeper_mm, key=deeper_mm.__getitem__) == min(PLACES, key=PLACES.__getitem__), deeper_mm


def test_a_first_operator_takes_an_image_and_goes_to_a_particle_by_what_the_page_says(page: Page) -> None:
    with step("take an image"):
        page.obeyed(lambda: page.click("#program-scan"))
        until(lambda: "Image" in page.banners(), "an image that is taken")
        end = time.monotonic() + 5.0 * PATIENCE_S
        while "Image" in page.banners():
            assert time.monotonic() < end, f"the image takes for ever: {page.banners()}"
            page.page.wait_for_timeout(1000.0)
        assert page.value(FILLED) > 24
    with step("let the tip follow the hand again"):
        page.follow()
    with step("go to a particle"):
        page.click("#show-flat")
        page.click("#place-tip")
        page.until(
            "!telenano.view.flat.element.hidden && telenano.view.flat.frame.scale > 1.01", "the image from above"
        )
        x_nm, y_nm, x_px, y_px = page.value(_HIGHEST)
        box = page.page.locator("#scene .flat canvas").bounding_box()
        page.page.mouse.click(box["x"] + x_px, box["y"] + y_px)
        until(lambda: abs(1e9 * page.last("tip", "x") - x_nm) < 2.0, "a tip over the particle")
        assert abs(1e9 * page.last("tip", "y") - y_nm) < 2.0


def test_a_first_operator_says_why_it_feels_late_by_what_the_page_says(page: Page) -> None:
    with step("without a delay it is not the link that is set"):
        page.until("document.querySelector('#age').textContent.includes('Largest part of the latency')", "its parts")
        assert "DELAYED" not in page.banners()
    with step("with one it is, and both places say so"):
        page.fill("#delay", "400")
        page.obeyed(lambda: page.click("#delay-set"))
        until(lambda: "DELAYED" in page.banners(), "the banner of the delay")
        until(lambda: "link" in page.page.inner_text("#age summary"), "the link as the largest part")
        page.page.locator("#age summary").focus()
        page.page.keyboard.press("Enter")
        assert page.page.inner_text("#age div").count(" ms") > 2
