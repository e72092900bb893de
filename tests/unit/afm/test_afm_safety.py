import math

import pytest

from telenano.afm import safety
from telenano.afm.safety import SafetyInputs, SafetyState, initial_safety_state, safety_step
from telenano.extend.instruments import SafetyParams

DT = 1e-3
PARAMS = SafetyParams(
    base_min_m=-200e-9,
    base_max_m=200e-9,
    base_speed_m_per_s=2e-6,
    resume_acceleration_m_per_s2=2e-6,
    retract_position_m=-100e-9,
    retract_speed_m_per_s=1e-6,
    force_limit_n=200e-9,
    command_deadline_s=0.050,
    hold_time_s=0.2,
)
FRESH = SafetyInputs(reference_m=0.0, command_age_s=0.0, action=0, arm_requested=False, estop=False, force_n=0.0)
FOLLOWING = SafetyState(safety.MODE_FOLLOW, 0.0, safety.REASON_ARMED)
HOLDING = SafetyState(safety.MODE_HOLD, 0.0, safety.REASON_COMMAND_DEADLINE)
HELD_BY_WISH = HOLDING._replace(reason=safety.REASON_HOLD_REQUESTED)
RETRACTED = initial_safety_state(PARAMS)
STOPPED = SafetyState(safety.MODE_ESTOP, PARAMS.retract_position_m, safety.REASON_ESTOP)
# armed, and without a command that it may follow
WISHED = SafetyState(safety.MODE_RETRACTED, PARAMS.retract_position_m, safety.REASON_ARMED)


def tick(state, dt=DT, **changes):
    return safety_step(PARAMS, state, FRESH._replace(**changes), dt)


def test_a_node_starts_retracted_and_stays_so_without_arming():
    state = RETRACTED
    assert (state.mode, state.base_m, state.reason) == (safety.MODE_RETRACTED, -100e-9, safety.REASON_START)
    for _ in range(10):
        state, outputs = tick(state, reference_m=50e-9)
    assert (outputs.mode, outputs.base_m, outputs.limited) == (safety.MODE_RETRACTED, -100e-9, 0)


@pytest.mark.parametrize(
    ("state", "changes", "mode", "reason"),
    [
        (FOLLOWING, {}, safety.MODE_FOLLOW, safety.REASON_ARMED),
        (FOLLOWING, {"command_age_s": 0.050}, safety.MODE_FOLLOW, safety.REASON_ARMED),
        (FOLLOWING, {"command_age_s": 0.0500001}, safety.MODE_HOLD, safety.REASON_COMMAND_DEADLINE),
        (FOLLOWING, {"command_age_s": 0.25}, safety.MODE_HOLD, safety.REASON_COMMAND_DEADLINE),
        (FOLLOWING, {"command_age_s": 0.2500001}, safety.MODE_RETRACTING, safety.REASON_HOLD_EXPIRED),
        (FOLLOWING, {"command_age_s": math.inf}, safety.MODE_RETRACTING, safety.REASON_HOLD_EXPIRED),
        (FOLLOWING, {"command_age_s": math.nan}, safety.MODE_RETRACTING, safety.REASON_HOLD_EXPIRED),
        (FOLLOWING, {"reference_m": math.nan}, safety.MODE_HOLD, safety.REASON_COMMAND_DEADLINE),
        (FOLLOWING, {"reference_m": math.inf}, safety.MODE_HOLD, safety.REASON_COMMAND_DEADLINE),
        (FOLLOWING, {"action": 1}, safety.MODE_HOLD, safety.REASON_HOLD_REQUESTED),
        (FOLLOWING, {"action": 2}, safety.MODE_RETRACTING, safety.REASON_RETRACT_REQUESTED),
        (FOLLOWING, {"action": 99}, safety.MODE_HOLD, safety.REASON_HOLD_REQUESTED),
        (FOLLOWING, {"action": 2, "command_age_s": 0.06}, safety.MODE_HOLD, safety.REASON_COMMAND_DEADLINE),
        (FOLLOWING, {"force_n": 200e-9}, safety.MODE_FOLLOW, safety.REASON_ARMED),
        (FOLLOWING, {"force_n": 200.0001e-9}, safety.MODE_RETRACTING, safety.REASON_FORCE_LIMIT),
        (FOLLOWING, {"force_n": -1e-6}, safety.MODE_FOLLOW, safety.REASON_ARMED),
        (FOLLOWING, {"force_n": math.nan}, safety.MODE_RETRACTING, safety.REASON_FORCE_INVALID),
        (FOLLOWING, {"force_n": -math.inf}, safety.MODE_RETRACTING, safety.REASON_FORCE_INVALID),
        (FOLLOWING, {"device_lost": True}, safety.MODE_RETRACTING, safety.REASON_DEVICE_LOST),
        (FOLLOWING, {"device_lost": True, "force_n": math.nan}, safety.MODE_RETRACTING, safety.REASON_DEVICE_LOST),
        (FOLLOWING, {"device_lost": True, "estop": True}, safety.MODE_ESTOP, safety.REASON_ESTOP),
        (FOLLOWING, {"estop": True}, safety.MODE_ESTOP, safety.REASON_ESTOP),
        (FOLLOWING, {"estop": True, "force_n": 1.0}, safety.MODE_ESTOP, safety.REASON_ESTOP),
        (HOLDING, {}, safety.MODE_FOLLOW, safety.REASON_COMMANDS_RESUMED),
        (HOLDING, {"command_age_s": 0.051}, safety.MODE_HOLD, safety.REASON_COMMAND_DEADLINE),
        (HOLDING, {"command_age_s": 0.2500001}, safety.MODE_RETRACTING, safety.REASON_HOLD_EXPIRED),
        (HOLDING, {"action": 1}, safety.MODE_HOLD, safety.REASON_COMMAND_DEADLINE),
        # a hold that was asked for keeps its reason when the commands stay away after it
        (HELD_BY_WISH, {"command_age_s": 0.051}, safety.MODE_HOLD, safety.REASON_HOLD_REQUESTED),
        (HOLDING, {"action": 2}, safety.MODE_RETRACTING, safety.REASON_RETRACT_REQUESTED),
        (HOLDING, {"device_lost": True}, safety.MODE_RETRACTING, safety.REASON_DEVICE_LOST),
        (HOLDING, {"force_n": 201e-9}, safety.MODE_RETRACTING, safety.REASON_FORCE_LIMIT),
        (HOLDING, {"estop": True}, safety.MODE_ESTOP, safety.REASON_ESTOP),
        (RETRACTED, {"arm_requested": True}, safety.MODE_FOLLOW, safety.REASON_ARMED),
        (RETRACTED, {"arm_requested": True, "device_lost": True}, safety.MODE_RETRACTED, safety.REASON_START),
        (RETRACTED, {"estop": True}, safety.MODE_ESTOP, safety.REASON_ESTOP),
        (RETRACTED, {"action": 2}, safety.MODE_RETRACTED, safety.REASON_START),
        (STOPPED, {}, safety.MODE_ESTOP, safety.REASON_ESTOP),
        (STOPPED, {"arm_requested": True}, safety.MODE_FOLLOW, safety.REASON_ARMED),
        (STOPPED, {"arm_requested": True, "command_age_s": 1.0}, safety.MODE_RETRACTED, safety.REASON_ARMED),
        (RETRACTED, {"arm_requested": True, "command_age_s": math.inf}, safety.MODE_RETRACTED, safety.REASON_ARMED),
        (RETRACTED, {"arm_requested": True, "action": 1}, safety.MODE_RETRACTED, safety.REASON_ARMED),
        (WISHED, {"command_age_s": 0.0500001}, safety.MODE_RETRACTED, safety.REASON_ARMED),
        (WISHED, {"command_age_s": math.nan}, safety.MODE_RETRACTED, safety.REASON_ARMED),
        (WISHED, {"reference_m": math.nan}, safety.MODE_RETRACTED, safety.REASON_ARMED),
        (WISHED, {"action": 1}, safety.MODE_RETRACTED, safety.REASON_ARMED),
        (WISHED, {"action": 99}, safety.MODE_RETRACTED, safety.REASON_ARMED),
        (WISHED, {}, safety.MODE_FOLLOW, safety.REASON_ARMED),
        (WISHED, {"action": 2}, safety.MODE_RETRACTED, safety.REASON_RETRACT_REQUESTED),
        (WISHED, {"device_lost": True}, safety.MODE_RETRACTED, safety.REASON_DEVICE_LOST),
        (WISHED, {"estop": True}, safety.MODE_ESTOP, safety.REASON_ESTOP),
    ],
)
def test_every_transition(state, changes, mode, reason):
    after, outputs = tick(state, **changes)
    assert (safety.MODE_NAMES[outputs.mode], safety.REASON_NAMES[outputs.reason]) == (
        safety.MODE_NAMES[mode],
        safety.REASON_NAMES[reason],
    )
    assert (after.mode, after.base_m, after.reason) == (outputs.mode, outputs.base_m, outputs.reason)


@pytest.mark.parametrize(
    ("state", "changes", "refusal"),
    [
        (RETRACTED, {}, safety.ARM_NOT_REFUSED),
        (RETRACTED, {"command_age_s": 0.050}, safety.ARM_NOT_REFUSED),
        (RETRACTED, {"command_age_s": 0.0500001}, safety.ARM_NOT_REFUSED),
        (RETRACTED, {"command_age_s": math.inf}, safety.ARM_NOT_REFUSED),
        (RETRACTED, {"reference_m": math.nan}, safety.ARM_NOT_REFUSED),
        (RETRACTED, {"action": 1}, safety.ARM_NOT_REFUSED),
        (RETRACTED, {"action": 2}, safety.ARM_NOT_REFUSED),
        (WISHED, {"command_age_s": math.inf}, safety.ARM_NOT_REFUSED),
        (RETRACTED, {"estop": True}, safety.ARM_REFUSED_ESTOP),
        (RETRACTED, {"device_lost": True}, safety.ARM_REFUSED_DEVICE_LOST),
        (STOPPED, {"device_lost": True}, safety.ARM_REFUSED_DEVICE_LOST),
        (FOLLOWING, {"device_lost": True}, safety.ARM_REFUSED_DEVICE_LOST),
        (STOPPED, {"estop": True}, safety.ARM_REFUSED_ESTOP),
        (STOPPED._replace(base_m=-99e-9), {}, safety.ARM_REFUSED_RETRACTING),
        (SafetyState(safety.MODE_RETRACTING, -50e-9, safety.REASON_FORCE_LIMIT), {}, safety.ARM_REFUSED_RETRACTING),
        (FOLLOWING, {}, safety.ARM_REFUSED_ALREADY_ARMED),
        (HOLDING, {}, safety.ARM_REFUSED_ALREADY_ARMED),
    ],
)
def test_arming_is_refused_with_a_reason(state, changes, refusal):
    after, outputs = tick(state, arm_requested=True, **changes)
    assert outputs.arm_refusal == refusal
    if refusal != safety.ARM_NOT_REFUSED:
        assert after.reason != safety.REASON_ARMED or state.reason == safety.REASON_ARMED
    assert tick(state, **changes)[1].arm_refusal == safety.ARM_NOT_REFUSED


def held(base_m=30e-9):
    state = FOLLOWING._replace(base_m=base_m)
    for _ in range(20):
        state, outputs = tick(state, reference_m=-50e-9, command_age_s=0.1)
    assert (outputs.mode, outputs.base_m) == (safety.MODE_HOLD, base_m)
    return state


def test_hold_keeps_the_base_and_resumes():
    _, outputs = tick(held(), reference_m=30.001e-9)
    assert (outputs.mode, outputs.base_m, outputs.limited) == (safety.MODE_FOLLOW, 30.001e-9, 0)


def test_after_a_hold_the_tip_does_not_jump_to_where_the_reference_went():
    state, moved = held(), []
    for _ in range(1100):
        state, outputs = tick(state, reference_m=150e-9)
        moved.append(outputs.base_m - 30e-9)
    # x = a t^2 / 2 in steps, where at full speed it would have been 40 nm
    assert moved[19] == pytest.approx(0.5 * 2e-6 * 0.020 * 0.021, rel=1e-9, abs=0.0)
    assert outputs.limited == 0
    assert state.base_m == 150e-9
    # by then a second is over, and the base has its speed again
    assert state.slower_m_per_s == 0.0
    assert tick(state, reference_m=0.0)[1].base_m == pytest.approx(148e-9, rel=1e-12, abs=0.0)


def test_arming_approaches_at_full_speed_also_after_a_hold():
    state, _ = tick(held(), command_age_s=1.0)
    while state.mode == safety.MODE_RETRACTING:
        state, _ = tick(state)
    assert tick(state, arm_requested=True)[1].base_m == pytest.approx(-98e-9, rel=1e-12, abs=0.0)


@pytest.mark.parametrize("cause", [{"force_n": 1e-6}, {"command_age_s": 1.0}, {"action": 2}])
def test_retracting_ends_latched_and_keeps_its_reason(cause):
    state, outputs = tick(FOLLOWING, **cause)
    reason, ticks = outputs.reason, 1
    while state.mode == safety.MODE_RETRACTING:
        before = state.base_m
        state, outputs = tick(state, reference_m=0.0)
        assert math.isclose(before - state.base_m, 1e-9, rel_tol=1e-6) or state.base_m == -100e-9
        ticks += 1
    assert abs(ticks - 100) <= 1
    assert (outputs.mode, outputs.base_m, outputs.reason) == (safety.MODE_RETRACTED, -100e-9, reason)
    # commands alone do not bring it back
    state, outputs = tick(state)
    assert (outputs.mode, outputs.base_m) == (safety.MODE_RETRACTED, -100e-9)


def test_estop_retracts_and_is_latched():
    state, _ = tick(FOLLOWING, estop=True)
    for _ in range(150):
        state, outputs = tick(state)
    assert (outputs.mode, outputs.base_m) == (safety.MODE_ESTOP, -100e-9)
    state, outputs = tick(state, arm_requested=True, reference_m=-99e-9)
    assert (outputs.mode, outputs.reason, outputs.base_m) == (safety.MODE_FOLLOW, safety.REASON_ARMED, -99e-9)


def test_retracting_never_moves_towards_the_sample():
    far = SafetyState(safety.MODE_FOLLOW, -150e-9, safety.REASON_ARMED)
    state, outputs = tick(far, action=2)
    assert (outputs.mode, outputs.base_m) == (safety.MODE_RETRACTED, -150e-9)
    assert tick(state, arm_requested=True, reference_m=-150e-9)[1].mode == safety.MODE_FOLLOW


@pytest.mark.parametrize(
    ("start", "reference", "base", "limited"),
    [
        (0.0, 2e-9, 2e-9, 0),
        (0.0, 2.0001e-9, 2e-9, safety.LIMITED_BY_SPEED),
        (0.0, -2.0001e-9, -2e-9, safety.LIMITED_BY_SPEED),
        (199.5e-9, 200e-9, 200e-9, 0),
        (199.5e-9, 200.0001e-9, 200e-9, safety.LIMITED_BY_RANGE),
        (-199.5e-9, -201e-9, -200e-9, safety.LIMITED_BY_RANGE),
        (0.0, 1.0, 2e-9, safety.LIMITED_BY_RANGE | safety.LIMITED_BY_SPEED),
    ],
)
def test_range_and_speed_limits(start, reference, base, limited):
    _, outputs = tick(FOLLOWING._replace(base_m=start), reference_m=reference)
    assert math.isclose(outputs.base_m, base, rel_tol=1e-12)
    assert outputs.limited == limited


@pytest.mark.parametrize("dt", [0.0, -1e-3, math.nan, math.inf])
def test_an_impossible_dt_is_refused(dt):
    with pytest.raises(ValueError, match="dt in s must be finite and > 0"):
        tick(FOLLOWING, dt=dt)


def test_every_code_has_a_name():
    tables = {
        "MODE_": safety.MODE_NAMES,
        "ACTION_": safety.ACTION_NAMES,
        "REASON_": safety.REASON_NAMES,
        "ARM_": safety.ARM_REFUSAL_NAMES,
    }
    for prefix, names in tables.items():
        codes = [value for name, value in vars(safety).items() if name.startswith(prefix) and isinstance(value, int)]
        assert sorted(codes) == sorted(names)
        assert len(set(names.values())) == len(names)


def test_a_lateral_force_above_its_limit_retracts_the_tip() -> None:
    params = PARAMS._replace(lateral_limit_n=50e-9)
    kept, _ = safety_step(params, FOLLOWING, FRESH._replace(lateral_n=50e-9), DT)
    gone, outputs = safety_step(params, FOLLOWING, FRESH._replace(lateral_n=50.1e-9), DT)
    assert kept.mode == safety.MODE_FOLLOW
    assert (gone.mode, safety.REASON_NAMES[outputs.reason]) == (safety.MODE_RETRACTING, "lateral_limit")
    assert tick(FOLLOWING, lateral_n=1.0)[0].mode == safety.MODE_FOLLOW


def test_a_tip_without_a_lateral_sensor_is_not_retracted_for_a_lateral_force() -> None:
    # the limit of 50 nN is set, and the device measures no force across the tip
    after, _ = safety_step(PARAMS._replace(lateral_limit_n=50e-9), FOLLOWING, FRESH, DT)
    assert after.mode == safety.MODE_FOLLOW


def test_the_base_neither_moves_nor_is_limited_while_it_is_held() -> None:
    state, outputs = tick(FOLLOWING, reference_m=150e-9, action=safety.ACTION_HOLD)
    assert (outputs.mode, outputs.base_m, outputs.limited) == (safety.MODE_HOLD, 0.0, 0)
    assert not safety.is_placed(outputs)
    assert safety.is_armed(state.mode, state.reason)


@pytest.mark.parametrize(
    ("mode", "reason", "armed", "wished"),
    [
        (safety.MODE_FOLLOW, safety.REASON_ARMED, True, False),
        (safety.MODE_FOLLOW, safety.REASON_COMMANDS_RESUMED, True, False),
        (safety.MODE_HOLD, safety.REASON_COMMAND_DEADLINE, True, False),
        (safety.MODE_RETRACTED, safety.REASON_ARMED, True, True),
        (safety.MODE_RETRACTED, safety.REASON_START, False, False),
        (safety.MODE_RETRACTED, safety.REASON_DEVICE_LOST, False, False),
        (safety.MODE_RETRACTING, safety.REASON_FORCE_LIMIT, False, False),
        (safety.MODE_RETRACTING, safety.REASON_ARMED, False, False),
        (safety.MODE_ESTOP, safety.REASON_ESTOP, False, False),
    ],
)
def test_a_tip_is_armed_while_it_follows_is_held_or_waits_for_a_command(
    mode: int, reason: int, armed: bool, wished: bool
) -> None:
    assert (safety.is_armed(mode, reason), safety.is_wished(mode, reason)) == (armed, wished)


@pytest.mark.parametrize(
    ("reference_m", "placed"),
    [
        (2e-9, True),
        # 2 nm in a tick is all that 2 um/s allow
        (2.0001e-9, False),
        (-2.0001e-9, False),
        # beyond the range and the speed: still on its way
        (1.0, False),
    ],
)
def test_the_base_is_placed_where_no_speed_limit_keeps_it_from_its_reference(reference_m: float, placed: bool) -> None:
    assert safety.is_placed(tick(FOLLOWING, reference_m=reference_m)[1]) is placed


def test_the_base_is_placed_at_the_end_of_its_range_where_the_reference_lies_beyond() -> None:
    _, outputs = tick(FOLLOWING._replace(base_m=199.5e-9), reference_m=250e-9)
    assert (outputs.limited, safety.is_placed(outputs)) == (safety.LIMITED_BY_RANGE, True)


@pytest.mark.parametrize(
    "state", [HOLDING, RETRACTED, WISHED, STOPPED, FOLLOWING._replace(mode=safety.MODE_RETRACTING)]
)
def test_a_base_that_follows_nothing_is_not_placed(state: SafetyState) -> None:
    outputs = safety.SafetyOutputs(state.base_m, state.mode, 0, state.reason, safety.ARM_NOT_REFUSED)
    assert not safety.is_placed(outputs)


@pytest.mark.parametrize(
    ("base_m", "reference_m", "way_m"),
    [
        (-100e-9, -20e-9, 80e-9),
        (50e-9, -100e-9, 150e-9),
        (-100e-9, -150e-9, 50e-9),
        (30e-9, 30e-9, 0.0),
        # the base goes no further than its range of 200 nm
        (100e-9, -1.0, 300e-9),
    ],
)
def test_placing_takes_the_way_to_the_reachable_reference_at_the_speed_of_the_base(
    base_m: float, reference_m: float, way_m: float
) -> None:
    assert safety.way_s(PARAMS, base_m, reference_m) == pytest.approx(way_m / 2e-6, rel=1e-12, abs=0.0)
    # after that time the base is there, to one tick
    state = SafetyState(safety.MODE_FOLLOW, base_m, safety.REASON_ARMED)
    ticks, (state, outputs) = 1, tick(state, reference_m=reference_m)
    while not safety.is_placed(outputs):
        ticks, (state, outputs) = ticks + 1, tick(state, reference_m=reference_m)
    assert ticks == pytest.approx(way_m / 2e-6 / DT, abs=1.0)
