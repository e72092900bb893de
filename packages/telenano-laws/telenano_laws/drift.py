"""Estimate of the drift speed of a sample, from positions and forces of a tip in contact.

x = F / K + v t: the drift is the motion of the tip minus the change of its force divided by the contact stiffness K.
Speed and rate of force are those over the last `STEADY_S`. The estimate is a mean over `MEAN_S` in which a sample has
more weight the less the force changes, because an error of K then matters less. A tip that moves faster than any sample
drifts has met or left something, and gets little weight.

Only the share 1 - (2 e / v)^2 of the estimate is followed, with the speed v and its standard error e, and nothing below
2 e: otherwise the curvature of the contact would be taken for drift while a hand swings on a sample at rest. A swing of
the hand makes successive deviations from the mean correlated. Their correlation time follows from the share of their
variance that is left in a mean over `RECENT_S`, and e is the error of a mean of values correlated over that time.
"""

import math
from typing import NamedTuple

from telenano.extend.virtual_mass import bounded
from telenano.numerics import compiled

# Time constant over which changes of force and position are measured [s].
STEADY_S = 0.1
# Time constant of the estimated speed while the force is constant [s].
MEAN_S = 1.0
# Time constant of the mean from which the correlation time of the deviations is found [s].
RECENT_S = 0.25
# The prior, a uniform distribution up to the fastest drift, has the weight of this time at constant force [s].
BEFOREHAND_S = 0.02
# An estimate below this number of its standard errors is not followed.
SURE = 2.0


class Drift(NamedTuple):
    """Smoothed position and force, the estimate of the drift, and the total displacement that was followed.

    speed, square: mean of the observed speeds, and their mean square deviation from it; recent, slow_square: their mean
    over `RECENT_S`, and its mean square deviation from the speed; known_s: weight of the observations, as a time at
    constant force, up to `MEAN_S` [s]; gone: displacement of the sample that was followed.
    Units are those of the caller: m and N, or nm and nN, at either scale; speeds in these per second.
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
    """Return the estimate at the first position and force of a contact: no drift, and none faster than `most`."""
    square = most * most / 3.0
    return Drift(place, force, 0.0, square, 0.0, square * STEADY_S / (STEADY_S + RECENT_S), BEFOREHAND_S, 0.0)


@compiled
def _error(square: float, slow_square: float, known_s: float) -> float:
    alike = min(slow_square / max(square, 1e-300), 0.95)
    alike_s = max(RECENT_S * alike / (1.0 - alike), STEADY_S)
    return math.sqrt(square * alike_s / (alike_s + known_s))


@compiled
def _share(speed: float, error: float) -> float:
    """Return the share of a speed that is followed: 0 up to `SURE` standard errors, and near 1 far above."""
    part = SURE * error / max(abs(speed), 1e-300)
    return max(1.0 - part * part, 0.0)


@compiled
def drifted(
    drift: Drift, place: float, force: float, known: float, slope: float, elapsed_s: float, stands: float, most: float
) -> Drift:
    """Update the estimate with a pair of position and force.

    Args:
        drift: The estimate so far.
        place: The position of the tip.
        force: The force on the tip.
        known: The force that the model predicts there; at constant force the displacement absorbs the difference.
        slope: The stiffness of the contact there.
        elapsed_s: The time since the last pair [s].
        stands: Rate of force below which the force counts as constant.
        most: Greatest possible speed of a drift.
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
    """Return the standard error of the speed, from deviations that are correlated for at least `STEADY_S`."""
    return _error(drift.square, drift.slow_square, drift.known_s)
