"""The layer of particles as telenano finds it (entry point `telenano.samples`); it imports no compiled step."""

from typing import TYPE_CHECKING, Any

import numpy as np

from telenano.afm import Ground, Height, Layer
from telenano.wire import Array
from telenano_lab.assembly.particles.settings import ParticlesConfig

if TYPE_CHECKING:
    from telenano_lab.assembly.particles.layer import Particles


def _height(settings: ParticlesConfig) -> Height:
    radius_m = settings.kind.radius_m
    return Height(settings.highest_m, settings.clear_m, f"the highest particle, with a radius of {radius_m:g} m")


def _around(settings: ParticlesConfig, part: Any, ground: Ground) -> Any:
    from telenano_lab.assembly.particles.layer import particle_layer

    return particle_layer(settings, part, ground)


def _fields(particles: "Particles") -> dict[str, Any]:
    """Return the fields of `afm/particles`, the true places of the particles."""
    arrays = particles._replace(moving=particles.moving.astype(np.uint8))._asdict()
    return {"simulated": True, **{name: Array.from_numpy(array) for name, array in arrays.items()}}


def _changes(particles: "Particles") -> bool:
    return bool(particles.moving.any())


PARTICLES = Layer("particles", ParticlesConfig, _height, _around, "afm/particles", _fields, _changes)
