"""An operator's day at the page of a running rig, in order: each test is a part of it and leaves the rig to the next.

What the page does is looked for on the bus, not in the page. The pictures of docs/view.md are renewed with
TELENANO_PICTURES=docs/view.
"""

import logging
import os
import signal
import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any, NamedTuple

import numpy as np
import pytest
from browser_page import BESIDE_A_BROWSER, FILLED, PATIENCE_S, Page, View, has, needs_browser, open_page, until
from page_walks import Keyboard, check_rules, look, step, theme
from stack_rig import Rig

from telenano.analysis.verdict import Verdict, judge

_LOG = logging.getLogger(__name__)
pytestmark = [pytest.mark.browser, pytest.mark.endurance, needs_browser]

# what docs/view.md tells a newcomer to type
STIFFNESS = "afm_node.cantilever.stiffness_n_per_m=4"
DELAYS_MS = (200, 300)
LAW = "wave"
# alpha_f of the scenario
FORCE_SCALE = 1e8
DEEP_MM, PUSH_MM, AGAIN_MM = 14.0, 6.0, 8.0
# five swings
WATCHED_S = 6.0
# of a swing, whose verdict the reports leave open after less than 12 s
SWUNG_S = 15.0
# with which hand and tip press in steady state
HELD_N = 1.0
LINES = 40


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with closing(Rig(tmp_path_factory.mktemp("viewed"))) as rig:
        rig.start("--duration", "3600", "--no-view", "--set", STIFFNESS, *BESIDE_A_BROWSER, scenario="image")
        rig.wait_until(rig.running, "a running session")
        yield rig


@pytest.fixture(scope="module")
def view(rig: Rig) -> Iterator[View]:
    with closing(View(rig.environment)) as view:
        yield view


@pytest.fixture(scope="module")
def operator(chromium: Any, view: View) -> Iterator[Page]:
    page = open_operator(chromium, view)
    yield page
    page.page.context.close()


def open_operator(chromium: Any, view: View) -> Page:
    page = open_page(chromium, view.operator)
    page.until("telenano.store.rings.get('tip')?.length > 200", "curves on the page")
    page.until("document.querySelectorAll('#law-name option').length > 1", "the forms of the law")
    return page


def since(rig: Rig, topic: str, begin_ns: int) -> list[Any]:
    return [message.decode() for message in rig.recording().messages(topic, begin_ns)]


def force_n(rig: Rig) -> float:
    """Return with which force the operator pushes the device, up [N]."""
    return float(rig.newest("haptic/state").operator_force_n[2])


def let_go(rig: Rig) -> None:
    rig.wait_until(lambda: force_n(rig) == 0.0, "a hand that has let go")


def felt(rig: Rig) -> None:
    rig.wait_until(lambda: rig.newest("haptic/command").force_n[2] > 0.1, "the force that comes back")


def is_in(rig: Rig, *modes: str) -> None:
    rig.wait_until(lambda: rig.newest("afm/state").mode in modes, f"a tip that is in {modes}")


def stopped(rig: Rig, page: Page) -> None:
    """Wait until the emergency stop holds at the hand and at the tip, and the page says so."""
    rig.wait_until(lambda: rig.newest("haptic/state").estop, "the stop at the haptic device")
    is_in(rig, "estop")
    until(lambda: "EMERGENCY STOP" in page.banners(), "the banner of the stop")


def armed(rig: Rig) -> None:
    rig.wait_until(lambda: not rig.newest("haptic/state").estop, "an armed haptic device")
    is_in(rig, "follow")


def programme(rig: Rig, *, runs: bool) -> None:
    """Wait until the operator's programme runs, or has ended."""
    rig.wait_until(lambda: (rig.newest("haptic/state").session_s >= 0.0) == runs, "start or end of the programme")


def scan(page: Page, **given: int) -> None:
    for key, value in given.items():
        page.fill(f"#program-scan-{key}", str(value))
    assert "acknowledged" in page.answered(lambda: page.click("#program-scan"))


def test_a_rig_is_operated_by_keys_from_the_first_press_to_the_emergency_stop(
    rig: Rig, chromium: Any, view: View
) -> None:
    """No part of this test touches the pointer, and the page is asked whether anything did."""
    page = open_operator(chromium, view)
    keys = Keyboard(page)
    with step("stopped by Escape and armed again"):
        assert "acknowledged" in page.answered(lambda: keys.press("Escape"))
        stopped(rig, page)
        # what the operator does runs on behind it, and nothing follows
        page.until("document.querySelector('#start').getAttribute('aria-pressed') === 'false'", "a start that is over")
        assert "acknowledged" in keys.answered("#arm")
        armed(rig)
    with step("an image with settings of one's own"):
        keys.reach('[role="tab"][aria-selected="true"]')
        while page.value("document.activeElement.id") != "tab-image":
            keys.press("ArrowRight")
        for key, value in {"pixels": "32", "lines": "16", "dwell_s": "8"}.items():
            keys.type(f"#program-scan-{key}", value)
        assert "acknowledged" in keys.answered("#program-scan")
        page.until(f"{FILLED} === 16", "the whole image")
        is_in(rig, "retracted")
    with step("its profile"):
        keys.reach("#section")
        keys.press("Enter")
        page.until("telenano.view.section.profile", "a profile")
        keys.press("Enter")
    with step("the tip follows, and goes to a place"):
        keys.reach("#mode-bilateral")
        keys.press("Enter")
        is_in(rig, "follow")
        keys.type("#tip-x", "-12")
        keys.type("#tip-y", "7")
        assert "acknowledged" in keys.answered("#tip-go")
        place_m = pytest.approx((-12e-9, 7e-9), rel=1e-6)
        rig.wait_until(lambda: rig.newest("afm/state").base_position_m[:2] == place_m, "the tip at its place")
    with step("a key that is held pushes, and lets go with the key"):
        begin_ns = time.time_ns()
        keys.reach("#hand-pad")
        for _ in range(8):
            # it repeats itself: a millimetre each time
            page.page.keyboard.down("ArrowDown")
        pushes = lambda: [message.force_n[2] < -0.2 for message in since(rig, "operator/force", begin_ns)]  # noqa: E731
        rig.wait_until(lambda: any(pushes()), "the force of the keys on its topic")
        page.page.keyboard.up("ArrowDown")
        let_go(rig)
    with step("pressed until a force is felt, and held there while the law changes"):
        keys.reach("#hand-keep")
        keys.press("Space")
        keys.reach("#hand-pad")
        for _ in range(14):
            keys.press("ArrowDown")
        felt(rig)
        until(lambda: float(page.page.inner_text("#felt-force").replace("–", "0")) > 0.1, "that force on the page")
        keys.choose("#law-name", "wave")
        rig.wait_until(lambda: rig.newest("teleop/backward").law == "wave", "the law on the bus")
        assert force_n(rig) < -0.1, "the hand is held while other keys are pressed"
    with step("a delay"):
        keys.type("#delay", "20")
        assert "acknowledged" in page.answered(lambda: keys.press("Enter"))
        until(lambda: "DELAYED" in page.banners(), "the banner of the delay")
        rig.wait_until(lambda: rig.newest("link/status").forward.settings.get("delay_s") == 0.02, "it on the bus")
        page.until("document.querySelector('#profile').value === 'constant delay'", "the network that is in force")
        page.until("document.querySelector('#delay').placeholder === '20'", "the delay that is in force")
        keys.type("#delay", "0")
        assert "acknowledged" in page.answered(lambda: keys.press("Enter"))
    with step("marks, one with a text and one by the key m"):
        begin_ns = time.time_ns()
        keys.type("#mark-text", "by keys")
        assert "acknowledged" in page.answered(lambda: keys.press("Enter"))
        keys.reach("#pause")
        assert "acknowledged" in page.answered(lambda: keys.press("m"))
        marks = lambda: [event for event in since(rig, "session/event", begin_ns) if event.kind == "mark"]  # noqa: E731
        rig.wait_until(lambda: len(marks()) == 2, "both marks in the recording")
        assert marks()[0].data.get("text") == "by keys"
    with step("scopes: paused by Enter, going on by the key p, another layout"):
        keys.press("Enter")
        page.until("document.querySelector('#pause').textContent === 'Go on'", "scopes that stand")
        keys.press("p")
        page.until("document.querySelector('#pause').ariaPressed === 'false'", "scopes that go on")
        keys.choose("#layout", "Stability")
        page.until("telenano.scopes.specs[1].kind === 'spectrum'", "the spectrum of the forces")
        page.until("telenano.scopes.plots[1].data[1]?.length > 100", "its values")
        keys.choose("#layout", "Loop")
    with step("stop and start of the operator's programme"):
        for button in ("stop", "start"):
            assert "acknowledged" in keys.answered(f"#{button}")
            programme(rig, runs=button == "start")
    with step("the emergency stop"):
        assert "acknowledged" in page.answered(lambda: keys.press("Escape"))
        stopped(rig, page)
    keys.choose("#law-name", "virtual_impedance")
    assert "acknowledged" in keys.answered("#arm")
    armed(rig)
    keys.check()
    page.page.context.close()


class Watched(NamedTuple):
    """The force on the tip at the hand's scale over a while: what became of it, how far it went, and its mean [N]."""

    verdict: Verdict
    peak_to_peak_n: float
    mean_n: float


def watched(rig: Rig, for_s: float = WATCHED_S) -> Watched:
    """Watch for a while, and judge as the reports do."""
    begin_ns = time.time_ns()
    end_ns = begin_ns + round(for_s * 1e9)
    rig.wait_until(lambda: rig.recording().messages("afm/state")[-1].log_ns > end_ns, "what is watched")
    rows = since(rig, "afm/state", begin_ns)
    time_s = np.array([1e-9 * (row.t_ns - rows[0].t_ns) for row in rows])
    tip_n = FORCE_SCALE * np.array([row.tip_force_n[2] for row in rows])
    found = Watched(judge(time_s, tip_n, HELD_N), float(np.ptp(tip_n)), float(tip_n.mean()))
    _LOG.info("%.1f s: %s", time_s[-1], found)
    return found


def press(page: Page, down_mm: float) -> None:
    """Press with a hand that is kept: the pointer is free afterwards, and the hand stays where it is."""
    page.press(down_mm)
    page.page.mouse.up()


def touch(rig: Rig, page: Page) -> None:
    """Press the tip onto the sample with a hand that is kept, again where a page that was too slow has let it go."""
    if rig.newest("haptic/command").force_n[2] > 0.1:
        return
    page.follow()
    if page.page.get_attribute("#hand-keep", "aria-pressed") != "true":
        page.click("#hand-keep")
    press(page, DEEP_MM)
    felt(rig)


def held(rig: Rig, page: Page, most_n: float, least_n: float) -> Watched:
    """Wait until the tip is pressed with at least so much [N], and the force moves by no more than so much [N].

    A page that was too slow for a moment has let the hand go, and says so: then it presses again.
    """
    end = time.monotonic() + 2.0 * PATIENCE_S
    while (found := watched(rig)).peak_to_peak_n > most_n or found.mean_n < least_n:
        assert time.monotonic() < end, f"waited in vain for a force that stands: {found}"
        touch(rig, page)
    return found


def test_a_newcomer_images_touches_delays_holds_and_stops(rig: Rig, operator: Page, chromium: Any, view: View) -> None:
    """The first walk of docs/view.md, with a look at each state of the page at four sizes of window."""
    page = operator
    theme(page, "light")
    with step("the sample is imaged, and the image grows on the page"):
        begin_ns = time.time_ns()
        scan(page, pixels=48, lines=LINES, dwell_s=12)
        page.until(f"{FILLED} > {LINES // 2}", "a part of the image")
        look(page, "imaging")
        page.until(f"{FILLED} === {LINES}", "the whole image")
        is_in(rig, "retracted")
        check_image(rig, page, begin_ns)
    with step("the tip is pressed onto the sample, and the force comes back"):
        page.follow()
        page.fill("#tip-x", "0")
        page.fill("#tip-y", "0")
        assert "acknowledged" in page.answered(lambda: page.click("#tip-go"))
        touch(rig, page)
        rig.wait_until(lambda: rig.newest("operator/force").force_n[2] < -0.2, "the force of the page on its topic")
        until(lambda: page.last("command", "tip_force") > 0.1, "that force on the page")
        until(lambda: page.last("tip", "force") > 1e-9, "the push of the sample")
        held(rig, page, 0.1 * HELD_N, 0.5 * HELD_N)
    look(page, "live")
    with step("pictures in red and cyan and of a section"):
        page.choose("#stretch", "2")
        page.click("#section")
        page.picture("section")
        page.click("#section")
        page.choose("#stretch", "1")
        page.choose("#stereo", "anaglyph")
        page.picture("anaglyph")
        page.choose("#stereo", "off")
    with step("an observer looks, and may stop"):
        observer = open_page(chromium, view.observer)
        observer.until("telenano.store.rings.get('tip')?.length > 3000", "curves on the observer's page")
        theme(observer, "light")
        look(observer, "observer")
        assert observer.page.is_enabled("#estop")
        observer.page.context.close()
    with step("a delay that does no harm yet"):
        touch(rig, page)
        delay(page, 60)
        until(lambda: "DELAYED" in page.banners(), "the banner of the delay")
        look(page, "delayed")
    with step("a delay at which the loop swings"):
        delay_ms, swinging = swing(rig, page)
        assert swinging.verdict.kind in ("diverged", "limit_cycle"), swinging
        until(lambda: "OSCILLATES" in page.banners(), "the banner of the oscillation")
        page.picture("oscillates")
        theme(page, "dark")
        look(page, "oscillating")
        theme(page, "light")
    with step("the law wave holds the tip on the sample"):
        assert "acknowledged" in page.answered(lambda: page.choose("#law-name", LAW))
        rig.wait_until(lambda: rig.newest("teleop/backward").law == LAW, "the law on the bus")
        # hand and tip stand where the swing had them, so the sample may be higher or lower now: press again
        press(page, AGAIN_MM)
        held(rig, page, 0.1 * swinging.peak_to_peak_n, 0.2 * HELD_N)
        assert rig.newest("afm/state").in_contact
        assert rig.newest("link/status").forward.delay_mean_s == pytest.approx(1e-3 * delay_ms, rel=0.1)
        page.picture("holds")
    with step("a hand that is kept is let go by its button"):
        page.click("#hand-keep")
        let_go(rig)
    with step("the emergency stop by Escape"):
        theme(page, "dark")
        assert "acknowledged" in page.answered(lambda: page.page.keyboard.press("Escape"))
        stopped(rig, page)
        look(page, "stopped")
        page.click("#arm")
        armed(rig)
    delay(page, 0)
    page.answered(lambda: page.choose("#law-name", "virtual_impedance"))
    assert page.faults == []


def swing(rig: Rig, page: Page) -> tuple[int, Watched]:
    """Raise the delay until the loop swings, and return the delay [ms] and how it swings."""
    for delay_ms in DELAYS_MS:
        delay(page, delay_ms)
        for _ in range(2):
            # a loop at rest needs a push, and what comes of it begins small
            touch(rig, page)
            press(page, PUSH_MM)
            watched(rig)
            swinging = watched(rig, SWUNG_S)
            if swinging.peak_to_peak_n > 2.0 * HELD_N:
                return delay_ms, swinging
    raise AssertionError(f"the loop does not swing at {DELAYS_MS[-1]} ms: {swinging}")


def delay(page: Page, delay_ms: int) -> None:
    page.fill("#delay", str(delay_ms))
    assert "acknowledged" in page.answered(lambda: page.click("#delay-set"))


def check_image(rig: Rig, page: Page, begin_ns: int) -> None:
    """Check that the page has what was published, line by line."""
    published = [line for line in since(rig, "afm/scanline", begin_ns) if line.direction == "trace"]
    assert [line.line for line in published] == list(range(LINES))
    heights_nm = 1e9 * np.array([np.frombuffer(line.height_m.data, f"<{line.height_m.dtype}") for line in published])
    # a dot is 10 nm high
    assert np.ptp(heights_nm) > 5.0
    shown_nm = page.value("[telenano.view.surface.least, telenano.view.surface.greatest]")
    assert shown_nm == pytest.approx([heights_nm.min(), heights_nm.max()], rel=1e-5)
    page.until(has("#program-state", "scan is finished"), "the page's word")


def test_every_tab_can_be_read_in_light_and_dark(operator: Page) -> None:
    details = "document.querySelectorAll('details').forEach((found) => {{ found.open = {}; }})"
    operator.value(details.format("true"))
    for _ in range(2):
        for tab in ("image", "nodes", "events", "settings"):
            operator.click(f"#tab-{tab}")
            check_rules(operator, tab)
        operator.click("#theme")
    operator.value(details.format("false"))


def test_the_forms_of_law_and_link_change_the_rig_and_refuse_what_cannot_be(rig: Rig, operator: Page) -> None:
    link = lambda: rig.newest("link/status")  # noqa: E731
    operator.click("#tab-settings")
    with step("what cannot be is said at its field, and nothing is sent"):
        gain = "#law-virtual_impedance-force_gain"
        operator.fill(gain, "-1")
        operator.click("#law-apply")
        operator.until(has(f"{gain}-fault", "must be"), "what is wrong at the field")
        assert operator.page.get_attribute(gain, "aria-invalid") == "true"
    with step("a gain of the law"):
        operator.fill(gain, "12.5")
        assert "acknowledged" in operator.answered(lambda: operator.click("#law-apply"))
    with step("jitter one way and loss the other"):
        operator.fill("#link-forward-jitter-scale_s", "2")
        operator.fill("#link-backward-loss-probability", "0.05")
        assert "acknowledged" in operator.answered(lambda: operator.click("#link-apply"))
        rig.wait_until(lambda: link().forward.settings.get("jitter.scale_s") == 0.002, "the jitter on the bus")
        rig.wait_until(lambda: link().backward.settings.get("loss.probability") == 0.05, "the loss on the bus")
        rig.wait_until(lambda: sum(link().backward.dropped.values()) > 0, "messages that are lost")
        until(lambda: operator.last("link", "backward_loss") > 0.0, "the loss on the page")
    with step("what is in force is what the rig reports, and a field that was applied is empty again"):
        forward = "document.querySelector('#link-forward-jitter-scale_s')"
        operator.until(f"{forward}.placeholder === '2' && {forward}.value === ''", "the jitter in its field")
        operator.until("document.querySelector('#profile').value === 'custom'", "the network that is in force")
    with step("profiles of the link"):
        for profile in ("dsl", "clean"):
            operator.answered(lambda profile=profile: operator.choose("#profile", profile))
            rig.wait_until(lambda profile=profile: link().forward.profile == profile, f"the profile {profile}")


def test_the_programs_of_the_instrument_run_pause_and_end_from_the_page(rig: Rig, operator: Page) -> None:
    def is_at(program: str, state: str) -> bool:
        report = rig.newest("afm/program")
        return (report.program, report.state) == (program, state)

    with step("a force curve"):
        operator.fill("#program-curve-load_n", "10")
        # 0.1 nm a step, which are 0.4 nN at this cantilever
        operator.fill("#program-curve-speed_m_per_s", "25")
        begin_ns = time.time_ns()
        assert "acknowledged" in operator.answered(lambda: operator.click("#program-curve"))
        rig.wait_until(lambda: is_at("curve", "finished"), "a force curve")
        is_in(rig, "retracted")
        pressed_n = max(state.tip_force_n[2] for state in since(rig, "afm/state", begin_ns))
        assert pressed_n == pytest.approx(1e-8, rel=0.1)
    with step("an image that is paused, goes on and is broken off"):
        # a pixel needs two steps of the instrument, which makes 250 a second here
        scan(operator, lines=8, dwell_s=10)
        rig.wait_until(lambda: is_at("scan", "running"), "an image that is taken")
        for button, state in (("pause", "paused"), ("resume", "running"), ("abort", "ended")):
            assert "acknowledged" in operator.answered(lambda button=button: operator.click(f"#program-{button}"))
            rig.wait_until(lambda state=state: is_at("scan", state), f"an image that is {state}")
        is_in(rig, "retracted")
    with step("the tactile path, which ends where the tip follows the hand again"):
        assert "acknowledged" in operator.answered(lambda: operator.click("#program-tactile"))
        rig.wait_until(lambda: is_at("tactile", "running"), "the tactile path")
        operator.click("#mode-bilateral")
        is_in(rig, "follow")
    with step("a new file of the recording"):
        files = len(list(rig.out.glob("session*.mcap")))
        assert "acknowledged" in operator.answered(lambda: operator.click("#split"))
        rig.wait_until(lambda: len(list(rig.out.glob("session*.mcap"))) == files + 1, "a new file")
    assert operator.faults == []


def test_what_is_saved_is_every_sample_that_is_shown(rig: Rig, operator: Page) -> None:
    operator.choose("#span", "1")
    operator.until("telenano.store.rings.get('hand')?.length > 1000", "a second of the hand")
    operator.click("#pause")
    operator.until("document.querySelector('#pause').textContent === 'Go on'", "scopes that stand")
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
    operator.click("#pause")
    operator.choose("#span", "10")


def test_the_hand_holds_while_the_page_draws_for_longer_than_the_server_waits(rig: Rig, operator: Page) -> None:
    def held() -> bool:
        """Press, keep the page busy for longer than the server waits, and return whether the hand went on pushing."""
        operator.press(10.0)
        rig.wait_until(lambda: force_n(rig) < -0.2, "a hand that pushes")
        begin_ns = time.time_ns()
        # as one long picture does: nothing else of the page runs meanwhile
        operator.value("(() => { const begun = performance.now(); while (performance.now() - begun < 700); })()")
        end_ns = time.time_ns()
        rig.wait_until(lambda: rig.newest("haptic/state").t_ns > end_ns, "what was recorded meanwhile")
        pushes = [-s.operator_force_n[2] for s in since(rig, "haptic/state", begin_ns) if s.t_ns < end_ns]
        sent = [message for message in since(rig, "operator/force", begin_ns) if message.t_ns < end_ns]
        operator.page.mouse.up()
        let_go(rig)
        # and by the newest place of the arm, not by that before the picture
        return min(pushes) > 0.0 and len({message.force_n[2] for message in sent}) > 5

    # Where others have the processors, the server itself may be held up for longer than it waits for a page. A hand
    # whose spring is in the drawing thread is let go each time.
    assert any(held() for _ in range(8))


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


def test_a_gamepad_presses_with_its_stick_and_rumbles_with_the_force_that_comes_back(rig: Rig, operator: Page) -> None:
    operator.value(GAMEPAD)
    try:
        operator.value("pad.axes[1] = 0.8")
        rig.wait_until(lambda: rig.newest("operator/force").force_n[2] < -0.2, "the force of the stick on its topic")
        felt(rig)
        operator.until("rumbles.some((effect) => effect.strongMagnitude > 0.02)", "a gamepad that rumbles")
    finally:
        operator.value("pad.axes[1] = 0")
    operator.until("resets > 0", "a gamepad that rests with the hand")
    let_go(rig)


def test_a_force_that_is_kept_is_released_by_a_scan_and_a_stop_and_not_taken_up_again(rig: Rig, operator: Page) -> None:
    def hold() -> None:
        operator.follow()
        operator.click("#hand-keep")
        press(operator, 10.0)
        rig.wait_until(lambda: force_n(rig) < -0.2, "the force at the device")

    def check_nothing_presses() -> None:
        begin_ns = time.time_ns()
        operator.page.wait_for_timeout(2000.0)
        assert not any(state.operator_force_n[2] for state in since(rig, "haptic/state", begin_ns))

    with step("a scan releases it"):
        hold()
        scan(operator, pixels=16, lines=8, dwell_s=8)
        let_go(rig)
        operator.until(has("#hand-text", "Let go: the instrument runs a scan"), "why")
        assert operator.page.get_attribute("#hand-keep", "aria-pressed") == "false"
        is_in(rig, "retracted")
        operator.follow()
        check_nothing_presses()
    with step("the end of the operator's programme releases it"):
        hold()
        operator.answered(lambda: operator.click("#stop"))
        programme(rig, runs=False)
        operator.until(has("#hand-text", "Let go: "), "why")
        operator.answered(lambda: operator.click("#start"))
        programme(rig, runs=True)
        check_nothing_presses()


def test_the_tip_goes_where_the_pointer_says(rig: Rig, operator: Page) -> None:
    begin_ns = time.time_ns()
    operator.follow()
    operator.click("#place-tip")
    operator.page.locator("#scene").evaluate("scene => scene.scrollIntoView()")
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
    # and those that did not reach the recorder are not known here.
    rig.wait_until(lambda: is_there() or (carried() and is_there()), "the tip where the pointer was")
    operator.click("#place-tip")


def test_the_tip_is_pressed_from_a_headset_and_stopped_there(rig: Rig, chromium: Any, view: View) -> None:
    page = open_page(chromium, view.operator, headset=True)
    right, left = "headset.controllers.right", "headset.controllers.left"

    def put(hand: str, x: float, y: float) -> None:
        page.value(f"{hand}.position.set({x}, {y}, -0.4)")

    def button(hand: str, name: str, value: int) -> None:
        page.value(f"{hand}.updateButtonValue('{name}', {value})")

    with step("the session of the headset begins"):
        page.until("telenano.store.rings.get('tip')?.length > 100", "curves on the page")
        page.until("!document.querySelector('#vr').hidden", "a browser with a headset")
        page.click("#vr")
        page.until("telenano.view.headset.isPresenting", "a session of the headset")
        begin = page.value("telenano.view.frames")
        page.until(f"telenano.view.frames > {begin} + 3", "pictures in the headset")
        put(right, 0.1, 1.2)
        put(left, -0.1, 1.2)
    with step("one hand carries the surface as far as it goes itself"):
        button(right, "squeeze", 1)
        page.until("telenano.view.headset.held.size === 1", "a surface in the hand")
        page.until("telenano.view.headset.before.length === 1", "a picture of it")
        before = page.value("telenano.view.world.position.x")
        put(right, 0.3, 1.2)
        page.until(f"Math.abs(telenano.view.world.position.x - {before} - 0.2) < 1e-3", "a surface that was carried")
    with step("two hands scale it"):
        scale = page.value("telenano.view.world.scale.x")
        button(left, "squeeze", 1)
        page.until("telenano.view.headset.before.length === 2", "a surface in both hands")
        put(left, -0.5, 1.2)
        page.until(f"telenano.view.world.scale.x > 1.9 * {scale}", "a surface twice as large")
        button(left, "squeeze", 0)
        button(right, "squeeze", 0)
        page.until("telenano.view.headset.held.size === 0", "a surface that was let go")
    with step("the trigger takes hold of the arm, and 12 cm down mean 12 mm at the arm"):
        begin_ns = time.time_ns()
        button(right, "trigger", 1)
        page.until("telenano.view.headset.pressed", "a trigger that is held")
        put(right, 0.3, 1.08)
        rig.wait_until(lambda: rig.newest("operator/force").force_n[2] < -0.2, "the force of the headset on its topic")
        touches = lambda: any(state.in_contact for state in since(rig, "afm/state", begin_ns))  # noqa: E731
        rig.wait_until(touches, "the tip on the sample")
        felt(rig)
    with step("the button beside the stick is the emergency stop"):
        button(right, "b-button", 1)
        stopped(rig, page)
        button(right, "b-button", 0)
        button(right, "trigger", 0)
        page.until("!telenano.view.headset.pressed", "a trigger that was let go")
    with step("the session of the headset ends"):
        page.click("#vr")
        page.until("!telenano.view.headset.isPresenting", "the end of the session of the headset")
        assert page.value("telenano.view.world.scale.x") == 1.0
        page.click("#arm")
        armed(rig)
    page.page.context.close()


def test_a_lost_node_is_shown_until_it_is_back(rig: Rig, operator: Page) -> None:
    found = rig.process_of("controller@slave")
    assert found is not None
    os.kill(found, signal.SIGSTOP)
    try:
        until(lambda: "LOST: controller@slave" in operator.banners(), "the banner of the lost node")
    finally:
        os.kill(found, signal.SIGCONT)
    until(lambda: "LOST" not in operator.banners(), "its return")


def test_a_stop_without_a_server_looks_dead_and_says_what_stops_the_rig(operator: Page, view: View) -> None:
    """The last part: it ends the server of the page."""
    view.kill()
    until(lambda: "DISCONNECTED" in operator.banners(), "the banner of a lost server")
    shown = operator.page.inner_text("#estop")
    assert "NOT CONNECTED" in shown
    assert "telenano estop" in shown
    with step("a dead stop looks dead under the pointer too"):
        operator.page.hover("#estop")
        operator.page.wait_for_timeout(300.0)
        assert operator.value("getComputedStyle(document.querySelector('#estop')).backgroundImage") != "none"
        assert operator.value("getComputedStyle(document.querySelector('#estop')).color") != "rgb(255, 255, 255)"
    with step("Escape says what stops the rig"):
        assert "telenano estop" in operator.answered(lambda: operator.page.keyboard.press("Escape"))
    look(operator, "disconnected")
