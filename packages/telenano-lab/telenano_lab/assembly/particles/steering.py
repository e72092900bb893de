"""The direction in which a tip must move so that the particle it pushes turns towards a goal.

The direction psi of a pushed particle, seen from the tip, obeys psi' = -u_t / d, with u_t the motion across it. If the
tip moves at the angle -atan(clip(2 (psi* - psi), +-sqrt 3)) to psi, psi* being the bearing of the goal from the
particle, the error decays within d / 2.
"""

import math

from telenano.numerics import compiled

_STEEPEST = math.sqrt(3.0)


@compiled
def steered(ahead_x: float, ahead_y: float, goal_x: float, goal_y: float) -> tuple[float, float]:
    """Return the direction of the tip, of length 1.

    Args:
        ahead_x: Direction from the tip to the particle, of length 1.
        ahead_y: The same in y.
        goal_x: Vector from the particle to the goal, of any length.
        goal_y: The same in y.
    """
    error = math.atan2(ahead_x * goal_y - ahead_y * goal_x, ahead_x * goal_x + ahead_y * goal_y)
    # Cosine and sine follow from the tangent without another function.
    slope = -min(max(2.0 * error, -_STEEPEST), _STEEPEST)
    cosine = 1.0 / math.sqrt(1.0 + slope * slope)
    sine = slope * cosine
    return cosine * ahead_x - sine * ahead_y, sine * ahead_x + cosine * ahead_y
