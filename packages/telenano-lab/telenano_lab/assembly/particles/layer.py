"""A layer of particles on a surface, as a part of the instrument that wraps the part which models tip and surface.

The wrapped part knows nothing of particles. Where particles hold the tip up, the layer raises the surface under it.
Where the tip pushes them from the side, their upward force F acts like a base that is further away by F / k, because
the spring is linear; the layer adds it to the reading. The wrapped part models the friction of the tip on the surface.
A vibrating tip (tapping) passes no lateral force on and leaves particles where they are.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.afm import (
    Ground,
    Part,
    height_over_middle,
    inputs_over,
    part_start,
    part_step,
    register_part,
)
from telenano.extend.samples import AfmSample, PlantInputs
from telenano.numerics import compiled
from telenano_lab.assembly.particles.push import RADIUS, RESTED, X, Y, height_m, packed, tick
from telenano_lab.assembly.particles.settings import ParticlesConfig
from telenano_lab.assembly.particles.tip_shape import Spring, TipShape, tip_shape

Array = npt.NDArray[np.float64]


class Particles(NamedTuple):
    """The true particles of a simulation: places (n, 2) [m], radii (n,) [m], and which of them move, (n,)."""

    places_m: Array
    radii_m: Array
    moving: npt.NDArray[np.bool_]


class ParticleLayerParams(NamedTuple):
    """The wrapped part; the surface as the tip sees it; tip, spring and particles (`push.push_step`).

    is_plane: whether the surface is flat at height 0; model: tip and spring (`push.packed`); rest_distance_m: L of the
    cantilever [m]; volts_per_m: gain of its read-out [V/m].
    """

    within: Any
    surface: Any
    is_plane: bool
    model: Array
    tip: TipShape
    spring: Spring
    fixed: Array
    start: Array
    rest_distance_m: float
    volts_per_m: float


class ParticleLayerState(NamedTuple):
    """State of the wrapped part; the particles; place at the last step [m]; their effect on the tip.

    raised_m: height by which they raise the surface [m]; lift_n: their upward force on the tip [N].
    """

    within: Any
    moving: Array
    x_m: float
    y_m: float
    raised_m: float
    lift_n: float


def particle_layer(settings: ParticlesConfig, within: Any, ground: Ground) -> ParticleLayerParams:
    """Return the parameters of particles around a part over a surface.

    Raises:
        ValueError: The particles find no room, overlap, or lie outside the sample.
    """
    fixed, start = settings.rows(ground.tip_radius_m, *ground.sides_m)
    tip = tip_shape(ground.tip_radius_m, math.radians(settings.cone_deg))
    spring = Spring(
        normal_n_per_m=ground.stiffness_n_per_m,
        lateral_n_per_m=ground.lateral_n_per_m,
        friction=settings.tip_friction,
        loaded_area=settings.loaded_area,
        rest_s=settings.rest_s,
    )
    return ParticleLayerParams(
        within,
        ground.surface,
        ground.is_plane,
        packed(tip, spring),
        tip,
        spring,
        fixed,
        start,
        ground.rest_distance_m,
        ground.volts_per_m,
    )


@compiled
def _ground(params: ParticleLayerParams, x_m: float, y_m: float) -> float:
    return 0.0 if params.is_plane else height_over_middle(params.surface, x_m, y_m)[0]


@compiled
def _step(
    params: ParticleLayerParams, state: ParticleLayerState, inputs: PlantInputs, dt: float
) -> tuple[ParticleLayerState, AfmSample]:
    k = params.spring.normal_n_per_m
    # Particles lie on the plane of height 0: a higher surface under the tip keeps it away from them.
    ground = _ground(params, inputs.x_m, inputs.y_m)
    free = params.rest_distance_m - inputs.base_m
    held_up = max(free, ground)
    moving, contact = tick(
        params.model,
        params.fixed,
        state.moving,
        state.x_m,
        state.y_m,
        inputs.x_m,
        inputs.y_m,
        held_up,
        free,
        inputs.amplitude_m > 0.0,
        dt,
    )
    # Over a particle that it does not touch yet, the tip feels its attraction.
    apex = contact.apex_m if contact.touched == 0 or contact.apex_m > held_up else 0.0
    raised = max(apex - ground, 0.0)
    # If particles hold the tip up, their force comes from the raised surface.
    lift = 0.0 if raised > 0.0 else contact.lift_n
    within, sample = part_step(params.within, state.within, inputs_over(inputs, raised, lift / k), dt)
    after = ParticleLayerState(within, moving, inputs.x_m, inputs.y_m, raised, lift)
    return after, AfmSample(
        base_m=inputs.base_m,
        deflection_m=sample.deflection_m + lift / k,
        force_n=sample.force_n + lift,
        bridge_voltage_v=sample.bridge_voltage_v + params.volts_per_m * lift / k,
        distance_m=sample.distance_m,
        distance_valid=sample.distance_valid,
        in_contact=sample.in_contact or contact.touched > 0,
        meniscus=sample.meniscus,
        lateral_x_n=sample.lateral_x_n + contact.push_x_n,
        lateral_y_n=sample.lateral_y_n + contact.push_y_n,
    )


def _start(params: ParticleLayerParams, inputs: PlantInputs) -> ParticleLayerState:
    ground = _ground(params, inputs.x_m, inputs.y_m)
    apex = height_m(params.tip, params.fixed, params.start, inputs.x_m, inputs.y_m)
    raised = max(apex - ground, 0.0)
    within = part_start(params.within, inputs_over(inputs, raised, 0.0))
    return ParticleLayerState(within, params.start, inputs.x_m, inputs.y_m, raised, 0.0)


def _inputs_within(params: ParticleLayerParams, state: ParticleLayerState, inputs: PlantInputs) -> PlantInputs:
    return inputs_over(inputs, state.raised_m, state.lift_n / params.spring.normal_n_per_m)


def _truths(params: ParticleLayerParams, state: ParticleLayerState) -> Mapping[str, Any]:
    moves = state.moving[:, RESTED] < params.spring.rest_s
    own = Particles(state.moving[:, (X, Y)], params.fixed[:, RADIUS], moves)
    return {"particles": own}


register_part(ParticleLayerParams, Part(_start, _step, truths=_truths, within="within", inputs_within=_inputs_within))
