"""The thermal drift between tip and sample, estimated from places that are seen again.

Each axis has an offset p and a speed v, which changes by a white acceleration of density q: over the time T,

    p' = p + v T,    Q = q [[T^3 / 3, T^2 / 2], [T^2 / 2, T]],

and a particle that is seen twice measures v T with the standard deviation sigma (a Kalman filter, after B. Mokaberi and
A. A. G. Requicha, IEEE Trans. Autom. Sci. Eng. 3 (2006) 199).
"""

import math
from typing import NamedTuple

# Density for a speed of 0.1 nm/s that changes within two hours.
DENSITY_M2_PER_S3 = 1.3889e-24
FASTEST_M_PER_S = 0.1e-9


class Axis(NamedTuple):
    """Offset [m] and speed [m/s] of an axis, with their covariance [m^2, m^2/s, m^2/s^2]."""

    offset_m: float
    speed_m_per_s: float
    offset_variance: float
    covariance: float
    speed_variance: float

    @property
    def error_m(self) -> float:
        return math.sqrt(max(self.offset_variance, 0.0))


class Drift(NamedTuple):
    """The drift along both axes at a time [s]."""

    time_s: float
    x: Axis
    y: Axis


def unknown(fastest_m_per_s: float = FASTEST_M_PER_S) -> Axis:
    """Return an axis at the first look: its offset is 0 by definition, its speed has this standard deviation."""
    return Axis(0.0, 0.0, 0.0, 0.0, fastest_m_per_s**2)


def predicted(axis: Axis, elapsed_s: float, density_m2_per_s3: float = DENSITY_M2_PER_S3) -> Axis:
    """Return an axis after elapsed_s [s] without a look."""
    t, q = elapsed_s, density_m2_per_s3
    return Axis(
        axis.offset_m + axis.speed_m_per_s * t,
        axis.speed_m_per_s,
        axis.offset_variance + t * (2.0 * axis.covariance + t * axis.speed_variance) + q * t**3 / 3.0,
        axis.covariance + t * axis.speed_variance + q * t**2 / 2.0,
        axis.speed_variance + q * t,
    )


def moved(axis: Axis, by_m: float, elapsed_s: float, error_m: float) -> Axis:
    """Return an axis after a measurement of its motion by_m [m] in the last elapsed_s [s], with a standard error [m].

    A particle that is seen twice gives this motion; its place before the drift began is not known.
    """
    whole = elapsed_s**2 * axis.speed_variance + error_m**2
    if whole <= 0.0:
        return axis
    gain, speed_gain = elapsed_s * axis.covariance / whole, elapsed_s * axis.speed_variance / whole
    missed = by_m - axis.speed_m_per_s * elapsed_s
    return Axis(
        axis.offset_m + gain * missed,
        axis.speed_m_per_s + speed_gain * missed,
        axis.offset_variance - gain * elapsed_s * axis.covariance,
        axis.covariance - gain * elapsed_s * axis.speed_variance,
        axis.speed_variance - speed_gain * elapsed_s * axis.speed_variance,
    )


def drift_at(drift: Drift, time_s: float) -> Drift:
    """Return the predicted drift at a time [s]."""
    elapsed_s = max(time_s - drift.time_s, 0.0)
    return Drift(drift.time_s + elapsed_s, predicted(drift.x, elapsed_s), predicted(drift.y, elapsed_s))


def offset_at(drift: Drift, time_s: float) -> tuple[float, float]:
    """Return both offsets [m] at a time [s] before or after the last look, at the speeds known now."""
    elapsed_s = time_s - drift.time_s
    return drift.x.offset_m + drift.x.speed_m_per_s * elapsed_s, drift.y.offset_m + drift.y.speed_m_per_s * elapsed_s
