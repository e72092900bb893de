"""The page against a running rig: what it does is looked for on the bus, not in the page."""

import os
import re
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_page import Page, View, browser, needs_browser, open_page, until
from stack_rig import Rig

from presets import DEFAULT_SITE_FILE
from proto import encode
from proto.messages import AfmScanline, Array
from recording.writer import RecordingWriter
from services.recorder.config import RecorderConfig
from services.runtime.bus import ZmqPublisher
from services.runtime.main import load_site
from services.runtime.participant import open_participant
from services.viz_node.requests import PROTOCOL

pytestmark = [pytest.mark.browser, needs_browser]

# an image of 96 x 96 points over 120 nm: terraces of mica with a grain on them
POINTS = 96
SIZE_M = 120e-9
EPOCH_NS = 10**18
# lines that the surface on the page has
FILLED = "telenano.view.surface.filled.filter(Boolean).length"
TIP = "afm_node@slave"
LINE_NS = 20_000_000


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        yield found


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    rig = Rig(tmp_path_factory.mktemp("viewed"))
    try:
        rig.start("--duration", "600", scenario="image")
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


def has(selector: str, text: str) -> str:
    """Return the expression for whether an element of the page has a text."""
    return f"document.querySelector({selector!r}).textContent.includes({text!r})"


def newest(rig: Rig, topic: str) -> Any:
    return rig.recording().messages(topic)[-1].decode()


def since(rig: Rig, topic: str, begin_ns: int) -> list[Any]:
    return [message.decode() for message in rig.recording().messages(topic, begin_ns)]


@pytest.mark.endurance
def test_every_control_changes_the_rig(rig: Rig, operator: Page) -> None:
    operator.fill("#delay", "4")
    assert "acknowledged" in operator.answered(lambda: operator.click("#delay-set"))
    rig.wait_until(lambda: newest(rig, "link/status").forward.settings.get("delay_s") == 0.004, "the delay on the bus")
    until(lambda: "DELAYED" in operator.banners(), "the banner of the delay")
    operator.fill("#delay", "0")
    operator.answered(lambda: operator.click("#delay-set"))
    operator.answered(lambda: operator.choose("#law-name", "wave"))
    rig.wait_until(lambda: newest(rig, "teleop/backward").law == "wave", "the law on the bus")
    operator.answered(lambda: operator.choose("#law-name", "virtual_impedance"))
    operator.fill("#law-virtual_impedance-force_gain", "12.5")
    operator.answered(lambda: operator.click("#law-apply"))
    begin_ns = time.time_ns()
    operator.fill("#mark-text", "jump to contact")
    operator.answered(lambda: operator.click("#mark"))
    marks = lambda: [event for event in since(rig, "session/event", begin_ns) if event.kind == "mark"]  # noqa: E731
    rig.wait_until(lambda: any(mark.data.get("text") == "jump to contact" for mark in marks()), "the mark")
    operator.answered(lambda: operator.click("#stop"))
    rig.wait_until(lambda: newest(rig, "haptic/state").session_s < 0.0, "the end of the operator's programme")
    operator.answered(lambda: operator.click("#start"))
    rig.wait_until(lambda: newest(rig, "haptic/state").session_s >= 0.0, "its start")
    assert operator.faults == []


@pytest.mark.endurance
def test_what_a_node_refuses_is_said_on_the_page(operator: Page) -> None:
    operator.page.evaluate("document.querySelector('#law-virtual_impedance-force_gain').removeAttribute('min')")
    operator.fill("#law-virtual_impedance-force_gain", "-1")
    answer = operator.answered(lambda: operator.click("#law-apply"))
    assert "refused" in answer
    assert "force_gain" in answer
    operator.fill("#law-virtual_impedance-force_gain", "")


@pytest.mark.endurance
def test_the_virtual_hand_presses_the_tip_and_the_force_comes_back(rig: Rig, operator: Page) -> None:
    # to 10 mm below where the arm is: 2 N at first
    operator.press(10.0)
    rig.wait_until(lambda: newest(rig, "operator/force").force_n[2] < -0.2, "the force of the page on its topic")
    rig.wait_until(lambda: newest(rig, "haptic/state").operator_force_n[2] < -0.2, "the force at the device")
    rig.wait_until(lambda: newest(rig, "afm/state").in_contact, "the tip on the sample")
    rig.wait_until(lambda: newest(rig, "haptic/command").force_n[2] > 0.1, "the force that comes back")
    until(lambda: operator.last("command", "tip_force") > 0.1, "that force on the page")
    until(lambda: operator.last("tip", "force") > 1e-9, "the push of the sample")
    operator.picture("touch")
    operator.page.mouse.up()
    rig.wait_until(lambda: newest(rig, "haptic/state").operator_force_n[2] == 0.0, "a hand that has let go")


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
        rig.wait_until(lambda: newest(rig, "operator/force").force_n[2] < -0.2, "the force of the stick on its topic")
        rig.wait_until(lambda: newest(rig, "haptic/command").force_n[2] > 0.1, "the force that comes back")
        operator.until("rumbles.some((effect) => effect.strongMagnitude > 0.02)", "a gamepad that rumbles")
        strongest = operator.value("Math.max(...rumbles.map((effect) => effect.strongMagnitude))")
        felt_n = max(message.force_n[2] for message in since(rig, "haptic/command", 0))
        # no more than what came back, of which 3 N are all that it has
        assert strongest <= 1.01 * felt_n / 3.0
    finally:
        operator.value("pad.axes[1] = 0")
    operator.until("resets > 0", "a gamepad that rests with the hand")
    rig.wait_until(lambda: newest(rig, "haptic/state").operator_force_n[2] == 0.0, "a hand that has let go")


@pytest.mark.endurance
def test_the_sample_is_imaged_from_the_page_and_the_tip_goes_where_the_pointer_says(rig: Rig, operator: Page) -> None:
    operator.until("!document.querySelector('#instrument').hidden", "the controls of the instrument")
    for key, value in {"pixels": "64", "lines": "40", "dwell_s": "0.003"}.items():
        operator.fill(f"#program-scan-{key}", value)
    begin_ns = time.time_ns()
    answer = operator.answered(lambda: operator.click("#program-scan"))
    assert "acknowledged" in answer, answer
    operator.until(f"{FILLED} > 1", "the first lines of the surface")
    first = operator.value(FILLED)
    operator.until(f"{FILLED} > {first}", "a surface that grows")
    operator.until(f"{FILLED} > 24", "more than half of it")
    operator.picture("surface")
    rig.wait_until(lambda: newest(rig, "afm/program").state == "finished", "the end of the image")
    operator.until(f"{FILLED} === 40", "the whole surface")
    published = [line for line in since(rig, "afm/scanline", begin_ns) if line.direction == "trace"]
    assert [line.line for line in published] == list(range(40))
    heights_nm = 1e9 * np.array([np.frombuffer(line.height_m.data, f"<{line.height_m.dtype}") for line in published])
    # a dot is 10 nm high, and the page has what was published
    assert np.ptp(heights_nm) > 5.0
    shown_nm = operator.value("[telenano.view.surface.least, telenano.view.surface.greatest]")
    assert shown_nm == pytest.approx([heights_nm.min(), heights_nm.max()], rel=1e-5)
    operator.until(has("#program-state", "the scan is finished"), "the page's word")
    # after an image the tip is away until it is armed
    operator.click("#mode-bilateral")
    rig.wait_until(lambda: newest(rig, "afm/state").mode == "follow", "a tip that follows")
    operator.click("#place-tip")
    box = operator.page.locator("#scene > canvas").bounding_box()
    x, y = box["x"] + 0.56 * box["width"], box["y"] + 0.68 * box["height"]
    operator.page.mouse.move(x, y)
    operator.page.mouse.down()
    operator.page.mouse.move(x + 40.0, y, steps=4)
    operator.page.mouse.up()
    operator.click("#place-tip")
    rig.wait_until(lambda: abs(newest(rig, "afm/state").base_position_m[0]) > 2e-9, "a tip that was carried")
    wanted = [
        (control.parameters["lateral.x_m"], control.parameters["lateral.y_m"])
        for control in since(rig, "session/control", begin_ns)
        if "lateral.x_m" in control.parameters
    ]
    rig.wait_until(
        lambda: newest(rig, "afm/state").base_position_m[:2] == pytest.approx(wanted[-1], rel=1e-6), "the tip there"
    )
    # pressed onto the sample there, so that every curve has something to show
    operator.press(14.0)
    rig.wait_until(lambda: newest(rig, "haptic/command").force_n[2] > 0.1, "the force that comes back")
    operator.page.wait_for_timeout(6000.0)
    operator.picture("scanned")
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
    operator.page.set_viewport_size({"width": 820, "height": 1180})
    operator.page.wait_for_timeout(500.0)
    operator.picture("tablet")
    operator.page.set_viewport_size({"width": 1360, "height": 850})
    operator.page.mouse.up()


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
    rig.wait_until(lambda: newest(rig, "operator/force").force_n[2] < -0.2, "the force of the headset on its topic")
    rig.wait_until(lambda: newest(rig, "afm/state").in_contact, "the tip on the sample")
    rig.wait_until(lambda: newest(rig, "haptic/command").force_n[2] > 0.1, "the force that comes back")
    page.value(f"{hands}.right.updateButtonValue('b-button', 1)")
    rig.wait_until(lambda: newest(rig, "afm/state").mode == "estop", "the stop at the instrument")
    rig.wait_until(lambda: newest(rig, "haptic/state").estop, "the stop at the haptic device")
    page.value(f"{hands}.right.updateButtonValue('b-button', 0); {hands}.right.updateButtonValue('trigger', 0)")
    page.until("!telenano.view.headset.pressed", "a trigger that was let go")
    page.click("#vr")
    page.until("!telenano.view.headset.isPresenting", "the end of the session of the headset")
    assert page.value("telenano.view.world.scale.x") == 1.0
    page.click("#arm")
    rig.wait_until(lambda: not newest(rig, "haptic/state").estop, "an armed haptic device")
    page.page.context.close()


@pytest.mark.endurance
def test_an_observer_sees_and_cannot_command(chromium: Any, view: View) -> None:
    observer = open_page(chromium, view.observer)
    observer.until("telenano.store.rings.get('tip')?.length > 100", "curves on the observer's page")
    assert observer.page.is_disabled("#estop")
    answer = observer.value("telenano.connection.ask({k: 'command', command: 'stop', target: 'haptic_node'})")
    assert (answer["ok"], "observer" in answer["text"]) == (False, True)
    observer.page.context.close()


@pytest.mark.endurance
def test_a_lost_node_is_shown(rig: Rig, operator: Page) -> None:
    found = rig.process_of("controller@slave")
    assert found is not None
    os.kill(found, signal.SIGSTOP)
    try:
        until(lambda: "LOST: controller@slave" in operator.banners(), "the banner of the lost node")
    finally:
        os.kill(found, signal.SIGCONT)
    until(lambda: "LOST" not in operator.banners(), "its return")


@pytest.mark.endurance
def test_the_emergency_stop_is_on_a_key(rig: Rig, operator: Page) -> None:
    answer = operator.answered(lambda: operator.page.keyboard.press("Escape"))
    assert "acknowledged" in answer
    rig.wait_until(lambda: newest(rig, "haptic/state").estop, "the stop at the haptic device")
    rig.wait_until(lambda: newest(rig, "afm/state").mode == "estop", "the stop at the instrument")
    until(lambda: "EMERGENCY STOP" in operator.banners(), "the banner of the stop")
    operator.click("#theme")
    operator.picture("stopped-dark")
    operator.click("#arm")
    rig.wait_until(lambda: not newest(rig, "haptic/state").estop, "an armed haptic device")


def heights_m(line: int) -> Any:
    """Return a line of an image: terraces of mica with a grain on them."""
    x, y = np.linspace(0.0, 1.0, POINTS), line / (POINTS - 1)
    terrace = 1e-9 * (np.floor(3.0 * (0.7 * x + 0.4 * y)))
    grain = 6e-9 * np.exp(-((x - 0.62) ** 2 + (y - 0.45) ** 2) / 0.012)
    return terrace + grain + 0.05e-9 * np.sin(60.0 * x + 9.0 * y)


def scanline(line: int) -> dict[str, Any]:
    """Return the fields of a line of the image."""
    y_m = (line / (POINTS - 1) - 0.5) * SIZE_M
    return {
        "line": line,
        "lines": POINTS,
        "direction": "trace",
        "start_m": (-SIZE_M / 2, y_m, 0.0),
        "end_m": (SIZE_M / 2, y_m, 0.0),
        "height_m": Array.from_numpy(heights_m(line)),
        "amplitude_m": None,
        "phase_rad": None,
    }


def scanned(folder: Path) -> Path:
    """Write a recording of an image, line by line."""
    writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=folder))
    channel = writer.channel("afm/scanline", TIP, "slave")
    for line in range(POINTS):
        t_ns = EPOCH_NS + line * LINE_NS
        message = AfmScanline(seq=line, t_ns=t_ns, src=TIP, v=1, **scanline(line))
        writer.write(channel, t_ns, t_ns, line, encode(message))
    writer.finish()
    return writer.path


def check_section_and_pick(page: Page) -> None:
    """Look at the middle of the image: the section through it and a picked point are what was measured."""
    page.click("#section")
    page.until("telenano.view.section.profile", "a section along the lines")
    profile = page.value("telenano.view.section.profile")
    middle = heights_m((POINTS - 1) // 2), heights_m(POINTS // 2)
    measured_nm = 0.5e9 * (middle[0] + middle[1])
    where = np.linspace(0.0, SIZE_M * 1e9, POINTS)
    found = np.interp(where, profile["distance"], profile["height"])
    # terraces are steps, which lie between two samples of the section
    off_nm = np.abs(found - measured_nm)
    assert np.median(off_nm) < 0.01
    assert np.count_nonzero(off_nm > 0.1) <= 4
    page.click("#section")
    box = page.page.locator("#scene > canvas").bounding_box()
    page.page.mouse.dblclick(box["x"] + box["width"] / 2, box["y"] + 0.55 * box["height"])
    page.until("/Measured point/.test(document.querySelector('#scene .note').textContent)", "a picked point")
    note = page.page.inner_text("#scene .note")
    numbers = re.search(r"Measured point (\d+) of line (\d+): x (\S+) nm, y (\S+) nm, z (\S+) nm", note)
    assert numbers is not None, note
    point, line = int(numbers[1]), int(numbers[2])
    step_nm = SIZE_M * 1e9 / (POINTS - 1)
    expected = (-SIZE_M * 5e8 + point * step_nm, -SIZE_M * 5e8 + line * step_nm, 1e9 * heights_m(line)[point])
    assert [float(number) for number in numbers.groups()[2:]] == pytest.approx(expected, abs=1.1e-3)


@pytest.mark.endurance
def test_a_scan_grows_on_the_page_while_it_runs(chromium: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with tempfile.TemporaryDirectory(prefix="tnv-") as folder:
        monkeypatch.setenv("TELENANO_RUNTIME_DIR", folder)
        with open_participant(TIP, load_site(DEFAULT_SITE_FILE)) as participant:
            instrument = participant.bind(TIP)
            view = View(dict(os.environ))
            try:
                page = open_page(chromium, view.operator)
                assert page.value("telenano.view.surface.isEmpty")
                for line in range(POINTS):
                    # the first finds the page connected when it arrives, or is sent again
                    until(lambda line=line: shown(page, instrument, line), f"line {line} on the page")
                least, greatest = page.value("[telenano.view.surface.least, telenano.view.surface.greatest]")
                assert greatest - least == pytest.approx(8.0, rel=0.2)
                assert page.faults == []
            finally:
                view.close()


def shown(page: Page, instrument: ZmqPublisher, line: int) -> bool:
    """Publish a line, and return whether the page then has as many as were published."""
    if page.value(FILLED) <= line:
        instrument.publish("afm/scanline", **scanline(line))
    return bool(page.value(FILLED) == line + 1)


def test_a_recording_plays_and_its_surface_grows(chromium: Any, tmp_path: Path) -> None:
    view = View(dict(os.environ), str(scanned(tmp_path)))
    try:
        page = open_page(chromium, view.operator)
        page.until("telenano.view.surface.greatest > 0", "the first lines of the surface")
        page.until("telenano.store.source.playing === false", "the end of the recording")
        least, greatest = page.value("[telenano.view.surface.least, telenano.view.surface.greatest]")
        assert greatest - least == pytest.approx(8.0, rel=0.2)
        check_section_and_pick(page)
        check_exaggeration(page)
        assert "acknowledged" in page.answered(lambda: page.click("#play"))
        page.until("telenano.store.source.playing === true", "a recording that plays again")
        assert "acknowledged" in page.answered(lambda: page.click("#play"))
        page.until("telenano.store.source.playing === false", "a recording that pauses")
        half_s = LINE_NS * 1e-9 * POINTS / 2
        sought = f"field => {{ field.value = {half_s}; field.dispatchEvent(new Event('change')); }}"
        assert "acknowledged" in page.answered(lambda: page.page.locator("#place").evaluate(sought))
        page.until(f"{FILLED} === {POINTS // 2 + 1}", "the surface as it was half way")
        page.choose("#rate", "10")
        assert "acknowledged" in page.answered(lambda: page.click("#play"))
        page.until(f"{FILLED} === {POINTS}", "the whole surface again")
        assert page.faults == []
        check_old_page(chromium, view)
        check_wrong_token(chromium, view)
    finally:
        view.close()


@pytest.mark.endurance
def test_a_page_says_that_the_server_is_gone_and_comes_back_by_itself(chromium: Any, tmp_path: Path) -> None:
    environment = {**os.environ, "TELENANO_VIEW_OPERATOR_TOKEN": "operator-of-the-tests"}
    recording = str(scanned(tmp_path))
    view = View(environment, recording)
    try:
        page = open_page(chromium, view.operator)
        view.close()
        until(lambda: "DISCONNECTED" in page.banners(), "the banner of a lost server")
        port = view.operator.partition("/#")[0].rpartition(":")[2]
        view = View(environment, "--port", port, recording)
        until(lambda: "REPLAYED" in page.banners(), "a page that is connected again")
        page.until(f"{FILLED} > 0", "what the server sends")
        page.page.context.close()
    finally:
        view.close()


def check_exaggeration(page: Page) -> None:
    """Draw heights five times as high: the page says so, and what is picked keeps its measured height."""
    page.choose("#stretch", "5")
    page.until("telenano.view.surface.mesh.scale.z === 5", "heights five times as high")
    page.until(has("#scene .note", "drawn 5 times as high"), "the factor in words")
    picked = page.value("telenano.view.mark.position.z / 5 + telenano.view.surface.least")
    assert picked == pytest.approx(page.value("telenano.view.markHeight"), abs=1e-6)
    page.choose("#stretch", "1")
    page.until(has("#scene .note", "as measured, to scale"), "heights to scale")


def check_wrong_token(chromium: Any, view: View) -> None:
    """Open the page with a token that is none: it says what to do, and does not try again and again."""
    window = chromium.new_context()
    page = Page(window.new_page())
    page.page.goto(f"{view.operator.partition('#')[0]}#not-the-token-0123", wait_until="commit")
    page.page.wait_for_selector("#banners .banner", state="attached")
    until(lambda: "the token is wrong: open the address that the view printed" in page.banners(), "what is wrong")
    assert page.value("telenano.store.streams.size") == 0
    window.close()


def check_old_page(chromium: Any, view: View) -> None:
    """Open the page as one of an older version would be: it says what to do, and is admitted to nothing."""
    window = chromium.new_context()
    replaced: list[int] = []

    def older(route: Any) -> None:
        script = route.fetch().text()
        replaced.append(script.count(f"protocol:{PROTOCOL}"))
        route.fulfill(body=script.replace(f"protocol:{PROTOCOL}", "protocol:0"), content_type="text/javascript")

    window.route("**/assets/*.js", older)
    page = Page(window.new_page())
    page.page.goto(view.operator, wait_until="commit")
    page.page.wait_for_selector("#banners .banner", state="attached")
    until(lambda: "load the page again" in page.banners(), "what an old page says")
    assert sum(replaced) == 1
    assert page.value("telenano.store.streams.size") == 0
    window.close()
