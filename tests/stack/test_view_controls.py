"""Controls of the page in a browser, beside a rig whose state the test sets: within reach, uncut, and answered.

With TELENANO_PICTURES it keeps the pictures of such states that docs/view.md shows.
"""

from collections.abc import Iterator
from typing import Any

import pytest
from browser_page import Page, needs_browser, open_page, until
from page_walks import check_rules
from page_without_rig import TOKEN, SaidRig, served

pytestmark = [pytest.mark.browser, needs_browser, pytest.mark.timeout(300)]

PHONE, TABLET, LAPTOP = {"width": 390, "height": 844}, {"width": 820, "height": 1100}, {"width": 1366, "height": 768}
# Where the change touches the page or what serves it: rules that are not about stopping, arming and lost forces, a
# window beside the narrowest one, and a second way to the same rule. Those of single modules are in Vitest as well.
FURTHER = pytest.mark.drawn(0.0, "services/viz_node/", "telenano/serving/")


@pytest.fixture
def rig_page() -> Iterator[tuple[SaidRig, str]]:
    with served(SaidRig()) as found:
        yield found


def box(page: Page, selector: str) -> dict[str, float]:
    found: dict[str, float] = page.page.locator(selector).bounding_box()
    return found


@pytest.mark.parametrize("size", [PHONE, *(pytest.param(size, marks=FURTHER) for size in (TABLET, LAPTOP))])
def test_after_a_stop_arm_is_the_one_filled_button_and_no_second_tap_on_stop_arms(
    chromium: Any, rig_page: tuple[SaidRig, str], size: dict[str, int]
) -> None:
    rig, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=size, has_touch=True)
    until(lambda: "follows the hand" in page.banners(), "a rig that runs")
    assert page.page.locator("#arm").count() == 0
    stop = box(page, "#estop")
    middle = (stop["x"] + stop["width"] / 2, stop["y"] + stop["height"] / 2)
    for _ in range(5):
        page.page.touchscreen.tap(*middle)
        page.page.wait_for_timeout(150.0)
    page.page.locator("#arm").wait_for()
    assert box(page, "#estop") == stop
    # A press on the button right after one of the stop does nothing, whatever is drawn by then.
    page.value("for (const name of ['estop', 'arm']) document.getElementById(name).click()")
    until(lambda: page.page.is_enabled("#arm"), "a button that can be pressed")
    assert set(rig.asked) == {"estop"}
    assert page.page.locator("button.go:visible").all_inner_texts() == ["Arm"]
    bar = box(page, "#arm")
    if size is PHONE:
        page.picture("stopped-phone")
        # It is above the stop, and both are in the lower quarter of the window.
        assert 0.75 * size["height"] < bar["y"] < bar["y"] + bar["height"] < stop["y"]
    assert bar["height"] >= 44.0
    page.page.touchscreen.tap(bar["x"] + 60.0, bar["y"] + 20.0)
    page.page.locator("#arm").wait_for(state="detached")
    assert rig.asked[-1] == "arm" and rig.asked.count("arm") == 1
    assert box(page, "#estop") == stop
    assert page.faults == []


def choose(page: Page, how: str, selector: str, key: str) -> None:
    """Make a choice by pointer, by touch, or by its key."""
    page.page.locator(selector).wait_for()
    if how == "pointer":
        page.page.click(selector)
    elif how == "touch":
        page.page.tap(selector)
    else:
        page.page.keyboard.press(key)


@pytest.mark.parametrize("how", ["touch", *(pytest.param(how, marks=FURTHER) for how in ("pointer", "key"))])
def test_arming_shows_its_two_choices_with_their_numbers_and_any_input_ends_the_way_back(
    chromium: Any, rig_page: tuple[SaidRig, str], how: str
) -> None:
    rig, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=LAPTOP, has_touch=how == "touch")
    until(lambda: "follows the hand" in page.banners(), "a rig that runs")
    assert page.page.locator("#go-back").count() == 0
    rig.is_stopped = True
    rig.way = {"offset_m": 1.105e-7, "return_place_m": 0.0, "return_speed_m_per_s": 5e-8, "return_s": 2.0}
    until(lambda: page.page.locator("#arm:enabled").count(), "a button that arms")
    assert page.page.locator("#go-back").count() == 0
    choose(page, how, "#arm", "n")
    until(lambda: rig.words == [{}], "an arm that starts nothing")
    page.page.locator("#go-back").wait_for()
    assert page.page.inner_text("#go-back") == "Go back to 0.0 nm (50 nm/s, 2.0 s)"
    assert page.page.inner_text("#stay") == "Stay withdrawn"
    # what moves nothing stays as it was chosen, and the way back is still there, unfilled
    choose(page, how, "#stay", "w")
    page.page.locator("#stay").wait_for(state="detached")
    assert "go" not in page.page.get_attribute("#go-back", "class").split()
    assert rig.words == [{}]
    word = {"place_m": 0.0, "speed_m_per_s": 5e-8}
    rig.way_s = 30.0
    for ends in ("key", "press", "touch", "wheel"):
        rig.words.clear()
        choose(page, how, "#go-back", "g")
        until(lambda: rig.words == [word], "a tip that goes back")
        page.page.locator("#end-way").wait_for()
        # who presses the filled button once more does not end it: there is none
        assert page.page.locator("button.go").count() == 0
        until(lambda: " s left" in page.page.inner_text("#next-says"), "a countdown")
        if ends == "press":
            page.page.mouse.click(5.0, 5.0)
        elif ends == "touch" and how == "touch":
            page.page.touchscreen.tap(5.0, 5.0)
        elif ends == "wheel":
            page.page.mouse.wheel(0.0, 10.0)
        else:
            page.page.keyboard.press("x")
        until(lambda: rig.words == [word, {}], "an arm that ends it")
        until(lambda: "going back was ended" in page.page.inner_text("#answers"), "the answer")
        until(lambda: page.page.locator("#end-way").count() == 0, "the end of the countdown")
    rig.is_stopped = True
    page.page.locator("#go-back").wait_for(state="detached")
    assert page.faults == []


@FURTHER
def test_what_is_next_leads_from_control_to_letting_go_by_keys_alone(
    chromium: Any, rig_page: tuple[SaidRig, str]
) -> None:
    rig, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=LAPTOP)
    rig.tip = {"in_contact": False, "meniscus": False}
    until(lambda: "follows the hand" in page.banners(), "a rig that runs")

    def step(name: str) -> None:
        current = page.page.locator("#next [aria-current=step]")
        until(lambda: current.inner_text() == name, name)

    step("Take control")
    page.page.keyboard.press("n")
    step("Approach")
    until(page.page.locator("#hold").count, "a hand to hold")
    page.page.keyboard.press("n")
    until(page.page.locator("#lower").count, "a hand that is held")
    assert page.value("document.activeElement.id") == "hand-pad"
    for _ in range(3):
        page.page.keyboard.press("n")
    until(
        lambda: page.last("hand", "force") == pytest.approx(0.3, abs=0.01), "0.5 mm of a spring of 200 N/m, three times"
    )
    rig.tip = {"in_contact": True, "separation_m": -1e-9, "tip_force_n": (0.0, 0.0, 3e-9)}
    step("Let go")
    page.page.keyboard.press("u")
    step("Touch")
    until(lambda: page.last("hand", "force") == 0.0, "a hand that has let go")
    assert page.faults == []


@FURTHER
def test_the_stop_the_numbers_and_both_pictures_are_in_one_window_of_a_phone(
    chromium: Any, rig_page: tuple[SaidRig, str]
) -> None:
    _, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=PHONE, has_touch=True)
    until(lambda: "follows the hand" in page.banners(), "a rig that runs")
    seen = [box(page, name) for name in ("#hand-force", "#felt-force", "#hand-pad", "#gap", "#take", "#estop")]
    for found in seen:
        assert found["x"] >= 0.0 and found["x"] + found["width"] <= PHONE["width"]
        assert found["y"] >= 0.0 and found["y"] + found["height"] <= PHONE["height"]
    pad, gap = seen[2], seen[3]
    assert pad["height"] > 150.0 and gap["height"] > 150.0 and pad["x"] + pad["width"] <= gap["x"]
    assert page.value("document.documentElement.scrollHeight") <= PHONE["height"]
    # the rest is behind tabs, of which each shows its part and nothing else
    for place, shown in {"scene": "#scene", "scopes": "#scopes", "controls": "#controls", "more": "#dock"}.items():
        page.page.tap(f"#place-{place}")
        assert page.page.is_visible(shown), place
        assert not page.page.is_visible("#hand"), place
        assert page.page.is_visible("#estop"), place
    assert page.faults == []


# What a finger presses that is smaller than 44 px.
_SMALL = """[...document.querySelectorAll("button, select, input, summary")].filter((found) => {
  const { width, height } = found.getBoundingClientRect();
  return width > 0 && (height < 44 || width < 44) && found.type !== "checkbox";
}).map((found) => `${found.id} ${found.textContent} ${found.getBoundingClientRect().width}`)"""


@FURTHER
@pytest.mark.parametrize("size", [PHONE, TABLET])
def test_what_a_finger_presses_is_large_enough(
    chromium: Any, rig_page: tuple[SaidRig, str], size: dict[str, int]
) -> None:
    _, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=size, has_touch=True, is_mobile=True)
    until(lambda: "follows the hand" in page.banners(), "a rig that runs")
    for place in ("touch", "scene", "scopes", "controls", "more"):
        page.value(f"document.querySelector('#place-{place}').click()")
        assert page.value(_SMALL) == [], place


@FURTHER
@pytest.mark.parametrize(
    ("scheme", "size"),
    [
        pytest.param(scheme, size, id=f"{scheme}-{name}")
        for scheme in ("light", "dark")
        for name, size in (("phone", PHONE), ("tablet", TABLET), ("laptop", LAPTOP))
    ],
)
def test_axe_finds_nothing_in_any_part_of_the_page(
    chromium: Any, rig_page: tuple[SaidRig, str], size: dict[str, int], scheme: str
) -> None:
    rig, address = rig_page
    rig.way = {"offset_m": 1.105e-7, "return_place_m": 0.0, "return_speed_m_per_s": 5e-8, "return_s": 2.0}
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=size, color_scheme=scheme)
    page.page.locator("#go-back").wait_for()
    for place in ("touch", "scene", "scopes", "controls", "more"):
        page.value(f"document.querySelector('#place-{place}').click()")
        check_rules(page, f"{place}, with both choices")
        if size is not PHONE:
            break
    rig.is_stopped = True
    until(lambda: "EMERGENCY STOP" in page.banners(), "the stop")
    check_rules(page, "stopped")


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


@FURTHER
@pytest.mark.parametrize("size", [PHONE, TABLET, LAPTOP], ids=["phone", "tablet", "laptop"])
def test_titles_of_scopes_are_one_line_and_the_name_of_the_profile_is_whole(
    chromium: Any, rig_page: tuple[SaidRig, str], size: dict[str, int]
) -> None:
    _, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=size)
    page.value("document.querySelector('#place-controls').click()")
    page.until("document.querySelectorAll('#profile option').length > 5", "the profiles")
    profile = page.page.locator("#profile")
    profile.select_option("…", force=True)
    page.until("document.querySelectorAll('#profile option').length > 20", "the networks")
    for name in page.value("[...document.querySelectorAll('#profile option')].map((option) => option.value)"):
        profile.evaluate("(list, name) => { list.value = name; }", name)
        # Both paddings and the arrow of the list take 30 px.
        assert profile.evaluate("(list) => list.clientWidth") >= profile.evaluate(_TEXT_WIDTH) + 30.0, name
        row = box(page, "#link .row")
        for part in ("#profile", "#delay", "#delay-set"):
            found = box(page, part)
            assert row["x"] <= found["x"] and found["x"] + found["width"] <= row["x"] + row["width"] + 1.0, part
    page.value("document.querySelector('#place-scopes').click()")
    for layout in page.value("[...document.querySelectorAll('#layout option')].map((option) => option.value)"):
        page.choose("#layout", layout)
        page.page.wait_for_timeout(300.0)
        assert page.value(_CUT) == [], layout
        assert max(page.value(_LINES)) < 20.0, layout
        heights = page.value("[...document.querySelectorAll('.plot .area')].map((area) => area.clientHeight)")
        assert min(heights) > 60.0, layout


_LINES = "[...document.querySelectorAll('.plot .words')].map((words) => words.getBoundingClientRect().height)"
# The boxes of what is shown, by their ids. Who holds control is said in other words during an act, and the banners have
# the width that these leave.
_BOXES = """Object.fromEntries([...document.querySelectorAll("[id]")].flatMap((element) => {
  const { x, y, width, height } = element.getBoundingClientRect();
  const isFree = width === 0 || element.closest("#answers, #events, #watch, #control");
  return isFree ? [] : [[element.id, [x, y, element.id === "banners" ? 0 : width, height]]];
}))"""


# Where the rows of the page begin, and how high they are; below its first row the page of a tablet scrolls.
_ROWS = """["#status", "#next", "#answers", "main", "#hand-force", "#gap"].map((name) => {
  const { y, height } = document.querySelector(name).getBoundingClientRect();
  return [name, y, name === "main" ? 0 : height];
})"""


@FURTHER
@pytest.mark.parametrize("size", [PHONE, TABLET, LAPTOP])
def test_what_came_of_a_press_has_a_place_of_its_own_covers_no_number_and_moves_nothing(
    chromium: Any, rig_page: tuple[SaidRig, str], size: dict[str, int]
) -> None:
    rig, address = rig_page
    page = open_page(chromium, f"{address}#{TOKEN}", viewport=size)
    until(lambda: "follows the hand" in page.banners(), "a rig that runs")
    # the panel of a package comes when its module has been loaded
    page.page.wait_for_selector("#tab-particles", state="attached")
    page.page.wait_for_timeout(500.0)
    before = page.value(_BOXES)
    rig.delay_s = 0.5
    page.page.keyboard.press("o")
    note = page.page.locator(".answer.pending")
    until(note.count, "an answer that is awaited")
    assert page.value(_BOXES) == before
    until(page.page.locator(".answer.done").count, "the answer")
    assert "couple hand and tip: acknowledged" in page.page.inner_text(".answer.done")
    assert page.value(_BOXES) == before
    place, shown = box(page, "#answers"), box(page, ".answer")
    assert shown["y"] >= place["y"] and shown["x"] + shown["width"] <= place["x"] + place["width"]
    # it is whole, and covers nothing
    assert shown["y"] + shown["height"] <= place["y"] + place["height"] + 1.0
    middle = f"{shown['x'] + shown['width'] / 2.0}, {shown['y'] + shown['height'] / 2.0}"
    assert page.value(f"document.elementFromPoint({middle}).closest('#answers')") is not None
    for number in ("#hand-force", "#felt-force"):
        found = box(page, number)
        assert found["y"] >= place["y"] + place["height"] or found["x"] >= place["x"] + place["width"], number
    # one that has no room there is whole for who looks at it, by keys too, and nothing moves for it
    page.value("telenano.cockpit.commands.show('begin', false, 'a reason of many words '.repeat(24)), 0")
    page.until("document.querySelector('#answers').hasAttribute('data-long')", "a place that says that there is more")
    assert page.value(_BOXES) == before
    page.page.focus("#answers")
    assert page.value(
        "(({ clientHeight, scrollHeight }) => clientHeight >= scrollHeight)(document.querySelector('#answers'))"
    )
    assert page.value(_BOXES) == before


def test_a_tip_that_its_guard_withdrew_is_said_to_be_so_and_nothing_moves_for_it(
    chromium: Any, rig_page: tuple[SaidRig, str]
) -> None:
    rig, address = rig_page
    for size in (PHONE, TABLET, LAPTOP):
        rig.tip = {}
        page = open_page(chromium, f"{address}#{TOKEN}", viewport=size)
        until(lambda page=page: "running" in page.banners(), "a rig that runs")
        before = page.value(_ROWS)
        rig.tip = {"mode": "retracted"}
        rig.event = {"kind": "mode", "level": "warning", "text": "the AFM is in mode retracted: force_limit"}
        until(lambda page=page: "above its limit" in page.banners(), "the reason")
        assert "running" not in page.banners()
        assert "force_limit" not in page.page.inner_text("body")
        assert page.value(_ROWS) == before
        page.page.context.close()


def test_a_page_whose_server_has_gone_calls_nothing_refused(chromium: Any) -> None:
    rig = SaidRig()
    with served(rig) as (_, address):
        page = open_page(chromium, f"{address}#{TOKEN}", viewport=LAPTOP)
        until(lambda: "follows the hand" in page.banners(), "a rig that runs")
    until(lambda: "DISCONNECTED" in page.banners(), "the banner of a lost server")
    said = page.answered(lambda: page.page.keyboard.press("Escape"))
    assert said.startswith("emergency stop: not sent") and "telenano estop" in said
    page.until("/emergency stop: not sent/.test(document.querySelector('#events').textContent)", "the event")


@FURTHER
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
    press(second, "Give up control")
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
    until(lambda: "FORCE DIFFERS" in page.banners(), "the banner")
    until(lambda: "the hand pressed with 0.0 N" in page.page.inner_text("#hand-text"), "the words at the pad")
    page.picture("force-differs-laptop")
    # What is said takes room of the pad, and the hand that is still dragged means no other place by it.
    before = page.value("telenano.cockpit.hand.force")
    at = box(page, "#hand-pad")
    page.page.mouse.move(at["x"] + 121.0, page.value("window.lastY"))
    assert page.value("telenano.cockpit.hand.force") == pytest.approx(before, rel=0.02)
    page.page.mouse.up()
    rig.is_deaf = False
    until(lambda: "FORCE DIFFERS" not in page.banners(), "the end of the banner")
    rig.is_silent = True
    until(lambda: "no data came from the hand" in page.banners(), "the banner of a silence")
