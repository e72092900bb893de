"""Whoever arms what, as fast as a script can: on a live rig no tip follows a hand that is not armed.

TELENANO_CLICKS is how often the page is connected and clicked, 12 times by default.
"""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest
from browser_page import BESIDE_A_BROWSER, View, browser, needs_browser
from commands import Commands
from stack_rig import Rig, first_of_the_session

from telenano.recording.reader import Recording

pytestmark = pytest.mark.check
CLICKS = int(os.environ.get("TELENANO_CLICKS", "12"))
# Arms as soon as the page is connected, before it has drawn anything.
CLICK_AT_ONCE = """() => new Promise((done) => {
  const begun = performance.now();
  const look = () => {
    const commands = window.telenano?.cockpit.commands;
    if (commands?.link === "open") { void commands.arm(); done(performance.now() - begun); }
    else if (performance.now() - begun > 20000) done(-1);
    else setTimeout(look, 1);
  };
  look();
})"""
# The rig of `make test` begins so as well.
OF_THE_START = pytest.mark.drawn(0.0, "telenano/afm/", "services/afm_node/", "telenano/launcher/")
# A command is in force for 50 ms, and the turns of two processes lie between [ns].
GRACE_NS = 120_000_000


def followed_unarmed(recordings: Sequence[Path]) -> list[tuple[int, str]]:
    """Return when the tip followed although the hand had not been armed for longer than a command is in force."""
    found: list[tuple[int, str]] = []
    armed_ns = -(10**18)
    messages = [each for path in recordings for each in Recording(path).messages(["haptic/state", "afm/state"])]
    for message in sorted(messages, key=lambda each: each.publish_ns):
        state = message.decode()
        if message.topic == "haptic/state":
            armed_ns = state.t_ns if state.armed else armed_ns
        elif state.mode == "follow" and state.t_ns - armed_ns > GRACE_NS:
            found.append((state.t_ns, state.mode))
    return found


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path)
    try:
        rig.start("--duration", "3000", *BESIDE_A_BROWSER, scenario="touch")
        rig.wait_until(rig.running, "a running session")
        yield rig
    finally:
        rig.close()


def recordings_of(rig: Rig) -> list[Path]:
    return sorted(rig.out.glob("*.mcap"))


@pytest.mark.browser
@pytest.mark.endurance
@needs_browser
def test_a_click_just_after_a_connection_never_arms_a_tip_alone(rig: Rig) -> None:
    view = View(rig.environment)
    try:
        with browser() as chromium:
            page, other = chromium.new_page(), chromium.new_page()
            other.goto(view.observer)
            # a page whose policy allows no text as code is asked, and does not wait by itself
            is_open = "window.telenano?.cockpit.commands.link === 'open'"
            rig.wait_until(lambda: other.evaluate(is_open), "the page of the observer")
            page.goto(view.operator)
            for _ in range(CLICKS):
                # Anybody who sees the tip may stop it, and the page is loaded while the stop is on its way.
                other.evaluate("() => void window.telenano.cockpit.commands.estop()")
                page.reload(wait_until="domcontentloaded")
                assert page.evaluate(CLICK_AT_ONCE) >= 0.0, "the page did not connect"
                page.wait_for_timeout(200.0)
    finally:
        view.close()
    rig.stop()
    assert followed_unarmed(recordings_of(rig)) == []


def armed(rig: Rig, *target: str) -> str:
    """Arm until the tip has gone back and no stop can be younger than the wish, and return the command's words.

    A delayed command has to take a stop that came meanwhile for a younger one, and a tip that still goes back from a
    stop refuses to be armed.
    """
    for _ in range(5):
        found = rig.telenano("session", "arm", *target)
        is_void = " is void: an emergency stop came to " in found.stderr
        if not is_void and "not armed: still_retracting" not in found.stdout:
            break
    assert found.returncode == 0, found.stdout + found.stderr
    return found.stdout


def at_once(rig: Rig, *commands: Sequence[str]) -> None:
    """Run commands side by side, each from a process of its own."""

    def run(arguments: Sequence[str]) -> None:
        with closing(Commands()) as own:
            own.run(tuple(arguments), rig.environment, 60.0)

    with ThreadPoolExecutor(len(commands)) as turns:
        list(turns.map(run, commands))


def test_the_real_commands_in_any_order_arm_no_tip_alone(rig: Rig) -> None:
    assert rig.telenano("estop").returncode == 0
    tip = armed(rig, "--target", "afm_node")
    assert "stays withdrawn until a fresh command of an armed hand comes" in tip
    rig.wait_until(lambda: rig.newest("afm/state").mode == "retracted", "a tip that waits")
    assert rig.newest("afm/state").armed is True
    arm_tip = ("session", "arm", "--target", "afm_node")
    at_once(rig, arm_tip, ("estop",))
    at_once(rig, arm_tip, ("session", "arm", "--target", "haptic_node"))
    assert "the tip is placed: its base is at" in armed(rig)
    rig.wait_until(lambda: rig.newest("afm/state").mode == "follow", "a tip that follows")
    rig.stop()
    assert followed_unarmed(recordings_of(rig)) == []


@pytest.mark.parametrize(
    ("speed_m_per_s", "rate_hz"),
    [
        *(
            pytest.param(*case, marks=pytest.mark.endurance)
            for case in [(15e-9, 250), (50e-9, 250), (2e-6, 125), (2e-6, 1000)]
        ),
        pytest.param(2e-6, 250, marks=OF_THE_START),
    ],
)
def test_a_session_on_the_bus_begins_with_the_tip_at_the_papers_distance(
    tmp_path: Path, speed_m_per_s: float, rate_hz: int
) -> None:
    rig = Rig(tmp_path)
    speed = f"afm_node.safety.base_speed_m_per_s={speed_m_per_s}"
    try:
        rig.start("--set", speed, "--duration", "0.3", rate=("--set", f"realtime.rate_hz={rate_hz}"))
        code, _, err = rig.finish()
        assert code == 0, err
        tip, _ = first_of_the_session(recordings_of(rig))
    finally:
        rig.close()
    assert tip.placed is True
    assert tip.separation_m == pytest.approx(10e-9, rel=0.0, abs=0.1e-9)


@pytest.mark.parametrize(
    "scenario",
    [
        *(pytest.param(name, marks=pytest.mark.endurance) for name in ("fig10", "touch")),
        pytest.param("image", marks=OF_THE_START),
    ],
)
def test_every_scenario_begins_with_the_tip_placed_or_its_program_under_way(tmp_path: Path, scenario: str) -> None:
    rig = Rig(tmp_path)
    try:
        rig.start("--duration", "0.3", scenario=scenario)
        code, _, err = rig.finish()
        assert code == 0, err
        tip, start = first_of_the_session(recordings_of(rig))
    finally:
        rig.close()
    assert (tip.placed, tip.mode, start.armed) == (True, "follow", True)
