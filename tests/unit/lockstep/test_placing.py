"""A session begins with the tip where the hand is: placed at any speed, and let in where the hand is beyond."""

from typing import Any

import pytest
from tried_laws import TRIED_LAWS

import telenano
from telenano.wire.errors import RigError

SPEED = "afm_node.safety.base_speed_m_per_s"
FIRST_S = 0.05


@pytest.mark.grid(round_trip_ms=40.0)
@pytest.mark.usefixtures("plain_loop")
@pytest.mark.parametrize("speed_m_per_s", [15e-9, 50e-9, 300e-9, 2e-6])
@pytest.mark.parametrize("round_trip_ms", [0.0, 40.0])
def test_a_session_begins_at_the_papers_distance_at_any_speed_of_the_base(
    speed_m_per_s: float, round_trip_ms: float
) -> None:
    settings = {SPEED: speed_m_per_s}
    session = telenano.simulate("fig12", round_trip_ms=round_trip_ms, settings=settings, duration_s=FIRST_S)
    assert session["separation_m"][0] == pytest.approx(10e-9, rel=0.0, abs=0.1e-9)
    assert len(session["time_s"]) == round(FIRST_S * 1e3)


@pytest.mark.usefixtures("plain_loop")
def test_a_tip_that_cannot_be_placed_is_named_with_place_and_speed() -> None:
    settings: dict[str, Any] = {"afm_node.spring.bilateral": False, "afm_node.spring.rest_position_m": -150e-9}
    with pytest.raises(RigError, match=r"not placed within .* of arming: its guard has withdrawn it \(force_limit\)"):
        telenano.simulate("fig12", environment="spring", settings=settings, duration_s=FIRST_S)


@pytest.mark.check("runs every law once")
@pytest.mark.drawn(0.3, "telenano/laws/", "telenano/lockstep/")
@pytest.mark.usefixtures("plain_loop")
@pytest.mark.grid(law="virtual_impedance")
@pytest.mark.parametrize("law", TRIED_LAWS)
@pytest.mark.parametrize("start_m", [0.002, 0.008, 0.014])
def test_a_hand_that_is_beyond_the_surface_when_it_is_armed_gives_no_law_a_strike(law: str, start_m: float) -> None:
    settings = {"haptic_node.device.start_position_m": start_m}
    operator = {"kind": "force_profile", "points": [{"time_s": 0.0, "force_n": 0.0}, {"time_s": 9.0, "force_n": 0.0}]}
    session = telenano.simulate("fig12", law=law, settings=settings, operator=operator, duration_s=3.0)
    force_n = session["scaled_tip_force_n"]
    # in contact the offset stands, so that nothing presses harder than its threshold, with the step of the contact
    assert float(force_n.max()) < 0.2
    assert abs(float(session["base_position_m"][0])) <= 2e-9
    assert bool(session["hand_following"].all())
