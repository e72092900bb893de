"""The simulated operator: a hand that follows a force profile, or an impedance moving along an intended path.

Force profile: F_m(t) piecewise linear through the given points, zero before the first, the last value held after.

Impedance: F_m = k (x_i - x_m) + b (v_i - v_m) - m a, the three in parallel between the intended path and the arm. The
arm's acceleration is never differentiated from its position: the mass m of the hand has a state of its own and is
attached to the arm through the finger pad (k_p, b_p), so a = a_m low-passed by (b_p s + k_p) / (m s^2 + b_p s + k_p);
below sqrt(k_p / m) it equals a_m. In discrete time, with the arm going from x0 to x1 in dt, everything is evaluated at
the middle of the step (mean positions, displacement over dt): the force times x1 - x0 is then exactly the energy that
the springs and the mass release, minus that of the dampers. The model is passive for all non-negative parameters and
every dt.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from telenano.extend.operators import OperatorInputs, OperatorOutputs
from telenano.numerics.compiler import compiled

FORCE_PROFILE = 0
IMPEDANCE = 1


class OperatorParams(NamedTuple):
    """Constants of the hand. values: forces [N] of a profile, or positions [m] of an intended path, at times_s."""

    kind: int
    times_s: NDArray[np.float64]
    values: NDArray[np.float64]
    stiffness_n_per_m: float = 0.0  # k
    damping_n_s_per_m: float = 0.0  # b
    mass_kg: float = 0.0  # m
    pad_stiffness_n_per_m: float = 0.0  # k_p
    pad_damping_n_s_per_m: float = 0.0  # b_p
    max_force_n: float = math.inf


class OperatorState(NamedTuple):
    """Position and velocity of the mass of the hand (used by the impedance operator only)."""

    hand_position_m: float
    hand_velocity_m_per_s: float


@compiled
def interpolate(times_s: NDArray[np.float64], values: NDArray[np.float64], time_s: float, before: float) -> float:
    """Return the piecewise-linear value at time_s: `before` ahead of the first point, the last value after the last.

    interpolate(np.array([0.0, 1.0]), np.array([0.0, 2.0]), 0.25, 0.0)    # 0.5

    Args:
        times_s: The times of the points [s], strictly increasing (checked where they are configured), shape (n,), n >=
            1.
        values: The values at the points, shape (n,).
        time_s: The time at which the value is wanted [s].
        before: The value ahead of the first point.
    """
    if time_s < times_s[0]:
        return before
    low, high = 0, len(times_s)
    while high - low > 1:
        middle = (low + high) // 2
        if times_s[middle] <= time_s:
            low = middle
        else:
            high = middle
    if high == len(times_s):
        return float(values[low])
    # Arithmetic with NumPy scalars takes three times as long as with plain numbers.
    begin_s, first = float(times_s[low]), float(values[low])
    share = (time_s - begin_s) / (float(times_s[high]) - begin_s)
    return first + share * (float(values[high]) - first)


@compiled
def _impedance_step(
    params: OperatorParams, state: OperatorState, inputs: OperatorInputs, dt: float
) -> tuple[OperatorState, float]:
    x0, x1 = inputs.start_position_m, inputs.end_position_m
    v = (x1 - x0) / dt
    first = params.values[0]
    path0 = interpolate(params.times_s, params.values, inputs.session_time_s - dt, first)
    path1 = interpolate(params.times_s, params.values, inputs.session_time_s, first)
    arm_force_n = params.stiffness_n_per_m * 0.5 * (path0 + path1 - x0 - x1)
    arm_force_n += params.damping_n_s_per_m * ((path1 - path0) / dt - v)
    # Midpoint rule for m v_h' = -F, F = k_p e + b_p w with e = x_h - x_m: solved for the mean rate w of e.
    m, kp, bp = params.mass_kg, params.pad_stiffness_n_per_m, params.pad_damping_n_s_per_m
    e = state.hand_position_m - x0
    w = (2.0 * m * (state.hand_velocity_m_per_s - v) - dt * kp * e) / (2.0 * m + dt * (0.5 * dt * kp + bp))
    pad = kp * (e + 0.5 * dt * w) + bp * w
    hand = OperatorState(state.hand_position_m + dt * (w + v), 2.0 * (w + v) - state.hand_velocity_m_per_s)
    return hand, arm_force_n + pad


@compiled
def step(
    params: OperatorParams, state: OperatorState, inputs: OperatorInputs, dt: float
) -> tuple[OperatorState, OperatorOutputs]:
    """Return the force of the hand over a period dt [s], > 0 (mean over it for an impedance, at its end for a profile).

    Before the session starts the force is zero, and the hand moves with the arm. A force beyond max_force_n is clipped
    to it and flagged; the impedance is passive as long as it is not clipped.
    """
    force = 0.0
    hand = OperatorState(inputs.end_position_m, (inputs.end_position_m - inputs.start_position_m) / dt)
    if inputs.session_time_s >= 0.0:
        if params.kind == IMPEDANCE:
            hand, force = _impedance_step(params, state, inputs, dt)
        else:
            force = interpolate(params.times_s, params.values, inputs.session_time_s, 0.0)
    if abs(force) > params.max_force_n:
        return hand, OperatorOutputs(math.copysign(params.max_force_n, force), True)
    return hand, OperatorOutputs(force, False)
