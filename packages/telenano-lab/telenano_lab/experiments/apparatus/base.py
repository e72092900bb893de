"""An apparatus carries out a trial and has its task judge it; what it runs on is in `lockstep` and `live`."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from telenano.recording import ColumnTable
from telenano_lab.experiments.desk import AbortedError, Answers, Desk
from telenano_lab.experiments.extend import Judged, Series, TrialData
from telenano_lab.experiments.journal import now_utc
from telenano_lab.experiments.operators import SimulatedParticipant
from telenano_lab.experiments.plan import Plan, checked_document, parameters_of
from telenano_lab.experiments.types import Trial, TrialOutcome


class Take(NamedTuple):
    """One interval of a trial, as it was measured.

    Args:
        data: The tables, with times from its beginning; None where it was disturbed so that nothing can be judged.
        disturbance: What disturbed it, in words; empty for nothing.
        recording: The path of its recording from the experiment's folder; empty without one.
        verified: What link and law reported before it counted.
    """

    data: TrialData | None
    disturbance: str
    recording: str
    verified: Mapping[str, Any]


class Course(NamedTuple):
    """What an apparatus runs: the trial, the attempt, the scenario, how long [s], and the number of the interval."""

    trial: Trial
    attempt: int
    document: Mapping[str, Any]
    duration_s: float
    interval: int
    intervals: int
    parameters: Any


class Apparatus(ABC):
    """What trials run on.

    Args:
        plan: The experiment.
        desk: Tells and asks participant and experimenter.
    """

    def __init__(self, plan: Plan, desk: Desk) -> None:
        self.plan, self.desk = plan, desk

    def prepare(self, trial: Trial) -> None:
        """Bring up what a trial runs on, so that its participant can be addressed before it."""
        return

    @abstractmethod
    def take(self, course: Course) -> Take:
        """Run one interval.

        Raises:
            AbortedError: Somebody ended it.
            RigError: The apparatus cannot continue.
        """

    def close(self) -> None:
        """Give up what runs."""
        return

    def run(self, trial: Trial, attempt: int) -> TrialOutcome:
        """Carry out an attempt at a trial, whose seed is that of the attempt, and judge it."""
        task, started_utc = self.plan.tasks[trial.task], now_utc()
        parameters = parameters_of(task, trial.task_parameters)
        intervals = task.intervals(parameters, trial.seed)
        takes: list[Take] = []
        try:
            for number, interval in enumerate(intervals):
                document = self.document(trial, parameters, interval.settings)
                course = Course(trial, attempt, document, interval.duration_s, number, len(intervals), parameters)
                takes.append(self.take(course))
                if takes[-1].disturbance:
                    break
        except AbortedError as error:
            duration_s = math.fsum(interval.duration_s for interval in intervals)
            return TrialOutcome({}, "aborted", str(error), duration_s, started_utc, "", {})
        durations_s = [interval.duration_s for interval in intervals[: len(takes)]]
        parts = [take.data for take in takes if take.data is not None]
        disturbance = takes[-1].disturbance
        answers: Answers = ()
        measures: Judged = {}
        if len(parts) == len(takes):
            data = joined(parts, durations_s) if len(parts) > 1 else parts[0]
            answers = data.answers
            if not disturbance:
                answers = (*answers, *self._answers(trial, task, parameters, data))
            measures = task.judge(data._replace(answers=answers), parameters, trial.seed)
        return TrialOutcome(
            measures={name: _finite(value) for name, value in measures.items()},
            status="disturbed" if disturbance else "done",
            disturbance=disturbance,
            duration_s=math.fsum(durations_s),
            started_utc=started_utc,
            recording=";".join(take.recording for take in takes if take.recording),
            verified=dict(takes[-1].verified),
            answers=answers,
        )

    def document(self, trial: Trial, parameters: Any, interval: Mapping[str, Any]) -> dict[str, Any]:
        """Return the checked scenario of an interval: of the task, of the condition over it, and of the operator."""
        settings = {**interval, **trial.settings}
        if (hand := self.simulated(trial)) is not None:
            settings |= hand.settings(self.plan.tasks[trial.task], parameters, trial)
        origin = f"{self.plan.path}: trial {trial.index} of {trial.participant}"
        return checked_document(self.plan, trial.task, trial.task_parameters, settings, trial.seed, origin)

    def simulated(self, trial: Trial) -> SimulatedParticipant | None:
        """Return the simulated participant of a trial; None where a person does it."""
        operator = self.plan.experiment.operator
        return SimulatedParticipant(operator.profile, trial.seed) if operator.kind == "simulated" else None

    def steering(self, course: Course) -> Any:
        """Return what makes the hand that steers the tip in a course (`pushing`); None for none."""
        trial, hand = course.trial, self.simulated(course.trial)
        task = self.plan.tasks[trial.task]
        if hand is None or not hand.steers(task, course.parameters, trial.seed):
            return None
        # The particles take a second to load, which other tasks do not need.
        from telenano_lab.experiments.pushing import steering_of

        goal_m = task.target(course.parameters, trial.seed)
        assert goal_m is not None
        return steering_of(course.document, goal_m, task.band(course.parameters), hand.profile, trial.seed)

    def _answers(self, trial: Trial, task: Any, parameters: Any, data: TrialData) -> Answers:
        hand = self.simulated(trial)
        if hand is not None:
            return tuple(hand.answer(task, parameters, trial, data))
        questions = task.questions(parameters)
        return self.desk.ask(trial, questions, data) if questions else ()


def _finite(value: Any) -> Any:
    """Return a value as a journal keeps it: None for a number that is none, plain numbers for those of numpy."""
    plain = value.item() if hasattr(value, "item") else value
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain


def joined(parts: Sequence[TrialData], durations_s: Sequence[float]) -> TrialData:
    """Return the data of a trial whose intervals ran one after another: times continue, `interval` counts from 0.

    Args:
        parts: The data of each interval, with times from its own beginning.
        durations_s: How long each interval took [s].
    """
    starts = np.concatenate(([0.0], np.cumsum(durations_s)))[: len(parts)]
    afm, haptic, status = (
        _joined([getattr(part, name) for part in parts], starts) for name in ("afm", "haptic", "status")
    )
    answers = tuple(
        {**answer, "time_s": answer["time_s"] + start}
        for part, start in zip(parts, starts.tolist(), strict=True)
        for answer in part.answers
    )
    return TrialData(afm, haptic, status, answers)


def _joined(tables: Sequence[ColumnTable], starts: Series) -> ColumnTable:
    first = tables[0]
    columns = {name: np.concatenate([table[name] for table in tables]) for name in first}
    sizes = [len(table["time_s"]) for table in tables]
    columns["time_s"] = columns["time_s"] + np.repeat(starts, sizes)
    columns["interval"] = np.repeat(np.arange(len(tables)), sizes)
    units, texts = {**first.units, "interval": ""}, {**first.descriptions, "interval": "Interval of the trial, from 0"}
    return ColumnTable("a trial of several intervals", columns, units, texts)
