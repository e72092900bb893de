"""What a simulated instrument is composed of: parts, each a pure step with parameters, a state and inputs.

    step(params, state, inputs, dt) -> (state, AfmSample)

A part is chosen by the class of its parameters. Parts contain each other: a disturbed instrument has a tip over a
surface, and that has a cantilever, which is quasi-static or dynamic. `step.step` puts the guard in front of any part
for a study in lockstep, and `sim.SimulatedInstrument` makes the driver of a node of it. Both call the same steps.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from telenano.extend.samples import AfmSample, Oscillation, PlantInputs
from telenano.numerics.compiler import chosen_step, compiled


@compiled
def inputs_at(base_m: float, x_m: float, y_m: float) -> PlantInputs:
    """Return the inputs of a place [m] where nothing else acts: compiled code fills in no defaults of a tuple."""
    return PlantInputs(base_m, x_m, y_m, 0.0, 0.0, 0.0, 0.0, 0)


@compiled
def inputs_over(inputs: PlantInputs, raised_m: float, away_m: float) -> PlantInputs:
    """Return inputs over a surface that is higher by raised_m [m], with the base further away by away_m [m]."""
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
    """What a part has besides whose tip moves between two steps.

    settle(params, state, inputs) -> (state, whether there is more to do): goes through a share of the motion that is
    known before the next step. oscillation(state) -> Oscillation at the last step, zeros without a drive.
    """

    settle: Callable[[Any, Any, PlantInputs], tuple[Any, bool]]
    oscillation: Callable[[Any], Oscillation]


class Part(NamedTuple):
    """The functions of a part.

    start(params, inputs) gives the state of a part that has been there for long. lateral: whether x and y mean anything
    to it. motion(params) gives what a part has whose tip moves between two steps, None for one that does not.
    truths(params, state) gives what is so in it and no instrument knows, by the name of its layer (`layers`): a
    simulation is judged by it, and no planner reads it. within: the field of its parameters, and of its state, that has
    another part, whose motion and truths it has as well. inputs_within(params, state, inputs): what acts on that part
    between two steps; None where the inputs themselves do.
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
    """Let a part be chosen by the class of its parameters; TypeError, if another part has this class already."""
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
    """Return what is so in the part with these parameters and no instrument knows, by the name of the layer."""
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


# The parameters choose the step of their part, in plain Python and in compiled code.
part_step = chosen_step(lambda kind: _PARTS[kind].step)
