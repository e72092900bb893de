"""The contact of a round tip on a cone with a sphere that lies on a plane.

A tip ends in a sphere of radius R_t, continued by a cone of half-angle alpha. A sphere of radius R lies on the plane at
height 0. At the point of contact, the normal is tilted by theta above the horizontal,

    theta = max(alpha, asin((z + R_t - R) / (R_t + R))),

with z the height of the apex of the tip. The horizontal distance between the axis of the tip and the centre of the
sphere is then d(z) = (R_t + R) cos theta on the cap, and d(z) = (R_t + R) / cos alpha + (R - R_t - z) tan alpha on the
cone. Both follow from the tangency of two circles, and of a circle and a straight line.
"""

import math
from typing import NamedTuple

from telenano.numerics import compiled


class TipShape(NamedTuple):
    """Radius R_t of the apex [m]; sine, cosine and tangent of the half-angle alpha of the cone."""

    radius_m: float
    sin_cone: float
    cos_cone: float
    tan_cone: float


class Spring(NamedTuple):
    """Normal and lateral stiffness [N/m], coefficient of friction in the contact of tip and particle, and options.

    loaded_area: whether the load of the tip on a particle increases the area that holds it. rest_s: time of rest [s]
    after which a particle has its static hold again.
    """

    normal_n_per_m: float
    lateral_n_per_m: float
    friction: float
    loaded_area: bool
    rest_s: float


def tip_shape(radius_m: float, cone_rad: float) -> TipShape:
    """Return the shape of a tip.

    Raises:
        ValueError: The radius [m] is not positive, or the half-angle [rad] is not between 0 and a right angle.
    """
    if not (math.isfinite(radius_m) and radius_m > 0.0):
        raise ValueError(f"tip radius = {radius_m} m must be finite and > 0 m")
    if not 0.0 < cone_rad < 0.5 * math.pi:
        raise ValueError(f"half-angle of the tip = {math.degrees(cone_rad):g} degrees must lie between 0 and 90")
    return TipShape(radius_m, math.sin(cone_rad), math.cos(cone_rad), math.tan(cone_rad))


@compiled
def distance_m(x_m: float, y_m: float) -> float:
    """Return the length of a vector [m]; `math.hypot` of Python and of C round differently."""
    return math.sqrt(x_m * x_m + y_m * y_m)


@compiled
def join_height_m(tip: TipShape, radius_m: float) -> float:
    """Return the height z* of the apex [m] at which the contact passes from the cone to the cap."""
    return radius_m - tip.radius_m + (tip.radius_m + radius_m) * tip.sin_cone


@compiled
def tilt(tip: TipShape, radius_m: float, apex_m: float) -> tuple[float, float]:
    """Return sine and cosine of theta for an apex at a height [m] that touches a sphere of radius_m [m]."""
    both = tip.radius_m + radius_m
    sine = min((apex_m + tip.radius_m - radius_m) / both, 1.0)
    if sine <= tip.sin_cone:
        return tip.sin_cone, tip.cos_cone
    return sine, math.sqrt(max(1.0 - sine * sine, 0.0))


@compiled
def touch_distance_m(tip: TipShape, radius_m: float, apex_m: float) -> float:
    """Return the distance d(z) at which tip and sphere touch [m]; it is 0 from the top of the sphere on."""
    both = tip.radius_m + radius_m
    sine, cosine = tilt(tip, radius_m, apex_m)
    if sine > tip.sin_cone:
        return both * cosine
    return both / tip.cos_cone + (radius_m - tip.radius_m - apex_m) * tip.tan_cone


@compiled
def ride_height_m(tip: TipShape, radius_m: float, distance_m: float) -> float:
    """Return the height [m] at which the sphere holds the apex up, the inverse of d(z), which is its image.

    It is 0 where the tip stands on the plane without touching the sphere.
    """
    both = tip.radius_m + radius_m
    if distance_m <= both * tip.cos_cone:
        return radius_m - tip.radius_m + math.sqrt(both * both - distance_m * distance_m)
    return max(radius_m - tip.radius_m + (both / tip.cos_cone - distance_m) / tip.tan_cone, 0.0)


@compiled
def climb(tip: TipShape, radius_m: float, apex_m: float, friction: float) -> float:
    """Return tan(theta - phi), the upward force per lateral force on the tip, with tan phi = friction."""
    sine, cosine = tilt(tip, radius_m, apex_m)
    return (sine - friction * cosine) / max(cosine + friction * sine, 1e-12)
