"""The hold of a sphere on a substrate: JKR contact, sliding friction of its area, rolling resistance.

The contact under the load P has the radius a with a^3 = (R / K) (P + 3 pi w R + sqrt(6 pi w R P + (3 pi w R)^2)), K =
4 E* / 3 (K. L. Johnson, K. Kendall, A. D. Roberts, Proc. R. Soc. A 324 (1971) 301). Its sliding friction is tau pi a^2,
of which the share rho remains in motion. Rolling needs the moment 6 pi w R xi (C. Dominik, A. G. G. M. Tielens, Phil.
Mag. A 72 (1995) 783): a sphere pushed at its side rolls if the friction in the contact with the tip plus that moment
over R is less than the sliding friction.
"""

import math
from typing import Literal, NamedTuple

from telenano.afm import reduced_modulus_pa
from telenano.numerics import compiled

Motion = Literal["slide", "roll", "auto"]


class Material(NamedTuple):
    """Young's modulus [Pa] and Poisson ratio of a material."""

    modulus_pa: float
    poisson: float


POLYSTYRENE = Material(3e9, 0.34)
SILICA = Material(73e9, 0.17)
GOLD = Material(79e9, 0.42)
GLASS = Material(70e9, 0.22)
SILICON = Material(165e9, 0.22)


class Kind(NamedTuple):
    """A kind of particle: radius [m], reduced modulus with its substrate [Pa], work of adhesion [J/m^2].

    shear_pa: strength of the interface [Pa]; rolling_m: critical rolling distance xi [m]; material: of the particle.
    """

    radius_m: float
    reduced_pa: float
    adhesion_j_per_m2: float
    shear_pa: float
    rolling_m: float
    material: Material


def kind_of(
    radius_m: float, material: Material, substrate: Material, adhesion: float, shear_pa: float, rolling_m: float
) -> Kind:
    """Return a kind of particle on a substrate; adhesion in J/m^2, shear_pa in Pa, rolling_m in m."""
    return Kind(radius_m, reduced_modulus_pa(*material, *substrate), adhesion, shear_pa, rolling_m, material)


# The shear strength of latex is the middle of a measured range (9 to 15 MPa, B. Suemer and M. Sitti, J. Adhes. Sci.
# Technol. 22 (2008) 481); those of gold and silica, and all works of adhesion, are assumptions for teaching.
KINDS = {
    "latex_250": kind_of(250e-9, POLYSTYRENE, GLASS, 0.05, 12e6, 2.1e-9),
    "latex_1010": kind_of(1010e-9, POLYSTYRENE, GLASS, 0.05, 12e6, 8.6e-9),
    "gold_50": kind_of(50e-9, GOLD, SILICA, 0.10, 50e6, 0.5e-9),
    "silica_500": kind_of(500e-9, SILICA, SILICON, 0.05, 30e6, 1.25e-9),
}


class Hold(NamedTuple):
    """The hold of a particle [N]: force that moves it from rest, force that keeps it moving, pull-off 3 pi w R / 2."""

    static_n: float
    kinetic_n: float
    pull_off_n: float


def contact_radius_m(radius_m: float, reduced_pa: float, adhesion_j_per_m2: float, load_n: float = 0.0) -> float:
    """Return the radius a of a JKR contact [m] under a load [N]."""
    pull = 3.0 * math.pi * adhesion_j_per_m2 * radius_m
    loaded = load_n + pull + math.sqrt(max(2.0 * pull * load_n + pull * pull, 0.0))
    return math.cbrt(0.75 * radius_m / reduced_pa * loaded)


@compiled
def area_ratio(load_n: float, pull_off_n: float) -> float:
    """Return the ratio of the contact's area under a load [N] to that without one; pull_off_n is 3 pi w R / 2 [N]."""
    share = load_n / (2.0 * pull_off_n)
    return float((0.5 * (share + 1.0 + math.sqrt(max(2.0 * share + 1.0, 0.0)))) ** (2.0 / 3.0))


def rolling_n(kind: Kind, tip_radius_m: float, cone_rad: float, tip_friction: float) -> float:
    """Return the lateral force [N] at which a sphere rolls when a silicon tip pushes its side.

    It is the moment over R plus the friction in the contact with the tip, whose load is the push itself.
    """
    between = tip_radius_m * kind.radius_m / (tip_radius_m + kind.radius_m)
    reduced = reduced_modulus_pa(*kind.material, *SILICON)
    moment = 6.0 * math.pi * kind.adhesion_j_per_m2 * kind.rolling_m
    force = moment
    # The load depends on the force: each iteration leaves a fifth of the error.
    for _ in range(60):
        load = force / math.cos(cone_rad)
        a = contact_radius_m(between, reduced, kind.adhesion_j_per_m2, load)
        force = moment + kind.shear_pa * math.pi * a * a + tip_friction * load
    return force


def hold_of(
    kind: Kind, kinetic_share: float, motion: Motion, tip_radius_m: float, cone_rad: float, tip_friction: float
) -> Hold:
    """Return the hold of a particle; the tip matters only if the particle may roll.

    Args:
        kind: The particle on its substrate.
        kinetic_share: Ratio of kinetic to static friction, rho.
        motion: slide, roll, or auto for the one that needs less force.
        tip_radius_m: The radius of the apex of the tip [m].
        cone_rad: The half-angle of the tip [rad].
        tip_friction: The coefficient of friction in the contact with the tip.
    """
    a = contact_radius_m(kind.radius_m, kind.reduced_pa, kind.adhesion_j_per_m2)
    slides_n = kind.shear_pa * math.pi * a * a
    pull_off_n = 1.5 * math.pi * kind.adhesion_j_per_m2 * kind.radius_m
    if motion != "slide":
        rolls_n = rolling_n(kind, tip_radius_m, cone_rad, tip_friction)
        if motion == "roll" or rolls_n < slides_n:
            return Hold(rolls_n, rolls_n, pull_off_n)
    return Hold(slides_n, kinetic_share * slides_n, pull_off_n)
