"""The simulated hand across the sample: its motion, what it gives back, and its place in the settings."""

import math
from typing import Any

import pytest

from telenano.hand.lateral_hand import LateralHandState, lateral_hand_step
from telenano.laws.lateral import LateralFar, LateralHand, lateral_at_rest, lateral_master_step
from telenano.sections.hand_section import HapticConfig
from telenano.sections.lateral_hand_section import LateralHandConfig
from telenano.sections.lateral_section import LateralConfig
from telenano.settings.config import validate
from telenano.wire.errors import ConfigError

DT = 1e-3
NONE = (0.0, 0.0)


def config(**keys: Any) -> Any:
    return LateralHandConfig.model_validate(keys).to_params()


def test_it_follows_the_intended_path_of_the_session_and_stands_before_it() -> None:
    params = config(path=[{"time_s": 0.5}, {"time_s": 0.6, "x_m": 1e-2, "y_m": -5e-3}])
    state = LateralHandState()
    for _ in range(500):
        state = lateral_hand_step(params, state, NONE, NONE, -1.0, DT)
    assert state[:4] == (0.0, 0.0, 0.0, 0.0)
    for n in range(3000):
        state = lateral_hand_step(params, state, NONE, NONE, n * DT, DT)
    assert state[:2] == pytest.approx((1e-2, -5e-3), rel=1e-3)


def test_person_and_controller_pull_with_limited_forces_and_it_stops_at_its_reach() -> None:
    params, state = config(max_force_n=2.0, reach_m=5e-3), LateralHandState()
    state = lateral_hand_step(params, state, (9.0, 0.0), (-9.0, 1.0), 0.0, DT)
    assert (state.own_x_n, state.shown_x_n, state.shown_y_n, state.x_m) == (2.0, -2.0, 1.0, 0.0)
    for _ in range(2000):
        state = lateral_hand_step(params, state, (2.0, 0.0), NONE, 0.0, DT)
    assert (state.x_m, state.speed_x_m_per_s) == (5e-3, 0.0)


@pytest.mark.parametrize("pulls", [False, True], ids=["nobody holds it", "a person pulls now and then"])
def test_it_gives_back_no_more_than_it_was_given(pulls: bool) -> None:
    params, state, given = config(), LateralHandState(), 0.0
    for n in range(5000):
        shown = (2.0 * math.sin(0.01 * n), 1.5 * math.cos(0.02 * n))
        # the damping changes with each begin and end of a pull
        own = (3.0 * math.sin(0.03 * n), 1.0) if pulls and n % 70 < 30 else NONE
        after = lateral_hand_step(params, state, own, shown, 0.0, DT)
        given += (own[0] + shown[0]) * (after.x_m - state.x_m) + (own[1] + shown[1]) * (after.y_m - state.y_m)
        state = after
        assert given >= -1e-12


# of the page (web/src/spring.ts) and of the controller in mode rate, the defaults of `controller.lateral`
PAGE_N_PER_M, CENTRING_N_PER_M, DAMPER_N_S_PER_M = 200.0, 30.0, 2.0


def bears_s(damping: float, mass: float) -> float:
    """Return the lag of the page's spring from which on it drives stylus and controller into a swing [s]."""
    k, c, b = PAGE_N_PER_M, CENTRING_N_PER_M, damping + DAMPER_N_S_PER_M
    half = (0.5 * b * b - c * mass) / mass**2
    w = math.sqrt(math.sqrt(half**2 + (k * k - c * c) / mass**2) - half)
    return (math.pi - math.atan2(b * w, c - mass * w * w)) / w


def held_by_a_page(lag_s: float, **keys: Any) -> tuple[float, float]:
    """Let a late page hold the stylus 10 mm aside; return speed [m/s] and power into the controller [W] then."""
    params, state = config(**keys), LateralHandState()
    places, shown, power, speed = [0.0] * (round(lag_s / DT) + 1), 0.0, 0.0, 0.0
    for n in range(6000):
        pulled = min(max(PAGE_N_PER_M * (0.01 - places[-1 - round(lag_s / DT)]), -5.0), 5.0)
        after = lateral_hand_step(params, state, (pulled, 0.0), (shown, 0.0), 0.0, DT)
        if n >= 4000:
            power -= shown * (after.x_m - state.x_m) / 2.0
            speed = max(speed, abs(after.speed_x_m_per_s))
        state = after
        places.append(state.x_m)
        shown = -CENTRING_N_PER_M * state.x_m - DAMPER_N_S_PER_M * state.speed_x_m_per_s
    return speed, power


def test_the_spring_of_a_page_that_is_late_does_not_drive_the_stylus() -> None:
    usual = LateralHandConfig()
    most_s = bears_s(usual.damping_n_s_per_m, usual.mass_kg)
    assert most_s > 0.3
    for lag_s in (0.0, 0.05, 0.1, 0.2):
        speed, power = held_by_a_page(lag_s)
        assert speed < 1e-3 and abs(power) < 1e-4
    # The closed form is the edge.
    assert held_by_a_page(0.95 * most_s)[0] < held_by_a_page(1.05 * most_s)[0]


def test_a_light_damper_lets_the_page_put_a_watt_into_the_controller() -> None:
    assert bears_s(1.0, 0.1) == pytest.approx(0.016, abs=1e-3)
    speed, power = held_by_a_page(0.06, damping_n_s_per_m=1.0)
    # what the damper of the controller takes
    assert speed > 0.5 and 0.3 < power < 3.0


# of mode rate: what the displacement of the hand is to the tip [1/s], and the dead zone [m]
RATE, DEAD_M = LateralConfig().rate_per_s, LateralConfig().dead_zone_m


def let_go(**keys: Any) -> tuple[list[float], list[float]]:
    """Let a page hold the stylus aside in mode rate, and let go; return places and what the tip went since [m]."""
    params, state = config(**keys), LateralHandState()
    across, master = LateralConfig(mode="rate").to_params(), lateral_at_rest()
    places, ways = [], []
    for n in range(2500):
        pulled = (PAGE_N_PER_M * (0.01 - state.x_m), 0.0) if n < 1000 else NONE
        state = lateral_hand_step(params, state, pulled, master.force_n[:2], 0.0, DT)
        hand = LateralHand(state.x_m, state.y_m, 0.0, state.speed_x_m_per_s, state.speed_y_m_per_s, 0.0, True)
        master = lateral_master_step(across, master, hand, LateralFar(0.0, 0.0, 0.0, 0.0, True), DT)
        places.append(state.x_m)
        ways.append(master.travel.x_m)
    return places[999:], [way - ways[999] for way in ways[999:]]


def test_a_stylus_that_is_let_go_is_back_in_its_middle_soon_and_the_tip_stands() -> None:
    places, ways = let_go()
    w, begin = math.sqrt(CENTRING_N_PER_M / 0.1), places[0]
    assert begin == pytest.approx(PAGE_N_PER_M * 0.01 / (PAGE_N_PER_M + CENTRING_N_PER_M), rel=1e-2)
    for n, x in enumerate(places):
        # without an overshoot, and as the closed form has it
        assert x > -1e-6 and x == pytest.approx(begin * (1.0 + w * n * DT) * math.exp(-w * n * DT), abs=0.03 * begin)
    closed = [max(begin * (1.0 + w * n * DT) * math.exp(-w * n * DT) - DEAD_M, 0.0) for n in range(1000)]
    assert ways[-1] == pytest.approx(RATE * DT * sum(closed), rel=0.1) and ways[-1] < 35e-9
    # from 0.3 s on it stands
    assert set(ways[300:]) == {ways[-1]}


def test_a_stylus_that_keeps_the_damping_of_the_hand_goes_on_for_seconds() -> None:
    places, ways = let_go(free_damping_n_s_per_m=40.0)
    assert places[1000] > DEAD_M and ways[-1] > 1.5e-7


def test_a_path_that_goes_back_in_time_names_the_corner() -> None:
    with pytest.raises(ConfigError, match=r"lateral.path: time_s = 1.0 s of corner 1 must be later than 1.0 s"):
        validate(HapticConfig, {"lateral": {"path": [{"time_s": 1.0}, {"time_s": 1.0}]}}, "a test", "haptic_node")
