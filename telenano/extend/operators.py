"""A simulated hand: settings, and a pure step from motion of the arm to force on it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from pydantic import BaseModel

Step = Callable[..., Any]


class OperatorInputs(NamedTuple):
    """Session time (negative: not started) at the end of the step, and the arm's position at its two ends."""

    session_time_s: float
    start_position_m: float
    end_position_m: float


class OperatorOutputs(NamedTuple):
    """F_m on the device, positive towards the sample, after the limit of hand and sensor."""

    force_n: float
    limited: bool


@dataclass(frozen=True)
class OperatorModel:
    """A model of the hand on the device.

    config: settings with `kind: Literal[name]`, `max_force_n` [N] and `to_params()`, which gives a `params`;
    params: a NamedTuple of the model's own, with `max_force_n`; `start(params, position_m) -> state`, a hand at rest;
    `step(params, state, OperatorInputs, dt) -> (state, OperatorOutputs)`, pure and compiled, over dt [s] > 0.
    """

    name: str
    config: type[BaseModel]
    params: type
    start: Step
    step: Step
