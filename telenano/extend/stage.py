"""The lateral stage: its limits of range and speed, and its motion."""

import math
from typing import NamedTuple

from telenano.numerics.compiler import compiled

LATERAL_BY_RANGE = 1  # Bits that tell which limit acted on a motion.
LATERAL_BY_SPEED = 2


class LateralParams(NamedTuple):
    """Reach to either side of the centre [m] and greatest speed [m/s], the same on both axes."""

    reach_m: float
    speed_m_per_s: float


class Place(NamedTuple):
    """A place of the tip over the sample in the AFM frame [m]; (0, 0) is the centre of the sample."""

    x_m: float
    y_m: float


@compiled
def moved(params: LateralParams, place: Place, wanted: Place, dt: float) -> tuple[Place, int]:
    """Return the place of the stage after moving towards `wanted` for dt [s] in a straight line, and the limits' bits.

    Raises:
        ValueError: dt is not positive and finite, or the target is not finite.
    """
    if not (dt > 0.0 and math.isfinite(dt)):
        raise ValueError("dt in s must be finite and > 0")
    if not (math.isfinite(wanted.x_m) and math.isfinite(wanted.y_m)):
        raise ValueError("a lateral target in m must be finite")
    reach = params.reach_m
    x, y = min(max(wanted.x_m, -reach), reach), min(max(wanted.y_m, -reach), reach)
    limited = LATERAL_BY_RANGE if x != wanted.x_m or y != wanted.y_m else 0
    dx, dy = x - place.x_m, y - place.y_m
    way, longest = math.hypot(dx, dy), params.speed_m_per_s * dt
    if way <= longest:
        return Place(x, y), limited
    share = longest / way
    return Place(place.x_m + share * dx, place.y_m + share * dy), limited | LATERAL_BY_SPEED
