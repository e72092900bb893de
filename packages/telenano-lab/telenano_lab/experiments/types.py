"""What the parts of an experiment give each other: a planned trial, what was measured in it, and what came of it."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.recording import ColumnTable


class Trial(NamedTuple):
    """One planned trial.

    Args:
        participant: The pseudonym, such as P01.
        session: The number of the participant's visit, from 1.
        block: The number of the block in the session, from 0; practice is a block of its own.
        index: The number of the trial over all of the participant's sessions, from 0.
        phase: Either practice or main.
        task: The name of the task in the registry.
        task_parameters: The parameters of the task, checked by its own model.
        condition: The level of each factor, as the experiment's file has it.
        settings: What the condition and the task mean, by dotted key of a scenario.
        seed: The seed that follows from those of the experiment, the participant and the index; a repeated attempt
            has another one, which the runner mixes in.
    """

    participant: str
    session: int
    block: int
    index: int  # type: ignore[assignment]
    phase: str
    task: str
    task_parameters: Mapping[str, Any]
    condition: Mapping[str, Any]
    settings: Mapping[str, Any]
    seed: int


class TrialOutcome(NamedTuple):
    """What came of one attempt at a trial.

    Args:
        measures: The value of each measure of the task; None where it could not be judged.
        status: One of done, disturbed or aborted.
        disturbance: What the truth of the link cannot explain, in words; empty where the trial was not disturbed.
        duration_s: How long the attempt took [s].
        started_utc: When it began, in ISO 8601.
        recording: The path of its recording from the experiment's folder, empty where there is none.
        verified: What link and law reported before the trial counted, by key.
        answers: What the participant answered during the trial.
    """

    measures: Mapping[str, float | bool | str | None]
    status: str
    disturbance: str
    duration_s: float
    started_utc: str
    recording: str
    verified: Mapping[str, Any]
    answers: tuple[Mapping[str, Any], ...] = ()


def particle_table(time_s: npt.NDArray[Any], x_m: npt.NDArray[Any], y_m: npt.NDArray[Any]) -> ColumnTable:
    """Return the table `particles` of a trial: times [s] and places [m], shape (n,) each."""
    columns = {"time_s": np.asarray(time_s), "x_m": np.asarray(x_m), "y_m": np.asarray(y_m)}
    texts = {"time_s": "Time since the trial began", "x_m": "Centre of the particle", "y_m": "Centre of the particle"}
    return ColumnTable("particles", columns, {"time_s": "s", "x_m": "m", "y_m": "m"}, texts)
