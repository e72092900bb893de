"""The linear environment of the theory of delay, F = K (x_s - L), behind the safety chain of the AFM.

It has the interface of `services.afm_node.physics.step`: the same inputs and outputs, the same guard, and in place of
cantilever and sample a spring on the base itself. The distance reported is L - x_s.
"""

import math
from typing import NamedTuple

from services.afm_node.physics.step import AfmInputs, AfmOutputs, guarded
from services.afm_node.safety import SafetyParams, SafetyState, initial_safety_state
from services.numerics.compiled import compiled


class SpringParams(NamedTuple):
    """Limits, stiffness K [N/m], L [m]; `bilateral`: it also pulls, which is what makes it linear."""

    safety: SafetyParams
    stiffness_n_per_m: float
    rest_distance_m: float
    bilateral: bool


class SpringState(NamedTuple):
    """Safety chain and the force last measured [N]."""

    safety: SafetyState
    force_n: float


def spring_params(
    safety: SafetyParams, stiffness_n_per_m: float, rest_distance_m: float, bilateral: bool
) -> SpringParams:
    """Return the constants of the environment.

    Parameters: safety; stiffness_n_per_m, K [N/m], > 0; rest_distance_m, L [m]; bilateral.
    Raises: ValueError naming value and unit.
    """
    if not (math.isfinite(stiffness_n_per_m) and stiffness_n_per_m > 0.0):
        raise ValueError(f"stiffness of the environment K = {stiffness_n_per_m} N/m must be finite and > 0 N/m")
    if not math.isfinite(rest_distance_m):
        raise ValueError(f"rest distance L = {rest_distance_m} m must be finite")
    return SpringParams(safety, stiffness_n_per_m, rest_distance_m, bilateral)


@compiled
def spring_force(params: SpringParams, base_m: float) -> float:
    """Return the force [N] on the tip at base position x_s [m]: K (x_s - L), without the pull where it is one-sided."""
    force = params.stiffness_n_per_m * (base_m - params.rest_distance_m)
    return force if params.bilateral or force > 0.0 else 0.0


def initial_state(params: SpringParams) -> SpringState:
    """Return the state at the start: retracted, at the force there."""
    safety = initial_safety_state(params.safety)
    return SpringState(safety, spring_force(params, safety.base_m))


@compiled
def step(params: SpringParams, state: SpringState, inputs: AfmInputs, dt: float) -> tuple[SpringState, AfmOutputs]:
    """Advance guard and spring by dt [s]. Raises ValueError if dt is not positive and finite."""
    safety, allowed = guarded(params.safety, state.safety, inputs, state.force_n, dt)
    force = spring_force(params, allowed.base_m)
    outputs = AfmOutputs(
        allowed.base_m,
        params.rest_distance_m - allowed.base_m,
        0.0,
        force,
        0.0,
        force != 0.0,
        False,
        allowed.mode,
        allowed.limited,
        allowed.reason,
        allowed.arm_refusal,
    )
    return SpringState(safety, force), outputs
