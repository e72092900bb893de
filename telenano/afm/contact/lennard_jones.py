"""Van der Waals attraction and short-range repulsion of a sphere over a flat (Eq. 5)."""

import math

from telenano.numerics.compiler import compiled

# F = 0 at a0 = 30^(-1/6) sigma, dF/dh = 0 at (8/60)^(1/6) sigma, d2F/dh2 = 0 further out.
CONTACT_RATIO = 30.0 ** (-1.0 / 6.0)
MINIMUM_RATIO = (8.0 / 60.0) ** (1.0 / 6.0)


@compiled
def lennard_jones_force(distance_m: float, hamaker_j: float, radius_m: float, sigma_m: float) -> tuple[float, float]:
    """Force and gradient of a sphere over a flat, without capillary and electrostatic parts.

    F = -(H R / 6 sigma^2) [(sigma/h)^2 - (sigma/h)^8 / 30]                     (Eq. 5)

    The arguments are scalars, and unchecked because this runs in the innermost loop: callers keep h above the contact
    point. The equation is valid for h much smaller than R.

    Args:
        distance_m: The distance of tip and sample, h [m], > 0.
        hamaker_j: The Hamaker constant, H [J].
        radius_m: The radius of the tip, R [m].
        sigma_m: The interatomic distance, sigma [m], > 0.

    Returns:
        The force [N], negative is attractive, and its gradient dF/dh [N/m].
    """
    F0 = hamaker_j * radius_m / (6.0 * sigma_m * sigma_m)
    q = sigma_m / distance_m
    q2 = q * q
    q8 = q2 * q2 * q2 * q2
    return -F0 * (q2 - q8 / 30.0), F0 * (2.0 * q2 - 8.0 * q8 / 30.0) / distance_m


def contact_distance_m(sigma_m: float) -> float:
    """Distance a0 = 30^(-1/6) sigma at which the force of Eq. 5 is zero and contact begins.

    Raises:
        ValueError: sigma is not a positive finite length.

    >>> round(contact_distance_m(3.49e-10) * 1e9, 6)
    0.197988
    """
    return CONTACT_RATIO * _length(sigma_m)


def minimum_distance_m(sigma_m: float) -> float:
    """Distance (8/60)^(1/6) sigma of the strongest attraction of Eq. 5.

    Raises:
        ValueError: sigma is not a positive finite length.
    """
    return MINIMUM_RATIO * _length(sigma_m)


def _length(sigma_m: float) -> float:
    if not (math.isfinite(sigma_m) and sigma_m > 0.0):
        raise ValueError(f"interatomic distance sigma = {sigma_m} m must be finite and > 0 m")
    return sigma_m
