"""A tiny task, an apparatus in no time, and a plan for the tests of experiments; nothing is compiled."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field
from telenano_lab.experiments import tasks
from telenano_lab.experiments.apparatus.base import Apparatus, Course, Take
from telenano_lab.experiments.apparatus.lockstep import empty
from telenano_lab.experiments.desk import Desk
from telenano_lab.experiments.extend import Judged, Measure, Parameters, Plain, Task, TrialData
from telenano_lab.experiments.plan import Plan, load_plan


class Tiny(Parameters):
    """Parameters of the task."""

    length_s: float = Field(2.0, gt=0.0, description="How long a trial takes [s]")
    level: float = Field(0.0, description="What an adaptive method sets")


class _Task(Plain):
    name = "tiny"
    title = "Tiny"
    parameters = Tiny
    measures = (Measure("time_s", "s", "A time"), Measure("correct", "", "Whether the level was above 1"))

    def duration_s(self, p: Tiny) -> float:
        return p.length_s

    def instruction(self, p: Tiny) -> str:
        return "Do it."

    def settings(self, p: Tiny, seed: int) -> Mapping[str, Any]:
        return {"afm_node.rest_distance_m": 2e-8}

    def judge(self, data: TrialData, p: Tiny, seed: int) -> Judged:
        return {"time_s": p.length_s + 1e-10 * seed, "correct": p.level > 1.0}


class Other(_Task):
    """A second task."""

    name = "other"


TASKS = {"tiny": _Task(), "other": Other()}
DATA = TrialData(empty("afm/state"), empty("haptic/state"), empty("law/status"))


def task_named(name: str, parameters: Mapping[str, Any]) -> tuple[Task, Parameters]:
    """Return a task of the project with its parameters."""
    return tasks.TASKS[name], tasks.TASKS[name].parameters(**parameters)


class Bench(Apparatus):
    """An apparatus that takes no time; `disturb` says of a trial and an attempt what disturbed it."""

    def __init__(self, plan: Plan, desk: Desk | None = None) -> None:
        super().__init__(plan, desk or Desk(plan))
        self.taken: list[Course] = []
        self.disturbed: dict[tuple[str, int, int], str] = {}

    def take(self, course: Course) -> Take:
        self.taken.append(course)
        trial = course.trial
        text = self.disturbed.get((trial.participant, trial.index, course.attempt), "")
        return Take(DATA, text, "", {"law": course.document["controller"]["law"]})

    def document(self, trial: Any, parameters: Any, interval: Any) -> dict[str, Any]:
        """Return the scenario unchecked: that takes most of the time of a test."""
        return self.plan.document(
            {**self.plan.tasks[trial.task].settings(parameters, trial.seed), **trial.settings}, ""
        )

    def simulated(self, trial: Any) -> None:
        """Return no hand: what it does is tested with the tasks."""


DOCUMENT: dict[str, Any] = {
    "name": "tiny",
    "scenario": "fig12",
    "seed": 5,
    "participants": 2,
    "tasks": ["tiny"],
    "factors": {"law": ["wave", "passivity"], "round_trip_ms": [0, 40, 80]},
}


def plan_of(folder: Path, known: Mapping[str, Task] = TASKS, **changes: Any) -> Plan:
    """Return a plan with some keys of its file changed."""
    path = folder / "experiment.yaml"
    path.write_text(yaml.safe_dump({**DOCUMENT, **changes}, sort_keys=False), encoding="utf-8")
    return load_plan(path, known)
