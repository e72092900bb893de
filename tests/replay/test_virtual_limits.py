"""A hand is pressed at either end of its travel, and a tip at the end of its range, by every law in a whole rig."""

import math
from typing import Any, NamedTuple

import pytest

from telenano.sections.controller_section import KNOWN_LAWS
from telenano.virtual import VirtualRig

# Travel of the hand [m], and the way of the tip for it at the scale of the defaults.
ENDS_M = {1: 14.5e-3, -1: -4.5e-3}
SCALE = 1.5e-6
# Way of the hand to its end [m].
WAY_M = 1.5e-3
PRESSED_N = 2.0
# Times of the profile of the operator [s]: the hand has been at its end for half of the first one.
LET_GO_S, END_S = 0.6, 0.9
# A reference beyond an end [m], up to the search for a force.
BEYOND_M = 1e-7
# Way that shows that hand or tip have begun [m], and the time within which they do after the force has turned [s].
BEGUN_M, BEGUN_TIP_M, BEGUN_S = 2e-5, 5e-11, 0.06
# The tip goes on by this after the hand stands [m]: with its own motion of four channels, or a wave under way.
COASTED_M = {"four_channel": 1e-8, "wave": 1e-9}
LEADING = [law for law in KNOWN_LAWS if law != "tactile"]


class Pressed(NamedTuple):
    """Rows of time [s] and place [m] of hand, commanded hand, base; times count from the start of the profile."""

    hand: list[tuple[float, float]]
    asked: list[tuple[float, float]]
    base: list[tuple[float, float]]
    rig: VirtualRig


def pressed(law: str, side: int, start_m: float, **afm_node: Any) -> Pressed:
    force_n = side * PRESSED_N
    points = [(0.0, 0.0), (0.02, force_n), (LET_GO_S, force_n), (LET_GO_S + 0.02, -force_n), (END_S, -force_n)]
    scenario = {
        "name": "pressed",
        "description": "A hand presses at the end of its travel, and draws back",
        "duration_s": 1.0,
        "haptic_node": {
            "device": {"start_position_m": start_m},
            "operator": {
                "kind": "force_profile",
                "points": [{"time_s": time_s, "force_n": force_n} for time_s, force_n in points],
            },
        },
        "controller": {"law": law},
        "afm_node": {"rest_distance_m": 200e-9, **afm_node},
    }
    rig = VirtualRig(None, 5, scenario=scenario)
    rig.run_until(0.1)
    # The base stays at its place of safety, and moves with the hand from there.
    rig.command("arm", "*")
    rig.run_until(0.2)
    rig.command("start", "haptic_node")
    rig.run_until(0.2 + END_S)
    hands = rig.received("haptic/state", "haptic_node@master")
    begun_ns = next(one.t_ns for one in hands if one.session_s >= 0.0)

    def rows(messages: list[Any], field: str) -> list[tuple[float, float]]:
        return [((one.t_ns - begun_ns) * 1e-9, -getattr(one, field)[2]) for one in messages]

    commands = [one for one in rig.received("haptic/command", "controller@master") if one.mode != "off"]
    bases = rig.received("afm/state", "afm_node@slave")
    return Pressed(rows(hands, "position_m"), rows(commands, "position_m"), rows(bases, "base_position_m"), rig)


def begins_s(rows: list[tuple[float, float]], least_m: float) -> float:
    """Return the time after the force has turned at which a place has moved by least_m [m]; NaN if it has not."""
    rest_m = [at_m for at_s, at_m in rows if at_s <= LET_GO_S][-1]
    return next((at_s - LET_GO_S for at_s, at_m in rows if at_s > LET_GO_S and abs(at_m - rest_m) > least_m), math.nan)


@pytest.mark.check("takes 0.6 s for each of the 24 rigs")
@pytest.mark.drawn(0.3)
@pytest.mark.grid(law="position_force", side=1)
@pytest.mark.parametrize("side", ENDS_M)
@pytest.mark.parametrize("law", LEADING)
def test_a_hand_pressed_at_its_end_winds_nothing_up(law: str, side: int) -> None:
    end_m = ENDS_M[side]
    seen = pressed(law, side, end_m - side * WAY_M)
    assert max(side * at_m for _, at_m in seen.asked) <= side * end_m + BEYOND_M
    begun_m = next(at_m for at_s, at_m in seen.base if at_s > 0.0)
    farthest_m = max(side * (at_m - begun_m) for at_s, at_m in seen.base if at_s > 0.0)
    assert farthest_m <= SCALE * (WAY_M + BEYOND_M) + COASTED_M.get(law, 0.0)
    # While the hand stands, so does the tip.
    rest = [at_m for at_s, at_m in seen.base if LET_GO_S - 0.1 < at_s < LET_GO_S]
    assert max(rest) - min(rest) < (1e-9 if law in COASTED_M else BEGUN_TIP_M)
    for rows, least_m in ((seen.hand, BEGUN_M), (seen.base, BEGUN_TIP_M)):
        assert begins_s(rows, least_m) <= BEGUN_S


@pytest.mark.check("takes 0.6 s for each of the 12 rigs")
@pytest.mark.drawn(0.3)
@pytest.mark.grid(law="position_force")
@pytest.mark.parametrize("law", LEADING)
def test_a_tip_at_its_end_lets_no_hand_go_on_alone(law: str) -> None:
    # The base may go 1 nm from where it is, which is 0.67 mm of the hand: in the free, so that no force holds the hand.
    seen = pressed(law, 1, 0.0, safety={"base_max_m": -99e-9})
    end_m = 1e-9 / SCALE
    lead_m = 2.4e-3 if KNOWN_LAWS[law].local_loop or KNOWN_LAWS[law].uses_energy else 0.45e-3
    if KNOWN_LAWS[law].uses_waves:
        # The wave law feels the end as a wall that gives way, and drops what the base did not follow.
        assert begins_s(seen.base, BEGUN_TIP_M) <= BEGUN_S
        return
    assert max(at_m for _, at_m in seen.hand) <= end_m + lead_m


def test_a_surface_beyond_the_travel_leads_a_tactile_hand_to_its_end_only() -> None:
    scenario = {
        "name": "felt",
        "description": "A surface that rises by more than the travel of the hand",
        "duration_s": 1.0,
        "controller": {"law": "tactile", "tactile": {"position_scale": 1e-9}},
        "afm_node": {"rest_distance_m": 10e-9},
    }
    rig = VirtualRig(None, 5, scenario=scenario)
    rig.run_until(0.1)
    rig.command("arm", "*", place="hand")
    rig.run_until(0.3)
    asked = [-one.position_m[2] for one in rig.received("haptic/command", "controller@master") if one.mode != "off"]
    assert all(ENDS_M[-1] - BEYOND_M <= at_m <= ENDS_M[1] + BEYOND_M for at_m in asked)
