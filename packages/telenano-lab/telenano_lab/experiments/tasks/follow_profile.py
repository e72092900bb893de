"""Task: follow a profile. The tip moves across a grating while the participant keeps a force on it."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field

from telenano_lab.experiments.extend import (
    COMMON,
    Course,
    Judged,
    Measure,
    Parameters,
    Plain,
    TrialData,
    common_of,
    tip_of,
)
from telenano_lab.experiments.tasks.common import rms, steady_force


class FollowProfile(Parameters):
    """Parameters of the task."""

    force_n: float = Field(10e-9, gt=0.0, le=1e-6, description="Force on the tip that the hand has to keep [N]")
    band: float = Field(
        0.3, gt=0.0, lt=1.0, description="Half the width of the band about that force, as a share of it"
    )
    period_m: float = Field(200e-9, gt=0.0, le=1e-5, description="Period of the grating [m]")
    height_m: float = Field(5e-9, gt=0.0, le=1e-6, description="Height of the grating's ridges [m]")
    way_m: float = Field(800e-9, gt=0.0, le=1e-5, description="Way across the grating [m]")
    duration_s: float = Field(24.0, gt=1.0, le=600.0, description="Duration of a trial [s]")
    lead_in_s: float = Field(
        4.0, ge=0.0, le=60.0, description="Time in which the hand reaches the force, not judged [s]"
    )
    contact_n: float = Field(1e-9, gt=0.0, le=1e-6, description="Force below which contact counts as lost [N]")


class _Task(Plain):
    name = "follow_profile"
    title = "Follow a profile"
    parameters = FollowProfile
    measures = (
        Measure("force_error_n", "N", "Root mean square of the difference to the force that is to be kept"),
        Measure("in_band", "", "Share of the time in the band"),
        Measure("lost_contact", "", "Share of the time without contact"),
        Measure("height_range_m", "m", "Range of the base while the tip went across: what the hand followed"),
        Measure("way_m", "m", "Way that the tip went across; none where the table has no such place"),
        *COMMON,
        Measure("success", "", "Whether contact was kept for 95 % of the time"),
    )

    def duration_s(self, p: FollowProfile) -> float:
        return p.duration_s

    def instruction(self, p: FollowProfile) -> str:
        return (
            f"The tip goes across a sample with ridges. Keep {1e9 * p.force_n:g} nN on it: give way where it rises, and"
            " follow where it falls."
        )

    def target(self, p: FollowProfile, seed: int) -> Course:
        return steady_force(p.force_n, p.duration_s)

    def band(self, p: FollowProfile) -> float:
        return p.band * p.force_n

    def settings(self, p: FollowProfile, seed: int) -> Mapping[str, Any]:
        """Return the grating, and a hand across it that goes along x at a constant speed."""
        scale = 5e-5
        half = 0.5 * p.way_m / scale
        ends = [{"time_s": p.lead_in_s, "x_m": -half}, {"time_s": p.duration_s, "x_m": half}]
        size_m = 2.0 * p.way_m
        return {
            "afm_node.sample": {
                "name": "grating",
                "size_m": size_m,
                "pixels": 256,
                "period_m": p.period_m,
                "height_m": p.height_m,
            },
            # The lateral hand feels no force, because sticking to a ridge and leaping over it is another task.
            "controller.lateral": {"mode": "position", "position_scale": scale, "force_scale": 1e3, "pulse_n": 0.0},
            "haptic_node.lateral": {"path": ends, "reach_m": max(0.02, 1.1 * half)},
        }

    def judge(self, data: TrialData, p: FollowProfile, seed: int) -> Judged:
        tip = tip_of(data)
        judged = tip.time_s >= p.lead_in_s
        force_n, base_m = tip.force_n[judged], tip.base_m[judged]
        measures: Judged = dict.fromkeys(("force_error_n", "in_band", "lost_contact", "height_range_m", "way_m"))
        measures.update(common_of(data))
        measures["success"] = False
        if force_n.size == 0:
            return measures
        error = force_n - p.force_n
        lost = float(np.count_nonzero(force_n < p.contact_n)) / force_n.size
        measures["force_error_n"] = rms(error)
        measures["in_band"] = float(np.count_nonzero(np.abs(error) <= self.band(p))) / error.size
        measures["lost_contact"] = lost
        measures["height_range_m"] = float(base_m.max() - base_m.min())
        measures["success"] = lost <= 0.05
        if "base_position_m.0" in data.afm:
            x_m = data.afm["base_position_m.0"][judged]
            measures["way_m"] = math.fsum(np.abs(np.diff(x_m)).tolist())
        return measures


FOLLOW_PROFILE = _Task()
