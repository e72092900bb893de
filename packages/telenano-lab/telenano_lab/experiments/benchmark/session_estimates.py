"""Estimates of line, sample and drift from a running session, each with its interval of 95 %.

Some twenty samples a second suffice, so a reader may take only the newest of those that wait. An interval follows from
the scatter of parts of the record, because successive samples are correlated. It is widened by errors that the samples
cannot show, those of an open-loop piezo (Physik Instrumente, Piezo tutorial: hysteresis of 2 % of a small motion to
15 % of a large one, creep of 1 to 2 % of a step per decade of time after 0.1 s).
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis import DEVIATIONS, half_width, student
from telenano_lab.experiments.benchmark.shown_range import Estimate

Series = npt.NDArray[np.float64]
# The line is estimated over the first time, and not before the second has passed [s].
LINE_S = 10.0
_LINE_LEAST_S = 4.0
# The contact is estimated over the first time; a drift needs at least the second [s].
CONTACT_S = 12.0
_DRIFT_LEAST_S = 8.0
# Samples within this time of each other are treated as correlated [s].
_ALIKE_S = 0.5
# Unevenness is the distance of this quantile of the ages from their median.
UNEVEN_SHARE = 0.95
# Resolution of the age [ms].
_STEP_MS = 0.5
# A stiffness counts as known if half its interval is less than this share of it.
_KNOWN_TO = 0.3
# Hysteresis and creep make a piezo move up to this share less than commanded: a contact looks softer than it is, and
# its drift faster. By noise it may look a little stiffer.
_SOFTER = 0.37
_STIFFER = 0.05
# Creep adds this share of a step per decade of time, beginning at the second value [s].
_CREEP_SHARE = 0.02
_CREEP_FROM_S = 0.1
# Steps of the base, summed over each second, are remembered for this time [s].
_STEPS_S = 240.0
_DRIFT_PARTS = 4
NEVER = -math.inf


class LineEstimate:
    """Mean and unevenness of the age of the hand's sample to which the newest answer responds."""

    def __init__(self) -> None:
        self._ages: deque[tuple[float, float]] = deque()

    def record(self, time_s: float, age_s: float) -> None:
        """Record an age [s] at a time [s]."""
        self._ages.append((time_s, 1e3 * age_s))
        while time_s - self._ages[0][0] > LINE_S:
            self._ages.popleft()

    def forget(self) -> None:
        """Forget all ages, because the next ones belong to another session."""
        self._ages.clear()

    def estimate(self) -> tuple[Estimate, Estimate] | None:
        """Return mean age and unevenness [ms]; None if there are too few ages."""
        if not self._ages or self._ages[-1][0] - self._ages[0][0] < _LINE_LEAST_S:
            return None
        times, ages = np.array(self._ages).T
        means = _means(times, ages)
        if means.size < 6:
            return None
        error = _error_of_mean(means)
        half = student(means.size - 1) * error + _STEP_MS
        mean = float(ages.mean())
        return Estimate(mean, max(0.0, mean - half), mean + half), _unevenness(ages, error)


def _unevenness(ages: Series, error: float) -> Estimate:
    """Return the unevenness, with an interval by order statistics for the effective number of independent ages."""
    count = min(float(ages.size), max(4.0, float(ages.var()) / max(error * error, 1e-12)))
    half = DEVIATIONS * math.sqrt(UNEVEN_SHARE * (1.0 - UNEVEN_SHARE) / count)
    middle = float(np.median(ages))
    shares = UNEVEN_SHARE, max(0.5, UNEVEN_SHARE - half), min(1.0, UNEVEN_SHARE + half)
    value, low, high = (float(np.quantile(ages, share)) - middle for share in shares)
    return Estimate(value, max(0.0, low - _STEP_MS), high + _STEP_MS)


def _means(times: Series, values: Series) -> Series:
    """Return the mean of the samples within each interval of `_ALIKE_S`."""
    parts = np.floor((times - times[0]) / _ALIKE_S).astype(np.int64)
    counts = np.bincount(parts)
    return np.asarray((np.bincount(parts, values) / np.maximum(counts, 1))[counts > 0], dtype=np.float64)


def _error_of_mean(means: Series) -> float:
    """Return the standard error of the mean of correlated successive means."""
    off = means - means.mean()
    square = float(off @ off)
    alike = min(max(float(off[1:] @ off[:-1]) / square, 0.0), 0.9) if square > 0.0 else 0.0
    return math.sqrt(square / (means.size - 1) / means.size * (1.0 + alike) / (1.0 - alike))


class Unknown(NamedTuple):
    """The reason why a figure is not known."""

    reason: str


class ContactEstimate:
    """Stiffness and drift of a contact, estimated from base and force."""

    def __init__(self) -> None:
        # Time [s], position of the base towards the sample [nm], force [nN].
        self._samples: deque[tuple[float, float, float]] = deque()
        # Time [s] and position of the base [nm] once a second.
        self._steps: deque[tuple[float, float]] = deque()
        self._stiffness: Estimate | None = None

    def record(self, time_s: float, base_m: float, force_n: float, *, touches: bool) -> None:
        """Record a sample; touches: whether the tip follows the hand in contact with the sample."""
        base_nm = 1e9 * base_m
        if not self._steps or time_s - self._steps[-1][0] >= 1.0 or time_s < self._steps[-1][0]:
            self._steps.append((time_s, base_nm))
        while time_s - self._steps[0][0] > _STEPS_S:
            self._steps.popleft()
        if not touches:
            self.leave()
            return
        self._samples.append((time_s, base_nm, 1e9 * force_n))
        while time_s - self._samples[0][0] > CONTACT_S:
            self._samples.popleft()

    def leave(self) -> None:
        """Forget the contact: the next may be with another sample."""
        self._samples.clear()
        self._stiffness = None

    def stiffness(self) -> Estimate | Unknown:
        """Return the latest known stiffness [N/m] of this contact, as the base meets it."""
        if len(self._samples) < 40:
            return self._stiffness or Unknown("the tip has not touched the sample for long enough")
        estimate = _stiffness(*np.array(self._samples).T)
        if estimate is not None:
            self._stiffness = estimate
        return self._stiffness or Unknown("the hand did not move enough")

    def drift(self) -> Estimate | Unknown:
        """Return the absolute speed of the contact's drift [pm/s]."""
        stiffness = self.stiffness()
        if isinstance(stiffness, Unknown):
            return stiffness
        if self._samples[-1][0] - self._samples[0][0] < _DRIFT_LEAST_S:
            return Unknown("the tip has not touched the sample for long enough")
        times, base, force = np.array(self._samples).T
        still = base - force / stiffness.value
        speed = _slope(times, still)
        parts = np.array(
            [_slope(*part) for part in zip(*(np.array_split(one, _DRIFT_PARTS) for one in (times, still)), strict=True)]
        )
        scatter = half_width(float(parts.std(ddof=1)), _DRIFT_PARTS)
        crept = 0.5 * _CREEP_SHARE * _slope(times, self._creep(times))
        softer = max(stiffness.value / stiffness.low - 1.0, 1.0 - stiffness.value / stiffness.high)
        pressed = softer * abs(_slope(times, force)) / stiffness.value
        half = 1e3 * (math.hypot(scatter, crept) + pressed)
        value = 1e3 * abs(speed + crept)
        # The base is commanded further than the piezo moves, so the true drift may be slower.
        return Estimate(value, max(0.0, value - half) * (1.0 - _SOFTER), value + half)

    def _creep(self, times: Series) -> Series:
        """Return the creep of a piezo after the steps of the base [nm], if it were the whole step per decade."""
        began, at = np.array(self._steps).T
        # Time since the step of each second.
        since = times[:, None] - began[None, 1:]
        decades = np.log10(np.maximum(since, _CREEP_FROM_S) / _CREEP_FROM_S)
        return np.asarray(decades @ np.diff(at), dtype=np.float64)


def _slope(times: Series, values: Series) -> float:
    off = times - times.mean()
    return float(off @ values / (off @ off))


def _stiffness(times: Series, base: Series, force: Series) -> Estimate | None:
    """Return the slope of force over base, apart from a linear drift, with its interval; None if it is uncertain."""
    away = _without_trend(times, base)
    square = float(away @ away)
    if square <= 0.0:
        return None
    slope = float(away @ force) / square
    left = _without_trend(times, force) - slope * away
    parts = np.floor((times - times[0]) / _ALIKE_S).astype(np.int64)
    pulls = np.bincount(parts, away * left)
    if pulls.size < 6:
        return None
    freedom = pulls.size - 3
    half = student(freedom) * math.sqrt(float(pulls @ pulls) * pulls.size / freedom) / square
    if slope <= 0.0 or half > _KNOWN_TO * slope:
        return None
    return Estimate(slope, (1.0 - _STIFFER) * (slope - half), (slope + half) / (1.0 - _SOFTER))


def _without_trend(times: Series, values: Series) -> Series:
    trend = (times - times.mean()) * _slope(times, values)
    return np.asarray(values - values.mean() - trend, dtype=np.float64)
