"""The first two tasks of the help on the page, on a real rig, by what its buttons and numbers say and no document.

Each step uses what is written there: the filled button, the hand, a field or a number by its name.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser_page import BESIDE_A_BROWSER, Page, View, needs_browser, open_page, until
from page_walks import step
from stack_rig import Rig

pytestmark = [pytest.mark.browser, pytest.mark.endurance, needs_browser]

STIFFNESS = "afm_node.cantilever.stiffness_n_per_m=4"
TOUCH_NN = 10.0


@pytest.fixture
def page(chromium: Any, tmp_path: Path) -> Iterator[Page]:
    rig = Rig(tmp_path)
    try:
        rig.start("--duration", "600", "--no-view", "--set", STIFFNESS, *BESIDE_A_BROWSER, scenario="image")
        rig.wait_until(rig.running, "a running session")
        view = View(rig.environment)
        try:
            yield open_page(chromium, view.operator, viewport={"width": 1366, "height": 768})
        finally:
            view.close()
    finally:
        rig.close()


def shown(page: Page, name: str) -> float:
    """Return a number by the name that stands beside it on the page; NaN for none."""
    text = page.page.locator(f"#hand dt:text-is('{name}') + dd").inner_text()
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
    page.until("telenano.store.rings.get('tip')?.length > 200", "curves on the page")
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
    assert page.faults == []
