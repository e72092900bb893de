"""Task: push a particle to a target; measures are its final distance, the time, and the lateral force.

Only a simulation knows the true place of the particle (`afm/particles`), by which the trial is judged; no participant
is told it. The table `particles` has this place over time, `x_m` and `y_m`.
"""

import math
import random
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field

from telenano_lab.experiments.extend import COMMON, Course, Judged, Measure, Parameters, Plain, TrialData, common_of


class PushParticle(Parameters):
    """Parameters of the task."""

    way_m: float = Field(500e-9, gt=0.0, le=1e-5, description="Distance of the target from the particle [m]")
    tolerance_m: float = Field(
        100e-9, gt=0.0, le=1e-6, description="Distance to the target at which the particle counts as arrived [m]"
    )
    limit_s: float = Field(40.0, gt=0.0, le=600.0, description="Duration of a trial [s]")
    preset: str = Field("latex_250", description="Kind of particle, see afm_node.sample.particles.preset")


# Start of the particle [m]; the tip starts beside it, at 0, 0.
PLACE_M = (700e-9, 0.0)


def goal_of(p: PushParticle, seed: int) -> tuple[float, float]:
    """Return the target of a trial [m], in a direction from the particle that depends on the seed."""
    bearing = random.Random(f"push {seed}").uniform(-math.pi, math.pi)
    return PLACE_M[0] + p.way_m * math.cos(bearing), PLACE_M[1] + p.way_m * math.sin(bearing)


class _Task(Plain):
    name = "push_particle"
    title = "Push a particle to a target"
    parameters = PushParticle
    measures = (
        Measure("placing_error_m", "m", "Distance of the particle from its target at the end"),
        Measure(
            "completion_time_s", "s", "Time from which on the particle stays at its target; none where it does not"
        ),
        Measure("tip_path_m", "m", "Length of the way of the tip across the sample"),
        Measure("peak_lateral_force_n", "N", "Largest force across the tip"),
        *COMMON,
        Measure("success", "", "Whether the particle is at its target at the end"),
    )

    def duration_s(self, p: PushParticle) -> float:
        return p.limit_s

    def instruction(self, p: PushParticle) -> str:
        return "Push the particle into the circle with the tip, and leave it there."

    def target(self, p: PushParticle, seed: int) -> Course:
        return Course(np.array([0.0, p.limit_s]), np.array([goal_of(p, seed)] * 2), "place")

    def band(self, p: PushParticle) -> float:
        return p.tolerance_m

    def settings(self, p: PushParticle, seed: int) -> Mapping[str, Any]:
        """Return a sample with one particle, an instrument that pushes it, and a hand across it."""
        particles = {"preset": p.preset, "places": [list(PLACE_M)]}
        return {
            "afm_node.sample": {"name": "flat", "size_m": 8e-6, "pixels": 16, "particles": particles},
            # In dry air, because a meniscus would hold the tip of so soft a cantilever.
            "afm_node.cantilever.stiffness_n_per_m": 10.0,
            "afm_node.meniscus": False,
            # A retracted tip clears the particle.
            "afm_node.safety": {
                "base_min_m": -1.2e-6,
                "retract_position_m": -0.7e-6,
                "base_max_m": 0.3e-6,
                "base_speed_m_per_s": 20.0e-6,
                "retract_speed_m_per_s": 20.0e-6,
            },
            "controller.lateral.mode": "rate",
            "haptic_node.lateral.mass_kg": 0.1,
        }

    def judge(self, data: TrialData, p: PushParticle, seed: int) -> Judged:
        measures: Judged = dict.fromkeys(("placing_error_m", "completion_time_s", "tip_path_m", "peak_lateral_force_n"))
        measures.update(common_of(data))
        measures["success"] = None
        afm, places = data.afm, getattr(data, "particles", None)
        if "base_position_m.0" in afm:
            steps = np.diff(afm["base_position_m.0"]) ** 2 + np.diff(afm["base_position_m.1"]) ** 2
            measures["tip_path_m"] = math.fsum(np.sqrt(steps).tolist())
        if "tip_force_n.0" in afm:
            across = np.sqrt(afm["tip_force_n.0"] ** 2 + afm["tip_force_n.1"] ** 2)
            measures["peak_lateral_force_n"] = float(across.max(initial=0.0))
        if places is None or not places["time_s"].size:
            return measures
        goal_x_m, goal_y_m = goal_of(p, seed)
        away_m = np.sqrt((places["x_m"] - goal_x_m) ** 2 + (places["y_m"] - goal_y_m) ** 2)
        measures["placing_error_m"] = float(away_m[-1])
        measures["success"] = bool(away_m[-1] <= p.tolerance_m)
        if measures["success"]:
            last_away = np.flatnonzero(away_m > p.tolerance_m)
            arrived = int(last_away[-1]) + 1 if last_away.size else 0
            measures["completion_time_s"] = float(places["time_s"][arrived])
        return measures


PUSH_PARTICLE = _Task()
