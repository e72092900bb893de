"""The page by the keyboard alone: no test here touches the pointer, and the page is asked whether anything did."""

from pathlib import Path
from typing import Any

import pytest
from browser_page import BESIDE_A_BROWSER, FILLED, View, needs_browser, open_page, until
from page_walks import Keyboard
from stack_rig import Rig

pytestmark = [pytest.mark.browser, needs_browser]


@pytest.mark.endurance
def test_a_rig_is_operated_by_keys_from_the_first_press_to_the_emergency_stop(chromium: Any, tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    try:
        rig.start("--duration", "300", "--no-view", *BESIDE_A_BROWSER, scenario="image")
        rig.wait_until(rig.running, "a running session")
        view = View(rig.environment)
        try:
            operate(rig, Keyboard(open_page(chromium, view.operator)))
        finally:
            view.close()
    finally:
        rig.close()


def operate(rig: Rig, keys: Keyboard) -> None:
    page = keys.page
    page.until("telenano.store.rings.get('tip')?.length > 200", "curves on the page")
    until(lambda: page.page.locator("#law-name option").count() > 1, "the forms of the law")
    # stopped and armed again
    assert "acknowledged" in page.answered(lambda: keys.press("Escape"))
    rig.wait_until(lambda: rig.newest("haptic/state").estop, "the stop at the haptic device")
    assert "acknowledged" in keys.answered("#arm")
    rig.wait_until(lambda: not rig.newest("haptic/state").estop, "an armed haptic device")
    rig.wait_until(lambda: rig.newest("afm/state").mode == "follow", "an armed instrument")
    # an image, with settings of one's own
    keys.reach('[role="tab"][aria-selected="true"]')
    while page.value("document.activeElement.id") != "tab-image":
        keys.press("ArrowRight")
    for key, value in {"pixels": "32", "lines": "16", "dwell_s": "8"}.items():
        keys.type(f"#program-scan-{key}", value)
    assert "acknowledged" in keys.answered("#program-scan")
    page.until(f"{FILLED} === 16", "the whole image")
    rig.wait_until(lambda: rig.newest("afm/state").mode == "retracted", "a tip that is away")
    # its profile along a line that the arrow keys move
    keys.reach("#section")
    keys.press("Enter")
    page.until("telenano.view.section.profile", "a profile")
    keys.reach("#mode-bilateral")
    keys.press("Enter")
    rig.wait_until(lambda: rig.newest("afm/state").mode == "follow", "a tip that follows the hand")
    keys.type("#tip-x", "0")
    keys.type("#tip-y", "0")
    assert "acknowledged" in keys.answered("#tip-go")
    # pressed until 1 N is felt, and held there while the law changes
    keys.reach("#hand-keep")
    keys.press("Space")
    keys.reach("#hand-pad")
    for _ in range(14):
        keys.press("ArrowDown")
    rig.wait_until(lambda: rig.newest("haptic/command").force_n[2] > 0.1, "the force that comes back")
    until(lambda: float(page.page.inner_text("#felt-force").replace("–", "0")) > 0.1, "that force on the page")
    until(lambda: page.last("tip", "force") > 1e-9, "the push of the sample")
    keys.choose("#law-name", "wave")
    rig.wait_until(lambda: rig.newest("teleop/backward").law == "wave", "the law on the bus")
    assert rig.newest("haptic/state").operator_force_n[2] < -0.1, "the hand is held while other keys are pressed"
    keys.type("#delay", "20")
    assert "acknowledged" in page.answered(lambda: keys.press("Enter"))
    until(lambda: "DELAYED" in page.banners(), "the banner of the delay")
    keys.type("#mark-text", "by keys")
    assert "acknowledged" in page.answered(lambda: keys.press("Enter"))
    marks = lambda: [m.fields() for m in rig.recording().messages("session/event") if m.fields()["kind"] == "mark"]  # noqa: E731
    rig.wait_until(lambda: any(mark["data"].get("text") == "by keys" for mark in marks()), "the mark with its text")
    # scopes: paused, one changed and moved, another layout
    keys.reach("#pause")
    keys.press("Enter")
    page.until("document.querySelector('#pause').textContent === 'Continue'", "scopes that stand")
    keys.press("Enter")
    keys.choose("#layout", "Stability")
    page.until("telenano.scopes.specs[1].kind === 'spectrum'", "the spectrum of the forces")
    assert "acknowledged" in keys.answered("#stop")
    rig.wait_until(lambda: rig.newest("haptic/state").session_s < 0.0, "the end of the operator's force profile")
    assert "acknowledged" in keys.answered("#start")
    rig.wait_until(lambda: rig.newest("haptic/state").session_s >= 0.0, "its start")
    assert "acknowledged" in page.answered(lambda: keys.press("Escape"))
    rig.wait_until(lambda: rig.newest("afm/state").mode == "estop", "the stop at the instrument")
    until(lambda: "EMERGENCY STOP" in page.banners(), "the banner of the stop")
    # the programme of the operator goes on behind it, and nothing follows
    page.until("document.querySelector('#start').getAttribute('aria-pressed') === 'false'", "a start that is over")
    keys.check()
