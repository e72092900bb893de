"""The layer of particles by which telenano finds it (entry point `telenano.layers`); it imports no compiled step."""

from typing import TYPE_CHECKING, Any

import numpy as np

from telenano.afm import Ground, Height, Layer, TruthMessage
from telenano.wire import Array
from telenano_assembly.particles.settings import ParticlesConfig

if TYPE_CHECKING:
    from telenano_assembly.particles.layer import Particles


def _height(settings: ParticlesConfig) -> Height:
    radius_m = settings.kind.radius_m
    return Height(settings.highest_m, settings.clear_m, f"the highest particle, with a radius of {radius_m:g} m")


def _around(settings: ParticlesConfig, part: Any, ground: Ground) -> Any:
    from telenano_assembly.particles.layer import particle_layer

    return particle_layer(settings, part, ground)


def says(found: "Particles") -> TruthMessage:
    """Return the message of where the particles really are: `afm/particles`."""
    arrays = found._replace(moving=found.moving.astype(np.uint8))._asdict()
    fields = {"simulated": True, **{name: Array.from_numpy(array) for name, array in arrays.items()}}
    return TruthMessage("afm/particles", fields, bool(found.moving.any()))


PARTICLES = Layer("particles", ParticlesConfig, _height, _around, says)
