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
from browser_page import PATIENCE_S, PATIENT, Page, View, browser, has, needs_browser, open_page
from stack_rig import Rig

from recording.reader import Recording
from services.afm_node.physics.particles.settings import ParticlesConfig

pytestmark = [pytest.mark.browser, pytest.mark.endurance, needs_browser]

ONE = "afm_node.sample.particles.count=1"
# 1.3 d
BEHIND_M = 4.34e-7
DEEP_MM, WAY_M = 14.0, 1e-6
# of half the pad: some 130 nm/s
SHARE = 0.4
# the kinetic friction of latex_250
PLATEAU_N = 10.75e-9


class Pushed:
    """The way of the stage under the force of a particle that slides; each row is read once."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self._since_ns, self.way_m = rig, time.time_ns(), 0.0
        self._before = newest(rig, "afm/state").base_position_m[:2]

    def follow(self) -> float:
        """Return the way until now [m]."""
        for message in self._rig.recording().messages("afm/state", self._since_ns):
            row, self._since_ns = message.decode(), message.log_ns + 1
            place_m = row.base_position_m[:2]
            if abs(math.hypot(*row.tip_force_n[:2]) - PLATEAU_N) < 0.05 * PLATEAU_N and row.mode == "follow":
                self.way_m += math.dist(place_m, self._before)
            self._before = place_m
        return self.way_m


def newest(rig: Rig, topic: str) -> Any:
    return rig.recording().messages(topic)[-1].decode()


def done(page: Page, action: Callable[[], object]) -> None:
    """Do something, again where a server that was held up cannot show that it is fresh, which the page says."""
    end = time.monotonic() + PATIENCE_S
    while "acknowledged" not in (answer := page.answered(action)):
        assert "send it again" in answer and time.monotonic() < end, answer


# A particle that is pushed through its middle turns aside by itself: who pushes has to follow the force that is felt,
# by the law of services/afm_node/physics/particles/steering.py. The hand does so in the page, at what the page shows:
# from outside a move of the pointer takes seconds on a busy machine, and a particle is lost in as many.
HAND = """share => {
  const pad = document.querySelector('#steer-pad'), box = pad.getBoundingClientRect();
  const half = Math.min(box.width, box.height) / 2, steepest = Math.sqrt(3);
  let ahead = [1, 0];
  return setInterval(() => {
    const [x, y] = ['force_x', 'force_y'].map((name) => telenano.store.last('tip', name)), size = Math.hypot(x, y);
    if (size > 5e-9) ahead = [-x / size, -y / size];
    const slope = -Math.max(-steepest, Math.min(steepest, 2 * Math.atan2(-ahead[1], ahead[0])));
    const pull = (share * half) / Math.hypot(1, slope);
    const right = pull * (ahead[0] - slope * ahead[1]), up = pull * (slope * ahead[0] + ahead[1]);
    const at = { clientX: box.left + box.width / 2 + right, clientY: box.top + box.height / 2 - up };
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
    return int(page.page.evaluate(HAND, share))


def test_a_hand_in_the_browser_pushes_a_particle_a_micrometre(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    try:
        rig.start("--duration", "300", "--no-view", "--set", ONE, "--set", PATIENT, scenario="assembly")
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
        lambda: math.dist(newest(rig, "afm/state").base_position_m[:2], (at_x, at_y)) < 1e-9,
        "a tip beside the particle",
    )
    page.click("#hand-keep")
    page.press(DEEP_MM)
    page.page.mouse.up()
    rig.wait_until(lambda: newest(rig, "afm/state").tip_force_n[2] > 7e-9, "a tip that presses")
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
    stood = newest(rig, "afm/state").base_position_m[:2]
    page.page.wait_for_timeout(1000.0)
    # the hand is back in its middle, and the tip stands
    assert newest(rig, "afm/state").base_position_m[:2] == stood
    events = [row.decode().data for row in rig.recording().messages("session/event", begin_ns)]
    assert "met" in [event.get("lateral") for event in events]
    status = newest(rig, "law/status")
    assert status.passive
    assert page.faults == []


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
