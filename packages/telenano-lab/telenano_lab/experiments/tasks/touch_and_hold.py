"""Task: touch the sample and hold a force; measures are the settling time into a band about it, and its error."""

import math

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
    held_from,
    tip_of,
)
from telenano_lab.experiments.tasks.common import rms, steady_force


class TouchAndHold(Parameters):
    """Parameters of the task."""

    force_n: float = Field(10e-9, gt=0.0, le=1e-6, description="Force on the tip that the hand has to hold [N]")
    band: float = Field(
        0.15, gt=0.0, lt=1.0, description="Half the width of the band about that force, as a share of it"
    )
    hold_s: float = Field(1.0, gt=0.0, le=60.0, description="Time for which the force has to stay in the band [s]")
    limit_s: float = Field(12.0, gt=0.0, le=600.0, description="Duration of a trial [s]")
    contact_n: float = Field(
        1e-9, gt=0.0, le=1e-6, description="Force on the tip from which on it counts as touching [N]"
    )


class _Task(Plain):
    name = "touch_and_hold"
    title = "Touch and hold a force"
    parameters = TouchAndHold
    measures = (
        Measure("completion_time_s", "s", "Time until the force stays in the band, the hold itself not included"),
        Measure("contact_time_s", "s", "Time until the first touch"),
        Measure("settling_time_s", "s", "From the first touch until the force stays in the band"),
        Measure("mean_force_n", "N", "Mean force over the hold"),
        Measure("force_error_n", "N", "Root mean square of the difference to the target over the hold"),
        Measure("overshoot_n", "N", "How far the largest force was above the target; 0 where it was not"),
        *COMMON,
        Measure("success", "", "Whether the force was held within the time"),
    )

    def duration_s(self, p: TouchAndHold) -> float:
        return p.limit_s

    def instruction(self, p: TouchAndHold) -> str:
        return (
            f"Press the tip onto the sample until the force is {1e9 * p.force_n:g} nN, as fast as you can, and keep it"
            " within the band until the time is over."
        )

    def target(self, p: TouchAndHold, seed: int) -> Course:
        return steady_force(p.force_n, p.limit_s)

    def band(self, p: TouchAndHold) -> float:
        return p.band * p.force_n

    def judge(self, data: TrialData, p: TouchAndHold, seed: int) -> Judged:
        tip, common = tip_of(data), common_of(data)
        touched = np.flatnonzero(tip.force_n >= p.contact_n)
        contact_s = float(tip.time_s[touched[0]]) if touched.size else None
        settled_s = held_from(tip.time_s, np.abs(tip.force_n - p.force_n) <= p.band * p.force_n, p.hold_s)
        peak_n = common["peak_force_n"]
        measures: Judged = {
            "completion_time_s": settled_s,
            "contact_time_s": contact_s,
            "settling_time_s": None if settled_s is None or contact_s is None else settled_s - contact_s,
            "mean_force_n": None,
            "force_error_n": None,
            "overshoot_n": None if peak_n is None else max(0.0, peak_n - p.force_n),
            **common,
            "success": settled_s is not None,
        }
        if settled_s is not None:
            held_n = tip.force_n[(tip.time_s >= settled_s) & (tip.time_s <= settled_s + p.hold_s)]
            measures["mean_force_n"] = math.fsum(held_n.tolist()) / held_n.size
            measures["force_error_n"] = rms(held_n - p.force_n)
        return measures


TOUCH_AND_HOLD = _Task()
