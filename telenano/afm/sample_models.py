"""Samples that installed packages bring (entry points `telenano.samples`): parts in the place of cantilever and sample.

A sample is told where the base and the tip are, and how much time has passed, and answers with what the instrument
measures there. It may have a state of its own: of hysteresis, of particles that the tip pushes, of plastic deformation.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from telenano.afm.part import Part, PlantInputs, register_part

Step = Callable[..., Any]


@dataclass(frozen=True)
class SampleModel:
    """A sample under the tip.

    config: settings with `to_params()`, which gives a `params`; params: a NamedTuple of the sample's own;
    `start(params, base_m) -> state`, for a base at base_m [m] towards the sample;
    `measure(params, state, inputs, dt) -> (state, AfmSample)`, pure and compiled, with inputs.base_m, the place of the
    tip over the sample inputs.x_m and inputs.y_m [m], and the time since the last step dt [s], which is 0 at the start.
    stiffness_n_per_m: of the contact where it is pressed, nominal, for whoever has to know how far to press; where
    config has a field of that name, studies set it.
    """

    name: str
    config: type[BaseModel]
    params: type
    start: Step
    measure: Step
    stiffness_n_per_m: float


def checked_sample(name: str, value: Any) -> SampleModel:
    """Return the sample that an entry of a package is; TypeError or ValueError says what is wrong with it."""
    if not isinstance(value, SampleModel):
        raise TypeError(f"is a {type(value).__name__}, must be a SampleModel")
    if value.name != name:
        raise ValueError(f"calls itself {value.name}")
    if not isinstance(value.config().to_params(), value.params):  # type: ignore[attr-defined]
        raise TypeError(f"to_params() of its settings gives no {value.params.__name__}")
    if len(inspect.signature(value.measure).parameters) != 4:
        raise TypeError("its measure must take (params, state, inputs, dt): the position of the base is inputs.base_m")
    register_sample(value)
    return value


def register_sample(model: SampleModel) -> None:
    """Let a sample be chosen as the part behind the guard, by the class of its parameters."""

    def start(params: Any, inputs: PlantInputs) -> Any:
        return model.start(params, inputs.base_m)

    register_part(model.params, Part(start, model.measure))
