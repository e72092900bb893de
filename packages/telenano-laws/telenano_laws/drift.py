"""How fast a sample drifts, from the places and forces of a tip in contact.

x = F / K + v t: what a tip goes beyond the change of its force over the slope is the drift. Speed and rate of force are
those of the last `STEADY_S`, and the estimate is their mean over `MEAN_S`, with the more weight the less the force
changes: there the slope says nothing and the drift is all. So a place is regressed on force and time, each where it
can be told. A tip that goes faster than any sample drifts has met or left something, and has little weight.

The estimate is followed by the share 1 - (2 e / v)^2 of it, v the speed and e its standard error, and not at all below
2 e: under a hand that swings on a still sample the curve of the contact is else taken for a drift. Deviations from the
mean are alike for as long as a swing of the hand makes them so. That time follows from how much of their variance is
left in their mean over `RECENT_S`, and e is the error of a mean of values that are alike for that time.
"""

import math
from typing import NamedTuple

from telenano.extend.virtual_mass import bounded
from telenano.numerics import compiled

# time constant over which the changes of force and place are taken for a drift [s]
STEADY_S = 0.1
# time constant with which the speed of a drift is learnt where the force stands [s]
MEAN_S = 1.0
# time constant of the mean that tells for how long deviations are alike [s]
RECENT_S = 0.25
# The assumption beforehand, that any drift up to the fastest is as likely, counts like this time of standing [s].
BEFOREHAND_S = 0.02
# An estimate of less than this number of its standard errors is not followed.
SURE = 2.0


class Drift(NamedTuple):
    """Place and force as they were lately, what is estimated of the drift, and the way so far.

    speed, square: mean of the speeds seen, and their mean square deviation from it; recent, slow_square: their mean
    over `RECENT_S`, and its mean square deviation from the speed; known_s: for how long the force has stood, up to
    `MEAN_S` [s]; gone: the way of the sample that was followed.
    In units of the caller: m and N, or nm and nN, at either scale; speeds in these a second.
    """

    slow_place: float
    slow_force: float
    speed: float
    square: float
    recent: float
    slow_square: float
    known_s: float
    gone: float


@compiled
def no_drift(place: float, force: float, most: float) -> Drift:
    """Return the drift at the first pair of a contact: none is known, and none is faster than `most`."""
    square = most * most / 3.0
    return Drift(place, force, 0.0, square, 0.0, square * STEADY_S / (STEADY_S + RECENT_S), BEFOREHAND_S, 0.0)


@compiled
def _error(square: float, slow_square: float, known_s: float) -> float:
    alike = min(slow_square / max(square, 1e-300), 0.95)
    alike_s = max(RECENT_S * alike / (1.0 - alike), STEADY_S)
    return math.sqrt(square * alike_s / (alike_s + known_s))


@compiled
def _share(speed: float, error: float) -> float:
    """Return the share of a speed that is followed: none up to `SURE` errors, and nearly all far above."""
    part = SURE * error / max(abs(speed), 1e-300)
    return max(1.0 - part * part, 0.0)


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
    seen = (place - drift.slow_place) / STEADY_S - rate / slope
    weight = 1.0 / (1.0 + (rate / stands) * (rate / stands) + (seen / most) * (seen / most))
    stood_s = weight * weight * min(elapsed_s, MEAN_S)
    known_s = drift.known_s + stood_s
    gain = stood_s / known_s
    off = seen - drift.speed
    speed = bounded(drift.speed + gain * off, most)
    recent = drift.recent + min(stood_s / RECENT_S, 1.0) * (seen - drift.recent)
    square = drift.square + gain * (off * off - drift.square)
    slow_square = drift.slow_square + gain * ((recent - speed) * (recent - speed) - drift.slow_square)
    sure = _share(speed, _error(square, slow_square, known_s))
    way = speed * elapsed_s + stood_s / MEAN_S * (known - force) / slope
    gone = drift.gone + sure * way
    slow_place = drift.slow_place + share * (place - drift.slow_place)
    slow_force = drift.slow_force + share * (force - drift.slow_force)
    return Drift(slow_place, slow_force, speed, square, recent, slow_square, min(known_s, MEAN_S), gone)


@compiled
def error_of(drift: Drift) -> float:
    """Return the standard error of the speed, with the time for which deviations are alike, at least `STEADY_S`."""
    return _error(drift.square, drift.slow_square, drift.known_s)
