"""The page against a running rig: what it does is looked for on the bus, not in the page."""

import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from browser_page import BESIDE_A_BROWSER, FILLED, Page, View, has, needs_browser, open_page, until
from page_walks import check_rules
from stack_rig import Rig

pytestmark = [pytest.mark.browser, needs_browser]


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    rig = Rig(tmp_path_factory.mktemp("viewed"))
    try:
        rig.start("--duration", "1800", "--no-view", *BESIDE_A_BROWSER, scenario="image")
        rig.wait_until(rig.running, "a running session")
        yield rig
    finally:
        rig.close()


@pytest.fixture(scope="module")
def view(rig: Rig) -> Iterator[View]:
    view = View(rig.environment)
    yield view
    view.close()


@pytest.fixture(scope="module")
def operator(chromium: Any, view: View) -> Page:
    page = open_page(chromium, view.operator)
    page.until("telenano.store.rings.get('tip')?.length > 200", "curves on the page")
    until(lambda: page.page.locator("#law-name option").count() > 1, "the forms of the law")
    return page


def since(rig: Rig, topic: str, begin_ns: int) -> list[Any]:
    return [message.decode() for message in rig.recording().messages(topic, begin_ns)]


@pytest.mark.endurance
def test_the_forms_and_profiles_of_the_link_change_it(rig: Rig, operator: Page) -> None:
    link = lambda: rig.newest("link/status")  # noqa: E731
    operator.click("#tab-settings")
    forms = {"#link-forward-jitter-scale_s": "2", "#link-backward-loss-probability": "0.05"}
    for field, value in forms.items():
        operator.fill(field, value)
    assert "acknowledged" in operator.answered(lambda: operator.click("#link-apply"))
    rig.wait_until(lambda: link().forward.settings.get("jitter.scale_s") == 0.002, "the jitter on the bus")
    rig.wait_until(lambda: link().backward.settings.get("loss.probability") == 0.05, "the loss on the bus")
    rig.wait_until(lambda: sum(link().backward.dropped.values()) > 0, "messages that are lost")
    until(lambda: operator.last("link", "backward_loss") > 0.0, "the loss on the page")
    # what is in force is what the rig reports, and a field that was applied is empty again
    forward = "document.querySelector('#link-forward-jitter-scale_s')"
    operator.until(f"{forward}.placeholder === '2' && {forward}.value === ''", "the jitter in its field")
    operator.until("document.querySelector('#profile').value === 'custom'", "the network that is in force")
    operator.answered(lambda: operator.choose("#profile", "dsl"))
    rig.wait_until(lambda: link().forward.profile == "dsl", "the profile on the bus")
    until(lambda: "DELAYED" in operator.banners(), "the banner of its delay")
    operator.answered(lambda: operator.choose("#profile", "clean"))
    rig.wait_until(lambda: link().forward.profile == "clean", "the profile without impairments")


@pytest.mark.endurance
def test_the_programs_of_the_instrument_run_pause_and_end_from_the_page(rig: Rig, operator: Page) -> None:
    def is_at(program: str, state: str) -> bool:
        # The instrument reports its first programme when that begins, so there may be no report yet.
        reports = [message.decode() for message in rig.recording().messages("afm/program")[-1:]]
        return [(report.program, report.state) for report in reports] == [(program, state)]

    operator.until("!document.querySelector('#instrument').hidden", "the controls of the instrument")
    operator.fill("#program-curve-load_n", "10")
    operator.fill("#program-curve-speed_m_per_s", "100")
    begin_ns = time.time_ns()
    assert "acknowledged" in operator.answered(lambda: operator.click("#program-curve"))
    rig.wait_until(lambda: is_at("curve", "finished"), "a force curve")
    rig.wait_until(lambda: rig.newest("afm/state").mode == "retracted", "a tip that is away")
    pressed_n = max(state.tip_force_n[2] for state in since(rig, "afm/state", begin_ns))
    assert pressed_n == pytest.approx(1e-8, rel=0.1)
    operator.fill("#program-scan-lines", "8")
    # a pixel needs two steps of the instrument, which makes 250 a second here
    operator.fill("#program-scan-dwell_s", "10")
    assert "acknowledged" in operator.answered(lambda: operator.click("#program-scan"))
    rig.wait_until(lambda: is_at("scan", "running"), "an image that is taken")
    for button, state in (("pause", "paused"), ("resume", "running"), ("abort", "ended")):
        assert "acknowledged" in operator.answered(lambda button=button: operator.click(f"#program-{button}"))
        rig.wait_until(lambda state=state: is_at("scan", state), f"an image that is {state}")
    rig.wait_until(lambda: rig.newest("afm/state").mode == "retracted", "a tip that is away")
    assert "acknowledged" in operator.answered(lambda: operator.click("#program-tactile"))
    rig.wait_until(lambda: is_at("tactile", "running"), "the tactile path")
    # ends what runs, and lets the tip follow the hand again
    operator.click("#mode-bilateral")
    rig.wait_until(lambda: rig.newest("afm/state").mode == "follow", "a tip that follows")
    operator.fill("#tip-x", "-12")
    operator.fill("#tip-y", "7")
    assert "acknowledged" in operator.answered(lambda: operator.click("#tip-go"))
    place_m = pytest.approx((-12e-9, 7e-9), rel=1e-6)
    rig.wait_until(lambda: rig.newest("afm/state").base_position_m[:2] == place_m, "the tip at its place")
    files = len(list(rig.out.glob("session*.mcap")))
    assert "acknowledged" in operator.answered(lambda: operator.click("#split"))
    rig.wait_until(lambda: len(list(rig.out.glob("session*.mcap"))) == files + 1, "a new file")
    assert operator.faults == []


@pytest.mark.endurance
def test_the_keyboard_pushes_marks_and_pauses(rig: Rig, operator: Page) -> None:
    keyboard = operator.page.keyboard
    begin_ns = time.time_ns()
    operator.page.locator("#hand-pad").focus()
    for _ in range(8):
        # a key that is held repeats itself: a millimetre each time
        keyboard.down("ArrowDown")
    pushes = lambda: [message.force_n[2] < -0.2 for message in since(rig, "operator/force", begin_ns)]  # noqa: E731
    rig.wait_until(lambda: any(pushes()), "the force of the keys on its topic")
    keyboard.up("ArrowDown")
    rig.wait_until(lambda: rig.newest("haptic/state").operator_force_n[2] == 0.0, "a hand that has let go")
    begin_ns = time.time_ns()
    assert "acknowledged" in operator.answered(lambda: keyboard.press("m"))
    rig.wait_until(lambda: any(event.kind == "mark" for event in since(rig, "session/event", begin_ns)), "the mark")
    for pressed in ("true", "false"):
        keyboard.press("p")
        operator.until(f"document.querySelector('#pause').ariaPressed === '{pressed}'", "scopes that stand or go on")


@pytest.mark.endurance
def test_what_is_saved_is_every_sample_that_is_shown(rig: Rig, operator: Page) -> None:
    operator.choose("#span", "1")
    operator.until("telenano.store.rings.get('hand')?.length > 1000", "a second of the hand")
    operator.click("#pause")
    operator.until("document.querySelector('#pause').textContent === 'Continue'", "scopes that stand")
    with operator.page.expect_download() as saved:
        operator.click("#save-csv")
    rows = [line.split(",") for line in saved.value.path().read_text().splitlines()]
    assert rows[0] == ["stream", "time_s", "column", "value", "unit"]
    assert rows[1][:3] == ["session", "0.000000", "t_ns"]
    origin_ns = int(rows[1][3])
    hand = [row for row in rows if (row[0], row[2]) == ("hand", "position")]
    shown = [(round(1e9 * float(row[1])) + origin_ns, float(row[3])) for row in hand]
    assert len(shown) > 125, "of a second at 250 Hz"
    # the recorder writes a chunk at a time, so the file may have the last of them later than the page
    rig.wait_until(lambda: rig.newest("haptic/state").t_ns > shown[-1][0], "what is shown in the recording")
    sent = sorted((state.t_ns, -state.position_m[2]) for state in since(rig, "haptic/state", origin_ns))
    # the page keeps times to some hundredths of a millisecond
    after = np.clip(np.searchsorted([at for at, _ in sent], [at for at, _ in shown]), 1, len(sent) - 1)
    pairs = [
        (min(sent[i - 1 : i + 1], key=lambda one, at=at: abs(one[0] - at)), at, value)
        for i, (at, value) in zip(after, shown, strict=True)
    ]
    # a recorder that lacks a processor may miss a sample that the page was sent
    same = [(found[1], value) for found, at, value in pairs if abs(found[0] - at) < 100_000]
    assert len(same) > 0.95 * len(shown)
    assert [value for _, value in same] == pytest.approx([sent for sent, _ in same], rel=1e-6, abs=1e-9)
    with operator.page.expect_download() as saved:
        operator.click("#save-png")
    assert saved.value.path().read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    operator.click("#pause")
    operator.choose("#span", "10")


@pytest.mark.endurance
def test_the_hand_holds_while_the_page_draws_for_longer_than_the_server_waits(rig: Rig, operator: Page) -> None:
    def held() -> bool:
        """Press, keep the page busy for longer than the server waits, and return whether the hand went on pushing."""
        operator.press(10.0)
        rig.wait_until(lambda: rig.newest("haptic/state").operator_force_n[2] < -0.2, "a hand that pushes")
        begin_ns = time.time_ns()
        # as one long picture does: nothing else of the page runs meanwhile
        operator.value("(() => { const begun = performance.now(); while (performance.now() - begun < 700); })()")
        end_ns = time.time_ns()
        rig.wait_until(lambda: rig.newest("haptic/state").t_ns > end_ns, "what was recorded meanwhile")
        pushes = [-s.operator_force_n[2] for s in since(rig, "haptic/state", begin_ns) if s.t_ns < end_ns]
        sent = [message for message in since(rig, "operator/force", begin_ns) if message.t_ns < end_ns]
        operator.page.mouse.up()
        rig.wait_until(lambda: rig.newest("haptic/state").operator_force_n[2] == 0.0, "a hand that has let go")
        # and by the newest place of the arm, not by that before the picture
        return min(pushes) > 0.0 and len({message.force_n[2] for message in sent}) > 5

    # Where others have the processors, the server itself may be held up for longer than it waits for a page. A hand
    # whose spring is in the drawing thread is let go each time.
    assert any(held() for _ in range(8))


@pytest.mark.endurance
def test_what_a_node_refuses_is_said_on_the_page(operator: Page) -> None:
    # the field says itself what cannot be, and nothing is sent
    operator.fill("#law-virtual_impedance-force_gain", "-1")
    operator.click("#law-apply")
    operator.until(has("#law-virtual_impedance-force_gain-fault", "must be"), "what is wrong at the field")
    assert operator.page.get_attribute("#law-virtual_impedance-force_gain", "aria-invalid") == "true"
    wrong = "{k: 'command', command: 'set', target: 'controller', parameters: {'virtual_impedance.force_gain': -1}}"
    answer = operator.value(f"telenano.connection.ask({wrong})")
    assert (answer["ok"], "force_gain" in answer["text"]) == (False, True)
    operator.fill("#law-virtual_impedance-force_gain", "")


# a gamepad whose stick is pushed half way, and that keeps what it was told to rumble
GAMEPAD = """
globalThis.rumbles = []; globalThis.resets = 0;
const motor = {
  playEffect: (kind, effect) => { rumbles.push({ kind, ...effect }); return Promise.resolve("complete"); },
  reset: () => { resets += 1; return Promise.resolve("complete"); },
};
globalThis.pad = { connected: true, axes: [0, 0], buttons: [], vibrationActuator: motor };
Object.defineProperty(navigator, "getGamepads", { value: () => [null, pad] });
"""


@pytest.mark.endurance
def test_a_gamepad_presses_with_its_stick_and_rumbles_with_the_force_that_comes_back(rig: Rig, operator: Page) -> None:
    operator.value(GAMEPAD)
    try:
        operator.value("pad.axes[1] = 0.8")
        rig.wait_until(lambda: rig.newest("operator/force").force_n[2] < -0.2, "the force of the stick on its topic")
        rig.wait_until(lambda: rig.newest("haptic/command").force_n[2] > 0.1, "the force that comes back")
        operator.until("rumbles.some((effect) => effect.strongMagnitude > 0.02)", "a gamepad that rumbles")
        strongest = operator.value("Math.max(...rumbles.map((effect) => effect.strongMagnitude))")
        felt_n = max(message.force_n[2] for message in since(rig, "haptic/command", 0))
        # no more than what came back, of which 3 N are all that it has
        assert strongest <= 1.01 * felt_n / 3.0
    finally:
        operator.value("pad.axes[1] = 0")
    operator.until("resets > 0", "a gamepad that rests with the hand")
    rig.wait_until(lambda: rig.newest("haptic/state").operator_force_n[2] == 0.0, "a hand that has let go")


@pytest.mark.endurance
def test_a_force_that_is_kept_is_released_by_a_scan_and_a_stop_and_not_taken_up_again(rig: Rig, operator: Page) -> None:
    force_n = lambda: rig.newest("haptic/state").operator_force_n[2]  # noqa: E731

    def hold() -> None:
        operator.follow()
        operator.click("#hand-keep")
        operator.press(10.0)
        operator.page.mouse.up()
        rig.wait_until(lambda: force_n() < -0.2, "the force at the device")

    def check_nothing_presses() -> None:
        begin_ns = time.time_ns()
        operator.page.wait_for_timeout(2000.0)
        assert not any(state.operator_force_n[2] for state in since(rig, "haptic/state", begin_ns))

    hold()
    for key, value in {"pixels": "16", "lines": "8", "dwell_s": "8"}.items():
        operator.fill(f"#program-scan-{key}", value)
    assert "acknowledged" in operator.answered(lambda: operator.click("#program-scan"))
    rig.wait_until(lambda: force_n() == 0.0, "a hand that has let go")
    operator.until(has("#hand-text", "Let go: the program Image runs"), "why")
    assert operator.page.get_attribute("#hand-keep", "aria-pressed") == "false"
    rig.wait_until(lambda: rig.newest("afm/state").mode == "retracted", "the end of the image")
    operator.follow()
    check_nothing_presses()
    hold()
    operator.answered(lambda: operator.click("#stop"))
    rig.wait_until(lambda: rig.newest("haptic/state").session_s < 0.0, "the end of the operator's force profile")
    operator.until(has("#hand-text", "Let go: "), "why")
    operator.answered(lambda: operator.click("#start"))
    rig.wait_until(lambda: rig.newest("haptic/state").session_s >= 0.0, "its start")
    check_nothing_presses()


@pytest.mark.endurance
def test_the_sample_is_imaged_from_the_page_and_the_tip_goes_where_the_pointer_says(rig: Rig, operator: Page) -> None:
    operator.until("!document.querySelector('#instrument').hidden", "the controls of the instrument")
    for key, value in {"pixels": "32", "lines": "40", "dwell_s": "12"}.items():
        operator.fill(f"#program-scan-{key}", value)
    begin_ns = time.time_ns()
    answer = operator.answered(lambda: operator.click("#program-scan"))
    assert "acknowledged" in answer, answer
    operator.until(f"{FILLED} > 1", "the first lines of the surface")
    first = operator.value(FILLED)
    operator.until(f"{FILLED} > {first}", "a surface that grows")
    operator.until(f"{FILLED} > 24", "more than half of it")
    rig.wait_until(lambda: rig.newest("afm/program").state == "finished", "the end of the image")
    operator.until(f"{FILLED} === 40", "the whole surface")
    published = [line for line in since(rig, "afm/scanline", begin_ns) if line.direction == "trace"]
    assert [line.line for line in published] == list(range(40))
    heights_nm = 1e9 * np.array([np.frombuffer(line.height_m.data, f"<{line.height_m.dtype}") for line in published])
    # a dot is 10 nm high, and the page has what was published
    assert np.ptp(heights_nm) > 5.0
    shown_nm = operator.value("[telenano.view.surface.least, telenano.view.surface.greatest]")
    assert shown_nm == pytest.approx([heights_nm.min(), heights_nm.max()], rel=1e-5)
    operator.until(has("#program-state", "scan is finished"), "the page's word")
    # after an image the tip is away until it is armed
    operator.click("#mode-bilateral")
    rig.wait_until(lambda: rig.newest("afm/state").mode == "follow", "a tip that follows")
    operator.click("#place-tip")
    box = operator.page.locator("#scene .solid > canvas").bounding_box()
    x, y = box["x"] + 0.56 * box["width"], box["y"] + 0.58 * box["height"]
    wanted = lambda: [  # noqa: E731
        (control.parameters["lateral.x_m"], control.parameters["lateral.y_m"])
        for control in since(rig, "session/control", begin_ns)
        if "lateral.x_m" in control.parameters
    ]

    def carried() -> bool:
        # a server that was held up for a second refuses what may have waited meanwhile, in words: drag again
        operator.page.mouse.move(x, y)
        operator.page.mouse.down()
        operator.page.mouse.move(x + 40.0, y, steps=4)
        operator.page.mouse.up()
        operator.page.wait_for_timeout(1500.0)
        return len(wanted()) > 0

    def is_there() -> bool:
        at = rig.newest("afm/state").base_position_m[:2]
        return any(at == pytest.approx(place, rel=1e-6) for place in wanted())

    # At one of the places that were asked for: of those that came too late for their second the instrument takes none,
    # and of those that did not reach the recorder nobody knows here.
    rig.wait_until(lambda: is_there() or (carried() and is_there()), "the tip where the pointer was")
    operator.click("#place-tip")
    # pressed onto the sample there, so that every curve has something to show
    operator.click("#hand-keep")
    operator.press(14.0)
    operator.page.mouse.up()
    rig.wait_until(lambda: rig.newest("haptic/command").force_n[2] > 0.1, "the force that comes back")
    scale = operator.value("telenano.view.surface.mesh.scale.z")
    operator.choose("#stretch", "2")
    operator.click("#section")
    operator.picture("section")
    assert operator.value("telenano.view.surface.mesh.scale.z") == 2.0 * scale
    operator.click("#section")
    operator.choose("#stretch", "1")
    operator.choose("#stereo", "anaglyph")
    operator.picture("anaglyph")
    operator.choose("#stereo", "off")
    operator.click("#hand-keep")
    rig.wait_until(lambda: rig.newest("haptic/state").operator_force_n[2] == 0.0, "a hand that has let go")


@pytest.mark.endurance
def test_the_tip_is_pressed_from_a_headset_and_stopped_there(rig: Rig, chromium: Any, view: View) -> None:
    page = open_page(chromium, view.operator, headset=True)
    page.until("telenano.store.rings.get('tip')?.length > 100", "curves on the page")
    page.until("!document.querySelector('#vr').hidden", "a browser with a headset")
    page.click("#vr")
    page.until("telenano.view.headset.isPresenting", "a session of the headset")
    begin = page.value("telenano.view.frames")
    page.until(f"telenano.view.frames > {begin} + 3", "pictures in the headset")
    hands = "headset.controllers"
    page.value(f"{hands}.right.position.set(0.1, 1.2, -0.4); {hands}.left.position.set(-0.1, 1.2, -0.4)")
    # one hand carries the surface as far as it goes itself, two scale it
    page.value(f"{hands}.right.updateButtonValue('squeeze', 1)")
    page.until("telenano.view.headset.held.size === 1", "a surface in the hand")
    page.until("telenano.view.headset.before.length === 1", "a picture of it")
    before = page.value("telenano.view.world.position.toArray()")
    page.value(f"{hands}.right.position.set(0.3, 1.2, -0.4)")
    page.until(f"telenano.view.world.position.x > {before[0]} + 0.199", "a surface that was carried")
    after = page.value("telenano.view.world.position.toArray()")
    assert np.subtract(after, before) == pytest.approx([0.2, 0.0, 0.0], abs=1e-3)
    scale = page.value("telenano.view.world.scale.x")
    page.value(f"{hands}.left.updateButtonValue('squeeze', 1)")
    page.until("telenano.view.headset.before.length === 2", "a surface in both hands")
    page.value(f"{hands}.left.position.set(-0.5, 1.2, -0.4)")
    page.until(f"telenano.view.world.scale.x > 1.9 * {scale}", "a surface twice as large")
    page.value(f"{hands}.left.updateButtonValue('squeeze', 0); {hands}.right.updateButtonValue('squeeze', 0)")
    page.until("telenano.view.headset.held.size === 0", "a surface that was let go")
    # the trigger takes hold of the arm, and 12 cm down mean 12 mm at the arm
    page.value(f"{hands}.right.updateButtonValue('trigger', 1)")
    page.until("telenano.view.headset.pressed", "a trigger that is held")
    page.value(f"{hands}.right.position.set(0.3, 1.08, -0.4)")
    rig.wait_until(lambda: rig.newest("operator/force").force_n[2] < -0.2, "the force of the headset on its topic")
    rig.wait_until(lambda: rig.newest("afm/state").in_contact, "the tip on the sample")
    rig.wait_until(lambda: rig.newest("haptic/command").force_n[2] > 0.1, "the force that comes back")
    page.value(f"{hands}.right.updateButtonValue('b-button', 1)")
    rig.wait_until(lambda: rig.newest("afm/state").mode == "estop", "the stop at the instrument")
    rig.wait_until(lambda: rig.newest("haptic/state").estop, "the stop at the haptic device")
    page.value(f"{hands}.right.updateButtonValue('b-button', 0); {hands}.right.updateButtonValue('trigger', 0)")
    page.until("!telenano.view.headset.pressed", "a trigger that was let go")
    page.click("#vr")
    page.until("!telenano.view.headset.isPresenting", "the end of the session of the headset")
    assert page.value("telenano.view.world.scale.x") == 1.0
    page.click("#arm")
    rig.wait_until(lambda: not rig.newest("haptic/state").estop, "an armed haptic device")
    page.page.context.close()


# how long after the last report of a node its banner stood there [ms]
FIRST_LOST = """
globalThis.lostAfter = Infinity;
new MutationObserver((_, observer) => {
  if (!document.querySelector("#banners").textContent.includes("LOST: Law at the tip")) return;
  globalThis.lostAfter = telenano.store.clock.ms - telenano.store.nodes.get("controller@slave").heard;
  observer.disconnect();
}).observe(document.querySelector("#banners"), { childList: true, subtree: true });
"""


@pytest.mark.endurance
def test_a_lost_node_is_shown_within_a_second(rig: Rig, operator: Page) -> None:
    found = rig.process_of("controller@slave")
    assert found is not None
    operator.value(FIRST_LOST)
    os.kill(found, signal.SIGSTOP)
    try:
        until(lambda: "LOST: Law at the tip" in operator.banners(), "the banner of the lost node")
    finally:
        os.kill(found, signal.SIGCONT)
    until(lambda: "LOST" not in operator.banners(), "its return")
    # by the clock of the page, which stands still when the page does
    assert operator.value("lostAfter") <= 1000.0


@pytest.mark.endurance
def test_everything_has_a_name_and_can_be_read_in_light_and_dark(operator: Page) -> None:
    operator.value("document.querySelectorAll('details').forEach((found) => { found.open = true; })")
    # The events have a pane where there is room for one beside the scopes, and are a tab on a narrower screen.
    usual, narrow = operator.page.viewport_size, {"width": 1280, "height": 850}
    for tab, size in (("image", usual), ("nodes", usual), ("events", narrow), ("settings", usual)):
        operator.page.set_viewport_size(size)
        operator.page.wait_for_selector(f"#tab-{tab}", state="attached")
        operator.click(f"#tab-{tab}")
        check_rules(operator, tab)
    for place in ("one theme", "the other"):
        check_rules(operator, place)
        operator.click("#theme")
    operator.value("document.querySelectorAll('details').forEach((found) => { found.open = false; })")
