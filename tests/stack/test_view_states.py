"""Eight states of the page at four sizes of window: what has to be seen is in the window, and nothing sticks out of it.

With TELENANO_PICTURES it keeps a picture of each, which docs/view.md shows.
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from browser_page import AXE, BESIDE_A_BROWSER, FILLED, Page, View, browser, keep, needs_browser, open_page, until
from stack_rig import Rig

pytestmark = [pytest.mark.browser, pytest.mark.endurance, needs_browser]

STIFFNESS = "afm_node.cantilever.stiffness_n_per_m=4"


class Size(NamedTuple):
    """A window: its name, width and height, and whether the page may be longer than it."""

    name: str
    width: int
    height: int
    scrolls: bool


SIZES = (
    Size("laptop", 1366, 768, False),
    Size("desktop", 1920, 1080, False),
    Size("tablet", 1024, 768, True),
    Size("phone", 390, 844, True),
)
# what the documents show besides the laptop
SHOWN = ("live-desktop", "recording-desktop")
# boxes of the parts of a page that must be seen without scrolling, wherever they are
BOXES = """(names) => names.map((name) => {
  const box = document.querySelector(name).getBoundingClientRect();
  return [name, box.left, box.top, box.right, box.bottom];
})"""
OVERFLOW = "[document.documentElement.scrollWidth - innerWidth, document.documentElement.scrollHeight - innerHeight]"
FIRST = ("#status", "#estop", "#hand-force", "#felt-force")


def look(page: Page, state: str) -> None:
    """Look at a state at every size: nothing sticks out, the stop and the forces are seen, axe finds nothing."""
    page.value(f"{AXE.read_text()}; 0")
    for size in SIZES:
        page.page.set_viewport_size({"width": size.width, "height": size.height})
        page.page.evaluate("scrollTo(0, 0)")
        page.page.wait_for_timeout(1200.0)
        beside, below = page.value(OVERFLOW)
        assert beside <= 0, f"{state}, {size.name}: {beside} px stick out at the side"
        assert size.scrolls or below <= 0, f"{state}, {size.name}: {below} px are below the fold"
        for name, left, top, right, bottom in page.page.evaluate(BOXES, list(FIRST)):
            seen = left >= 0 and top >= 0 and right <= size.width and bottom <= size.height
            assert seen, f"{state}, {size.name}: {name} is not in the window"
        check_rules(page, f"{state}, {size.name}")
        shown = size.name == "laptop" or f"{state}-{size.name}" in SHOWN
        if (folder := os.environ.get("TELENANO_PICTURES")) and shown:
            keep(page.page.screenshot(), Path(folder) / f"{state}-{size.name}.png")
    page.page.set_viewport_size({"width": 1366, "height": 768})


def check_rules(page: Page, where: str) -> None:
    """Check what axe-core can tell of WCAG 2.2, level AA."""
    found = page.value("axe.run({ runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa'] })")
    assert found["passes"]
    faults = {fault["id"]: [node["html"][:200] for node in fault["nodes"]] for fault in found["violations"]}
    assert faults == {}, where


def theme(page: Page, name: str) -> None:
    if page.value("document.documentElement.dataset.theme") != name:
        page.click("#theme")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        yield found


def test_the_states_of_a_running_rig(chromium: Any, tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    try:
        rig.start("--duration", "300", "--no-view", "--set", STIFFNESS, *BESIDE_A_BROWSER, scenario="image")
        rig.wait_until(rig.running, "a running session")
        view = View(rig.environment)
        try:
            states(rig, chromium, view)
        finally:
            view.close()
    finally:
        rig.close()


def test_the_states_of_a_recording(chromium: Any, tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    try:
        summary = rig.run("--no-view")
    finally:
        rig.close()
    view = View(dict(os.environ), str(rig.out / "session.mcap"))
    try:
        page = open_page(chromium, view.operator)
        page.until("telenano.cockpit.document.about?.summary", "a recording that was judged")
        theme(page, "light")
        page.click("#play")
        page.until("telenano.store.source.playing === false", "a recording that stands")
        # what the page says is what the report of the session says
        assert page.value("telenano.cockpit.document.about.summary.verdict") == summary["verdict"]
        page.page.keyboard.press("Home")
        for _ in range(40):
            page.page.keyboard.press("e")
            page.page.wait_for_timeout(200.0)
            if "jumps into contact" in page.page.inner_text("#place-event"):
                break
        page.choose("#span", "2")
        # an event names the folder of this test, which is no part of a picture
        page.value("telenano.store.events = telenano.store.events.filter(({ text }) => !text.includes('/'))")
        page.page.wait_for_timeout(1000.0)
        look(page, "recording")
        assert page.faults == []
    finally:
        view.close()


def states(rig: Rig, chromium: Any, view: View) -> None:
    page = open_page(chromium, view.operator)
    page.until("telenano.store.rings.get('tip')?.length > 200", "curves on the page")
    page.until("document.querySelectorAll('#law-name option').length > 1", "the forms of the law")
    theme(page, "light")
    for key, value in {"pixels": "48", "lines": "48", "dwell_s": "12"}.items():
        page.fill(f"#program-scan-{key}", value)
    assert "acknowledged" in page.answered(lambda: page.click("#program-scan"))
    page.until(f"{FILLED} > 24", "a part of the image")
    look(page, "imaging")
    page.until("telenano.store.fact('afm/state/slave', 'mode') === 'retracted'", "a tip that is away")
    page.follow()
    page.fill("#tip-x", "0")
    page.fill("#tip-y", "0")
    assert "acknowledged" in page.answered(lambda: page.click("#tip-go"))
    page.click("#hand-keep")
    page.press(14.0)
    page.page.mouse.up()
    until(lambda: page.last("command", "tip_force") > 0.5, "the sample felt")
    page.page.wait_for_timeout(4000.0)
    look(page, "live")
    observer = open_page(chromium, view.observer)
    observer.until("telenano.store.rings.get('tip')?.length > 3000", "curves on the observer's page")
    theme(observer, "light")
    look(observer, "observer")
    assert observer.page.is_enabled("#estop")
    observer.page.context.close()
    page.fill("#delay", "60")
    assert "acknowledged" in page.answered(lambda: page.click("#delay-set"))
    until(lambda: "DELAYED" in page.banners(), "the banner of the delay")
    look(page, "delayed")
    swing(page)
    theme(page, "dark")
    look(page, "oscillating")
    assert "acknowledged" in page.answered(lambda: page.page.keyboard.press("Escape"))
    until(lambda: "EMERGENCY STOP" in page.banners(), "the banner of the stop")
    look(page, "stopped")
    view.kill()
    until(lambda: "DISCONNECTED" in page.banners(), "the banner of a lost server")
    theme(page, "light")
    stop = page.page.inner_text("#estop")
    assert "NOT CONNECTED" in stop
    assert "telenano estop" in stop
    # a dead stop looks dead under the pointer too
    page.page.hover("#estop")
    page.page.wait_for_timeout(300.0)
    assert page.value("getComputedStyle(document.querySelector('#estop')).backgroundImage") != "none"
    assert page.value("getComputedStyle(document.querySelector('#estop')).color") != "rgb(255, 255, 255)"
    answer = page.answered(lambda: page.page.keyboard.press("Escape"))
    assert "telenano estop" in answer
    look(page, "disconnected")


def swing(page: Page) -> None:
    """Raise the delay and push until the loop swings."""
    page.fill("#delay", "200")
    assert "acknowledged" in page.answered(lambda: page.click("#delay-set"))
    end = time.monotonic() + 60.0
    while "OSCILLATES" not in page.banners():
        assert time.monotonic() < end, f"no oscillation was seen: {page.banners()}"
        page.press(6.0)
        page.page.mouse.up()
        page.page.wait_for_timeout(6000.0)
