"""A hand in the browser pushes a particle on a live rig, and gives it back: judged by what is on the bus."""

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from browser_page import BESIDE_A_BROWSER, PATIENCE_S, Page, View, browser, has, needs_browser, open_page
from stack_rig import Rig

from telenano.afm.particles.settings import ParticlesConfig
from telenano.afm.programs.push import AT_GOAL
from telenano.recording.reader import Recording

pytestmark = [pytest.mark.browser, pytest.mark.endurance, needs_browser]

ONE = "afm_node.sample.particles.count=1"
# 1.3 d
BEHIND_M = 4.34e-7
DEEP_MM, WAY_M = 14.0, 1e-6
# This share of half the pad steers at some 130 nm/s.
SHARE = 0.4
# the kinetic friction of latex_250
PLATEAU_N = 10.75e-9


class Pushed:
    """The way of the stage under the force of a particle that slides; each row is read once."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self._since_ns, self.way_m = rig, time.time_ns(), 0.0
        self._before = rig.newest("afm/state").base_position_m[:2]

    def follow(self) -> float:
        """Return the way until now [m]."""
        for message in self._rig.recording().messages("afm/state", self._since_ns):
            row, self._since_ns = message.decode(), message.log_ns + 1
            place_m = row.base_position_m[:2]
            if abs(math.hypot(*row.tip_force_n[:2]) - PLATEAU_N) < 0.05 * PLATEAU_N and row.mode == "follow":
                self.way_m += math.dist(place_m, self._before)
            self._before = place_m
        return self.way_m


def done(page: Page, action: Callable[[], object]) -> None:
    """Do something, again where a server that was held up cannot show that it is fresh, which the page says."""
    end = time.monotonic() + PATIENCE_S
    while "acknowledged" not in (answer := page.answered(action)):
        assert "send it again" in answer and time.monotonic() < end, answer


# A particle that is pushed through its middle turns aside by itself: who pushes has to follow the force that is felt,
# by the law of telenano/afm/particles/steering.py. The hand does so in the page, at what the page shows:
# from outside a move of the pointer takes seconds on a busy machine, and a particle is lost in as many.
HAND = """([share, deep]) => {
  const pad = document.querySelector('#steer-pad'), box = pad.getBoundingClientRect();
  const half = Math.min(box.width, box.height) / 2, steepest = Math.sqrt(3);
  let ahead = [1, 0];
  return setInterval(() => {
    const [x, y] = ['force_x', 'force_y'].map((name) => telenano.store.last('tip', name)), size = Math.hypot(x, y);
    if (size > 5e-9) ahead = [-x / size, -y / size];
    const slope = -Math.max(-steepest, Math.min(steepest, 2 * Math.atan2(-ahead[1], ahead[0])));
    const pull = share / Math.hypot(1, slope);
    const right = pull * (ahead[0] - slope * ahead[1]), up = pull * (slope * ahead[0] + ahead[1]);
    // up on the sample is away from the viewer, and 10 cm of a controller are 10 mm of the hand
    if (deep) return headset.controllers.right.position.set(0.2 + 0.2 * right, 1.2 - deep / 100, -0.4 - 0.2 * up);
    const at = { clientX: box.left + box.width / 2 + half * right, clientY: box.top + box.height / 2 - half * up };
    pad.dispatchEvent(new PointerEvent('pointermove', { pointerId: 1, ...at }));
  }, 100);
}"""


def begin_to_steer(page: Page, share: float) -> int:
    """Hold the pad across with the pointer, pull to the right by a share of its half, and return what ends that."""
    pad = page.page.locator("#steer-pad")
    pad.evaluate("pad => pad.scrollIntoView()")
    box = pad.bounding_box()
    page.page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.page.mouse.down()
    return int(page.page.evaluate(HAND, [share, 0.0]))


def test_a_hand_in_the_browser_pushes_a_particle_a_micrometre(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    try:
        rig.start("--duration", "300", "--no-view", "--set", ONE, *BESIDE_A_BROWSER, scenario="assembly")
        rig.wait_until(rig.running, "a running session")
        view = View(rig.environment)
        try:
            with browser() as chromium:
                walk(rig, open_page(chromium, view.operator))
        finally:
            view.close()
    finally:
        rig.close()


def walk(rig: Rig, page: Page) -> None:
    page.until("telenano.store.rings.get('tip')?.length > 200", "curves on the page")
    page.until("document.querySelector('#assemble') !== null", "the panel of the particles")
    page.value("document.querySelector('#tab-particles')?.click()")
    # The scene in three dimensions would take most of what the rig leaves of a machine without graphics.
    page.click("#show-flat")
    x_m, y_m = ParticlesConfig(count=1).placed(8e-6, 8e-6)[0].tolist()
    # The tip comes from 0, 0, and the particle is not on its way. It goes along x: a push that is a few degrees
    # beside its middle loses it within a micrometre.
    at_x, at_y = x_m - BEHIND_M, y_m
    page.follow()
    page.fill("#tip-x", f"{1e9 * at_x:.3f}")
    page.fill("#tip-y", f"{1e9 * at_y:.3f}")
    done(page, lambda: page.click("#tip-go"))
    rig.wait_until(
        lambda: math.dist(rig.newest("afm/state").base_position_m[:2], (at_x, at_y)) < 1e-9,
        "a tip beside the particle",
    )
    page.click("#hand-keep")
    page.press(DEEP_MM)
    page.page.mouse.up()
    rig.wait_until(lambda: rig.newest("afm/state").tip_force_n[2] > 7e-9, "a tip that presses")
    begin_ns, pushed = time.time_ns(), Pushed(rig)
    steering = begin_to_steer(page, SHARE)
    rig.wait_until(lambda: pushed.follow() > WAY_M, "a particle that was pushed a micrometre", PATIENCE_S)
    page.until(has("#particles-state", "Pushing"), "a page that says so")
    page.value(f"clearInterval({steering})")
    felt = max(math.hypot(*row.decode().force_n[:2]) for row in rig.recording().messages("haptic/command", begin_ns))
    assert felt > 1.0
    page.click("#show-solid")
    page.picture("particles")
    page.page.mouse.up()
    page.page.wait_for_timeout(1500.0)
    stood = rig.newest("afm/state").base_position_m[:2]
    page.page.wait_for_timeout(1000.0)
    # the hand is back in its middle, and the tip stands
    assert rig.newest("afm/state").base_position_m[:2] == stood
    events = [row.decode().data for row in rig.recording().messages("session/event", begin_ns)]
    assert "met" in [event.get("lateral") for event in events]
    status = rig.newest("law/status")
    assert status.passive
    assert page.faults == []


# The target lies in the image, because the page draws nothing beyond it.
IMAGED_M, TARGET_M = 1.7e-6, 7.5e-7


def particle_m(rig: Rig) -> tuple[float, float]:
    """Return where the simulated particle really is [m], which the page is not told."""
    (place,) = rig.newest("afm/particles").places_m.to_numpy().tolist()
    return place[0], place[1]


def pushes(rig: Rig, begin_ns: int) -> list[Any]:
    """Return the reports of pushes."""
    rows = [row.decode() for row in rig.recording().messages("afm/program", begin_ns)]
    return [row for row in rows if row.program == "push"]


@pytest.mark.parametrize("headset", [False, True], ids=["by pointer", "in a headset"])
def test_a_program_begins_a_hand_takes_over_and_the_program_ends_it(tmp_path: Path, headset: bool) -> None:
    rig = Rig(tmp_path)
    try:
        rig.start("--duration", "600", "--no-view", "--set", ONE, *BESIDE_A_BROWSER, scenario="assembly")
        rig.wait_until(rig.running, "a running session")
        view = View(rig.environment)
        try:
            with browser() as chromium:
                taken_over(rig, open_page(chromium, view.operator, headset=headset), headset)
        finally:
            view.close()
    finally:
        rig.close()


def imaged(rig: Rig, page: Page) -> None:
    """Take an image of the particle, light enough that it stays, and wait until the page has found it."""
    x_m, y_m = particle_m(rig)
    given = {"x_m": f"{1e9 * x_m:.0f}", "y_m": f"{1e9 * y_m:.0f}", "width_m": f"{1e9 * IMAGED_M:.0f}"}
    given |= {"depth_m": "1200", "pixels": "24", "lines": "10", "dwell_s": "70"}
    given |= {"setpoint_n": "1.5", "approach_m_per_s": "5000"}
    page.value("document.querySelector('#tab-image').click()")
    page.until("document.querySelector('#program-scan-pixels') !== null", "the form of an image")
    for key, value in given.items():
        page.fill(f"#program-scan-{key}", value)
    done(page, lambda: page.click("#program-scan"))
    # The tab Image is shown, from which a person scans.
    page.until("telenano.cockpit.tip.program === 'scan'", "an image that begins")
    rig.wait_until(lambda: rig.newest("afm/program").state == "finished", "the end of the image", 4.0 * PATIENCE_S)
    page.until("!telenano.cockpit.tip.program", "a page that knows of the end")
    page.value("document.querySelector('#tab-particles').click()")
    page.until("document.querySelectorAll('#particles-list li').length === 1", "a particle in the image")


def act(page: Page, button: str, headset: bool) -> None:
    """Press a button of the panel, or the stick of a controller, which does what comes next."""
    if not headset:
        page.click(f"#{button}")
        return
    stick = "headset.controllers.right.updateButtonValue('thumbstick', {})"
    page.value(stick.format(1))
    page.until("telenano.view.headset.isGoing", "a stick that is pressed")
    page.value(stick.format(0))
    page.until("!telenano.view.headset.isGoing", "a stick that was let go")


def drag_target(page: Page, x_nm: float, y_nm: float, to_x_nm: float, to_y_nm: float) -> None:
    """Drag the target of a particle with the pointer in the image from above."""
    page.page.locator("#scene").evaluate("scene => scene.scrollIntoView()")
    page.until("telenano.view.flat.canvas.clientHeight > 0 && telenano.view.flat.frame.scale !== 1", "the flat image")
    at = "(({{left, top}}, [x, y]) => [left + x, top + y])(flat.canvas.getBoundingClientRect(), flat.toCanvas("
    at = f"(flat => {at}telenano.view.surface.extent, {{}}, {{}})))(telenano.view.flat)"
    mouse = page.page.mouse
    mouse.move(*page.value(at.format(x_nm, y_nm)))
    mouse.down()
    mouse.move(*page.value(at.format(to_x_nm, to_y_nm)), steps=4)
    mouse.up()


def point_target(page: Page, x_nm: float, y_nm: float, to_x_nm: float, to_y_nm: float) -> None:
    """Drag the target of a particle with the trigger of the left controller, held over the table and pointing down."""
    left = "headset.controllers.left"
    page.value(f"{left}.quaternion.set(-Math.SQRT1_2, 0, 0, Math.SQRT1_2)")
    over = "(at => {left}.position.set(at.x, at.y + 0.2, at.z))(telenano.view.world.localToWorld({vector}))"
    for number, (x, y) in enumerate(((x_nm, y_nm), (to_x_nm, to_y_nm))):
        page.value(over.format(left=left, vector=f"telenano.view.world.position.clone().set({x}, {y}, 0)"))
        drawn = page.value("telenano.view.frames")
        page.until(f"telenano.view.frames > {drawn} + 2", "a controller that has moved")
        page.value(f"{left}.updateButtonValue('trigger', {1 - number})")
        page.until(f"{'!' * (1 - number)}!telenano.view.headset.dragged", "a target in the hand, and let go")


TRIGGER = "headset.controllers.right.updateButtonValue('trigger', {})"


def begin_in_headset(rig: Rig, page: Page) -> int:
    """Hold tip and stylus by the right controller, press, pull to the right, and return what ends that."""
    page.value("headset.controllers.right.position.set(0.2, 1.2, -0.4)")
    page.value(TRIGGER.format(1))
    page.until("telenano.view.headset.pressed", "a trigger that is held")
    page.value(f"headset.controllers.right.position.set(0.2, {1.2 - 1e-2 * DEEP_MM}, -0.4)")
    rig.wait_until(lambda: rig.newest("afm/state").tip_force_n[2] > 7e-9, "a tip that presses")
    return int(page.page.evaluate(HAND, [SHARE, DEEP_MM]))


def take_over(rig: Rig, page: Page, headset: bool) -> None:
    """Take over, again where a server that was held up has refused it, which the panel says."""
    end = time.monotonic() + PATIENCE_S
    while True:
        act(page, "take-over", headset)
        said = "document.querySelector('#particles-state').textContent"
        page.until(f"/By hand|take over again/.test({said})", "what comes of taking over")
        if "By hand" in page.value(said):
            break
        assert time.monotonic() < end, page.page.inner_text("#answers")
    rig.wait_until(lambda: rig.newest("afm/state").mode == "follow", "a tip that follows the hand")


def keys_choose(page: Page) -> None:
    """Change by the key k what the hand across is, and back."""
    for mode in ("position", "rate"):
        done(page, lambda: page.page.keyboard.press("k"))
        assert page.value("document.querySelector('#lateral-mode').value") == mode


def taken_over(rig: Rig, page: Page, headset: bool) -> None:
    page.until("telenano.store.rings.get('tip')?.length > 200", "curves on the page")
    page.until("document.querySelector('#assemble') !== null", "the panel of the particles")
    if not headset:
        page.click("#show-flat")
    before = particle_m(rig)
    imaged(rig, page)
    assert math.dist(before, particle_m(rig)) < 1e-9
    goal = before[0] + TARGET_M, before[1]
    begin_ns = time.time_ns()
    if headset:
        page.until("!document.querySelector('#vr').hidden", "a browser with a headset")
        page.click("#vr")
        page.until("telenano.view.headset.isPresenting && telenano.view.sheet.mesh.visible", "circles in the headset")
    (point_target if headset else drag_target)(page, *(1e9 * value for value in (*before, *goal)))
    page.until("/from its target/.test(document.querySelector('#particles-list li').textContent)", "a target")
    done(page, lambda: act(page, "assemble", headset))
    rig.wait_until(lambda: particle_m(rig)[0] - before[0] > 1e-7, "a particle that the program pushes")
    take_over(rig, page, headset)
    assert pushes(rig, begin_ns)[-1].state == "ended"
    middle = particle_m(rig)
    assert middle[0] - before[0] < TARGET_M - 2e-7
    if not headset:
        keys_choose(page)
        page.click("#hand-keep")
        page.press(DEEP_MM)
        page.page.mouse.up()
        rig.wait_until(lambda: rig.newest("afm/state").tip_force_n[2] > 7e-9, "a tip that presses")
    steering = begin_in_headset(rig, page) if headset else begin_to_steer(page, SHARE)
    rig.wait_until(lambda: math.dist(particle_m(rig), middle) > 1e-7, "a particle that the hand has pushed", PATIENCE_S)
    page.value(f"clearInterval({steering})")
    if headset:
        page.value(TRIGGER.format(0))
        page.until("!telenano.view.headset.pressed", "a trigger that was let go")
    else:
        page.page.mouse.up()
    by_hand_ns = time.time_ns()
    done(page, lambda: act(page, "give-back", headset))
    rig.wait_until(lambda: pushes(rig, by_hand_ns) != [], "a push that goes on")
    rig.wait_until(lambda: pushes(rig, by_hand_ns)[-1].state == "finished", "the end of the push")
    assert pushes(rig, by_hand_ns)[-1].values["why"] == AT_GOAL
    # The truth of a particle that rests comes once a second.
    rig.wait_until(lambda: math.dist(particle_m(rig), goal) < 50e-9, "a particle at its goal")
    page.until("!telenano.cockpit.tip.program", "a page that knows")
    page.click("#show-solid")
    assert page.faults == []


def transport(page: Page, action: str, value: float) -> None:
    page.value(f"telenano.cockpit.commands.ask('{action}', {{ k: 'transport', action: '{action}', value: {value} }})")


def contact_s(path: Path) -> float:
    """Return when a push has met its particle, from the begin of a recording [s]."""
    found = Recording(path)
    met = [row for row in found.messages(("afm/program",)) if (row.fields().get("values") or {}).get("in_contact")]
    return 1e-9 * (met[0].log_ns - found.span_ns[0])


def test_the_recording_of_an_assembly_shows_it_again(tmp_path: Path) -> None:
    (tmp_path / "there.txt").write_text("4e-7 1e-7\n")
    one = ("--afm", "sample.particles.places=[[0.0,0.0]]", "--afm", "sample.size_m=3e-6")
    out = tmp_path / "out"
    words = ["assemble", "--pattern", str(tmp_path / "there.txt"), "--out", str(out), "--json", *one]
    subprocess.run([sys.executable, "-m", "telenano", *words], check=True, capture_output=True)
    view = View({**os.environ, "TELENANO_RUNTIME_DIR": str(tmp_path)}, str(out / "assembly.mcap"))
    try:
        with browser() as chromium:
            page = open_page(chromium, view.operator, headset=True)
            page.until("document.querySelector('#particles-list') !== null", "the panel of the particles")
            page.value("document.querySelector('#tab-particles')?.click()")
            page.click("#show-flat")
            drawn = page.value("telenano.view.frames")
            transport(page, "rate", 10.0)
            page.until("document.querySelectorAll('#particles-list li').length === 1", "a particle in the first image")
            # A push takes half a second, which a page without a graphics processor draws a few times of.
            transport(page, "rate", 0.05)
            transport(page, "seek", contact_s(out / "assembly.mcap"))
            transport(page, "play", 0.0)
            page.until("/, pushed/.test(document.querySelector('#particles-list li').textContent)", "the push")
            transport(page, "rate", 10.0)
            # 400 and 100 nm, and the drift meanwhile
            at_goal = "(() => { const [x, y] = document.querySelector('#particles-list li').textContent.split(/[, ]+/)"
            page.until(f"{at_goal}; return Math.hypot(x - 400, y - 100) < 40; }})()", "the particle at its goal")
            # the scene is not drawn while only the flat image is shown
            assert page.value("telenano.view.frames") == drawn
            page.click("#show-solid")
            # the circles lie in the scene in three dimensions as well, which is that of a headset
            page.until("telenano.view.sheet.mesh.visible", "circles in three dimensions")
            page.until("document.querySelector('#vr').hidden === false", "a browser with a headset")
            page.click("#vr")
            page.until("telenano.view.headset.isPresenting", "a session of the headset")
            page.until("telenano.view.frames > 3", "pictures in the headset")
            # a recording has no targets, so that the places are noted that the left controller points at
            noted = "(x, y) => { window.from = [x, y]; return (toX, toY) => { window.to = [toX, toY]; }; }"
            page.value(f"void (telenano.view.headset.onGrab = {noted})")
            point_target(page, 100.0, -50.0, 400.0, 100.0)
            assert page.value("window.from") == pytest.approx([100.0, -50.0], abs=1.0)
            assert page.value("window.to") == pytest.approx([400.0, 100.0], abs=1.0)
            # elsewhere the trigger presses
            page.value("void (telenano.view.headset.onGrab = () => undefined)")
            page.value("headset.controllers.left.updateButtonValue('trigger', 1)")
            page.until("telenano.view.headset.pressed", "a trigger that presses")
            assert page.faults == []
    finally:
        view.close()
