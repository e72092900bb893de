"""Electrostatic force between a tip and a sample that are at different potentials.

F = -1/2 |dC/dh| V^2, for a sphere of radius R at h over a plane

    F = -pi eps0 R^2 V^2 / (h (h + R))

(S. Hudlet, M. Saint Jean, C. Guthmann, J. Berger, Eur. Phys. J. B 2 (1998) 5, without the cone behind the sphere; the
paper leaves this force out and names it as its next step). Conductors that touch have no gap to hold a voltage, but a
real tip has an oxide layer there: below the contact distance the force keeps the value that it has at that distance.
"""

import math

from telenano.numerics.compiler import compiled

VACUUM_PERMITTIVITY_F_PER_M = 8.8541878128e-12
# The position of a quasi-static tip and its force are iterated until an iteration moves the tip by less than this [m].
SETTLED_M = 1e-14
MOST_TURNS = 40


@compiled
def electrostatic_strength_n_m2(voltage_v: float, radius_m: float) -> float:
    """Return pi eps0 R^2 V^2 [N m^2].

    >>> strength = electrostatic_strength_n_m2(1.0, 10e-9)
    >>> round(strength / (1e-9 * 11e-9) * 1e12, 3)  # pN at 1 nm
    252.875
    """
    return math.pi * VACUUM_PERMITTIVITY_F_PER_M * (radius_m * voltage_v) ** 2


@compiled
def electrostatic_force_n(strength_n_m2: float, radius_m: float, least_m: float, distance_m: float) -> float:
    """Return the force [N], negative because it attracts; below the distance least_m [m] it grows no further."""
    h = max(distance_m, least_m)
    return -strength_n_m2 / (h * (h + radius_m))
