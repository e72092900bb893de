"""An environment with mass and damping: a body on a spring and a damper, touched one-sidedly through the cantilever.

    m y'' + b y' + K y = F,    F = k max(x_s - L - y, 0)

y is the displacement of the body from its place L [m], and k the stiffness of the cantilever. It is a part that
replaces cantilever and sample. Time is discrete as in the arm of `telenano.hand.operator`: every quantity is taken at
the middle of the step, and the force is the mean of the contact spring over its path, (V(z1) - V(z0)) / (z1 - z0).
Force times motion of the base is then exactly the energy that goes into springs, mass and damper: the body is passive
at every period. The body must swing more slowly than FASTEST_HZ in contact, so that the period of the instrument can
show its motion.
"""

import math
from typing import NamedTuple

from telenano.afm import Part, register_part
from telenano.extend.samples import AfmSample, PlantInputs
from telenano.numerics import compiled

FASTEST_HZ = 150.0
# The most passes for the fixed point of a step that makes or breaks contact; each pass leaves at most a quarter of the
# error.
_PASSES = 30


class BodyParams(NamedTuple):
    """K [N/m], b [N s/m], m [kg] of the body; k of the cantilever [N/m]; L [m]."""

    stiffness_n_per_m: float
    damping_n_s_per_m: float
    mass_kg: float
    cantilever_n_per_m: float
    rest_distance_m: float


class BodyState(NamedTuple):
    """Base x_s [m], displacement y of the body [m], its velocity y' [m/s]."""

    base_m: float
    pushed_m: float
    velocity_m_per_s: float


def body_params(
    stiffness_n_per_m: float,
    damping_n_s_per_m: float,
    mass_kg: float,
    cantilever_n_per_m: float,
    rest_distance_m: float,
) -> BodyParams:
    """Return the constants of the environment.

    Raises:
        ValueError: A value is impossible; the message names it and its unit.
    """
    stiffness = stiffness_n_per_m + cantilever_n_per_m
    least_kg = stiffness / (2.0 * math.pi * FASTEST_HZ) ** 2
    if not mass_kg >= least_kg:
        raise ValueError(
            f"mass of the body {mass_kg:g} kg: on {stiffness:g} N/m it must be at least {least_kg:.3g} kg, or the body"
            f" swings faster than {FASTEST_HZ:g} Hz"
        )
    if not damping_n_s_per_m >= 0.0:
        raise ValueError(f"damping of the body {damping_n_s_per_m} N s/m must be >= 0 N s/m")
    return BodyParams(stiffness_n_per_m, damping_n_s_per_m, mass_kg, cantilever_n_per_m, rest_distance_m)


@compiled
def pushed(
    params: BodyParams, base_m: tuple[float, float], y_m: float, v_m_per_s: float, dt: float
) -> tuple[float, float]:
    """Return y [m] and y' [m/s] after dt [s] in which the base moved from base_m[0] to base_m[1] [m]."""
    k, stiffness, damping = params.cantilever_n_per_m, params.stiffness_n_per_m, params.damping_n_s_per_m
    before = base_m[0] - params.rest_distance_m - y_m
    middle = 0.5 * (base_m[0] + base_m[1]) - params.rest_distance_m - y_m
    inertia = 2.0 * params.mass_kg / dt
    alone = inertia + damping + 0.5 * stiffness * dt
    driven = inertia * v_m_per_s - stiffness * y_m
    # The body is in contact throughout, or never.
    mean = (driven + k * middle) / (alone + 0.5 * k * dt) if before > 0.0 else driven / alone
    after = base_m[1] - params.rest_distance_m - y_m - dt * mean
    if (after > 0.0) != (before > 0.0):
        for _ in range(_PASSES):
            rise = after - before
            stored = 0.5 * k * (max(after, 0.0) ** 2 - max(before, 0.0) ** 2)
            force = stored / rise if rise != 0.0 else 0.0
            mean = (driven + force) / alone
            after = base_m[1] - params.rest_distance_m - y_m - dt * mean
    return y_m + dt * mean, 2.0 * mean - v_m_per_s


@compiled
def step(params: BodyParams, state: BodyState, inputs: PlantInputs, dt: float) -> tuple[BodyState, AfmSample]:
    """Advance cantilever and body by dt [s]; dt = 0 moves nothing and only measures the force."""
    base_m, y_m, velocity = inputs.base_m, state.pushed_m, state.velocity_m_per_s
    if dt > 0.0:
        y_m, velocity = pushed(params, (state.base_m, base_m), y_m, velocity, dt)
    gap_m = params.rest_distance_m + y_m - base_m
    force = params.cantilever_n_per_m * max(-gap_m, 0.0)
    return BodyState(base_m, y_m, velocity), AfmSample(
        base_m=base_m,
        deflection_m=max(-gap_m, 0.0),
        force_n=force,
        bridge_voltage_v=0.0,
        distance_m=max(gap_m, 0.0),
        distance_valid=True,
        in_contact=force > 0.0,
        meniscus=False,
        lateral_x_n=0.0,
        lateral_y_n=0.0,
    )


def _start(params: BodyParams, inputs: PlantInputs) -> BodyState:
    return BodyState(inputs.base_m, 0.0, 0.0)


register_part(BodyParams, Part(_start, step, lateral=False))
