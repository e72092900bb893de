"""What several tasks have in common: a force that stays the same, and the size of an error."""

import math

import numpy as np

from telenano_lab.experiments.extend import Course, Series


def steady_force(force_n: float, duration_s: float) -> Course:
    """Return the target of a force [N] that stays the same over a trial [s]."""
    return Course(np.array([0.0, duration_s]), np.full(2, force_n), "force")


def rms(values: Series) -> float:
    """Return the root mean square of one or more values."""
    return math.sqrt(math.fsum((values * values).tolist()) / len(values))
