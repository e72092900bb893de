"""A simulated lateral hand, without a device of its own: a stylus in a plane, pulled by a person and the controller.

    m v' = F_operator + F_controller - b v,   per axis, by the implicit Euler method; the stylus stops at its reach

The person pulls with a spring k between the position of the stylus and the intended one, which comes from an intended
path here or from a page that sends `operator/force`. The stylus is passive: it returns no more energy than it received.

The spring of a page is late by T, because the page gets the position of the stylus 30 times a second. Together with
the centring spring k_c of the controller it oscillates where m s^2 + b s + k_c + k e^(-sT) = 0 has a root in the right
half plane, which begins at

    T = (pi - arg(k_c - m w^2 + i b w)) / w,  where w > 0 and |k_c - m w^2 + i b w| = k

With b = 40 N s/m that is 0.35 s, and with 1 N s/m only 16 ms: a page then drove the stylus from end to end, and 1 W
went into the damper of the controller (`controller.lateral.damping_n_s_per_m`).

That damping belongs to the hand that holds the stylus. A released stylus has its own, b_0. With the damper b_c of the
controller it returns to the middle by m s^2 + (b_0 + b_c) s + k_c = 0, fastest without overshoot at

    b_0 = 2 sqrt(k_c m) - b_c,   x = x_0 (1 + w t) e^(-w t),   w = sqrt(k_c / m)

which is 1.46 N s/m and 17 1/s: from 10 mm it is within the dead zone of 1 mm after 0.22 s, and the tip has moved 30 nm
by then. With 40 N s/m it would take 3.2 s and 200 nm. Damping is never negative, so changing it adds no energy.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from telenano.hand.operator import interpolate
from telenano.numerics.compiler import compiled

Array = NDArray[np.float64]


class LateralHandParams(NamedTuple):
    """Constants of the stylus, and the intended path of the person; its arrays are empty if there is none."""

    mass_kg: float
    damping_n_s_per_m: float
    free_damping_n_s_per_m: float
    reach_m: float
    max_force_n: float
    stiffness_n_per_m: float
    times_s: Array
    path_x_m: Array
    path_y_m: Array


class LateralHandState(NamedTuple):
    """Position [m] and velocity [m/s] of the stylus; forces of the person (own) and the controller (shown) [N]."""

    x_m: float = 0.0
    y_m: float = 0.0
    speed_x_m_per_s: float = 0.0
    speed_y_m_per_s: float = 0.0
    own_x_n: float = 0.0
    own_y_n: float = 0.0
    shown_x_n: float = 0.0
    shown_y_n: float = 0.0


@compiled
def _axis(params: LateralHandParams, x: float, v: float, force: float, b: float, dt: float) -> tuple[float, float]:
    v = (v + dt * force / params.mass_kg) / (1.0 + dt * b / params.mass_kg)
    x += dt * v
    if abs(x) > params.reach_m:
        return math.copysign(params.reach_m, x), 0.0
    return x, v


@compiled
def _limited(force_n: float, most_n: float) -> float:
    return min(max(force_n, -most_n), most_n)


@compiled
def lateral_hand_step(
    params: LateralHandParams,
    state: LateralHandState,
    pushed_n: tuple[float, float],
    shown_n: tuple[float, float],
    session_s: float,
    dt: float,
) -> LateralHandState:
    """Advance the stylus by dt [s], > 0; a force of exactly 0 on both axes means that nobody holds it at a page.

    Args:
        params: The constants.
        state: The state before the step.
        pushed_n: Force of a person at a page, x and y [N].
        shown_n: Force of the controller, x and y [N].
        session_s: Time of the operator's force profile [s], negative before it.
        dt: The time of the step [s].
    """
    own_x, own_y = pushed_n
    b = params.damping_n_s_per_m if own_x != 0.0 or own_y != 0.0 else params.free_damping_n_s_per_m
    if len(params.times_s) > 0 and session_s >= 0.0:
        k, b = params.stiffness_n_per_m, params.damping_n_s_per_m
        own_x += k * (interpolate(params.times_s, params.path_x_m, session_s, params.path_x_m[0]) - state.x_m)
        own_y += k * (interpolate(params.times_s, params.path_y_m, session_s, params.path_y_m[0]) - state.y_m)
    most = params.max_force_n
    own_x, own_y = _limited(own_x, most), _limited(own_y, most)
    shown_x, shown_y = _limited(shown_n[0], most), _limited(shown_n[1], most)
    x, v_x = _axis(params, state.x_m, state.speed_x_m_per_s, own_x + shown_x, b, dt)
    y, v_y = _axis(params, state.y_m, state.speed_y_m_per_s, own_y + shown_y, b, dt)
    return LateralHandState(x, y, v_x, v_y, own_x, own_y, shown_x, shown_y)
