"""Settings of the particles on a sample and of their hold: the section `sample.particles`."""

import math
from typing import Annotated, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from telenano.settings import Settings
from telenano_lab.assembly.particles.adhered_sphere import KINDS, Kind, Motion, hold_of

MOST_PARTICLES = 50
# A retracted tip is this far above the highest particle.
CLEAR_M = 100e-9
# Random places keep this many radii from each other and from the edge, so that a tip fits between them.
_ROOM_RADII = 4.0
_ATTEMPTS = 2000

Array = npt.NDArray[np.float64]
Coordinate = Annotated[float, Field(ge=-1e-3, le=1e-3)]
Place = Annotated[tuple[Coordinate, Coordinate], Field(strict=False)]


class ParticlesConfig(Settings):
    """Spheres on the sample, which the tip moves. The presets are for teaching: real pairs scatter by a factor of 3."""

    preset: Literal[tuple(KINDS)] = Field(  # type: ignore[valid-type]
        "latex_250", description="Kind of particle and substrate: " + ", ".join(KINDS) + "."
    )
    count: int = Field(
        8, ge=0, le=MOST_PARTICLES, description="Number of particles at places drawn from the seed, to 50."
    )
    seed: int = Field(0, ge=0, lt=2**63, description="Seed of these places.")
    places: Annotated[tuple[Place, ...], Field(strict=False)] | None = Field(
        None, max_length=MOST_PARTICLES, description="Places x, y [m] instead of drawn ones; 0, 0 is the middle."
    )
    radius_m: float | None = Field(None, ge=1e-9, le=1e-5, description="Radius [m]; default that of the preset.")
    adhesion_j_per_m2: float | None = Field(
        None, gt=0.0, le=10.0, description="Work of adhesion w [J/m^2]; default that of the preset."
    )
    shear_pa: float | None = Field(
        None, gt=0.0, le=1e10, description="Shear strength tau of the interface [Pa]; default that of the preset."
    )
    kinetic_share: float = Field(
        0.5, gt=0.0, le=1.0, description="Ratio of kinetic to static friction; 0.3 to 0.6 were measured."
    )
    motion: Motion = Field("slide", description="slide, roll, or auto: whichever needs less force.")
    rest_s: float = Field(10e-3, ge=0.0, le=1e3, description="Rest after which the static friction is back [s].")
    loaded_area: bool = Field(False, description="Whether the load that the tip puts on a particle adds to its hold.")
    cone_deg: float = Field(15.0, ge=1.0, le=60.0, description="Half-angle of the tip behind its apex [degrees].")
    tip_friction: float = Field(0.0, ge=0.0, le=1.0, description="Coefficient of friction between tip and particle.")

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.places is not None and self.model_fields_set & {"count", "seed"}:
            raise ValueError("give either places or count and seed, not both")
        return self

    @property
    def kind(self) -> Kind:
        """Return the preset, with the given values replaced."""
        usual = KINDS[self.preset]
        return usual._replace(
            radius_m=self.radius_m or usual.radius_m,
            adhesion_j_per_m2=self.adhesion_j_per_m2 or usual.adhesion_j_per_m2,
            shear_pa=self.shear_pa or usual.shear_pa,
        )

    @property
    def highest_m(self) -> float:
        """Return the height of the top of the particles [m]."""
        return 2.0 * self.kind.radius_m

    @property
    def clear_m(self) -> float:
        """Return the height that a retracted tip must have [m]."""
        return self.highest_m + CLEAR_M

    def placed(self, width_m: float, depth_m: float) -> Array:
        """Return the places on a sample with these sides, shape (n, 2) [m].

        Raises:
            ValueError: Particles overlap, lie outside the sample, or find no room; the message names them.
        """
        radius_m = self.kind.radius_m
        if self.places is None:
            return self._drawn(radius_m, width_m, depth_m)
        places = np.array(self.places, np.float64).reshape(-1, 2)
        for i, (x_m, y_m) in enumerate(places.tolist()):
            if abs(x_m) > 0.5 * width_m - radius_m or abs(y_m) > 0.5 * depth_m - radius_m:
                raise ValueError(
                    f"particles.places: number {i} at {x_m:g}, {y_m:g} m with the radius {radius_m:g} m does not lie"
                    f" within the sample of {width_m:g} x {depth_m:g} m, whose middle is 0, 0"
                )
            for j in range(i):
                between_m = math.hypot(x_m - places[j, 0], y_m - places[j, 1])
                # Touching particles may be given with rounded coordinates.
                if between_m < 2.0 * radius_m * (1.0 - 1e-6):
                    raise ValueError(
                        f"particles.places: numbers {j} and {i} overlap: their centres are {between_m:g} m apart and"
                        f" must be at least {2.0 * radius_m:g} m"
                    )
        return places

    def _drawn(self, radius_m: float, width_m: float, depth_m: float) -> Array:
        random = np.random.Generator(np.random.PCG64(self.seed))
        room_m = _ROOM_RADII * radius_m
        free_x, free_y = width_m - 2.0 * room_m, depth_m - 2.0 * room_m
        places: list[tuple[float, float]] = []
        for _ in range(_ATTEMPTS * (min(free_x, free_y) > 0.0)):
            if len(places) == self.count:
                break
            u, v = random.random(2).tolist()
            x, y = (u - 0.5) * free_x, (v - 0.5) * free_y
            if all(math.hypot(x - p, y - q) >= room_m for p, q in places):
                places.append((x, y))
        if len(places) < self.count:
            raise ValueError(
                f"particles.count: {self.count} particles of radius {radius_m:g} m find no room on {width_m:g} x"
                f" {depth_m:g} m with {room_m:g} m between them: take fewer, or a larger sample.size_m"
            )
        return np.array(places, np.float64).reshape(-1, 2)

    def rows(self, tip_radius_m: float, width_m: float, depth_m: float) -> tuple[Array, Array]:
        """Return the arrays `fixed`, shape (n, 4), and `moving`, shape (n, 3), of `push.push_step`."""
        kind, places = self.kind, self.placed(width_m, depth_m)
        cone = math.radians(self.cone_deg)
        hold = hold_of(kind, self.kinetic_share, self.motion, tip_radius_m, cone, self.tip_friction)
        fixed = np.tile(np.array([kind.radius_m, *hold]), (len(places), 1))
        # All particles have rested long enough for static friction.
        return fixed, np.column_stack([places, np.full(len(places), self.rest_s)])
