"""Functions that several tasks share: a constant target force, and the size of an error."""

import math

import numpy as np

from telenano_lab.experiments.extend import Course, Series


def steady_force(force_n: float, duration_s: float) -> Course:
    """Return a constant target force [N] over the duration of a trial [s]."""
    return Course(np.array([0.0, duration_s]), np.full(2, force_n), "force")


def rms(values: Series) -> float:
    """Return the root mean square of an array that is not empty."""
    return math.sqrt(math.fsum((values * values).tolist()) / len(values))
