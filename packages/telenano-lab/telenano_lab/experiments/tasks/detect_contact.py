"""Task: report the touch of the tip; the measure is the time from the touch at the sample to the answer."""

from typing import Any

import numpy as np
from pydantic import Field

from telenano_lab.experiments.extend import (
    COMMON,
    Judged,
    Measure,
    Parameters,
    Plain,
    TrialData,
    choice,
    common_of,
    tip_of,
)
from telenano_lab.experiments.messages import Question

# Name of the answer that a button gives during the trial.
CONTACT = "contact"


class DetectContact(Parameters):
    """Parameters of the task."""

    contact_n: float = Field(
        1e-9, gt=0.0, le=1e-6, description="Force on the tip from which on it counts as touching [N]"
    )
    limit_s: float = Field(10.0, gt=0.0, le=600.0, description="Duration of a trial [s]")
    window_s: float = Field(2.0, gt=0.0, le=60.0, description="Longest time from touch to answer that counts [s]")


class _Task(Plain):
    name = "detect_contact"
    title = "Detect contact"
    parameters = DetectContact
    measures = (
        Measure("contact_time_s", "s", "Time until the tip touched"),
        Measure("detection_time_s", "s", "From the touch to the answer; none where there was no touch or no answer"),
        Measure("detection_force_n", "N", "Force on the tip when the answer came"),
        Measure("false_alarm", "", "Whether the answer came before the touch"),
        *COMMON,
        Measure("success", "", "Whether the touch was detected within the window"),
    )

    def duration_s(self, p: DetectContact) -> float:
        return p.limit_s

    def instruction(self, p: DetectContact) -> str:
        return (
            "Move the tip slowly towards the sample. Press the space bar, or the button, as soon as you feel the touch."
        )

    def questions_during(self, p: Any) -> tuple[Question, ...]:
        return (choice(CONTACT, "Press at the touch", ("I feel it",)),)

    def judge(self, data: TrialData, p: DetectContact, seed: int) -> Judged:
        tip = tip_of(data)
        touched = np.flatnonzero(np.abs(tip.force_n) >= p.contact_n)
        contact_s = float(tip.time_s[touched[0]]) if touched.size else None
        answered_s = next((float(a["time_s"]) for a in data.answers if a["name"] == CONTACT), None)
        measures: Judged = {
            "contact_time_s": contact_s,
            "detection_time_s": None,
            "detection_force_n": None,
            "false_alarm": answered_s is not None and (contact_s is None or answered_s < contact_s),
            **common_of(data),
            "success": False,
        }
        if answered_s is not None and contact_s is not None and answered_s >= contact_s:
            measures["detection_time_s"] = answered_s - contact_s
            measures["detection_force_n"] = float(np.interp(answered_s, tip.time_s, tip.force_n))
            measures["success"] = answered_s - contact_s <= p.window_s
        return measures


DETECT_CONTACT = _Task()
