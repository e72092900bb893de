"""The page against a running rig: what it does is looked for on the bus, not in the page."""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_page import Page, View, browser, needs_browser, open_page, until
from stack_rig import Rig

from proto import encode
from proto.messages import AfmScanline, Array
from recording.writer import RecordingWriter
from services.recorder.config import RecorderConfig

pytestmark = [pytest.mark.browser, needs_browser]

# an image of 96 x 96 points over 120 nm: terraces of mica with a grain on them
POINTS = 96
SIZE_M = 120e-9
EPOCH_NS = 10**18
LINE_NS = 20_000_000


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        yield found


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    rig = Rig(tmp_path_factory.mktemp("viewed"))
    try:
        rig.start("--duration", "600", scenario="touch")
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


def newest(rig: Rig, topic: str) -> Any:
    return rig.recording().messages(topic)[-1].decode()


def since(rig: Rig, topic: str, begin_ns: int) -> list[Any]:
    return [message.decode() for message in rig.recording().messages(topic, begin_ns)]


@pytest.mark.endurance
def test_every_control_changes_the_rig(rig: Rig, operator: Page) -> None:
    operator.fill("#delay", "4")
    assert "acknowledged" in operator.answered(lambda: operator.click("#delay-set"))
    rig.wait_until(lambda: newest(rig, "link/status").forward.settings["delay_s"] == 0.004, "the delay on the bus")
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
    pad = operator.page.locator("#hand-pad")
    pad.evaluate("pad => pad.scrollIntoView()")
    box = pad.bounding_box()
    assert box is not None
    x, y = box["x"] + 120.0, box["y"] + 50.0
    mouse = operator.page.mouse
    mouse.move(x, y)
    mouse.down()
    # to 10 mm below where the arm is: 2 N at first
    mouse.move(x, y + 10.0 / 25.0 * box["height"], steps=8)
    rig.wait_until(lambda: newest(rig, "operator/force").force_n[2] < -0.2, "the force of the page on its topic")
    rig.wait_until(lambda: newest(rig, "haptic/state").operator_force_n[2] < -0.2, "the force at the device")
    rig.wait_until(lambda: newest(rig, "afm/state").in_contact, "the tip on the sample")
    rig.wait_until(lambda: newest(rig, "haptic/command").force_n[2] > 0.1, "the force that comes back")
    until(lambda: operator.last("command", "tip_force") > 0.1, "that force on the page")
    until(lambda: operator.last("tip", "force") > 1e-9, "the push of the sample")
    operator.picture("touch")
    mouse.up()
    rig.wait_until(lambda: newest(rig, "haptic/state").operator_force_n[2] == 0.0, "a hand that has let go")


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


def scanned(folder: Path) -> Path:
    """Write a recording of an image, line by line."""
    writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=folder))
    channel = writer.channel("afm/scanline", "afm_node@slave", "slave")
    x = np.linspace(0.0, 1.0, POINTS)
    for line in range(POINTS):
        y = line / (POINTS - 1)
        terrace = 1e-9 * (np.floor(3.0 * (0.7 * x + 0.4 * y)))
        grain = 6e-9 * np.exp(-((x - 0.62) ** 2 + (y - 0.45) ** 2) / 0.012)
        height = Array.from_numpy(terrace + grain + 0.05e-9 * np.sin(60.0 * x + 9.0 * y))
        y_m = (y - 0.5) * SIZE_M
        message = AfmScanline(
            seq=line,
            t_ns=EPOCH_NS + line * LINE_NS,
            src="afm_node@slave",
            v=1,
            line=line,
            lines=POINTS,
            direction="trace",
            start_m=(-SIZE_M / 2, y_m, 0.0),
            end_m=(SIZE_M / 2, y_m, 0.0),
            height_m=height,
            amplitude_m=None,
            phase_rad=None,
        )
        writer.write(channel, message.t_ns, message.t_ns, line, encode(message))
    writer.finish()
    return writer.path


def test_a_recording_plays_and_its_surface_grows(chromium: Any, tmp_path: Path) -> None:
    view = View(dict(os.environ), str(scanned(tmp_path)))
    try:
        page = open_page(chromium, view.operator)
        page.until("telenano.view.surface.greatest > 0", "the first lines of the surface")
        page.until("telenano.store.source.playing === false", "the end of the recording")
        least, greatest = page.value("[telenano.view.surface.least, telenano.view.surface.greatest]")
        assert greatest - least == pytest.approx(8.0, rel=0.2)
        page.page.wait_for_timeout(200.0)
        page.picture("surface")
        page.choose("#stereo", "anaglyph")
        page.page.wait_for_timeout(300.0)
        page.picture("anaglyph")
        page.choose("#stereo", "off")
        assert "acknowledged" in page.answered(lambda: page.click("#play"))
        page.until("telenano.store.source.playing === true", "a recording that plays again")
        page.page.set_viewport_size({"width": 820, "height": 1180})
        page.page.wait_for_timeout(300.0)
        page.picture("tablet")
        assert page.faults == []
    finally:
        view.close()
