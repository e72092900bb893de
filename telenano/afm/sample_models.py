"""Samples from installed packages (entry points `telenano.samples`): parts that replace cantilever and sample.

A sample model gets the positions of base and tip and the time passed, and returns the measurement of the instrument
there. It may have a state of its own: of hysteresis, of particles that the tip pushes, of plastic deformation.
"""

import inspect
from collections.abc import Callable
from typing import Any

from telenano.afm.layers import Layer
from telenano.afm.part import Part, register_part
from telenano.extend.samples import PlantInputs, SampleModel

Step = Callable[..., Any]


def checked_sample(name: str, value: Any) -> SampleModel | None:
    """Register and return the sample of an entry point; None if it is a layer on a sample.

    `name` is the name of the entry point, which the sample must have too.

    Raises:
        TypeError, ValueError: It is neither, or cannot be used; the message says why.
    """
    if isinstance(value, Layer):
        return None
    if not isinstance(value, SampleModel):
        raise TypeError(f"is a {type(value).__name__}, must be a SampleModel or a Layer")
    if value.name != name:
        raise ValueError(f"is registered under another name than its own, {value.name}")
    if not isinstance(value.config().to_params(), value.params):  # type: ignore[attr-defined]
        raise TypeError(f"to_params() of its settings gives no {value.params.__name__}")
    if len(inspect.signature(value.measure).parameters) != 4:
        raise TypeError("its measure must take (params, state, inputs, dt): the position of the base is inputs.base_m")
    register_sample(value)
    return value


def register_sample(model: SampleModel) -> None:
    """Register a sample as a part under the class of its parameters, so that it can stand behind the guard."""

    def start(params: Any, inputs: PlantInputs) -> Any:
        return model.start(params, inputs.base_m)

    register_part(model.params, Part(start, model.measure))
