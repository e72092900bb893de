"""Task: tell which of two samples, felt one after the other, is stiffer (two-interval forced choice, 2AFC)."""

import random
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field

from telenano_lab.experiments.extend import (
    COMMON,
    Interval,
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

# The name of the answer, and its values.
ANSWER = "stiffer"
FIRST = "first"
SECOND = "second"


class DiscriminateStiffness(Parameters):
    """Parameters of the task."""

    standard_n_per_m: float = Field(20.0, gt=0.0, le=1e4, description="Stiffness of the standard [N/m]")
    ratio: float = Field(1.3, ge=1.0, le=10.0, description="Stiffness of the comparison over that of the standard")
    interval_s: float = Field(4.0, gt=0.0, le=120.0, description="Time for which each of the two is felt [s]")
    rest_position_m: float = Field(
        10e-9, ge=0.0, le=1e-6, description="Way of the base from its rest until the tip touches [m]"
    )


def comparison_is_first(seed: int) -> bool:
    """Return whether the stiffer sample comes first in a trial with this seed."""
    return random.Random(f"2afc {seed}").random() < 0.5


class _Task(Plain):
    name = "discriminate_stiffness"
    title = "Which one is stiffer?"
    parameters = DiscriminateStiffness
    measures = (
        Measure("correct", "", "Whether the stiffer one was chosen; none without an answer"),
        Measure("chose_first", "", "Whether the first one was chosen"),
        Measure("comparison_first", "", "Whether the stiffer one came first"),
        Measure("answer_time_s", "s", "When the answer was given, since the trial began"),
        Measure("first_peak_force_n", "N", "Largest force on the tip in the first interval"),
        Measure("second_peak_force_n", "N", "Largest force on the tip in the second interval"),
        *COMMON,
    )

    def duration_s(self, p: DiscriminateStiffness) -> float:
        return 2.0 * p.interval_s

    def instruction(self, p: DiscriminateStiffness) -> str:
        return (
            f"You feel two samples one after the other, each for {p.interval_s:g} s. Press each as you like, and then"
            " say which one was stiffer."
        )

    def settings(self, p: DiscriminateStiffness, seed: int) -> Mapping[str, Any]:
        return {
            "afm_node.environment": "spring",
            "afm_node.spring.bilateral": False,
            "afm_node.spring.rest_position_m": p.rest_position_m,
        }

    def intervals(self, p: DiscriminateStiffness, seed: int) -> tuple[Interval, ...]:
        pair = p.standard_n_per_m, p.standard_n_per_m * p.ratio
        order = pair[::-1] if comparison_is_first(seed) else pair
        return tuple(Interval(p.interval_s, {"afm_node.spring.stiffness_n_per_m": each}) for each in order)

    def questions(self, p: Any) -> tuple[Question, ...]:
        return (choice(ANSWER, "Which one was stiffer?", (FIRST, SECOND)),)

    def judge(self, data: TrialData, p: DiscriminateStiffness, seed: int) -> Judged:
        tip, first = tip_of(data), comparison_is_first(seed)
        answer = next((a for a in data.answers if a["name"] == ANSWER), None)
        chose_first = None if answer is None else answer["value"] == FIRST
        second = data.afm["interval"] > 0 if "interval" in data.afm else tip.time_s >= p.interval_s
        peaks = [float(np.max(tip.force_n[part], initial=0.0)) for part in (~second, second)]
        return {
            "correct": None if chose_first is None else chose_first == first,
            "chose_first": chose_first,
            "comparison_first": first,
            "answer_time_s": None if answer is None else float(answer["time_s"]),
            "first_peak_force_n": peaks[0],
            "second_peak_force_n": peaks[1],
            **common_of(data),
        }


DISCRIMINATE_STIFFNESS = _Task()
