"""From each state that a generator draws, the filled button of the page leads to a touch: in a browser, at a rig."""

import random
import time
from collections.abc import Iterator
from typing import Any

import pytest
from browser_page import BESIDE_A_BROWSER, Page, View, needs_browser, open_page
from stack_rig import Rig

pytestmark = [pytest.mark.browser, needs_browser]

MOST_PRESSES = 8
PATIENCE_S = 60.0
LAWS = ("virtual_impedance", "position_force", "wave", "passivity")
THINGS = ("withdraw", "stop", "law", "reload", "keys", "keys", "couple", "offline", "hidden")
_GO = "document.querySelector('.choices .go:enabled')"
_PRESS = f"(() => {{ const go = {_GO}, words = go?.textContent ?? ''; go?.click(); return words; }})()"
_TOUCHES = "telenano.store.fact('afm/state/slave', 'in_contact') === true && telenano.cockpit.hand.isHeld"
_SET_HIDDEN = """(isHidden) => {
  Object.defineProperty(document, "hidden", { value: isHidden, configurable: true });
  document.dispatchEvent(new Event("visibilitychange"));
}"""


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    rig = Rig(tmp_path_factory.mktemp("walked"))
    try:
        rig.start("--duration", "3600", "--no-view", *BESIDE_A_BROWSER, scenario="touch")
        rig.wait_until(rig.running, "a running session")
        yield rig
    finally:
        rig.close()


@pytest.fixture(scope="module")
def page(chromium: Any, rig: Rig) -> Iterator[Page]:
    view = View(rig.environment)
    try:
        page = open_page(chromium, view.operator)
        page.until("telenano.store.rings.get('tip')?.length > 200", "curves on the page")
        yield page
    finally:
        view.close()


def _disturb(rig: Rig, page: Page, draw: random.Random) -> str:
    """Let one thing happen, and return what."""
    what = draw.choice(THINGS)
    match what:
        case "withdraw":
            rig.telenano("session", "stop", "--target", "afm_node")
        case "stop":
            page.page.keyboard.press("Escape")
        case "law":
            law = draw.choice(LAWS)
            rig.telenano("session", "set", f"law={law}", "--target", "controller")
            what = f"law {law}"
        case "reload":
            page.page.reload()
            page.until("window.telenano?.store.rings.get('tip')?.length > 20", "the page again")
        case "keys":
            for _ in range(draw.randint(1, 4)):
                page.page.keyboard.press(draw.choice("nnd"))
                page.page.wait_for_timeout(draw.choice((100, 700)))
        case "couple":
            page.page.keyboard.press("o")
        case "offline":
            page.page.context.set_offline(True)
            page.page.wait_for_timeout(draw.choice((700, 2500)))
            assert page.value(f"telenano.store.isPictureOld && {_GO} === null"), "old data is offered as new"
            assert "NOT CONNECTED" in page.page.inner_text("#estop")
            page.page.context.set_offline(False)
        case "hidden":
            page.page.evaluate(_SET_HIDDEN, True)
            assert page.value("telenano.cockpit.hand.isHeld") is False
            page.page.evaluate(_SET_HIDDEN, False)
    page.page.wait_for_timeout(draw.choice((200, 1500)))
    return what


def _walk(rig: Rig, page: Page, seed: int) -> None:
    draw = random.Random(seed)
    trace = [_disturb(rig, page, draw) for _ in range(draw.randint(2, 4))]
    for presses in range(MOST_PRESSES + 1):
        end = time.monotonic() + PATIENCE_S
        while not page.value(f"{_GO} !== null || ({_TOUCHES})"):
            assert time.monotonic() < end, (trace, page.page.inner_text("#next-says"), page.banners())
            page.page.wait_for_timeout(100)
        if page.value(_TOUCHES):
            page.page.keyboard.press("u")
            return
        says, pressed = page.page.inner_text("#next-says"), page.value(_PRESS)
        trace.append(f"{says} [{pressed}]")
        assert presses < MOST_PRESSES, "\n".join(trace)
        # a person looks what became of it: a hand that is lowered is on its way for a second or two
        page.page.wait_for_timeout(2000)


@pytest.mark.endurance
def test_a_walk_ends_in_a_touch(rig: Rig, page: Page) -> None:
    _walk(rig, page, 1)
    assert page.faults == []


@pytest.mark.endurance
@pytest.mark.parametrize("seed", range(20))
def test_twenty_walks_end_in_a_touch(rig: Rig, page: Page, seed: int) -> None:
    _walk(rig, page, seed)
