"""Parts of a simulated instrument, each a pure step with parameters, a state and inputs.

The base comes from the guard, `telenano/afm/safety.py`. The force that a part returns goes back by way of the AFM node,
the slave half, the link and the master half to the hand, where `telenano/hand/safety.py` receives the command.

    step(params, state, inputs, dt) -> (state, AfmSample)

The class of the parameters selects the part. Parts contain each other: a disturbed instrument has a tip over a surface,
and that has a cantilever, which is quasi-static or dynamic. `step.step` puts the guard in front of any part for a study
in lockstep, and `sim.SimulatedInstrument` makes a node's driver of it. Both call the same steps.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from telenano.extend.samples import AfmSample, Oscillation, PlantInputs
from telenano.numerics.compiler import chosen_step, compiled


@compiled
def inputs_at(base_m: float, x_m: float, y_m: float) -> PlantInputs:
    """Return inputs at a place [m] where nothing else acts; compiled code cannot use the defaults of a named tuple."""
    return PlantInputs(base_m, x_m, y_m, 0.0, 0.0, 0.0, 0.0, 0)


@compiled
def inputs_over(inputs: PlantInputs, raised_m: float, away_m: float) -> PlantInputs:
    """Return the inputs with the surface higher by raised_m [m] and the base further away by away_m [m]."""
    return PlantInputs(
        base_m=inputs.base_m - away_m,
        x_m=inputs.x_m,
        y_m=inputs.y_m,
        height_m=inputs.height_m + raised_m,
        voltage_v=inputs.voltage_v,
        amplitude_m=inputs.amplitude_m,
        temperature_k=inputs.temperature_k,
        seed=inputs.seed,
    )


class Motion(NamedTuple):
    """Further functions of a part whose tip moves between two steps.

    settle(params, state, inputs) -> (state, whether there is more to do): simulates a share of the motion that is
    known before the next step. oscillation(state) -> Oscillation at the last step, zeros without a drive.
    """

    settle: Callable[[Any, Any, PlantInputs], tuple[Any, bool]]
    oscillation: Callable[[Any], Oscillation]


class Part(NamedTuple):
    """The functions of a part.

    start(params, inputs) returns the state of a part that has long been at rest there. lateral: whether the part uses x
    and y. motion(params) returns the `Motion` of a part whose tip moves between two steps, None for other parts.
    truths(params, state) returns the state that no instrument can measure, by the name of its layer (`layers`): tests
    judge a simulation by it, and no planner reads it. within: the field of the parameters, and of the state, that holds
    an inner part, whose motion and truths count as its own. inputs_within(params, state, inputs): the inputs of that
    inner part between two steps; None if they are the same.
    """

    start: Callable[[Any, PlantInputs], Any]
    step: Callable[[Any, Any, PlantInputs, float], tuple[Any, AfmSample]]
    lateral: bool = True
    motion: Callable[[Any], Motion | None] | None = None
    truths: Callable[[Any, Any], Mapping[str, Any]] | None = None
    within: str = ""
    inputs_within: Callable[[Any, Any, PlantInputs], PlantInputs] | None = None


_PARTS: dict[type, Part] = {}


def register_part(kind: type, part: Part) -> None:
    """Register a part under the class of its parameters; raise TypeError if another part has this class already."""
    if _PARTS.get(kind, part) != part:
        raise TypeError(f"another part has the parameters {kind.__module__}.{kind.__name__} already")
    _PARTS[kind] = part


def part_of(params: Any) -> Part:
    """Return the part whose parameters these are."""
    return _PARTS[type(params)]


def part_start(params: Any, inputs: PlantInputs) -> Any:
    """Return the state in which the part with these parameters starts."""
    return part_of(params).start(params, inputs)


def truths_of(params: Any, state: Any) -> Mapping[str, Any]:
    """Return the truths of the part with these parameters and of its inner parts, by the name of the layer."""
    part = part_of(params)
    inner = truths_of(getattr(params, part.within), getattr(state, part.within)) if part.within else {}
    return inner if part.truths is None else {**inner, **part.truths(params, state)}


def motion_of(params: Any) -> Motion | None:
    """Return the motion that the part with these parameters has between two steps, None where it has none."""
    part = part_of(params)
    if part.motion is not None:
        return part.motion(params)
    within, inputs_of = part.within, part.inputs_within
    if not within or (inner := motion_of(getattr(params, within))) is None:
        return None

    def settle(params: Any, state: Any, inputs: PlantInputs) -> tuple[Any, bool]:
        inner_inputs = inputs if inputs_of is None else inputs_of(params, state, inputs)
        after, continues = inner.settle(getattr(params, within), getattr(state, within), inner_inputs)
        return state._replace(**{within: after}), continues

    return Motion(settle, lambda state: inner.oscillation(getattr(state, within)))


# `part_step(params, ...)` calls the step that is registered for the class of params, in plain Python and compiled code.
part_step = chosen_step(lambda kind: _PARTS[kind].step)
