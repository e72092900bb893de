"""Simulated hand devices, each a pure step with parameters and a state; the class of the parameters selects it.

    step(params, state, command, session_time_s, dt) -> (state, DeviceReading)

Parameters and state have a field `operator`, the hand on the device. `sim.SimulatedHaptic` makes a node's device of
such a part, and `step.step` puts the guard in front of it for a study in lockstep. Both call the same steps.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from telenano.extend.hands import DeviceReading, DriveCommand, Pair
from telenano.hand.operator_models import operator_at_rest
from telenano.numerics.compiler import chosen_step


class HandPart(NamedTuple):
    """The functions of a simulated hand device, as in `HandPart(start, step, place).register(SlideParams)`.

    start(params, position_m, operator) returns the state of a device at rest at a position [m] along the paper's axis,
    with the given state of the hand on it. step advances device and hand by dt [s], > 0, under a guarded command.
    place(params, state) returns the position of the device [m], and whether it gives no force for a reason of its own.
    step and place must be marked `telenano.numerics.compiled`. pushed(params, force_n) returns parameters with a force
    of the hand along x and y [N]; None for a device of one axis.
    """

    start: Callable[[Any, float, Any], Any]
    step: Callable[[Any, Any, DriveCommand, float, float], tuple[Any, DeviceReading]]
    place: Callable[[Any, Any], tuple[float, bool]]
    pushed: Callable[[Any, Pair], Any] | None = None

    def register(self, kind: type) -> None:
        """Register the device under the class of its parameters.

        HandPart(start, step, place).register(SlideParams)

        Raises:
            TypeError: Another device has this class already.
        """
        if _PARTS.get(kind, self) != self:
            raise TypeError(f"another hand device has the parameters {kind.__module__}.{kind.__name__} already")
        _PARTS[kind] = self


_PARTS: dict[type, HandPart] = {}


def initial_plant(params: Any, position_m: float) -> Any:
    """Return the state of device and hand at rest at position_m [m]."""
    return _PARTS[type(params)].start(params, position_m, operator_at_rest(params.operator, position_m))


def pushed_across(params: Any, force_n: Pair) -> Any:
    """Return parameters with a force of the hand [N] along x and y; those of a device of one axis stay the same."""
    pushed = _PARTS[type(params)].pushed
    return params if pushed is None else pushed(params, force_n)


# Calls the step that is registered for the class of the parameters, in plain Python and in compiled code.
plant_step = chosen_step(lambda kind: _PARTS[kind].step)
# Calls the registered `place`: position of the device [m], and whether it gives no force for a reason of its own.
place_of = chosen_step(lambda kind: _PARTS[kind].place)
