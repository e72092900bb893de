"""Section `haptic_node.lateral`: a simulated hand across the sample (`telenano.hand.lateral_hand`)."""

from itertools import pairwise
from typing import Annotated, TypeVar

import numpy as np
from pydantic import AfterValidator, Field

from telenano.hand.lateral_hand import LateralHandParams
from telenano.settings.config import Settings, filled

Across = Annotated[float, Field(ge=-0.5, le=0.5)]


class Corner(Settings):
    """One corner of a course over the time of a session."""

    time_s: float = Field(ge=0.0, le=1e9, description="Time since the session started [s]; [0, 1e9]")


C = TypeVar("C", bound=Corner)


def _increasing(corners: tuple[C, ...]) -> tuple[C, ...]:
    for index, (before, after) in enumerate(pairwise(corners), 1):
        if not after.time_s > before.time_s:
            raise ValueError(f"time_s = {after.time_s} s of corner {index} must be later than {before.time_s} s")
    return corners


# A sequence of corners, each later than the one before.
Course = Annotated[tuple[C, ...], AfterValidator(_increasing)]


class LateralPoint(Corner):
    """One corner of an intended path across."""

    x_m: Across = Field(default=0.0, description="Intended place of the hand, x [m]")
    y_m: Across = Field(default=0.0, description="Intended place of the hand, y [m]")


# The intended path of a hand across the sample; in settings: `path: LateralPath = ()`.
LateralPath = Course[LateralPoint]


class LateralHandConfig(Settings):
    """The simulated hand across the sample."""

    mass_kg: float = Field(default=0.1, ge=1e-3, le=100.0, description="Mass of the stylus m [kg]")
    damping_n_s_per_m: float = Field(
        default=40.0,
        ge=0.0,
        le=1e3,
        description="Damping of stylus and hand while a person pulls, b [N s/m]; 40 tolerates the spring of a "
        "page that is"
        " up to 0.3 s late",
    )
    free_damping_n_s_per_m: float = Field(
        default=1.5,
        ge=0.0,
        le=1e3,
        description="Damping of the stylus without a hand that pulls [N s/m]; with 1.5 the usual spring of mode rate "
        "returns it to the middle in 0.3 s without overshoot",
    )
    reach_m: float = Field(default=0.02, ge=1e-4, le=0.5, description="Reach of the stylus either way [m]")
    max_force_n: float = Field(
        default=5.0,
        gt=0.0,
        le=100.0,
        description="Greatest force with which person and controller each pull [N]; (0, 100]",
    )
    stiffness_n_per_m: float = Field(
        default=200.0, ge=0.0, le=1e5, description="Spring by which the person draws the stylus to the path below [N/m]"
    )
    path: Annotated[LateralPath, Field(strict=False)] = Field(
        default=(), max_length=10_000, description="Corners of the intended path, linear between; none: no person"
    )

    def to_params(self) -> LateralHandParams:
        """Return the constants of the step, with the path as arrays of times [s] and places [m]."""
        columns = np.array([(point.time_s, point.x_m, point.y_m) for point in self.path], np.float64).reshape(-1, 3)
        times, x, y = (np.ascontiguousarray(column) for column in columns.T)
        return filled(LateralHandParams, self, times_s=times, path_x_m=x, path_y_m=y)
