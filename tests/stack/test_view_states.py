"""States of the page of a running rig at four sizes of window: what has to be seen is seen, and nothing sticks out.

With TELENANO_PICTURES it keeps a picture of each, which docs/view.md shows.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from browser_page import BESIDE_A_BROWSER, FILLED, PATIENCE_S, Page, View, needs_browser, open_page, until
from page_walks import look, theme
from stack_rig import Rig

pytestmark = [pytest.mark.browser, pytest.mark.endurance, needs_browser]

STIFFNESS = "afm_node.cantilever.stiffness_n_per_m=4"
# One way: the tip has no command for as long as a delay grows, and 0.3 s without one withdraw it.
STEPS_MS = (100, 200, 300)


@contextmanager
def opened(chromium: Any, folder: Path, role: str = "operator") -> Iterator[tuple[Page, View]]:
    """Open the page of a rig of its own, for a role."""
    rig = Rig(folder)
    try:
        rig.start("--duration", "900", "--no-view", "--set", STIFFNESS, *BESIDE_A_BROWSER, scenario="image")
        rig.wait_until(rig.running, "a running session")
        view = View(rig.environment)
        try:
            page = open_page(chromium, getattr(view, role))
            page.until("telenano.store.rings.get('tip')?.length > 1000", "curves on the page")
            if role == "operator":
                page.until("document.querySelectorAll('#law-name option').length > 1", "the forms of the law")
            theme(page, "light")
            yield page, view
        finally:
            view.close()
    finally:
        rig.close()


def test_the_page_while_an_image_is_taken(chromium: Any, tmp_path: Path) -> None:
    with opened(chromium, tmp_path) as (page, _):
        for key, value in {"pixels": "48", "lines": "48", "dwell_s": "12"}.items():
            page.fill(f"#program-scan-{key}", value)
        page.obeyed(lambda: page.click("#program-scan"))
        page.until(f"{FILLED} > 24", "a part of the image")
        look(page, "imaging")


def test_the_page_while_a_hand_presses(chromium: Any, tmp_path: Path) -> None:
    with opened(chromium, tmp_path) as (page, _):
        take_image(page)
        go_to_middle(page)
        page.lower_until(0.7)
        page.page.wait_for_timeout(4000.0)
        look(page, "live")


def test_the_page_of_an_observer(chromium: Any, tmp_path: Path) -> None:
    with opened(chromium, tmp_path, "observer") as (page, _):
        look(page, "observer")
        assert page.page.is_enabled("#estop")


def test_the_page_of_a_delayed_rig(chromium: Any, tmp_path: Path) -> None:
    with opened(chromium, tmp_path) as (page, _):
        delay(page, 60)
        until(lambda: "DELAYED" in page.banners(), "the banner of the delay")
        page.page.wait_for_timeout(4000.0)
        look(page, "delayed")


def test_the_page_of_a_rig_that_swings_and_is_stopped(chromium: Any, tmp_path: Path) -> None:
    with opened(chromium, tmp_path) as (page, _):
        swing(page)
        theme(page, "dark")
        look(page, "oscillating")
        page.obeyed(lambda: page.page.keyboard.press("Escape"))
        until(lambda: "EMERGENCY STOP" in page.banners(), "the banner of the stop")
        look(page, "stopped")


def test_the_page_whose_server_is_gone(chromium: Any, tmp_path: Path) -> None:
    with opened(chromium, tmp_path) as (page, view):
        view.kill()
        until(lambda: "DISCONNECTED" in page.banners(), "the banner of a lost server")
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


def take_image(page: Page) -> None:
    """Take a small image of the sample, and let the tip follow the hand again."""
    for key, value in {"pixels": "32", "lines": "32"}.items():
        page.fill(f"#program-scan-{key}", value)
    page.obeyed(lambda: page.click("#program-scan"))
    page.until(f"{FILLED} > 31", "an image")
    page.until("telenano.store.fact('afm/state/slave', 'mode') === 'retracted'", "a tip that is away")
    page.follow()


def go_to_middle(page: Page) -> None:
    page.fill("#tip-x", "0")
    page.fill("#tip-y", "0")
    page.obeyed(lambda: page.click("#tip-go"))


def delay(page: Page, one_way_ms: int) -> None:
    page.fill("#delay", str(one_way_ms))
    page.obeyed(lambda: page.click("#delay-set"))


def swing(page: Page) -> None:
    """Hold the hand on the sample, raise the delay in steps, and push until the loop swings."""
    page.lower_until(0.7)
    for one_way_ms in STEPS_MS:
        delay(page, one_way_ms)
        # commands come again before the delay grows further
        page.page.wait_for_timeout(2.0 * one_way_ms)
    end = time.monotonic() + PATIENCE_S
    while "OSCILLATES" not in page.banners():
        mode = page.fact("afm/state/slave", "mode")
        assert time.monotonic() < end, f"no oscillation was seen, the tip is in mode {mode}: {page.banners()}"
        # a machine that is held up may lose the hand for a moment, or leave the tip without commands for too long
        if mode in ("retracting", "retracted"):
            page.follow()
        # a loop at rest needs a push, and what comes of it takes some turns to grow
        page.value("telenano.cockpit.hand.holdHere(), telenano.cockpit.hand.lower(5e-3), 0")
        for _ in range(8):
            if "OSCILLATES" in page.banners():
                return
            page.page.wait_for_timeout(500.0)
        page.value("telenano.cockpit.hand.lower(-4e-3), 0")
