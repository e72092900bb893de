"""The guard: every transition at its bound and just past it, which way it moves, what it names, and a lost device."""

import math

import pytest

from telenano.extend.hands import MODE_FORCE, MODE_NAMES, MODE_OFF, MODE_POSITION
from telenano.hand import safety
from telenano.hand.safety import SafetyInputs, SafetyParams, SafetyState

DT = 1.0 / 1024.0  # exact in binary, as are the limits below: the bound is the bound
PARAMS = SafetyParams(0.050, -0.25, 0.75, 0.5, 4.0, True, False)
FORCE_DEVICE = PARAMS._replace(has_position_mode=False, has_force_mode=True)
REACH = 0.5 * DT


def inputs(mode=MODE_POSITION, **changes) -> SafetyInputs:
    base = SafetyInputs(mode, 0.0, 0.0, 0.0, False, False, 0.0)
    return base._replace(**changes)


def guard(state=None, params=PARAMS, mode=MODE_POSITION, **changes):
    state = SafetyState(False, MODE_OFF, 0.0) if state is None else state
    return safety.step(params, state, inputs(mode, **changes), DT)


def test_deadline_at_the_bound_and_just_past():
    assert guard(command_age_s=0.050)[1].mode == MODE_POSITION
    for age in (math.nextafter(0.050, 1.0), 1.0, math.inf, math.nan):
        _, out = guard(command_age_s=age)
        assert (out.mode, out.reason) == (MODE_OFF, safety.REASON_COMMAND_STALE)
        assert out.force_reference_n == 0.0


def test_recovers_by_itself_from_the_present_position_without_a_jump():
    state, _ = guard(position_reference_m=REACH / 2, position_m=0.0)
    state, out = guard(state, position_reference_m=0.5, position_m=0.125, command_age_s=0.051)
    assert (out.mode, out.position_reference_m) == (MODE_OFF, 0.125)
    reference = 0.125
    for _ in range(10):
        state, out = guard(state, position_reference_m=0.5, position_m=0.125)
        assert (out.mode, out.reason) == (MODE_POSITION, safety.REASON_SPEED_LIMIT)
        assert out.position_reference_m == reference + REACH
        reference += REACH


def test_speed_limit_at_the_bound_and_just_past():
    for sign in (1.0, -1.0):
        _, at = guard(position_reference_m=sign * REACH)
        assert (at.position_reference_m, at.reason) == (sign * REACH, safety.REASON_NONE)
        _, past = guard(position_reference_m=sign * math.nextafter(REACH, 1.0))
        assert (past.position_reference_m, past.reason) == (sign * REACH, safety.REASON_SPEED_LIMIT)


def test_reference_moves_from_the_last_one_not_from_the_lagging_arm():
    state = SafetyState(False, MODE_POSITION, 0.25)
    _, out = guard(state, position_reference_m=0.25 + REACH, position_m=0.1)
    assert (out.position_reference_m, out.reason) == (0.25 + REACH, safety.REASON_NONE)


@pytest.mark.parametrize(("bound", "outwards"), [(0.75, math.inf), (-0.25, -math.inf)])
def test_travel_limit_at_the_bound_and_just_past(bound, outwards):
    state = SafetyState(False, MODE_POSITION, bound)
    _, at = guard(state, position_reference_m=bound)
    assert (at.position_reference_m, at.reason) == (bound, safety.REASON_NONE)
    _, past = guard(state, position_reference_m=math.nextafter(bound, outwards))
    assert (past.position_reference_m, past.reason) == (bound, safety.REASON_TRAVEL_LIMIT)


def test_estop_latches_until_armed_and_wins_over_arm():
    state, out = guard(estop=True)
    assert (out.mode, out.reason, out.estop_latched) == (MODE_OFF, safety.REASON_ESTOP, True)
    state, out = guard(state)
    assert (out.mode, out.estop_latched) == (MODE_OFF, True)
    state, out = guard(state, estop=True, arm_requested=True)
    assert (out.mode, out.estop_latched) == (MODE_OFF, True)
    state, out = guard(state, arm_requested=True, position_m=0.3, position_reference_m=0.3)
    assert (out.mode, out.reason, out.estop_latched) == (MODE_POSITION, safety.REASON_NONE, False)
    assert out.position_reference_m == 0.3


def test_estop_is_latched_while_commands_are_stale_too():
    state, _ = guard(estop=True, command_age_s=math.inf)
    assert state.estop_latched
    state, out = guard(state, arm_requested=True, command_age_s=math.inf)
    assert (out.mode, out.reason) == (MODE_OFF, safety.REASON_COMMAND_STALE)


def test_force_limit_at_the_bound_and_just_past():
    for sign in (1.0, -1.0):
        _, at = guard(mode=MODE_FORCE, params=FORCE_DEVICE, force_reference_n=sign * 4.0)
        assert (at.mode, at.force_reference_n, at.reason) == (MODE_FORCE, sign * 4.0, safety.REASON_NONE)
        _, past = guard(mode=MODE_FORCE, params=FORCE_DEVICE, force_reference_n=sign * math.nextafter(4.0, 5.0))
        assert (past.force_reference_n, past.reason) == (sign * 4.0, safety.REASON_FORCE_LIMIT)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_reference_that_is_no_number_turns_off(bad):
    _, out = guard(position_reference_m=bad, position_m=0.1)
    assert (out.mode, out.reason, out.position_reference_m) == (MODE_OFF, safety.REASON_REFERENCE_INVALID, 0.1)
    _, out = guard(mode=MODE_FORCE, params=FORCE_DEVICE, force_reference_n=bad)
    assert (out.mode, out.reason, out.force_reference_n) == (MODE_OFF, safety.REASON_REFERENCE_INVALID, 0.0)


def test_a_reference_that_the_mode_does_not_use_is_not_judged():
    assert guard(force_reference_n=math.nan)[1].reason == safety.REASON_NONE
    assert guard(mode=MODE_OFF, position_reference_m=math.nan)[1].reason == safety.REASON_NONE


@pytest.mark.parametrize("code", [-1, 3, 99])
def test_unknown_mode_turns_off(code):
    _, out = guard(mode=code)
    assert (out.mode, out.reason) == (MODE_OFF, safety.REASON_MODE_UNKNOWN)


@pytest.mark.parametrize(("start", "wanted", "way"), [(0.5, 0.25, -1.0), (-0.125, -0.0625, 1.0), (0.5, 0.7, 1.0)])
def test_a_limited_reference_goes_towards_the_command_on_either_side_of_the_origin(
    start: float, wanted: float, way: float
) -> None:
    state = SafetyState(False, MODE_POSITION, start)
    _, out = guard(state, position_reference_m=wanted, position_m=start)
    assert (out.position_reference_m, out.reason) == (start + way * REACH, safety.REASON_SPEED_LIMIT)


def test_a_command_beyond_the_travel_is_named_as_that_while_the_reference_is_on_its_way() -> None:
    _, out = guard(SafetyState(False, MODE_POSITION, 0.5), position_reference_m=2.0)
    assert (out.position_reference_m, out.reason) == (0.5 + REACH, safety.REASON_TRAVEL_LIMIT)


def test_a_lost_device_is_off_and_begins_where_it_is_when_it_comes_back() -> None:
    state, out = guard(SafetyState(False, MODE_POSITION, 0.5), position_reference_m=0.5, device_lost=True)
    assert (out.mode, out.reason) == (MODE_OFF, safety.REASON_DEVICE_LOST)
    _, out = guard(state, position_reference_m=0.5, position_m=0.25)
    assert (out.mode, out.position_reference_m) == (MODE_POSITION, 0.25 + REACH)


@pytest.mark.parametrize(
    ("mode", "changes", "reason"),
    [
        (MODE_POSITION, {"has_position_mode": False}, safety.REASON_MODE_REFUSED),
        (MODE_FORCE, {"has_force_mode": False}, safety.REASON_MODE_REFUSED),
        (MODE_OFF, {"has_position_mode": False}, safety.REASON_NONE),
    ],
)
def test_a_mode_that_the_device_lacks_is_off_with_its_reason(mode: int, changes: dict[str, bool], reason: int) -> None:
    state, out = guard(SafetyState(False, MODE_OFF, 0.0), PARAMS._replace(**changes), mode)
    assert (state.mode, out.mode, out.reason) == (MODE_OFF, MODE_OFF, reason)


def test_an_emergency_stop_comes_before_every_other_reason() -> None:
    state, out = guard(SafetyState(False, MODE_OFF, 0.0), estop=True, device_lost=True, command_age_s=math.inf)
    assert (out.reason, out.estop_latched, state.estop_latched) == (safety.REASON_ESTOP, True, True)
    _, out = guard(SafetyState(True, MODE_OFF, 0.0))
    assert out.reason == safety.REASON_ESTOP
    _, out = guard(SafetyState(True, MODE_OFF, 0.0), arm_requested=True)
    assert (out.mode, out.estop_latched) == (MODE_POSITION, False)


def test_device_that_waits_is_off_where_the_arm_is_and_begins_there() -> None:
    state, out = guard(SafetyState(False, MODE_POSITION, 0.5), position_reference_m=0.5, device_waits=True)
    assert (out.mode, out.reason, state.mode) == (MODE_OFF, safety.REASON_DEVICE_WAITS, MODE_OFF)
    lost = guard(SafetyState(False, MODE_OFF, 0.0), device_lost=True, device_waits=True)[1]
    stopped = guard(SafetyState(False, MODE_OFF, 0.0), estop=True, device_waits=True, command_age_s=math.inf)[1]
    stale = guard(SafetyState(False, MODE_OFF, 0.0), device_waits=True, command_age_s=math.inf)[1]
    assert [found.reason for found in (lost, stopped, stale)] == [
        safety.REASON_DEVICE_LOST,
        safety.REASON_ESTOP,
        safety.REASON_DEVICE_WAITS,
    ]


def test_every_code_has_its_words():
    codes = {value for name, value in vars(safety).items() if name.startswith("REASON_")}
    assert codes == set(safety.REASONS)
    modes = {value for name, value in vars(safety).items() if name.startswith("MODE_") and isinstance(value, int)}
    assert modes == set(MODE_NAMES)


def test_a_hand_is_armed_by_a_person_and_by_nothing_else() -> None:
    state = SafetyState(False, MODE_OFF, 0.0)
    for _ in range(3):
        # commands drive the motor of a hand that was never armed, and no tip follows it
        state, out = guard(state)
        assert (out.mode, out.armed, state.armed) == (MODE_POSITION, False, False)
    state, out = guard(state, arm_requested=True)
    assert (out.armed, state.armed) == (True, True)
    for _ in range(3):
        state, out = guard(state)
        assert (out.armed, state.armed) == (True, True)


def test_an_emergency_stop_disarms_the_hand_until_a_person_arms_it_again() -> None:
    armed = SafetyState(False, MODE_POSITION, 0.0, armed=True)
    state, out = guard(armed, estop=True)
    assert (out.armed, state.armed) == (False, False)
    # the stop wins over a request to arm in the same step
    state, out = guard(armed, estop=True, arm_requested=True)
    assert (out.estop_latched, out.armed, state.armed) == (True, False, False)
    for _ in range(3):
        state, out = guard(state)
        assert (out.estop_latched, out.armed, state.armed) == (True, False, False)
    state, out = guard(state, arm_requested=True)
    assert (out.estop_latched, out.armed, state.armed) == (False, True, True)


@pytest.mark.parametrize("was_armed", [True, False])
def test_no_tip_follows_a_lost_hand_and_an_armed_one_is_followed_when_it_is_back(was_armed: bool) -> None:
    state, out = guard(SafetyState(False, MODE_POSITION, 0.0, armed=was_armed), device_lost=True)
    assert (out.armed, state.armed) == (False, was_armed)
    _, out = guard(state)
    assert out.armed is was_armed


def test_a_hand_that_waits_or_has_no_fresh_command_stays_armed() -> None:
    armed = SafetyState(False, MODE_POSITION, 0.0, armed=True)
    for changes in ({"device_waits": True}, {"command_age_s": 1.0}, {"position_reference_m": math.nan}):
        state, out = guard(armed, **changes)
        assert (out.mode, out.armed, state.armed) == (MODE_OFF, True, True)
