"""Samples that installed packages bring (entry points `telenano.samples`): parts in the place of cantilever and sample.

A sample is told where the base and the tip are, and how much time has passed, and answers with what the instrument
measures there. It may have a state of its own: of hysteresis, of particles that the tip pushes, of plastic deformation.
"""

import inspect
from collections.abc import Callable
from typing import Any

from telenano.afm.part import Part, register_part
from telenano.extend.samples import PlantInputs, SampleModel

Step = Callable[..., Any]


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
