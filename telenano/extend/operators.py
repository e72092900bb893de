"""The interface of a simulated hand: settings, and a pure step from the motion of the arm to the force on it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from pydantic import BaseModel

Step = Callable[..., Any]


class OperatorInputs(NamedTuple):
    """Session time at the end of the step [s] (negative: not started), and the arm's position at both ends [m]."""

    session_time_s: float
    start_position_m: float
    end_position_m: float


class OperatorOutputs(NamedTuple):
    """Force F_m on the device [N], positive towards the sample, after the limits of hand and sensor."""

    force_n: float
    limited: bool


@dataclass(frozen=True)
class OperatorModel:
    """A model of the hand on the device.

    config: settings with `kind: Literal[name]`, `max_force_n` [N] and `to_params()`, which returns a `params`;
    params: the model's NamedTuple, with `max_force_n`; `start(params, position_m) -> state`, a hand at rest;
    `step(params, state, OperatorInputs, dt) -> (state, OperatorOutputs)`, pure and compiled, over dt [s] > 0.
    """

    name: str
    config: type[BaseModel]
    params: type
    start: Step
    step: Step
