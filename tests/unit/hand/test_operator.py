"""The simulated hand: profile, impedance, passivity."""

import itertools
import math

import numpy as np
import pytest

from telenano.extend.operators import OperatorInputs, OperatorOutputs
from telenano.hand import operator
from telenano.hand.operator import OperatorState
from telenano.sections.operator_section import ForceProfileConfig, ImpedanceConfig, PathPoint

REST = OperatorState(0.0, 0.0)
FIG12 = ForceProfileConfig(kind="force_profile").to_params()


def impedance(points=((0.0, 0.0),), **overrides):
    path = tuple(PathPoint(time_s=t, position_m=x) for t, x in points)
    return ImpedanceConfig(kind="impedance", path=path).to_params()._replace(**overrides)


def force_at(params, time_s):
    return operator.step(params, REST, OperatorInputs(time_s, 0.0, 0.0), 1e-3)[1].force_n


def follow(params, positions, dt, state=None, start_s=1.0):
    """Move the arm through positions; gives forces (mean over each step) and the last state."""
    state = OperatorState(positions[0], 0.0) if state is None else state
    forces = []
    for index in range(len(positions) - 1):
        inputs = OperatorInputs(start_s + (index + 1) * dt, positions[index], positions[index + 1])
        state, out = operator.step(params, state, inputs, dt)
        forces.append(out.force_n)
    return np.array(forces), state


def test_fig12_profile_at_its_corners_and_between():
    before = ((0.0, 0.0), (0.8, 0.0), (1.0, 0.5), (1.2, 1.0), (2.0, 1.0), (2.6, 1.0), (2.75, 1.5), (2.9, 2.0))
    for time_s, force_n in (*before, (4.5, 2.0), (4.55, 1.0), (4.6, 0.0), (8.0, 0.0)):
        assert force_at(FIG12, time_s) == pytest.approx(force_n, rel=1e-12, abs=1e-13)


def test_profile_agrees_with_numpy_everywhere():
    times = np.linspace(-0.5, 6.0, 4001)
    expected = np.where(times < 0.8, 0.0, np.interp(times, FIG12.times_s, FIG12.values))
    np.testing.assert_allclose([force_at(FIG12, t) for t in times], expected, rtol=1e-12, atol=1e-13)


def test_zero_before_the_first_point_and_last_value_held():
    params = FIG12._replace(times_s=np.array([1.0, 2.0]), values=np.array([3.0, 5.0]))
    assert force_at(params, 1.0 - 1e-9) == 0.0
    assert force_at(params, 1.0) == 3.0
    assert force_at(params, 2.0) == force_at(params, 100.0) == 5.0
    single = FIG12._replace(times_s=np.array([1.0]), values=np.array([4.0]))
    assert (force_at(single, 0.999), force_at(single, 1.0), force_at(single, 9.0)) == (0.0, 4.0, 4.0)


@pytest.mark.parametrize("params", [FIG12, impedance(((0.0, 0.01),))])
def test_no_force_before_the_session_starts_and_the_hand_goes_along(params):
    state, out = operator.step(params, REST, OperatorInputs(-1.0, 0.001, 0.002), 1e-3)
    assert out == OperatorOutputs(0.0, False)
    assert state == OperatorState(0.002, (0.002 - 0.001) / 1e-3)


def test_force_limit_at_the_bound_and_just_past():
    for sign in (1.0, -1.0):
        for peak, limited in ((3.0, False), (3.0 * (1.0 + 1e-12), True)):
            params = FIG12._replace(times_s=np.array([0.0]), values=np.array([sign * peak]), max_force_n=3.0)
            assert operator.step(params, REST, OperatorInputs(1.0, 0.0, 0.0), 1e-3)[1] == (sign * 3.0, limited)


def test_steady_impedance_force_is_the_spring():
    params = impedance(((0.0, 0.0), (0.5, 0.006)), stiffness_n_per_m=450.0)
    forces, _ = follow(params, np.full(3000, 0.002), 1e-3)
    assert forces[-1] == pytest.approx(450.0 * (0.006 - 0.002), rel=1e-12, abs=0.0)


def test_damper_sees_the_difference_of_speeds():
    params = impedance(((0.0, 0.0), (10.0, 0.05)), stiffness_n_per_m=0.0)
    arm = 0.002 * 1e-3 * np.arange(4001)
    forces, _ = follow(params, arm, 1e-3)
    assert forces[-1] == pytest.approx(5.0 * (0.005 - 0.002), rel=1e-9, abs=0.0)


def test_mass_resists_a_slow_acceleration():
    params = impedance(stiffness_n_per_m=0.0, damping_n_s_per_m=0.0, mass_kg=0.2)
    acceleration, dt = 0.05, 1e-3
    arm = 0.5 * acceleration * (dt * np.arange(1001)) ** 2
    forces, _ = follow(params, arm, dt)
    assert forces[-1] == pytest.approx(-0.2 * acceleration, rel=1e-9, abs=0.0)


def test_no_mass_means_no_pad_force():
    params = impedance(stiffness_n_per_m=0.0, damping_n_s_per_m=0.0, mass_kg=0.0)
    forces, _ = follow(params, 1e-3 * np.sin(0.1 * np.arange(200)), 1e-3)
    np.testing.assert_allclose(forces, 0.0, atol=1e-12)


def test_sinusoid_agrees_with_the_transfer_function():
    """F/x_m = -(k + b s + m s^2 (b_p s + k_p) / (m s^2 + b_p s + k_p)) at 5 Hz, sampled at 20 kHz."""
    params = impedance()
    dt, w = 5e-5, 2.0 * math.pi * 5.0
    t = dt * np.arange(40_001)
    forces, _ = follow(params, 1e-3 * np.cos(w * t), dt)
    middle = t[:-1] + 0.5 * dt
    last = middle > 1.0
    measured = 2.0 * np.mean(forces[last] * np.exp(-1j * w * middle[last])) / 1e-3
    s = 1j * w
    m, kp, bp = params.mass_kg, params.pad_stiffness_n_per_m, params.pad_damping_n_s_per_m
    expected = -(300.0 + 5.0 * s + m * s * s * (bp * s + kp) / (m * s * s + bp * s + kp))
    assert abs(measured - expected) < 1e-5 * abs(expected)


@pytest.mark.parametrize("dt", [1e-5, 1e-3, 0.1])
def test_hand_is_passive_for_any_parameters_and_period(dt):
    """Work at the arm equals what springs and mass gave up less what the dampers took, step by step."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        k, b, m, kp, bp = 10.0 ** rng.uniform((0, -2, -2, 2, -1), (4, 2, 1, 6, 2))
        params = impedance(
            stiffness_n_per_m=k, damping_n_s_per_m=b, mass_kg=m, pad_stiffness_n_per_m=kp, pad_damping_n_s_per_m=bp,
            max_force_n=math.inf,
        )  # fmt: skip
        arm = 0.002 + np.cumsum(rng.normal(0.0, 1e-4, 100))
        state = OperatorState(arm[0] + 1e-3, 0.02)

        def stored(x, hand, k=k, m=m, kp=kp):
            return 0.5 * k * x**2 + 0.5 * m * hand.hand_velocity_m_per_s**2 + 0.5 * kp * (hand.hand_position_m - x) ** 2

        for x0, x1 in itertools.pairwise(arm):
            after, out = operator.step(params, state, OperatorInputs(1.0, x0, x1), dt)
            work = out.force_n * (x1 - x0)
            pad_rate = (after.hand_position_m - state.hand_position_m - (x1 - x0)) / dt
            lost = dt * (b * ((x1 - x0) / dt) ** 2 + bp * pad_rate**2)
            given = stored(x0, state) - stored(x1, after)
            scale = stored(x0, state) + stored(x1, after) + lost + abs(work)
            assert abs(work - (given - lost)) < 1e-10 * scale
            assert lost >= 0.0
            state = after


def test_encoder_sized_jitter_is_not_amplified_by_the_mass():
    """A 10 nm jitter differentiated twice at 1 kHz would be 0.2 kg * 10 nm / (1 ms)^2 = 2 mN; the pad takes it."""
    rng = np.random.default_rng(3)
    params = impedance(stiffness_n_per_m=0.0, damping_n_s_per_m=0.0, mass_kg=0.2)
    forces, _ = follow(params, rng.choice([0.0, 1e-8], 5000), 1e-3)
    twice = 0.2 * np.std(np.diff(rng.choice([0.0, 1e-8], 5000), 2)) / 1e-6
    assert np.std(forces[100:]) < 0.1 * twice
