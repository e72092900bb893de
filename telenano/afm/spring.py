"""The linear environment of the theory of delay, F = K (x_s - L): a part that replaces cantilever and sample.

The spring acts on the base itself, so there is no deflection. The distance reported is L - x_s.
"""

import math
from typing import NamedTuple

from telenano.afm.part import Part, register_part
from telenano.extend.samples import AfmSample, PlantInputs
from telenano.numerics.compiler import compiled


class SpringParams(NamedTuple):
    """Stiffness K [N/m], rest distance L [m]; `bilateral`: the spring also pulls, which makes it linear."""

    stiffness_n_per_m: float
    rest_distance_m: float
    bilateral: bool


class SpringState(NamedTuple):
    """The force last measured [N]; the step of a spring does not depend on it."""

    force_n: float


def spring_params(stiffness_n_per_m: float, rest_distance_m: float, bilateral: bool) -> SpringParams:
    """Return the constants of the environment.

    Args:
        stiffness_n_per_m: The stiffness K [N/m], > 0.
        rest_distance_m: The distance at rest, L [m].
        bilateral: Whether the spring also pulls, beyond the point of contact.

    Raises:
        ValueError: A value is impossible; the message names it and its unit.
    """
    if not (math.isfinite(stiffness_n_per_m) and stiffness_n_per_m > 0.0):
        raise ValueError(f"stiffness of the environment K = {stiffness_n_per_m} N/m must be finite and > 0 N/m")
    if not math.isfinite(rest_distance_m):
        raise ValueError(f"rest distance L = {rest_distance_m} m must be finite")
    return SpringParams(stiffness_n_per_m, rest_distance_m, bilateral)


@compiled
def spring_force(params: SpringParams, base_m: float) -> float:
    """Return the force [N] at base position x_s [m]: K (x_s - L), or 0 instead of a pull if it is not bilateral."""
    force = params.stiffness_n_per_m * (base_m - params.rest_distance_m)
    return force if params.bilateral or force > 0.0 else 0.0


@compiled
def step(params: SpringParams, state: SpringState, inputs: PlantInputs, dt: float) -> tuple[SpringState, AfmSample]:
    """Move the base and measure."""
    force = spring_force(params, inputs.base_m)
    return SpringState(force), AfmSample(
        base_m=inputs.base_m,
        deflection_m=0.0,
        force_n=force,
        bridge_voltage_v=0.0,
        distance_m=params.rest_distance_m - inputs.base_m,
        distance_valid=True,
        in_contact=force != 0.0,
        meniscus=False,
        lateral_x_n=0.0,
        lateral_y_n=0.0,
    )


def _start(params: SpringParams, inputs: PlantInputs) -> SpringState:
    return SpringState(spring_force(params, inputs.base_m))


register_part(SpringParams, Part(_start, step, lateral=False))
