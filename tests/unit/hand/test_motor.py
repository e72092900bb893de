"""The simulated motor against the poles, the analytic response and independent integrations."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from telenano.extend.hands import MODE_FORCE, MODE_OFF, MODE_POSITION
from telenano.hand import motor
from telenano.hand.motor import MotorInputs, MotorParams, MotorState
from telenano.sections.hand_section import DeviceConfig

PRESETS = ("paper_bandwidth", "paper_gain")
FREE = {
    "friction_torque_n_m": 0.0,
    "voltage_limit_v": math.inf,
    "torque_limit_n_m": math.inf,
    "position_min_m": -math.inf,
    "position_max_m": math.inf,
}


def device(preset="paper_bandwidth", **overrides) -> MotorParams:
    return DeviceConfig(preset=preset).to_params()._replace(**overrides)


def free(preset="paper_bandwidth", **overrides) -> MotorParams:
    return device(preset, **(FREE | overrides))


def friction_voltage(params):
    return params.friction_torque_n_m * params.armature_resistance_ohm * params.speed_gain_rad_per_s_v


def run(params, state, references, dt, mode=MODE_POSITION):
    states = [state]
    for reference in references:
        state, _ = motor.step(params, state, MotorInputs(mode, reference), dt)
        states.append(state)
    return np.array([s.position_m for s in states]), np.array([s.velocity_m_per_s for s in states])


def analytic_step(params, reference, t):
    """Partial fractions of M(s)/s, in complex numbers: shares no line with the code."""
    a2 = params.servo_gain_v_per_m * params.speed_gain_rad_per_s_v * params.screw_m_per_rad / params.time_constant_s
    p, q = np.roots([1.0, 1.0 / params.time_constant_s, a2])
    position = 1.0 + (q * np.exp(p * t) - p * np.exp(q * t)) / (p - q)
    velocity = p * q * (np.exp(p * t) - np.exp(q * t)) / (p - q)
    return reference * position.real, reference * velocity.real


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("dt", [1e-4, 2.5e-4, 1e-3, 7.3e-3, 0.1])
def test_step_response_is_the_analytic_one_for_any_period(preset, dt):
    params = free(preset)
    count = max(3, round(0.05 / dt))
    t = dt * np.arange(count + 1)
    x, v = run(params, MotorState(0.0, 0.0), [0.004] * count, dt)
    expected_x, expected_v = analytic_step(params, 0.004, t)
    np.testing.assert_allclose(x[1:], expected_x[1:], rtol=1e-11, atol=0.0)
    np.testing.assert_allclose(x, expected_x, rtol=0.0, atol=1e-12 * 0.004)
    largest = np.max(np.abs(analytic_step(params, 0.004, np.linspace(0.0, 0.02, 2001))[1]))
    np.testing.assert_allclose(v, expected_v, rtol=0.0, atol=1e-12 * largest)


def test_step_response_when_the_servo_rings_and_at_critical_damping():
    b = 1.0 / device().time_constant_s
    per_gain = device().speed_gain_rad_per_s_v * device().screw_m_per_rad * b
    for a2 in (16.0 * b * b, 0.25 * b * b * (1.0 + 1e-9), 0.25 * b * b * (1.0 - 1e-9)):
        params = free(servo_gain_v_per_m=a2 / per_gain)
        t = 2e-4 * np.arange(60)
        x, _ = run(params, MotorState(0.0, 0.0), [0.004] * 59, 2e-4)
        # The reference itself loses half its digits where its poles meet.
        accuracy = 1e-12 if a2 > b * b else 1e-7
        np.testing.assert_allclose(x, analytic_step(params, 0.004, t)[0], rtol=0.0, atol=0.004 * accuracy)


def test_stuck_shaft_moves_no_bit_and_sets_off_just_past_the_band():
    for preset in PRESETS:
        params = device(preset)
        edge = friction_voltage(params) / params.servo_gain_v_per_m
        for side in (1.0, -1.0):
            x, v = run(params, MotorState(0.001, 0.0), [0.001 + side * edge * (1.0 + 0.9e-6)] * 500, 1e-3)
            assert set(x) == {0.001} and set(v) == {0.0}
            x, v = run(params, MotorState(0.001, 0.0), [0.001 + side * edge * (1.0 + 3e-6)] * 2000, 1e-3)
            moved = side * (x[-1] - 0.001)
            assert moved == pytest.approx(3e-6 * edge, rel=0.35, abs=0.0)
            assert v[-1] == 0.0


def test_a_move_ends_at_the_edge_of_the_friction_band_without_chatter():
    for preset, duration in (("paper_bandwidth", 1.0), ("paper_gain", 8.0)):
        params = device(preset)
        edge = friction_voltage(params) / params.servo_gain_v_per_m
        x, v = run(params, MotorState(0.0, 0.0), [0.004] * round(duration / 1e-3), 1e-3)
        assert v[-1] == 0.0 and x[-1] == x[-2]
        assert x[-1] == pytest.approx(0.004 - edge, rel=1e-10, abs=0.0)
        assert np.all(v >= 0.0)


def test_friction_alone_is_exact_for_any_period():
    """Reversals are located in closed form, so cutting the same held references finer changes nothing."""
    for gain in (1.917e5, 3e6):
        params = free(servo_gain_v_per_m=gain, friction_torque_n_m=3.15e-3)
        references = 5e-5 * np.sin(2.0 * math.pi * 37.0 * 1e-3 * np.arange(200))
        x, v = run(params, MotorState(0.0, 0.0), references, 1e-3)
        fine, fine_v = run(params, MotorState(0.0, 0.0), np.repeat(references, 100), 1e-5)
        assert np.count_nonzero(np.diff(np.sign(v)) != 0) > 10
        np.testing.assert_allclose(x, fine[::100], rtol=0.0, atol=1e-10 * 5e-5)
        np.testing.assert_allclose(v, fine_v[::100], rtol=0.0, atol=1e-9 * np.max(np.abs(v)))


def limited_motion(t, y, params, reference, direction):
    """Equation of motion of one stroke, written from the paper's quantities rather than the code's."""
    x, v = y
    torque_constant = 1.0 / params.speed_gain_rad_per_s_v
    voltage = np.clip(params.servo_gain_v_per_m * (reference - x), -params.voltage_limit_v, params.voltage_limit_v)
    speed = v / params.screw_m_per_rad
    current = (voltage - torque_constant * speed) / params.armature_resistance_ohm
    torque = np.clip(torque_constant * current, -params.torque_limit_n_m, params.torque_limit_n_m)
    inertia = params.time_constant_s * torque_constant**2 / params.armature_resistance_ohm
    return [v, params.screw_m_per_rad * (torque - direction * params.friction_torque_n_m) / inertia]


@pytest.mark.parametrize("torque_limit_n_m", [0.05, math.inf])
def test_stroke_through_every_limit_agrees_with_an_independent_integration(torque_limit_n_m):
    params = device(torque_limit_n_m=torque_limit_n_m, voltage_limit_v=24.0)
    reference, duration = 0.002, 0.16
    scaled = solve_ivp(
        lambda t, y: np.array(limited_motion(t, y * 1e-3, params, reference, 1.0)) * 1e3,
        (0.0, duration),
        [0.0, 0.0],
        method="LSODA",
        rtol=1e-11,
        atol=1e-12,
        max_step=1e-4,
    )
    assert scaled.success
    x, v = run(params, MotorState(0.0, 0.0), [reference] * 1600, 1e-4)
    assert x[-1] == pytest.approx(scaled.y[0, -1] * 1e-3, rel=1e-7, abs=0.0)
    assert np.max(v) == pytest.approx(np.max(scaled.y[1]) * 1e-3, rel=1e-4, abs=0.0)


@pytest.mark.check("takes 1.6 s")
def test_limits_converge_with_second_order():
    params = device(voltage_limit_v=12.0)
    references = 0.002 * np.sin(2.0 * math.pi * 11.0 * 1e-3 * np.arange(300))

    def positions(divisions):
        x, _ = run(params, MotorState(0.0, 0.0), np.repeat(references, divisions), 1e-3 / divisions)
        return x[::divisions]

    reference = positions(256)
    errors = [np.max(np.abs(positions(n) - reference)) for n in (1, 4, 16, 64)]
    assert errors[0] < 2e-4 * 0.002
    # A quarter of the step leaves about a sixteenth; the moment within a step at which a limit acts is arbitrary.
    assert (errors[0] / errors[3]) > 64.0**1.7


def test_friction_and_winding_only_take_energy():
    """Kinetic plus servo energy falls by at least what friction takes, V_f |dx|, whatever happens in the step."""
    params = free(servo_gain_v_per_m=3e6, friction_torque_n_m=3.15e-3)
    a2, _ = params.closed_loop_coefficients()
    loss = a2 / params.servo_gain_v_per_m * friction_voltage(params)
    rng = np.random.default_rng(1)
    turned = 0
    for _ in range(300):
        state = MotorState(rng.uniform(-1e-5, 1e-5), rng.uniform(-0.01, 0.01))
        before = 0.5 * state.velocity_m_per_s**2 + 0.5 * a2 * state.position_m**2
        after, _ = motor.step(params, state, MotorInputs(MODE_POSITION, 0.0), 2e-4)
        energy = 0.5 * after.velocity_m_per_s**2 + 0.5 * a2 * after.position_m**2
        turned += state.velocity_m_per_s * after.velocity_m_per_s <= 0.0
        assert energy <= before - loss * abs(after.position_m - state.position_m) + 1e-12 * before
    assert turned > 20


@pytest.mark.parametrize("mode", [MODE_OFF, MODE_FORCE])
def test_without_position_mode_the_shaft_stops_when_the_closed_form_says(mode):
    params = device()
    v0, tm = 0.02, params.time_constant_s
    vf = friction_voltage(params) * params.speed_gain_rad_per_s_v * params.screw_m_per_rad
    stop_time = tm * math.log1p(v0 / vf)
    travel = tm * v0 - vf * stop_time
    x, v = run(params, MotorState(0.0, v0), [0.01] * 20, 1e-3, mode)
    assert x[-1] == pytest.approx(travel, rel=1e-12, abs=0.0)
    last_moving = math.floor(stop_time / 1e-3)
    assert np.all(v[: last_moving + 1] > 0.0) and np.all(v[last_moving + 1 :] == 0.0)
    assert np.all(np.diff(v) <= 0.0)


def test_off_sends_no_voltage_and_at_rest_no_force():
    _, out = motor.step(device(), MotorState(0.003, 0.0), MotorInputs(MODE_OFF, 0.01), 1e-3)
    assert out == motor.MotorOutputs(0.0, 0.0, False, False, False)


def test_voltage_limit_at_the_bound_and_just_past():
    params = device(servo_gain_v_per_m=1e4, voltage_limit_v=8.0, friction_torque_n_m=1.0, torque_limit_n_m=2.0)
    bound = 8.0 / 1e4
    _, at = motor.step(params, MotorState(0.0, 0.0), MotorInputs(MODE_POSITION, bound), 1e-3)
    _, past = motor.step(params, MotorState(0.0, 0.0), MotorInputs(MODE_POSITION, bound * (1.0 + 1e-9)), 1e-3)
    assert (at.voltage_v, at.voltage_limited) == (8.0, False)
    assert (past.voltage_v, past.voltage_limited) == (8.0, True)


def test_torque_limit_at_the_bound_and_just_past():
    """Friction above the limit keeps the shaft at rest, so the drive alone is seen."""
    params = device(torque_limit_n_m=0.05, friction_torque_n_m=1.0)
    bound = 0.05 * params.armature_resistance_ohm * params.speed_gain_rad_per_s_v / params.servo_gain_v_per_m
    for factor, limited in ((1.0 - 1e-9, False), (1.0 + 1e-9, True), (3.0, True)):
        _, out = motor.step(params, MotorState(0.0, 0.0), MotorInputs(MODE_POSITION, bound * factor), 1e-3)
        assert out.torque_limited is limited
        assert out.force_n == pytest.approx(0.05 / params.screw_m_per_rad, rel=2e-9, abs=0.0)
        assert out.voltage_v == pytest.approx(0.05 * 5.0 * 29.41, rel=2e-9, abs=0.0)


def test_torque_limit_bounds_the_acceleration():
    params = device(torque_limit_n_m=0.02)
    _, v = run(params, MotorState(0.0, 0.0), [0.01] * 10, 1e-4)
    inertia = params.time_constant_s / params.speed_gain_rad_per_s_v**2 / params.armature_resistance_ohm
    expected = params.screw_m_per_rad * (0.02 - 3.15e-3) / inertia
    np.testing.assert_allclose(np.diff(v) / 1e-4, expected, rtol=1e-10, atol=0.0)


def test_no_load_speed_is_never_exceeded_by_a_fast_motor():
    """Tm far below the period: a torque held too long would drive the motor past what its supply allows."""
    params = device(time_constant_s=1e-4, voltage_limit_v=2.0, torque_limit_n_m=0.0125, friction_torque_n_m=0.0)
    no_load = 2.0 * params.speed_gain_rad_per_s_v * params.screw_m_per_rad
    for dt in (1e-5, 1e-3, 5e-3):
        _, v = run(params, MotorState(-0.005, 0.0), [0.01] * round(0.05 / dt), dt)
        assert np.max(v) <= no_load * (1.0 + 1e-12)
        assert v[-1] == pytest.approx(no_load, rel=1e-6, abs=0.0)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_end_stop_clamps_takes_the_speed_and_lets_go_inwards(side):
    params = device()
    stop = params.position_max_m if side > 0 else params.position_min_m
    state = MotorState(stop - side * 1e-4, 0.0)
    for _ in range(100):
        state, out = motor.step(params, state, MotorInputs(MODE_POSITION, stop + side * 0.01), 1e-3)
    assert state == MotorState(stop, 0.0)
    assert out.end_stop
    state, out = motor.step(params, state, MotorInputs(MODE_POSITION, stop - side * 0.001), 1e-3)
    assert side * (stop - state.position_m) > 0.0
    assert not out.end_stop
