"""The guard of the hand away from its origin: which way it moves, what it names, and a device that is lost."""

import math

import pytest

from services.haptic_node import safety
from services.haptic_node.safety import MODE_FORCE, MODE_OFF, MODE_POSITION, SafetyInputs, SafetyParams, SafetyState

DT = 1.0 / 1024.0
PARAMS = SafetyParams(0.050, -0.25, 0.75, 0.5, 4.0, True, False)
REACH = 0.5 * DT


def guarded(state: SafetyState, params: SafetyParams = PARAMS, **changes: object) -> tuple[SafetyState, object]:
    inputs = SafetyInputs(MODE_POSITION, 0.0, 0.0, 0.0, False, False, 0.0)._replace(**changes)
    return safety.step(params, state, inputs, DT)


@pytest.mark.parametrize(("start", "wanted", "way"), [(0.5, 0.25, -1.0), (-0.125, -0.0625, 1.0), (0.5, 0.7, 1.0)])
def test_a_limited_reference_goes_towards_the_command_on_either_side_of_the_origin(
    start: float, wanted: float, way: float
) -> None:
    state = SafetyState(False, MODE_POSITION, start)
    _, out = guarded(state, position_reference_m=wanted, position_m=start)
    assert (out.position_reference_m, out.reason) == (start + way * REACH, safety.REASON_SPEED_LIMIT)


def test_a_command_beyond_the_travel_is_named_as_that_while_the_reference_is_on_its_way() -> None:
    _, out = guarded(SafetyState(False, MODE_POSITION, 0.5), position_reference_m=2.0)
    assert (out.position_reference_m, out.reason) == (0.5 + REACH, safety.REASON_TRAVEL_LIMIT)


def test_a_lost_device_is_off_and_begins_where_it_is_when_it_comes_back() -> None:
    state, out = guarded(SafetyState(False, MODE_POSITION, 0.5), position_reference_m=0.5, device_lost=True)
    assert (out.mode, out.reason) == (MODE_OFF, safety.REASON_DEVICE_LOST)
    _, out = guarded(state, position_reference_m=0.5, position_m=0.25)
    assert (out.mode, out.position_reference_m) == (MODE_POSITION, 0.25 + REACH)


@pytest.mark.parametrize(
    ("mode", "changes", "reason"),
    [
        (MODE_POSITION, {"has_position_mode": False}, safety.REASON_MODE_REFUSED),
        (MODE_FORCE, {"has_force_mode": False}, safety.REASON_MODE_REFUSED),
        (MODE_OFF, {"has_position_mode": False}, safety.REASON_NONE),
        (3, {}, safety.REASON_MODE_UNKNOWN),
    ],
)
def test_a_mode_that_the_device_lacks_is_off_with_its_reason(mode: int, changes: dict[str, bool], reason: int) -> None:
    state, out = guarded(SafetyState(False, MODE_OFF, 0.0), PARAMS._replace(**changes), command_mode=mode)
    assert (state.mode, out.mode, out.reason) == (MODE_OFF, MODE_OFF, reason)


def test_an_emergency_stop_comes_before_every_other_reason() -> None:
    state, out = guarded(SafetyState(False, MODE_OFF, 0.0), estop=True, device_lost=True, command_age_s=math.inf)
    assert (out.reason, out.estop_latched, state.estop_latched) == (safety.REASON_ESTOP, True, True)
    _, out = guarded(SafetyState(True, MODE_OFF, 0.0))
    assert out.reason == safety.REASON_ESTOP
    _, out = guarded(SafetyState(True, MODE_OFF, 0.0), arm_requested=True)
    assert (out.mode, out.estop_latched) == (MODE_POSITION, False)


def test_a_force_is_held_at_its_limit_either_way_and_given_as_it_came_within() -> None:
    device = PARAMS._replace(has_force_mode=True)
    for wanted, given, reason in (
        (5.0, 4.0, safety.REASON_FORCE_LIMIT),
        (-5.0, -4.0, safety.REASON_FORCE_LIMIT),
        (4.0, 4.0, safety.REASON_NONE),
        (-1.5, -1.5, safety.REASON_NONE),
    ):
        _, out = guarded(SafetyState(False, MODE_FORCE, 0.0), device, command_mode=MODE_FORCE, force_reference_n=wanted)
        assert (out.force_reference_n, out.reason) == (given, reason)


def test_device_that_waits_is_off_where_the_arm_is_and_begins_there() -> None:
    state, out = guarded(SafetyState(False, MODE_POSITION, 0.5), position_reference_m=0.5, device_waits=True)
    assert (out.mode, out.reason, state.mode) == (MODE_OFF, safety.REASON_DEVICE_WAITS, MODE_OFF)
    lost = guarded(SafetyState(False, MODE_OFF, 0.0), device_lost=True, device_waits=True)[1]
    stopped = guarded(SafetyState(False, MODE_OFF, 0.0), estop=True, device_waits=True, command_age_s=math.inf)[1]
    stale = guarded(SafetyState(False, MODE_OFF, 0.0), device_waits=True, command_age_s=math.inf)[1]
    assert [found.reason for found in (lost, stopped, stale)] == [
        safety.REASON_DEVICE_LOST,
        safety.REASON_ESTOP,
        safety.REASON_DEVICE_WAITS,
    ]
