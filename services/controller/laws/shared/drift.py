"""How fast a sample drifts, from the places and forces of a tip in contact.

x = F / K + v t: what a tip goes beyond the change of its force over the slope is the drift. Speed and rate of force are
those of the last `STEADY_S`, and the estimate is their mean over `MEAN_S`, with the more weight the less the force
changes: there the slope says nothing and the drift is all. So a place is regressed on force and time, each where it
can be told.
"""

import math
from typing import NamedTuple

from services.controller.laws.shared.virtual_mass import bounded
from services.numerics.compiled import compiled

# time constant over which the changes of force and place are taken for a drift [s]
STEADY_S = 0.1
# time constant with which the speed of a drift is learnt where the force stands [s]
MEAN_S = 1.0


class Drift(NamedTuple):
    """Place and force as they were lately, speed of the drift and mean square of what it varies by, and way so far.

    In units of the caller: m and N, or nm and nN, at either scale; speeds in these a second.
    """

    slow_place: float
    slow_force: float
    speed: float
    square: float
    gone: float


@compiled
def no_drift(place: float, force: float) -> Drift:
    """Return the drift at the first pair of a contact."""
    return Drift(place, force, 0.0, 0.0, 0.0)


@compiled
def drifted(
    drift: Drift, place: float, force: float, known: float, slope: float, elapsed_s: float, stands: float, most: float
) -> Drift:
    """Learn from the pair that comes elapsed_s [s] after the one before.

    Args:
        drift: What is known.
        place: Where the tip is.
        force: Its force.
        known: The force there by what is known; the way gone takes up the difference where the force stands.
        slope: The stiffness of the contact there.
        elapsed_s: The time since the last pair [s].
        stands: Change of force in a second below which the force stands.
        most: No sample is taken to drift faster.
    """
    share = min(elapsed_s / STEADY_S, 1.0)
    rate = (force - drift.slow_force) / STEADY_S
    weight = 1.0 / (1.0 + (rate / stands) * (rate / stands))
    weight = weight * weight * min(elapsed_s / MEAN_S, 1.0)
    off = (place - drift.slow_place) / STEADY_S - rate / slope - drift.speed
    speed = bounded(drift.speed + weight * off, most)
    return Drift(
        slow_place=drift.slow_place + share * (place - drift.slow_place),
        slow_force=drift.slow_force + share * (force - drift.slow_force),
        speed=speed,
        square=drift.square + weight * (off * off - drift.square),
        gone=drift.gone + speed * elapsed_s + weight * (known - force) / slope,
    )


@compiled
def error_of(drift: Drift) -> float:
    """Return the standard error of the speed: what it is the mean of is correlated over `STEADY_S`."""
    return math.sqrt(drift.square * STEADY_S / (STEADY_S + MEAN_S))
