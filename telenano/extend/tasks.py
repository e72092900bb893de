"""A task of one's own for experiments: parameters, declared measures, and a pure judge of a trial."""

from pydantic import Field

from studies.tasks import (
    COMMON,
    Course,
    Interval,
    Judged,
    Measure,
    Parameters,
    Plain,
    Series,
    Task,
    TrialData,
    choice,
    common_of,
    held_from,
    scale,
    tip_of,
)

__all__ = [
    "COMMON",
    "Course",
    "Field",
    "Interval",
    "Judged",
    "Measure",
    "Parameters",
    "Plain",
    "Series",
    "Task",
    "TrialData",
    "choice",
    "common_of",
    "held_from",
    "scale",
    "tip_of",
]
