"""The page by the keyboard alone: no test here touches the pointer, and the page is asked whether anything did."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser_page import AXE, BESIDE_A_BROWSER, FILLED, Page, View, browser, needs_browser, open_page, until
from made_sessions import Made
from stack_rig import Rig
from test_view_recording import DRAWN_NN, DRAWN_S, JUMP_S, touched

pytestmark = [pytest.mark.browser, needs_browser]

# more than the page has places for the focus
_MOST_STEPS = 250
# a click that a pointer makes has a count, and that of a key has none
WATCH = """
globalThis.pointed = 0;
for (const name of ["pointerdown", "wheel", "touchstart"]) addEventListener(name, () => { pointed += 1; }, true);
addEventListener("click", (event) => { if (event.isTrusted && event.detail > 0) pointed += 1; }, true);
"""
FOCUS_IS_SEEN = """(() => {
  const found = document.activeElement, style = getComputedStyle(found);
  const box = found.getBoundingClientRect();
  const inside = box.bottom > 0 && box.top < innerHeight && box.width > 0;
  return inside && (style.outlineStyle !== "none" || style.boxShadow !== "none");
})()"""


class Keyboard:
    """Somebody who has a keyboard and no pointer."""

    def __init__(self, page: Page) -> None:
        self.page = page
        page.value(f"{WATCH}; 0")

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.page.keyboard.press(key)

    def reach(self, selector: str) -> None:
        """Go on with Tab until an element has the focus, which is then seen."""
        for _ in range(_MOST_STEPS):
            if self.page.value(f"document.activeElement?.matches({selector!r})"):
                assert self.page.value(FOCUS_IS_SEEN), f"nobody sees that {selector} has the focus"
                return
            self.press("Tab")
        raise AssertionError(f"{selector} cannot be reached with the keyboard")

    def type(self, selector: str, text: str) -> None:
        """Put a text into a field."""
        self.reach(selector)
        self.press("Control+a")
        self.page.page.keyboard.type(text)

    def choose(self, selector: str, value: str) -> None:
        """Choose an option by the letters that it begins with, as a list is operated; the arrow keys do the rest."""
        self.reach(selector)
        options = self.page.value(f"[...document.querySelector({selector!r}).options].map((found) => found.value)")
        chosen = f"document.querySelector({selector!r}).value"
        while (now := self.page.value(chosen)) != value:
            self.press("ArrowDown" if options.index(now) < options.index(value) else "ArrowUp")
            assert self.page.value(chosen) != now, f"the keys do not move {selector}"

    def answered(self, selector: str, *, key: str = "Enter") -> str:
        """Press a button that has the focus, and return the answer."""
        self.reach(selector)
        return self.page.answered(lambda: self.press(key))

    def check(self) -> None:
        """Check that nothing was pointed at."""
        assert self.page.value("pointed") == 0
        assert self.page.faults == []


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        yield found


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
    keys.choose("#law-name", "wave")
    rig.wait_until(lambda: rig.newest("teleop/backward").law == "wave", "the law on the bus")
    assert rig.newest("haptic/state").operator_force_n[2] < -0.1, "the hand is held while other keys are pressed"
    keys.type("#delay", "20")
    assert "acknowledged" in page.answered(lambda: keys.press("Enter"))
    until(lambda: "DELAYED" in page.banners(), "the banner of the delay")
    keys.type("#mark-text", "by keys")
    assert "acknowledged" in page.answered(lambda: keys.press("Enter"))
    # scopes: paused, one changed and moved, another layout
    keys.reach("#pause")
    keys.press("Enter")
    page.until("document.querySelector('#pause').textContent === 'Go on'", "scopes that stand")
    keys.press("Enter")
    keys.choose("#layout", "Stability")
    page.until("telenano.scopes.specs[1].kind === 'spectrum'", "the spectrum of the forces")
    assert "acknowledged" in keys.answered("#stop")
    rig.wait_until(lambda: rig.newest("haptic/state").session_s < 0.0, "the end of the operator's programme")
    assert "acknowledged" in keys.answered("#start")
    rig.wait_until(lambda: rig.newest("haptic/state").session_s >= 0.0, "its start")
    assert "acknowledged" in page.answered(lambda: keys.press("Escape"))
    rig.wait_until(lambda: rig.newest("afm/state").mode == "estop", "the stop at the instrument")
    until(lambda: "EMERGENCY STOP" in page.banners(), "the banner of the stop")
    keys.check()


def test_a_recording_is_read_by_keys_alone(chromium: Any, tmp_path: Path) -> None:
    made = Made(tip_n=touched, in_contact=lambda time_s: time_s >= JUMP_S)
    view = View(dict(os.environ), str(made.write(tmp_path)))
    try:
        page = open_page(chromium, view.operator)
        page.until("telenano.cockpit.document.about?.read === 1", "a recording that was read")
        read(Keyboard(page))
        check_rules(page)
    finally:
        view.close()


def read(keys: Keyboard) -> None:
    page = keys.page
    place = "telenano.cockpit.document.at(performance.now())"
    # it plays to its end, and space plays it again
    page.until("telenano.store.source.playing === false", "the end of the recording")
    assert "acknowledged" in page.answered(lambda: keys.press("Space"))
    page.until("telenano.store.source.playing === true", "a recording that plays")
    assert "acknowledged" in page.answered(lambda: keys.press("Space"))
    page.until("telenano.store.source.playing === false", "a recording that stands")
    keys.press("Home")
    page.until(f"{place} === 0", "the beginning")
    for _ in range(8):
        before_s = page.value(place)
        keys.press("e")
        page.until(f"{place} > {before_s}", "the next event")
        page.page.wait_for_timeout(300.0)
        if "jumps into contact" in page.page.inner_text("#place-event"):
            break
    assert "jumps into contact" in page.page.inner_text("#place-event")
    keys.choose("#span", "0.5")
    page.until("telenano.scopes.shownWindow.to - telenano.scopes.shownWindow.from < 0.6", "half a second")
    page.until("telenano.cockpit.document.between(0, 0) && telenano.scopes.shownWindow.width === 0", "every sample")
    # n goes from sample to sample of the instrument, which are 5 ms apart in this one
    jump_s = page.value(place)
    # letters choose in a list that has the focus
    keys.press("Tab", "n", "n")
    assert page.value(place) - jump_s == pytest.approx(0.01, abs=0.0051)
    keys.press("E")
    # of the third scope: A where nothing was touched, B behind the jump
    keys.press("c")
    page.until("telenano.scopes.cursors", "two cursors")
    keys.reach(".plot:nth-child(3) .area")
    wanted_s = page.value("telenano.cockpit.document.about.session_s[0]") + JUMP_S + DRAWN_S / 2
    for _ in range(200):
        b_s = page.value("telenano.scopes.cursors[1].time")
        if abs(b_s - wanted_s) < 0.005:
            break
        keys.press("Shift+ArrowLeft" if b_s > wanted_s else "Shift+ArrowRight")
    measured = page.measured("normal, nN")
    assert measured[0] == "0"
    assert float(measured[1]) == pytest.approx(DRAWN_NN, rel=1e-3)
    for button in ("#save-png", "#save-csv"):
        keys.reach(button)
        with page.page.expect_download() as saved:
            keys.press("Enter")
        assert saved.value.path().stat().st_size > 1000
    keys.check()


def check_rules(page: Page) -> None:
    """Check what axe-core can tell of WCAG 2.2, level AA, of a document: with cursors, a sheet and a whole summary."""
    page.value(f"{AXE.read_text()}; 0")
    page.click(".plot:nth-child(1) .more")
    # the events have a pane where there is room for one beside the scopes, and are a tab on a narrower screen
    assert page.page.locator("#tab-events").count() == 0
    assert page.page.locator("#watch > #events").is_visible()
    wide, narrow = {"width": 1360, "height": 850}, {"width": 1280, "height": 850}
    for _ in range(2):
        for tab, size in (("summary", wide), ("image", wide), ("nodes", wide), ("events", narrow)):
            page.page.set_viewport_size(size)
            page.page.wait_for_selector(f"#tab-{tab}", state="attached")
            page.click(f"#tab-{tab}")
            found = page.value("axe.run({ runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa'] })")
            assert found["passes"]
            faults = {fault["id"]: [node["html"][:200] for node in fault["nodes"]] for fault in found["violations"]}
            assert faults == {}, tab
        page.click("#theme")
