"""Controls of the page in a browser, beside a rig whose state the test sets: within reach, uncut, and answered.

With TELENANO_PICTURES it keeps the pictures of such states that docs/view.md shows.
"""

from collections.abc import Iterator
from typing import Any

import pytest
from browser_page import Page, needs_browser, open_page, until
from page_without_rig import TOKEN, SaidRig, served

pytestmark = [pytest.mark.browser, needs_browser, pytest.mark.timeout(300)]

PHONE, TABLET, LAPTOP = {"width": 390, "height": 844}, {"width": 820, "height": 1100}, {"width": 1366, "height": 768}


@pytest.fixture
def rig_page() -> Iterator[tuple[SaidRig, str]]:
    with served(SaidRig()) as found:
        yield found


def box(page: Page, selector: str) -> dict[str, float]:
    found: dict[str, float] = page.page.locator(selector).bounding_box()
    return found


@pytest.mark.parametrize("size", [PHONE, TABLET])
def test_after_a_stop_the_rig_is_armed_within_reach_of_the_thumb_and_no_second_tap_on_stop_arms(
    chromium: Any, rig_page: tuple[SaidRig, str], size: dict[str, int]
) -> None:
    rig, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=size, has_touch=True)
    until(lambda: "follows the hand" in page.banners(), "a rig that runs")
    assert not page.page.is_visible("#rearm")
    stop = box(page, "#estop")
    middle = (stop["x"] + stop["width"] / 2, stop["y"] + stop["height"] / 2)
    for _ in range(5):
        page.page.touchscreen.tap(*middle)
        page.page.wait_for_timeout(150.0)
    page.page.locator("#rearm").wait_for()
    assert box(page, "#estop") == stop
    # A press on the bar right after one of the stop does nothing, whatever is drawn by then.
    page.value("for (const name of ['estop', 'rearm']) document.getElementById(name).click()")
    until(lambda: page.page.is_enabled("#rearm"), "a bar that can be pressed")
    assert set(rig.asked) == {"estop"}
    bar = box(page, "#rearm")
    if size is PHONE:
        page.picture("stopped-phone")
        # It is above the stop, and both are in the lower quarter of the window.
        assert 0.75 * size["height"] < bar["y"] < bar["y"] + bar["height"] < stop["y"]
    assert bar["height"] >= 44.0
    page.page.touchscreen.tap(bar["x"] + 60.0, bar["y"] + 20.0)
    page.page.locator("#rearm").wait_for(state="hidden")
    assert rig.asked[-1] == "arm" and rig.asked.count("arm") == 1
    assert box(page, "#estop") == stop
    assert page.faults == []


def test_going_back_is_a_choice_of_its_own_with_its_numbers_and_a_key_ends_it(
    chromium: Any, rig_page: tuple[SaidRig, str]
) -> None:
    rig, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=LAPTOP)
    until(lambda: "follows the hand" in page.banners(), "a rig that runs")
    assert not page.page.is_visible("#go-back")
    rig.way = {"offset_m": 1.105e-7, "return_place_m": 0.0, "return_speed_m_per_s": 5e-8, "return_s": 2.0}
    page.page.locator("#go-back").wait_for()
    assert page.page.inner_text("#go-back") == "Go back to 0.0 nm (50 nm/s, 2.0 s)"
    page.page.click("#arm")
    until(lambda: rig.words == [{}], "an arm that starts nothing")
    word = {"place_m": 0.0, "speed_m_per_s": 5e-8}
    rig.way_s = 30.0
    for begins, ends in (("button", "x"), ("key", "press")):
        rig.words.clear()
        if begins == "button":
            page.page.click("#go-back")
        else:
            page.page.keyboard.press("g")
        until(lambda: rig.words == [word], "a tip that goes back")
        if ends == "press":
            page.page.mouse.click(5.0, 5.0)
        else:
            page.page.keyboard.press(ends)
        until(lambda: rig.words == [word, {}], "an arm that ends it")
        until(lambda: "going back was ended" in page.page.inner_text("#answers"), "the answer")
    rig.is_stopped = True
    page.page.locator("#go-back").wait_for(state="hidden")
    assert page.faults == []


def test_the_bar_is_shown_where_the_other_button_is_far(chromium: Any, rig_page: tuple[SaidRig, str]) -> None:
    rig, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=PHONE)
    rig.is_stopped = True
    page.page.locator("#rearm").wait_for()
    page.page.set_viewport_size(LAPTOP)
    page.page.locator("#rearm").wait_for(state="hidden")
    assert page.page.is_visible("#arm")


# The width of a text in the font of an element [px].
_TEXT_WIDTH = """(element) => {
  const pen = document.createElement("canvas").getContext("2d");
  pen.font = getComputedStyle(element).font;
  return pen.measureText(element.selectedOptions[0].text).width;
}"""
# Words of the scopes that stick out of their place, or are cut by it.
_CUT = """[...document.querySelectorAll(".plot")].flatMap((plot) => {
  const whole = plot.getBoundingClientRect();
  return [...plot.querySelectorAll(".words, .words b, .key, .name button")].filter((part) => {
    const box = part.getBoundingClientRect();
    const isOut = box.left < whole.left || box.right > whole.right || box.top < whole.top || box.bottom > whole.bottom;
    return isOut || part.scrollWidth > part.clientWidth + 1 && getComputedStyle(part).display !== "inline";
  }).map((part) => part.textContent);
})"""


@pytest.mark.drawn(0.0, "services/viz_node/web/")
def test_titles_of_scopes_and_the_name_of_the_profile_are_whole_at_1366_px(
    chromium: Any, rig_page: tuple[SaidRig, str]
) -> None:
    _, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=LAPTOP)
    page.until("document.querySelectorAll('#profile option').length > 5", "the profiles")
    profile = page.page.locator("#profile")
    for name in page.value("[...document.querySelectorAll('#profile option')].map((option) => option.value)"):
        profile.evaluate("(list, name) => { list.value = name; }", name)
        # Both paddings and the arrow of the list take 30 px.
        assert profile.evaluate("(list) => list.clientWidth") >= profile.evaluate(_TEXT_WIDTH) + 30.0, name
        row = box(page, "#link .row")
        for part in ("#profile", "#delay", "#delay-set"):
            found = box(page, part)
            assert row["x"] <= found["x"] and found["x"] + found["width"] <= row["x"] + row["width"] + 1.0, part
    for layout in page.value("[...document.querySelectorAll('#layout option')].map((option) => option.value)"):
        page.choose("#layout", layout)
        page.page.wait_for_timeout(300.0)
        assert page.value(_CUT) == [], layout
        heights = page.value("[...document.querySelectorAll('.plot .area')].map((area) => area.clientHeight)")
        assert min(heights) > 60.0, layout


# The boxes of what is shown, by their ids; who holds control is said in other words during an act.
_BOXES = """Object.fromEntries([...document.querySelectorAll("[id]")].flatMap((element) => {
  const { x, y, width, height } = element.getBoundingClientRect();
  return width === 0 || element.closest("#answers, #events, #lease") ? [] : [[element.id, [x, y, width, height]]];
}))"""


def test_what_came_of_a_press_is_beside_it_and_among_the_events_and_moves_nothing(
    chromium: Any, rig_page: tuple[SaidRig, str]
) -> None:
    rig, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=LAPTOP)
    until(lambda: "follows the hand" in page.banners(), "a rig that runs")
    # the panel of a package comes when its module has been loaded
    page.page.wait_for_selector("#tab-particles", state="attached")
    before = page.value(_BOXES)
    rig.delay_s = 0.5
    page.page.locator("#couple").click()
    note = page.page.locator(".answer.pending")
    until(note.count, "an answer that is awaited")
    assert page.value(_BOXES) == before
    until(page.page.locator(".answer.done").count, "the answer")
    assert page.value(_BOXES) == before
    control, shown = box(page, "#couple"), box(page, ".answer")
    assert 0.0 < shown["y"] - (control["y"] + control["height"]) < 20.0
    assert shown["x"] < control["x"] + control["width"] and control["x"] < shown["x"] + shown["width"]
    assert shown["x"] + shown["width"] <= LAPTOP["width"]
    # It is whole, and the button that arms is seen beside it.
    assert page.value(
        "(({ scrollHeight, clientHeight }) => scrollHeight <= clientHeight)(document.querySelector('.answer'))"
    )
    arm = box(page, "#arm")
    assert shown["y"] >= arm["y"] + arm["height"]
    # What lies below the answer is pressed as if it were not there.
    middle = f"{shown['x'] + shown['width'] / 2.0}, {shown['y'] + shown['height'] / 2.0}"
    assert page.value(f"document.elementFromPoint({middle}).closest('#answers')") is None
    page.until("/couple hand and tip: acknowledged/.test(document.querySelector('#events').textContent)", "the event")


def test_a_page_whose_server_has_gone_calls_nothing_refused(chromium: Any) -> None:
    rig = SaidRig()
    with served(rig) as (_, address):
        page = open_page(chromium, f"{address}#{TOKEN}", viewport=LAPTOP)
        until(lambda: "follows the hand" in page.banners(), "a rig that runs")
    until(lambda: "DISCONNECTED" in page.banners(), "the banner of a lost server")
    said = page.answered(lambda: page.page.keyboard.press("Escape"))
    assert said.startswith("emergency stop: not sent") and "telenano estop" in said
    page.until("/emergency stop: not sent/.test(document.querySelector('#events').textContent)", "the event")


def test_control_goes_from_one_window_to_another_by_what_they_read_on_the_page(
    chromium: Any, rig_page: tuple[SaidRig, str]
) -> None:
    _, address = rig_page
    first, second = (open_page(chromium, f"{address}#{TOKEN}", viewport=LAPTOP) for _ in range(2))
    assert [page.page.title() for page in (first, second)] == ["telenano, window A", "telenano, window B"]

    def reads(page: Page, text: str) -> None:
        until(lambda: text in page.page.inner_text("#lease"), text)

    def press(page: Page, words: str) -> None:
        page.page.locator("#lease button", has_text=words).dispatch_event("click")

    press(first, "Take")
    reads(first, "You hold control")
    reads(second, "Window A holds control")
    press(second, "Ask")
    reads(second, "you have asked and are next")
    reads(first, "window B asks for it")
    first.value("document.querySelectorAll('.answer').forEach((shown) => shown.remove())")
    first.picture("asked-laptop")
    press(first, "Hand over to window B")
    reads(first, "Window B holds control")
    reads(second, "You hold control")
    # Without a press on Hand over it comes when the other one lets go, or its window is closed.
    press(first, "Ask")
    press(second, "Let go")
    reads(first, "You hold control")
    press(second, "Ask")
    reads(first, "window B asks for it")
    first.page.context.close()
    reads(second, "You hold control")


def test_a_page_whose_force_does_not_reach_the_hand_says_so_on_the_pad_and_in_the_banner(
    chromium: Any, rig_page: tuple[SaidRig, str]
) -> None:
    rig, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=LAPTOP)
    until(lambda: "follows the hand" in page.banners(), "a rig that runs")
    page.value("addEventListener('pointermove', (event) => { window.lastY = event.clientY; }, true); 0")
    page.click("#hand-keep")
    page.press(10.0)
    until(lambda: page.last("hand", "force") > 1.0, "a force at the hand")
    # What is felt drops to none, as in the haptic node where it has heard nothing for too long.
    rig.is_deaf = True
    until(lambda: "NOT AS HELD" in page.banners(), "the banner")
    until(lambda: "the hand presses with 0.0 N" in page.page.inner_text("#hand-text"), "the words at the pad")
    page.picture("not-as-held-laptop")
    # What is said takes room of the pad, and the hand that is still dragged means no other place by it.
    before = page.value("telenano.cockpit.hand.force")
    at = box(page, "#hand-pad")
    page.page.mouse.move(at["x"] + 121.0, page.value("window.lastY"))
    assert page.value("telenano.cockpit.hand.force") == pytest.approx(before, rel=0.02)
    page.page.mouse.up()
    rig.is_deaf = False
    until(lambda: "NOT AS HELD" not in page.banners(), "the end of the banner")
    rig.is_silent = True
    until(lambda: "no data comes from the hand" in page.banners(), "the banner of a silence")
