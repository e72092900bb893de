"""Interface for tasks of other packages: parameters, instruction, target, settings, measures, and a pure judge.

A task judges tables with the columns of the bus (`TrialData`), so it cannot tell a recording from lockstep. The force
of a task is the force on the tip [N]; the hand feels it scaled by the law.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict
from pydantic import Field as Field

from telenano.recording import ColumnTable
from telenano.wire import made
from telenano_lab.experiments.messages import Question

Series = npt.NDArray[np.float64]
Judged = dict[str, float | bool | None]
Quantity = Literal["none", "force", "position", "place"]


class TrialData(NamedTuple):
    """The data that a task judges, equal for recording and lockstep; the tables have the columns of the bus.

    Args:
        afm: The messages of afm/state.
        haptic: The messages of haptic/state.
        status: The messages of law/status, with the energies at the ports.
        answers: The participant's answers: name, value and time_s, the time since the trial began [s].
        particles: True place of the first particle of a simulation: time_s, x_m, y_m; None without particles.
    """

    afm: ColumnTable
    haptic: ColumnTable
    status: ColumnTable
    answers: tuple[Mapping[str, Any], ...] = ()
    particles: ColumnTable | None = None


class Measure(NamedTuple):
    """A declared outcome: its name in the table, its SI unit or an empty string, and its description."""

    name: str
    unit: str
    description: str


class Course(NamedTuple):
    """A target over the time of a trial, linear between its corners.

    Args:
        times_s: The times of the corners since the trial began [s], increasing, shape (n,).
        values: The target [N] or [m], shape (n,); x and y of a place, shape (n, 2).
        quantity: The quantity that is to follow it: force on the tip, base along the axis, or lateral place of the tip.
    """

    times_s: Series
    values: Series
    quantity: Quantity

    @property
    def unit(self) -> str:
        """The unit of the values."""
        return {"none": "", "force": "N", "position": "m", "place": "m"}[self.quantity]

    def at(self, times_s: Series) -> Series:
        """Return a one-dimensional target at some times [s]; outside its corners the end values hold."""
        return np.interp(times_s, self.times_s, self.values)


class Interval(NamedTuple):
    """A part of a trial with its own settings: its duration [s], and values by dotted key."""

    duration_s: float
    settings: Mapping[str, Any]


class Parameters(BaseModel):
    """Base class of the parameters of a task; it refuses unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Task(Protocol):
    """A task; all methods are pure functions of the parameters and the seed of the trial."""

    @property
    def name(self) -> str:
        """The name of the task in an experiment's file."""

    @property
    def title(self) -> str:
        """The heading of the participant's page."""

    @property
    def parameters(self) -> type[Parameters]:
        """The class of its parameters."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        """The outcomes of the task, each declared with its unit."""

    def duration_s(self, p: Any) -> float:
        """Return the duration of a trial [s]."""

    def instruction(self, p: Any) -> str:
        """Return the text for the participant, which must not reveal the condition."""

    def target(self, p: Any, seed: int) -> Course | None:
        """Return the target for the display and for a simulated participant; None without one."""

    def band(self, p: Any) -> float:
        """Return half the width of the band about the target that counts as on target, in its unit; 0 for none."""

    def settings(self, p: Any, seed: int) -> Mapping[str, Any]:
        """Return the scenario settings that the task itself needs, by key."""

    def intervals(self, p: Any, seed: int) -> tuple[Interval, ...]:
        """Return the intervals of a trial, in their order; most tasks have one."""

    def questions(self, p: Any) -> tuple[Question, ...]:
        """Return the questions after the trial."""

    def questions_during(self, p: Any) -> tuple[Question, ...]:
        """Return the questions that can be answered during a trial, each by a button."""

    def judge(self, data: TrialData, p: Any, seed: int) -> Judged:
        """Return the value of each measure; None for one that the data do not determine."""


class Plain:
    """Defaults that suit most tasks: one interval, no question, no target, no settings."""

    def target(self, p: Any, seed: int) -> Course | None:
        return None

    def band(self, p: Any) -> float:
        return 0.0

    def settings(self, p: Any, seed: int) -> Mapping[str, Any]:
        return {}

    def intervals(self: Any, p: Any, seed: int) -> tuple[Interval, ...]:
        return (Interval(self.duration_s(p), {}),)

    def questions(self, p: Any) -> tuple[Question, ...]:
        return ()

    def questions_during(self, p: Any) -> tuple[Question, ...]:
        return ()


class Tip(NamedTuple):
    """The course of the instrument in a trial, as arrays of equal length: times [s], force on the tip [N], base [m]."""

    time_s: Series
    force_n: Series
    base_m: Series


def scale(
    name: str, text: str, low: str, high: str, least: float = 1.0, most: float = 7.0, step: float = 1.0
) -> Question:
    """Return a rating scale; the default has seven points.

    Args:
        name: The name of the value in the answer and in the table.
        text: The question in words.
        low: Label of the lower end.
        high: Label of the upper end.
        least: The lowest value.
        most: The highest value.
        step: The distance of neighbouring values.
    """
    bounds = {"least": least, "most": most, "step": step}
    return made(Question, {"name": name, "text": text, "low": low, "high": high, **bounds, "options": ()})


def choice(name: str, text: str, options: Sequence[str]) -> Question:
    """Return a question with a choice of one option; the answer is the text of the option."""
    scale_of_none = {"low": "", "high": "", "least": 0.0, "most": 0.0, "step": 0.0}
    return made(Question, {"name": name, "text": text, **scale_of_none, "options": tuple(options)})


def tip_of(data: TrialData) -> Tip:
    """Return the course of the instrument; the base is positive towards the sample."""
    afm = data.afm
    return Tip(afm["time_s"], afm["tip_force_n.2"], -afm["base_position_m.2"])


COMMON = (
    Measure("peak_force_n", "N", "Largest force on the tip"),
    Measure("hand_energy_j", "J", "Energy that the hand put into its device, the integral of its force over its way"),
    Measure("tip_energy_j", "J", "Energy that the base put into cantilever and sample"),
    Measure("effort_n_s", "N s", "Integral of the magnitude of the hand's force"),
    Measure("hand_path_m", "m", "Length of the way of the hand along the axis"),
)


def common_of(data: TrialData) -> Judged:
    """Return the measures that every task has, see `COMMON`."""
    tip, hand = tip_of(data), data.haptic
    time_s, place_m = hand["time_s"], -hand["position_m.2"]
    force_n = -hand["operator_force_n.2"]
    return {
        "peak_force_n": _peak(tip.force_n),
        "hand_energy_j": _work(force_n, place_m),
        "tip_energy_j": _work(tip.force_n, tip.base_m),
        "effort_n_s": _work(np.abs(force_n), time_s),
        "hand_path_m": math.fsum(np.abs(np.diff(place_m)).tolist()) if place_m.size > 1 else None,
    }


def held_from(time_s: Series, inside: npt.NDArray[np.bool_], hold_s: float) -> float | None:
    """Return the time from which a condition holds without a break for at least hold_s [s]; None if it never does.

    Args:
        time_s: The times of the samples [s], shape (n,).
        inside: Whether the condition holds at each sample, shape (n,).
        hold_s: Least duration [s].
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([False], inside, [False])).astype(np.int8)))
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if time_s[last - 1] - time_s[first] >= hold_s:
            return float(time_s[first])
    return None


def _peak(values: Series) -> float | None:
    return float(values.max()) if values.size else None


def _work(force: Series, place: Series) -> float | None:
    if place.size < 2:
        return None
    return math.fsum((0.5 * (force[1:] + force[:-1]) * np.diff(place)).tolist())
