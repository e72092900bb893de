"""Task: track a moving target in force or position, a sum of sines; measures are the error and the lag."""

import math
import random
from typing import Literal

import numpy as np
from pydantic import Field

from telenano_lab.experiments.extend import (
    COMMON,
    Course,
    Judged,
    Measure,
    Parameters,
    Plain,
    Series,
    TrialData,
    common_of,
    tip_of,
)
from telenano_lab.experiments.tasks.common import rms

# Distance of the target's corners [s]; at 1 Hz, its fastest sine, the error is 1 % of the amplitude.
_CORNER_S = 0.05
_GRID_S = 0.02
_LONGEST_LAG_S = 2.0


class Track(Parameters):
    """Parameters of the task."""

    quantity: Literal["force", "position"] = Field(
        "force", description="Quantity that follows the target: force on the tip, or position of the base"
    )
    centre: float = Field(10e-9, ge=-1e-5, le=1e-5, description="Middle of the target [N] or [m]")
    amplitude: float = Field(
        5e-9, gt=0.0, le=1e-5, description="Greatest distance of the target from its middle [N] or [m]"
    )
    frequencies_hz: tuple[float, ...] = Field(
        (0.1, 0.17, 0.29), min_length=1, max_length=12, description="Frequencies of the target's sines [Hz], up to 1"
    )
    duration_s: float = Field(20.0, ge=4.0, le=600.0, description="Duration of a trial [s]")
    lead_in_s: float = Field(3.0, ge=0.0, le=60.0, description="Time at the beginning that is not judged [s]")
    on_target: float = Field(
        0.25, gt=0.0, description="Error that counts as on the target, as a share of the amplitude"
    )


def sum_of_sines(p: Track, seed: int) -> Course:
    """Return the target of a trial: sines of equal amplitude with phases from the seed.

    It begins at its middle and is faded in over the first second.
    """
    draw = random.Random(f"track {seed}")
    phases = [draw.uniform(0.0, 2.0 * math.pi) for _ in p.frequencies_hz]
    times: Series = np.arange(round(p.duration_s / _CORNER_S) + 1, dtype=np.float64) * _CORNER_S
    values: Series = np.zeros(len(times))
    for frequency, phase in zip(p.frequencies_hz, phases, strict=True):
        values = values + np.sin(2.0 * math.pi * frequency * times + phase)
    blend = np.minimum(1.0, times)
    return Course(times, p.centre + p.amplitude / len(phases) * blend * values, p.quantity)


def lag_s(target: Series, followed: Series, period_s: float) -> float | None:
    """Return the lag of a course behind its target, the maximum of their normalised cross-correlation [s].

    Each lag is evaluated over the overlap of both, and the maximum is refined by a parabola. None is returned if either
    is constant.

    Args:
        target: The target, evenly sampled, shape (n,).
        followed: The course that follows it, sampled alike, shape (n,).
        period_s: The sampling period [s].
    """
    most = min(round(_LONGEST_LAG_S / period_s), len(target) // 2)
    correlations = [_correlation(target[: len(target) - k], followed[k:]) for k in range(most + 1)]
    if not correlations or any(value is None for value in correlations):
        return None
    values = [float(value) for value in correlations if value is not None]
    best = max(range(len(values)), key=values.__getitem__)
    if not 0 < best < len(values) - 1:
        return best * period_s
    before, at, after = values[best - 1 : best + 2]
    curvature = before - 2.0 * at + after
    return period_s * (best + (0.5 * (before - after) / curvature if curvature < 0.0 else 0.0))


def _correlation(a: Series, b: Series) -> float | None:
    a, b = a - math.fsum(a.tolist()) / len(a), b - math.fsum(b.tolist()) / len(b)
    size = math.sqrt(math.fsum((a * a).tolist()) * math.fsum((b * b).tolist()))
    return math.fsum((a * b).tolist()) / size if size > 0.0 else None


class _Task(Plain):
    name = "track"
    title = "Track a moving target"
    parameters = Track
    measures = (
        Measure("rms_force_error_n", "N", "Root mean square of the error, where the target is a force"),
        Measure("rms_position_error_m", "m", "Root mean square of the error, where the target is a position"),
        Measure("relative_error", "", "Root mean square of the error over that of the target about its middle"),
        Measure("lag_s", "s", "Lag behind the target, the maximum of the cross-correlation"),
        Measure("on_target", "", "Share of the time on the target"),
        *COMMON,
    )

    def duration_s(self, p: Track) -> float:
        return p.duration_s

    def instruction(self, p: Track) -> str:
        what = "force on the tip" if p.quantity == "force" else "tip"
        return f"Keep the {what} on the target, which moves, as well as you can."

    def target(self, p: Track, seed: int) -> Course:
        return sum_of_sines(p, seed)

    def band(self, p: Track) -> float:
        return p.on_target * p.amplitude

    def judge(self, data: TrialData, p: Track, seed: int) -> Judged:
        tip, course = tip_of(data), sum_of_sines(p, seed)
        measures: Judged = dict.fromkeys(
            ("rms_force_error_n", "rms_position_error_m", "relative_error", "lag_s", "on_target")
        )
        measures.update(common_of(data))
        grid = np.arange(p.lead_in_s, min(p.duration_s, float(tip.time_s.max(initial=0.0))), _GRID_S)
        if grid.size < round(2.0 / _GRID_S):
            return measures
        value = np.interp(grid, tip.time_s, tip.force_n if p.quantity == "force" else tip.base_m)
        target = course.at(grid)
        error, about = value - target, target - p.centre
        size = rms(error)
        measures["rms_force_error_n" if p.quantity == "force" else "rms_position_error_m"] = size
        measures["relative_error"] = size / rms(about)
        measures["on_target"] = float(np.count_nonzero(np.abs(error) <= self.band(p))) / grid.size
        measures["lag_s"] = lag_s(target, value, _GRID_S)
        return measures


TRACK = _Task()
