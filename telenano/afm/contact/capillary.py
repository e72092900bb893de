"""Capillary force of the water meniscus between tip and sample (Eq. 6), in two readings.

`consistent` (E3, E4): one law in both directions. The meniscus forms when the tip comes to h = 2 r1, breaks when it
leaves delta_b, and its force is frozen at the contact value inside contact.
`as_printed`: Eq. 6 to the letter. The approach branch acts for h >= 2 r1 (the step function is printed inverted), the
retract branch, with h + delta in place of h - a0, acts after a contact up to h = delta_b; Eq. 4 has neither in contact.

Which branch is in force is memory, not a function of h: it belongs to the branch state of `cantilever`. The
solid-solid term F_s-s of Eq. 6 is left out, as the paper does.
"""

import math

from telenano.numerics.compiler import compiled

KELVIN_LENGTH_M = 0.54e-9  # water at 20 degrees Celsius, the number under Eq. 6


@compiled
def meniscus_force(
    distance_m: float, capillary_force_n: float, meniscus_width_m: float, contact_distance_m: float
) -> tuple[float, float]:
    """Force and gradient of an existing meniscus, `consistent` reading.

    F = -4 pi R gamma_L / (1 + (h - a0) / 2 r1) for h > a0, its value at a0 below        (Eq. 6, E3, E4)

    Args:
        distance_m: The distance of tip and sample, h [m].
        capillary_force_n: The greatest force, 4 pi R gamma_L [N].
        meniscus_width_m: The width of the meniscus, 2 r1 [m], > 0.
        contact_distance_m: The distance of contact, a0 [m].

    Returns:
        The force [N], <= 0, and its gradient dF/dh [N/m].
    """
    if distance_m < contact_distance_m:
        return -capillary_force_n, 0.0
    q = 1.0 / (1.0 + (distance_m - contact_distance_m) / meniscus_width_m)
    return -capillary_force_n * q, capillary_force_n * q * q / meniscus_width_m


@compiled
def printed_meniscus_force(
    distance_m: float,
    retracting: bool,
    capillary_force_n: float,
    meniscus_width_m: float,
    contact_distance_m: float,
    meniscus_break_m: float,
) -> tuple[float, float]:
    """Force and gradient of Eq. 6 as it stands in print; outside contact only.

    Approach: -4 pi R gamma_L / (1 + (h - a0) / 2 r1) u(h - 2 r1); retract: -4 pi R gamma_L / (1 + (h + delta) / 2 r1)
    u(delta - h).

    Args:
        distance_m: The distance of tip and sample, h [m].
        retracting: Selects the branch of retraction, else that of approach.
        capillary_force_n: The greatest force, 4 pi R gamma_L [N].
        meniscus_width_m: The width of the meniscus, 2 r1 [m], > 0.
        contact_distance_m: The distance of contact, a0 [m].
        meniscus_break_m: The distance at which the meniscus breaks, delta [m].

    Returns:
        The force [N], <= 0, and its gradient dF/dh [N/m]; the steps themselves have no gradient.
    """
    if retracting:
        if distance_m > meniscus_break_m:
            return 0.0, 0.0
        q = 1.0 / (1.0 + (distance_m + meniscus_break_m) / meniscus_width_m)
    else:
        if distance_m < meniscus_width_m:
            return 0.0, 0.0
        q = 1.0 / (1.0 + (distance_m - contact_distance_m) / meniscus_width_m)
    return -capillary_force_n * q, capillary_force_n * q * q / meniscus_width_m


def meniscus_radius_m(relative_humidity: float) -> float:
    """Curvature radius of the meniscus in equilibrium with the vapour, r1 = -0.54 nm / ln(P/Ps).

    Source: the Kelvin equation as quoted under Eq. 6, for water at 20 degrees Celsius.

    Args:
        relative_humidity: P/Ps, a fraction between 0 and 1, both excluded.

    Returns:
        The radius r1 [m].

    Raises:
        ValueError: The humidity is outside that range.

    >>> round(meniscus_radius_m(0.638) * 1e9, 2)
    1.2
    """
    if not 0.0 < relative_humidity < 1.0:
        raise ValueError(
            f"relative humidity = {relative_humidity} must be a fraction between 0 and 1 (63.8 % is 0.638)"
        )
    return -KELVIN_LENGTH_M / math.log(relative_humidity)


def relative_humidity(radius_m: float) -> float:
    """Relative humidity at which the meniscus radius is r1 [m]: exp(-0.54 nm / r1), the inverse of `meniscus_radius_m`.

    Raises:
        ValueError: The radius is not a positive finite length.
    """
    if not (math.isfinite(radius_m) and radius_m > 0.0):
        raise ValueError(f"meniscus radius r1 = {radius_m} m must be finite and > 0 m")
    return math.exp(-KELVIN_LENGTH_M / radius_m)
