"""A session begins with the tip where the hand is: placed at any speed, and let in where the hand is beyond."""

from typing import Any

import pytest
from law_loop import TRIED_LAWS

import telenano
from telenano.extend.laws import NO_TIP
from telenano.laws.entering import CLEARANCE_M, LET_IN_M_PER_S, Entry, entry_at_start, entry_step, shown_tip
from telenano.wire.errors import RigError

SPEED = "afm_node.safety.base_speed_m_per_s"
FIRST_S = 0.05


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
    settings: dict[str, Any] = {"afm_node.spring.bilateral": False, "afm_node.spring.rest_position_m": -15e-9}
    with pytest.raises(RigError, match=r"not placed within .* of arming: its guard has withdrawn it \(force_limit\)"):
        telenano.simulate("fig12", environment="spring", settings=settings, duration_s=FIRST_S)


@pytest.mark.check("runs every law once")
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


def test_an_offset_keeps_the_base_from_the_last_known_surface_and_is_let_in_while_nothing_presses() -> None:
    away = NO_TIP._replace(base_position_m=-100e-9)
    entry = entry_step(entry_at_start(), 12e-9, away, 1e8, 1e-3)
    assert entry.offset_m == 12e-9
    # a hand that is not beyond the rest point has none
    assert entry_step(entry, -3e-9, away, 1e8, 1e-3).offset_m == 0.0
    # a surface in front of the rest point is kept clear of
    met = Entry(0.0, -20e-9)
    assert entry_step(met, 0.0, away, 1e8, 1e-3).offset_m == pytest.approx(20e-9 + CLEARANCE_M, rel=1e-12, abs=0.0)
    follows = away._replace(base_position_m=0.0, following=True)
    let_in = entry_step(entry, 12e-9, shown_tip(entry, follows), 1e8, 0.1)
    assert let_in.offset_m == pytest.approx(12e-9 - 0.1 * LET_IN_M_PER_S, rel=1e-12, abs=0.0)
    for force_n, surface_m in ((1.1e-9, 0.0), (-1.1e-9, float("inf"))):
        pressed = shown_tip(entry, follows._replace(force_n=force_n))
        stands = entry_step(entry, 12e-9, pressed, 1e8, 0.1)
        assert (stands.offset_m, stands.surface_m) == (12e-9, surface_m)


def test_the_law_sees_the_base_where_it_would_be_without_the_offset() -> None:
    entry = Entry(5e-9, float("inf"))
    follows = NO_TIP._replace(base_position_m=1e-9, following=True)
    assert shown_tip(entry, follows).base_position_m == 6e-9
    assert shown_tip(entry, follows._replace(following=False)).base_position_m == 1e-9
