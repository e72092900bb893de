"""The page without a rig: it plays a recording, is told of an image line by line, and finds its server again."""

import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_page import FILLED, Page, View, browser, has, needs_browser, open_page, until
from made_sessions import FORCE_SCALE, STEP_S, Made, hand_force_n

from services.viz_node.requests import PROTOCOL
from telenano.afm.sample.surface import Surface
from telenano.afm.sample.surface_files import read_surface
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.runtime.bus.address_book import load_site
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.wiring.participant import open_participant
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import encode
from telenano.wire.messages import AfmScanline, Array

pytestmark = [pytest.mark.browser, needs_browser]

# an image of 96 x 96 points over 120 nm: terraces of mica with a grain on them
POINTS = 96
SIZE_M = 120e-9
EPOCH_NS = 10**18
TIP = "afm_node@slave"
LINE_NS = 20_000_000


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        yield found


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
    box = page.page.locator("#scene .solid > canvas").bounding_box()
    page.page.mouse.dblclick(box["x"] + box["width"] / 2, box["y"] + 0.55 * box["height"])
    page.until("/Measured point/.test(document.querySelector('#scene > .note').textContent)", "a picked point")
    note = page.page.inner_text("#scene > .note")
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
        check_image(page)
        assert "acknowledged" in page.answered(lambda: page.click("#play"))
        page.until("telenano.store.source.playing === true", "a recording that plays again")
        assert "acknowledged" in page.answered(lambda: page.click("#play"))
        page.until("telenano.store.source.playing === false", "a recording that pauses")
        half_s = LINE_NS * 1e-9 * POINTS / 2
        page.value(f"telenano.cockpit.document.seek({half_s})")
        page.until(f"{FILLED} === {POINTS // 2 + 1}", "the surface as it was half way")
        page.choose("#rate", "10")
        assert "acknowledged" in page.answered(lambda: page.click("#play"))
        page.until(f"{FILLED} === {POINTS}", "the whole surface again")
        assert page.faults == []
        check_old_page(chromium, view)
        check_wrong_token(chromium, view)
        check_token_leaves_the_address_bar(chromium, view)
    finally:
        view.close()


# when the tip jumps into contact in the session that is made up, for how long it is drawn to the sample, and how hard
JUMP_S, DRAWN_S, DRAWN_NN = 1.0, 0.1, -12.5


def touched(time_s: float) -> float:
    """Return alpha_f F_s [N] at a time of a session [s]: nothing, a jump into contact, and the hand's force."""
    if time_s < JUMP_S:
        return 0.0
    return DRAWN_NN * 1e-9 * FORCE_SCALE if time_s < JUMP_S + DRAWN_S else hand_force_n(time_s)


def test_somebody_finds_the_jump_to_contact_in_a_recording_that_has_ended(chromium: Any, tmp_path: Path) -> None:
    made = Made(tip_n=touched, in_contact=lambda time_s: time_s >= JUMP_S)
    view = View(dict(os.environ), str(made.write(tmp_path)))
    try:
        first = open_page(chromium, view.operator)
        first.value("telenano.connection.ask({k: 'transport', action: 'rate', value: 100})")
        first.until("telenano.store.source.playing === false", "the end of the recording")
        page = open_page(chromium, view.operator)
        page.until("telenano.cockpit.document.about?.read === 1", "a recording that was read")
        find_the_jump(page, tmp_path)
        assert page.faults == []
        for found in (first, page):
            found.page.context.close()
    finally:
        view.close()


def find_the_jump(page: Page, folder: Path) -> None:
    """Walk as somebody who opens a recording after its end: by keys to the jump, and with a cursor to its force."""
    page.until("telenano.scopes.plots[0].data[1]?.some((value) => value > 1.9)", "the curves of the whole")
    page.until("document.querySelector('#hand-force').innerText !== '–'", "the force of the hand at the end")
    # the panel is written some times a second, and so a little after the answer has come
    rows, holds = "document.querySelectorAll('#summary tbody tr')", "telenano.cockpit.document.about.holds"
    page.until(f"{holds}.length > 0 && {rows}.length === {holds}.length", "a row for each hold")
    keyboard = page.page.keyboard
    keyboard.press("Home")
    page.until("telenano.cockpit.document.at(performance.now()) === 0", "the beginning")
    for _ in range(5):
        place_s = page.value("telenano.cockpit.document.at(performance.now())")
        keyboard.press("e")
        page.until(f"telenano.cockpit.document.at(performance.now()) > {place_s}", "the next event")
        page.page.wait_for_timeout(300.0)
        if "jumps into contact" in page.page.inner_text("#place-event"):
            break
    assert "jumps into contact" in page.page.inner_text("#place-event")
    # who goes to an event wants to look at it: it does not play on
    page.until("telenano.store.source.playing === false", "a recording that stands there")
    begun_s = page.value("telenano.cockpit.document.about.session_s[0]")
    assert page.value("telenano.cockpit.document.at(performance.now())") == pytest.approx(begun_s + JUMP_S, abs=0.02)
    page.choose("#span", "0.5")
    keyboard.press("c")
    page.until("telenano.scopes.cursors", "two cursors")
    # the third scope has the force on the tip; what was drawn last has the window around the jump
    page.until("telenano.scopes.shownWindow.to - telenano.scopes.shownWindow.from < 0.6", "half a second")
    page.until("telenano.cockpit.document.between(0, 0) && telenano.scopes.shownWindow.width === 0", "every sample")
    place = f"telenano.scopes.plots[2].plot.valToPos({begun_s + JUMP_S + DRAWN_S / 2}, 'x')"
    box = page.page.locator(".plot").nth(2).locator(".u-over").bounding_box()
    page.page.mouse.click(box["x"] + page.value(place), box["y"] + box["height"] / 2)
    # B is the nearer of the two: from nothing before the jump to what is read there
    until(lambda: page.measured("normal, nN")[0] == "0" != page.measured("normal, nN")[1], "the force at a cursor")
    assert float(page.measured("normal, nN")[1]) == pytest.approx(DRAWN_NN, rel=1e-3)
    check_cursors(page, box)
    with page.page.expect_download() as saved:
        page.click("#save-png")
    assert saved.value.path().read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    with page.page.expect_download() as saved:
        page.click("#save-csv")
    rows = [line.split(",") for line in saved.value.path().read_text().splitlines()]
    forces_n = [float(row[3]) for row in rows if (row[0], row[2]) == ("tip", "force")]
    assert min(forces_n) == pytest.approx(DRAWN_NN * 1e-9, rel=1e-5)
    assert len(forces_n) == pytest.approx(0.5 / STEP_S, abs=3)


def check_cursors(page: Page, box: dict[str, float]) -> None:
    """Check that a cursor keeps its value, that the pointer reads the same, and what is measured between the two."""
    until(lambda: page.measured("normal, nN")[3] != "–", "what lies between the cursors")
    a_s, b_s = page.value("telenano.scopes.cursors.map((cursor) => cursor.time)")
    # of a force of 0 and one of -12.5 nN between the two: no more and no less
    assert float(page.measured("normal, nN")[3]) == pytest.approx(-DRAWN_NN, rel=1e-3)
    assert float(page.measured("normal, nN")[4]) == pytest.approx(DRAWN_NN * drawn_share(a_s, b_s), rel=0.1)
    # on the steep edge: at the time of one sample, which stays while other parts of the recording are drawn
    begun_s = page.value("telenano.cockpit.document.about.session_s[0]")
    x = page.value(f"telenano.scopes.plots[2].plot.valToPos({begun_s + JUMP_S}, 'x')")
    page.page.mouse.click(box["x"] + x, box["y"] + box["height"] / 2)
    pointed = page.page.locator(".plot").nth(2).locator(".at-cursor").inner_text().split()
    time_s, force_nn = page.measured("time")[1], page.measured("normal, nN")[1]
    assert (pointed[0], pointed[2]) == (time_s.removesuffix(" s"), force_nn)
    for span, rate in (("2", 1.0), ("whole", 1.0)):
        page.page.locator("#span").select_option(label=span if span == "whole" else f"{span} s", force=True)
        page.value("telenano.cockpit.document.seek(telenano.cockpit.document.at(performance.now()) + 1)")
        page.page.wait_for_timeout(500.0 * rate)
        assert (page.measured("time")[1], page.measured("normal, nN")[1]) == (time_s, force_nn)
    page.choose("#span", "0.5")
    page.value(f"telenano.cockpit.document.seek({begun_s + JUMP_S})")
    page.until("telenano.cockpit.document.between(0, 0) && telenano.scopes.shownWindow.width === 0", "every sample")


def drawn_share(a_s: float, b_s: float) -> float:
    """Return for which share of the time between two cursors around the jump the tip is drawn to the sample."""
    return 0.5 * DRAWN_S / abs(b_s - a_s)


@pytest.mark.endurance
def test_a_page_says_that_the_server_is_gone_and_comes_back_by_itself(chromium: Any, tmp_path: Path) -> None:
    environment = {**os.environ, "TELENANO_VIEW_OPERATOR_TOKEN": "operator-of-the-tests"}
    recording = str(scanned(tmp_path))
    view = View(environment, recording)
    try:
        page = open_page(chromium, view.operator)
        view.kill()
        until(lambda: "DISCONNECTED" in page.banners(), "the banner of a lost server")
        answer = page.answered(lambda: page.click("#play"))
        assert "there is no connection to the server" in answer
        view.close()
        port = view.operator.partition("/#")[0].rpartition(":")[2]
        view = View(environment, "--port", port, recording)
        until(lambda: "REPLAYED" in page.banners(), "a page that is connected again")
        assert "DISCONNECTED" not in page.banners()
        page.until(f"{FILLED} > 0", "what the server sends")
        assert "acknowledged" in page.answered(lambda: page.click("#play"))
        page.page.context.close()
    finally:
        view.close()


def check_image(page: Page) -> None:
    """Level the image, draw a line over it from above, and save it: Gwyddion's file has what was measured."""
    page.click("#show-both")
    page.until("!document.querySelector('.flat').hidden", "the image from above")
    page.choose("#levelling", "plane")
    page.choose("#palette", "grey")
    page.choose("#range", "0.01")
    page.until("telenano.view.surface.range[0] > telenano.view.surface.base", "colours without the ends of the heights")
    box = page.page.locator("#scene .flat canvas").bounding_box()
    frame = page.value("telenano.view.flat.frame")
    x, y = box["x"] + frame["left"], box["y"] + frame["top"]
    page.page.mouse.move(x + 10.0 * frame["scale"], y + 60.0 * frame["scale"])
    page.page.mouse.down()
    page.page.mouse.move(x + 110.0 * frame["scale"], y + 60.0 * frame["scale"], steps=4)
    page.page.mouse.up()
    page.until("telenano.view.section.profile?.distance.at(-1) > 99", "a profile along the line")
    assert page.value("telenano.view.section.profile.distance.at(-1)") == pytest.approx(100.0, abs=2.0)
    # without its plane nothing rises from one side to the other
    means = saved_heights(page).height_m.mean(axis=0)
    assert abs(np.polyfit(np.linspace(0.0, 1.0, POINTS), means, 1)[0]) < 1e-12
    page.choose("#levelling", "none")
    measured = saved_heights(page)
    assert measured.height_m == pytest.approx(np.array([heights_m(line) for line in range(POINTS)]), abs=1e-14)
    assert (measured.width_m, measured.depth_m) == pytest.approx((SIZE_M, SIZE_M), rel=1e-6)
    with page.page.expect_download() as saved:
        page.click("#save-image")
    assert saved.value.path().read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    for select, value in (("#levelling", "none"), ("#palette", "viridis"), ("#range", "0")):
        page.choose(select, value)


def saved_heights(page: Page) -> Surface:
    """Return what the page saves for Gwyddion."""
    with page.page.expect_download() as saved:
        page.click("#save-gsf")
    path = Path(saved.value.path()).with_suffix(".gsf")
    saved.value.save_as(path)
    return read_surface(path)


def check_exaggeration(page: Page) -> None:
    """Draw heights five times as high: the page says so, and what is picked keeps its measured height."""
    page.choose("#stretch", "5")
    page.until("telenano.view.surface.mesh.scale.z === 5", "heights five times as high")
    page.until(has("#scene > .note", "drawn 5 times as high"), "the factor in words")
    picked = page.value("telenano.view.mark.position.z / 5 + telenano.view.surface.base")
    assert picked == pytest.approx(page.value("telenano.view.markHeight"), abs=1e-6)
    page.choose("#stretch", "1")
    page.until(has("#scene > .note", "as measured, to scale"), "heights to scale")


def check_wrong_token(chromium: Any, view: View) -> None:
    """Open the page with a token that is none: it says what to do, and does not try again and again."""
    window = chromium.new_context()
    page = Page(window.new_page())
    page.page.goto(f"{view.operator.partition('#')[0]}#not-the-token-0123", wait_until="commit")
    page.page.wait_for_selector("#banners .banner", state="attached")
    until(
        lambda: "the token is wrong: open the address that telenano view --addresses prints" in page.banners(),
        "what is wrong",
    )
    assert page.value("telenano.store.streams.size") == 0
    window.close()


def check_token_leaves_the_address_bar(chromium: Any, view: View) -> None:
    """Load the page again after its token has left the address bar; another token of the same tab replaces it."""
    page = open_page(chromium, view.operator)
    base, _, token = view.operator.partition("#")
    assert page.value("location.href") == base
    assert token not in str(page.value("JSON.stringify({...localStorage})"))
    page.page.reload()
    page.until("window.telenano?.store.role === 'operator'", "the role after a reload")
    with page.page.expect_event("load"):
        page.page.evaluate("token => { location.hash = token; }", view.observer.partition("#")[2])
    page.until("window.telenano?.store.role === 'observer'", "the role of the other token")
    assert page.value("location.href") == base
    page.page.context.close()


def check_old_page(chromium: Any, view: View) -> None:
    """Open the page as one of an older version would be: it says what to do, and is admitted to nothing."""
    window = chromium.new_context()
    replaced: list[int] = []

    def older(route: Any) -> None:
        script = route.fetch().text()
        replaced.append(script.count(f"protocol:{PROTOCOL}"))
        route.fulfill(body=script.replace(f"protocol:{PROTOCOL}", "protocol:0"), content_type="text/javascript")

    # The script of the worker has headers of its own, without which the browser refuses it.
    window.route(re.compile(r"/assets/(?!.*worker)[^/]*\.js"), older)
    page = Page(window.new_page())
    page.page.goto(view.operator, wait_until="commit")
    page.page.wait_for_selector("#banners .banner", state="attached")
    until(lambda: "load the page again" in page.banners(), "what an old page says")
    assert sum(replaced) == 1
    assert page.value("telenano.store.streams.size") == 0
    window.close()
