"""The simulated hand across the sample: its motion, what it gives back, and its place in the settings."""

import math
from typing import Any

import pytest

from proto.errors import ConfigError
from services.haptic_node.config import HapticConfig
from services.haptic_node.physics.lateral_hand import LateralHandConfig, LateralHandState, lateral_hand_step
from services.runtime.settings.config import validate

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


def test_it_gives_back_no_more_than_it_was_given() -> None:
    params, state, given = config(), LateralHandState(), 0.0
    for n in range(5000):
        shown = (2.0 * math.sin(0.01 * n), 1.5 * math.cos(0.02 * n))
        after = lateral_hand_step(params, state, NONE, shown, 0.0, DT)
        given += shown[0] * (after.x_m - state.x_m) + shown[1] * (after.y_m - state.y_m)
        state = after
        assert given >= -1e-12


def test_a_path_that_goes_back_in_time_names_the_corner() -> None:
    with pytest.raises(ConfigError, match=r"path.1.time_s = 1.0 s must be later than 1.0 s"):
        validate(HapticConfig, {"lateral": {"path": [{"time_s": 1.0}, {"time_s": 1.0}]}}, "a test", "haptic_node")
