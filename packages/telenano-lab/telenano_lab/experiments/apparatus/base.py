"""Base of the apparatus: carry out a trial and have its task judge it; `lockstep` and `live` implement it."""

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
    """The data of one interval of a trial.

    Args:
        data: The tables, with times from its beginning; None if a disturbance makes it impossible to judge.
        disturbance: The disturbance, in words; empty for none.
        recording: The path of its recording relative to the experiment's folder; empty without one.
        verified: Reports of link and law before it began.
    """

    data: TrialData | None
    disturbance: str
    recording: str
    verified: Mapping[str, Any]


class Course(NamedTuple):
    """The interval to run: trial, attempt, scenario, duration [s], its number, count of intervals, task parameters."""

    trial: Trial
    attempt: int
    document: Mapping[str, Any]
    duration_s: float
    interval: int
    intervals: int
    parameters: Any


class Apparatus(ABC):
    """The apparatus on which trials run.

    Args:
        plan: The experiment.
        desk: Communicates with participant and experimenter.
    """

    def __init__(self, plan: Plan, desk: Desk) -> None:
        self.plan, self.desk = plan, desk

    def prepare(self, trial: Trial) -> None:
        """Start the apparatus for a trial, so that its participant can be addressed before it."""
        return

    @abstractmethod
    def take(self, course: Course) -> Take:
        """Run one interval.

        Raises:
            AbortedError: The experimenter ended it.
            RigError: The apparatus cannot continue.
        """

    def close(self) -> None:
        """Stop the apparatus."""
        return

    def run(self, trial: Trial, attempt: int) -> TrialOutcome:
        """Carry out and judge an attempt at a trial; the trial's seed must be that of the attempt."""
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
        """Return the checked scenario of an interval; the condition's keys, then the operator's, override its own."""
        settings = {**interval, **trial.settings}
        if (hand := self.simulated(trial)) is not None:
            settings |= hand.settings(self.plan.tasks[trial.task], parameters, trial)
        origin = f"{self.plan.path}: trial {trial.index} of {trial.participant}"
        return checked_document(self.plan, trial.task, trial.task_parameters, settings, trial.seed, origin)

    def simulated(self, trial: Trial) -> SimulatedParticipant | None:
        """Return the simulated participant of a trial; None if a person takes part."""
        operator = self.plan.experiment.operator
        return SimulatedParticipant(operator.profile, trial.seed) if operator.kind == "simulated" else None

    def steering(self, course: Course) -> Any:
        """Return a function that makes the hand which steers the tip in a course (`pushing`); None if none does."""
        trial, hand = course.trial, self.simulated(course.trial)
        task = self.plan.tasks[trial.task]
        if hand is None or not hand.steers(task, course.parameters, trial.seed):
            return None
        # Importing the particles takes a second, which other tasks do not need.
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
    """Return a value for the journal: NumPy scalars as Python numbers, and None for a float that is not finite."""
    plain = value.item() if hasattr(value, "item") else value
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain


def joined(parts: Sequence[TrialData], durations_s: Sequence[float]) -> TrialData:
    """Return the data of a trial of several intervals: times continue, and `interval` counts from 0.

    Args:
        parts: The data of each interval, with times from its own beginning.
        durations_s: The duration of each interval [s].
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
