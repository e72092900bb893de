"""A half of a law that comes back alone takes up where hand and tip are: no law makes the force at the tip jump.

For each law, in virtual time: a hand holds 1 N, a half is killed and started again 0.1 s later, and the hand then
presses with 1.4 N. The bounds are stated beforehand, as shares of what the hand asks for: no more than 10 % above it at
any time, and within 10 % of it at the end. A tip whose hand's half was away is withdrawn, and waits to be armed.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import pytest

from telenano.sections.controller_section import LAWS
from telenano.virtual import VirtualRig
from telenano.virtual.rig import ARMED_S, STARTED_S

HALVES = ("controller@master", "controller@slave")
AWAY_NS = 100_000_000
KILLED_S, PRESSED_S, ENDS_S = 2.2, 3.3, 4.8
FIRST_N, LAST_N = 1.0, 1.4
BOUND = 0.1
DELAY_S = 0.02
# The hand's force per newton at the tip.
FORCE_SCALE = 1e8
_POINTS = [(0.05, 0.0), (0.3, FIRST_N), (PRESSED_S - STARTED_S, FIRST_N), (PRESSED_S - STARTED_S + 0.3, LAST_N)]
SCENARIO: Mapping[str, Any] = {
    "name": "return",
    "description": "A hand presses the tip onto mica, and presses harder",
    "duration_s": ENDS_S,
    "realtime": {"rate_hz": 250.0},
    "haptic_node": {
        "operator": {
            "kind": "force_profile",
            "points": [{"time_s": time_s, "force_n": force_n} for time_s, force_n in [*_POINTS, (9.0, LAST_N)]],
        }
    },
    "afm_node": {"rest_distance_m": 10.0e-9},
    "delay_node": {way: {"delay_s": DELAY_S} for way in ("forward", "backward")},
}


class Course(NamedTuple):
    """What a session came to: forces at the tip [N at the hand], its mode at the end, and the hand's way [m].

    settled_n: when the half was killed; returned_n, pressed_n: the greatest from then until the hand presses harder,
    and since; last_n: at the end; way_m: how far the hand has moved from the kill until it presses harder.
    """

    settled_n: float
    returned_n: float
    pressed_n: float
    last_n: float
    mode: str
    way_m: float


def course(law: str, half: str) -> Course:
    """Run a session in which a half is killed and comes back."""
    rig = VirtualRig(None, 3, [f"controller.law={law}"], scenario=SCENARIO)
    rig.run_until(ARMED_S)
    rig.command("arm", "*", place="hand")
    rig.run_until(STARTED_S)
    rig.command("start", "haptic_node")
    rig.run_until(KILLED_S)
    before = rig.received("afm/state", "afm_node@slave")
    stood = rig.received("haptic/state", "haptic_node@master")
    rig.restart(half, AWAY_NS)
    rig.run_until(PRESSED_S)
    moved, held = rig.received("haptic/state", "haptic_node@master"), rig.received("afm/state", "afm_node@slave")
    rig.run_until(ENDS_S)
    after = rig.received("afm/state", "afm_node@slave")
    rig.close()
    forces = [FORCE_SCALE * one.tip_force_n[2] for one in after]
    return Course(
        settled_n=forces[len(before) - 1],
        returned_n=max(forces[len(before) : len(held)]),
        pressed_n=max(forces[len(held) :]),
        last_n=forces[-1],
        mode=after[-1].mode,
        way_m=abs(moved[-1].position_m[2] - stood[-1].position_m[2]),
    )


@pytest.mark.check("takes a second")
@pytest.mark.drawn(0.3, "telenano/laws/", "packages/telenano-laws/", "services/controller/")
@pytest.mark.parametrize("law", LAWS)
def test_the_half_at_the_tip_comes_back_without_a_jump_of_the_force(law: str) -> None:
    found = course(law, "controller@slave")
    assert found.settled_n == pytest.approx(FIRST_N, rel=0.2)
    assert found.returned_n <= (1.0 + BOUND) * FIRST_N
    assert found.pressed_n <= (1.0 + BOUND) * LAST_N
    assert (found.mode, found.last_n) == ("follow", pytest.approx(LAST_N, rel=BOUND))
    # The hand stays with the tip: it does not move on against a force that it does not feel.
    assert found.way_m <= 1.5e-3


@pytest.mark.check("takes a second")
@pytest.mark.drawn(0.3, "telenano/laws/", "packages/telenano-laws/", "services/controller/")
@pytest.mark.parametrize("law", LAWS)
def test_the_half_at_the_hand_comes_back_over_a_tip_that_is_withdrawn(law: str) -> None:
    found = course(law, "controller@master")
    assert found.returned_n <= (1.0 + BOUND) * FIRST_N
    assert (found.mode, found.last_n) == ("retracted", pytest.approx(0.0, abs=BOUND))


@pytest.mark.check("takes 10 s")
@pytest.mark.parametrize("is_late", [False, True], ids=["changed before", "the other half hears of the change later"])
@pytest.mark.parametrize("half", HALVES)
def test_a_half_that_comes_back_takes_over_the_law_that_was_changed(half: str, is_late: bool) -> None:
    rig = VirtualRig(None, 3, ["controller.law=virtual_impedance"], scenario=SCENARIO)
    rig.run_until(ARMED_S)
    rig.command("arm", "*", place="hand")
    rig.run_until(STARTED_S)
    rig.command("start", "haptic_node")
    rig.run_until(1.2)
    if not is_late:
        rig.command("set", "controller", law="wave")
    rig.run_until(KILLED_S)
    rig.restart(half, AWAY_NS)
    rig.run_until(KILLED_S + 0.4)
    if is_late:
        rig.command("set", *(other for other in HALVES if other != half), law="wave")
    rig.run_until(KILLED_S + 1.7)
    if half == "controller@master":
        rig.command("arm", "afm_node@slave", place="hand")
    rig.run_until(ENDS_S)
    assert [rig.received("law/status", each)[-1].law for each in HALVES] == ["wave", "wave"]
    assert rig.received("haptic/state", "haptic_node@master")[-1].mode == "position"
    tip = rig.received("afm/state", "afm_node@slave")[-1]
    # A tip that was withdrawn and comes to the hand again stays in front of the sample: only the hand presses it in.
    expected_n = pytest.approx(0.0, abs=0.2) if half == "controller@master" else pytest.approx(LAST_N, rel=BOUND)
    assert (tip.mode, FORCE_SCALE * tip.tip_force_n[2]) == ("follow", expected_n)
    texts = [event.text for event in rig.received("session/event", half)]
    assert sum(text.startswith("law wave is in force, as at the other site") for text in texts) == 1
    rig.close()
