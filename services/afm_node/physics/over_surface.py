"""A tip over a surface with heights and friction: a part around a cantilever, quasi-static or dynamic.

The tip follows the stage: what friction holds it back moves it less than a pixel.
"""

from typing import Any, NamedTuple

import numpy as np

from services.afm_node.physics.contact.friction import FrictionParams, FrictionState, friction_step
from services.afm_node.physics.part import (
    AfmSample,
    Motion,
    Oscillation,
    Part,
    PlantInputs,
    motion_of,
    part_start,
    part_step,
    register,
)
from services.afm_node.physics.sample.surface import Surface, height_at
from services.numerics.compiled import compiled

# Only the slopes matter here.
_SMOOTH = FrictionParams(0.0, 0.0, 1.0, 1.0)
_PLANE = Surface(np.zeros((2, 2)), 1.0, 1.0)


class OverSurfaceParams(NamedTuple):
    """The cantilever, the surface as its tip sees it, and the friction."""

    tip: Any
    surface: Surface
    friction: FrictionParams


class OverSurfaceState(NamedTuple):
    """Of the cantilever; place at the last step [m]; how far friction holds the tip back."""

    tip: Any
    x_m: float
    y_m: float
    held: FrictionState


def over_surface(tip: Any, surface: Surface | None, friction: FrictionParams | None) -> Any:
    """Return the parameters of a cantilever over a surface, None for a plane; its own over a plane without friction."""
    if surface is None and (friction is None or friction.coefficient <= 0.0):
        return tip
    return OverSurfaceParams(tip, surface or _PLANE, friction or _SMOOTH)


@compiled
def _height(surface: Surface, x_m: float, y_m: float) -> tuple[float, float, float]:
    """Return height [m] and slopes at a place whose 0, 0 is the middle of the map."""
    rows, columns = surface.height_m.shape
    x, y = x_m + 0.5 * (surface.step_x_m * columns), y_m + 0.5 * (surface.step_y_m * rows)
    height, slope_x, slope_y = height_at(surface.height_m, surface.step_x_m, surface.step_y_m, x, y)
    return float(height), float(slope_x), float(slope_y)


@compiled
def _raised(surface: Surface, inputs: PlantInputs) -> PlantInputs:
    return PlantInputs(
        base_m=inputs.base_m,
        x_m=inputs.x_m,
        y_m=inputs.y_m,
        height_m=inputs.height_m + _height(surface, inputs.x_m, inputs.y_m)[0],
        voltage_v=inputs.voltage_v,
        amplitude_m=inputs.amplitude_m,
        temperature_k=inputs.temperature_k,
        seed=inputs.seed,
    )


@compiled
def _step(
    params: OverSurfaceParams, state: OverSurfaceState, inputs: PlantInputs, dt: float
) -> tuple[OverSurfaceState, AfmSample]:
    _, slope_x, slope_y = _height(params.surface, inputs.x_m, inputs.y_m)
    tip, sample = part_step(params.tip, state.tip, _raised(params.surface, inputs), dt)
    held, force_x, force_y = friction_step(
        params.friction,
        state.held,
        inputs.x_m - state.x_m,
        inputs.y_m - state.y_m,
        sample.force_n,
        slope_x,
        slope_y,
        # a tapping tip lets go in each period
        sample.in_contact and inputs.amplitude_m == 0.0,
    )
    return OverSurfaceState(tip, inputs.x_m, inputs.y_m, held), AfmSample(
        base_m=sample.base_m,
        deflection_m=sample.deflection_m,
        force_n=sample.force_n,
        bridge_voltage_v=sample.bridge_voltage_v,
        distance_m=sample.distance_m,
        distance_valid=sample.distance_valid,
        in_contact=sample.in_contact,
        meniscus=sample.meniscus,
        lateral_x_n=force_x,
        lateral_y_n=force_y,
    )


def _start(params: OverSurfaceParams, inputs: PlantInputs) -> OverSurfaceState:
    tip = part_start(params.tip, _raised(params.surface, inputs))
    return OverSurfaceState(tip, inputs.x_m, inputs.y_m, FrictionState(0.0, 0.0))


def _motion(params: OverSurfaceParams) -> Motion | None:
    of_tip = motion_of(params.tip)
    if of_tip is None:
        return None

    def settle(
        params: OverSurfaceParams, state: OverSurfaceState, inputs: PlantInputs
    ) -> tuple[OverSurfaceState, bool]:
        tip, goes_on = of_tip.settle(params.tip, state.tip, inputs)
        return state._replace(tip=tip), goes_on

    def oscillation(state: OverSurfaceState) -> Oscillation:
        return of_tip.oscillation(state.tip)

    return Motion(settle, oscillation)


register(OverSurfaceParams, Part(_start, _step, motion=_motion))
