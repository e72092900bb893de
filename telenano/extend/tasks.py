"""A task of one's own for experiments: parameters, declared measures, and a pure judge of a trial."""

from pydantic import Field

from studies.experiments.asked import choice, scale
from studies.experiments.tasks.base import (
    COMMON,
    Course,
    Interval,
    Judged,
    Measure,
    Parameters,
    Plain,
    common_of,
    held_from,
    tip_of,
)
from studies.experiments.types import TrialData

__all__ = [
    "COMMON",
    "Course",
    "Field",
    "Interval",
    "Judged",
    "Measure",
    "Parameters",
    "Plain",
    "TrialData",
    "choice",
    "common_of",
    "held_from",
    "scale",
    "tip_of",
]
