"""Data that the parts of an experiment exchange: a planned trial, and its outcome."""

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
        condition: The level of each factor, as in the experiment's file.
        settings: The settings of condition and task, by dotted key of a scenario.
        seed: The seed, derived from those of the experiment, the participant and the index; the runner mixes in the
            number of a repeated attempt.
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
    """The outcome of one attempt at a trial.

    Args:
        measures: The value of each measure of the task; None where it could not be judged.
        status: One of done, disturbed or aborted.
        disturbance: Disturbances that the link's truth does not explain, in words; empty if there were none.
        duration_s: Duration of the attempt [s].
        started_utc: Time of its beginning, in ISO 8601.
        recording: The path of its recording relative to the experiment's folder; empty without one.
        verified: Reports of link and law before the trial began, by key.
        answers: The participant's answers during the trial.
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
