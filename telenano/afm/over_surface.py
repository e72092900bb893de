"""A tip over a surface with heights and friction: a part around a cantilever, quasi-static or dynamic.

The tip is taken to be where the stage is, because friction holds it back by less than a pixel.
"""

from typing import Any, NamedTuple

from telenano.afm.contact.friction import FrictionParams, FrictionState, friction_step
from telenano.afm.part import Part, inputs_over, part_start, part_step, register_part
from telenano.afm.sample.surface import PLANE, Surface, height_over_middle
from telenano.extend.samples import AfmSample, PlantInputs
from telenano.numerics.compiler import compiled

# Without friction only the slopes of the surface make a lateral force.
_SMOOTH = FrictionParams(0.0, 0.0, 1.0, 1.0)


class OverSurfaceParams(NamedTuple):
    """The cantilever, the surface as its tip sees it, and the friction."""

    tip: Any
    surface: Surface
    friction: FrictionParams


class OverSurfaceState(NamedTuple):
    """State of the cantilever; place of the tip at the last step [m]; how far friction holds the tip back."""

    tip: Any
    x_m: float
    y_m: float
    held: FrictionState


def over_surface(tip: Any, surface: Surface | None, friction: FrictionParams | None) -> Any:
    """Return the parameters of the cantilever `tip` over a surface, None for a plane, with friction, None for none.

    Over a plane without friction these are the cantilever's own parameters.
    """
    if surface is None and (friction is None or friction.coefficient <= 0.0):
        return tip
    return OverSurfaceParams(tip, surface or PLANE, friction or _SMOOTH)


@compiled
def _step(
    params: OverSurfaceParams, state: OverSurfaceState, inputs: PlantInputs, dt: float
) -> tuple[OverSurfaceState, AfmSample]:
    height, slope_x, slope_y = height_over_middle(params.surface, inputs.x_m, inputs.y_m)
    tip, sample = part_step(params.tip, state.tip, inputs_over(inputs, height, 0.0), dt)
    held, force_x, force_y = friction_step(
        params.friction,
        state.held,
        inputs.x_m - state.x_m,
        inputs.y_m - state.y_m,
        sample.force_n,
        slope_x,
        slope_y,
        # A tapping tip loses contact in each period, so no friction builds up.
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
    height = height_over_middle(params.surface, inputs.x_m, inputs.y_m)[0]
    tip = part_start(params.tip, inputs_over(inputs, height, 0.0))
    return OverSurfaceState(tip, inputs.x_m, inputs.y_m, FrictionState(0.0, 0.0))


register_part(OverSurfaceParams, Part(_start, _step, within="tip"))
