"""What a simulated instrument is composed of: parts, each a pure step with parameters, a state and inputs.

    step(params, state, inputs, dt) -> (state, AfmSample)

A part is chosen by the class of its parameters. Parts contain each other: a disturbed instrument has a tip over a
surface, and that has a cantilever, which is quasi-static or dynamic. `step.step` puts the guard in front of any part
for a study in lockstep, and `sim.SimulatedInstrument` makes the driver of a node of it. Both call the same steps.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.numerics.compiled import chosen_step, compiled


class PlantInputs(NamedTuple):
    """What acts on a part in a step.

    base_m: base position towards the sample [m]; x_m, y_m: place of the tip over the sample [m], 0, 0 is its middle;
    height_m: of the surface under the tip [m]; voltage_v: between tip and sample [V]; amplitude_m: that the drive of
    the base gives the tip without a sample [m], 0 without a drive; temperature_k: of a cantilever that has a motion
    [K], 0 without thermal impulses, and seed, which decides these.
    """

    base_m: float
    x_m: float = 0.0
    y_m: float = 0.0
    height_m: float = 0.0
    voltage_v: float = 0.0
    amplitude_m: float = 0.0
    temperature_k: float = 0.0
    seed: int = 0


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


class AfmSample(NamedTuple):
    """What the device reports for one base position.

    base_m: base position applied [m]; deflection_m: zeta [m], positive away from the sample; force_n: on the tip [N],
    positive is repulsive; bridge_voltage_v: Eq. 3 [V]; distance_m: h [m], meaningful if distance_valid (a real
    instrument does not know it); in_contact; meniscus: a bridge exists (`as_printed`: the retract law is in force);
    lateral_x_n, lateral_y_n: force on the tip by the sample in x and y [N].
    """

    base_m: float
    deflection_m: float
    force_n: float
    bridge_voltage_v: float
    distance_m: float
    distance_valid: bool
    in_contact: bool
    meniscus: bool
    lateral_x_n: float = 0.0
    lateral_y_n: float = 0.0


class Oscillation(NamedTuple):
    """Amplitude of the deflection at the frequency of the drive [m], and its lag behind the drive [rad].

    The lag is pi/2 in free motion at the resonance, more in attraction and less in repulsion (`dynamic.lag_rad`).
    dissipated_j: energy that the sample takes in a period [J].
    """

    amplitude_m: float
    phase_rad: float
    dissipated_j: float = 0.0


class Motion(NamedTuple):
    """What a part has besides whose tip moves between two steps.

    settle(params, state, inputs) -> (state, whether there is more to do): goes through a share of the motion that is
    known before the next step. oscillation(state) -> Oscillation at the last step, zeros without a drive.
    """

    settle: Callable[[Any, Any, PlantInputs], tuple[Any, bool]]
    oscillation: Callable[[Any], Oscillation]


class Particles(NamedTuple):
    """Where the particles of a simulation really are: places (n, 2) [m], radii (n,) [m], and which move, (n,)."""

    places_m: npt.NDArray[np.float64]
    radii_m: npt.NDArray[np.float64]
    moving: npt.NDArray[np.bool_]


class Part(NamedTuple):
    """The functions of a part.

    start(params, inputs) gives the state of a part that has been there for long. lateral: whether x and y mean anything
    to it. motion(params) gives what a part has whose tip moves between two steps, None for one that does not.
    particles(params, state) gives those that it has, for who judges a simulation and for nobody who plans.
    """

    start: Callable[[Any, PlantInputs], Any]
    step: Callable[[Any, Any, PlantInputs, float], tuple[Any, AfmSample]]
    lateral: bool = True
    motion: Callable[[Any], Motion | None] | None = None
    particles: Callable[[Any, Any], Particles | None] | None = None


_PARTS: dict[type, Part] = {}


def register(kind: type, part: Part) -> None:
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


def motion_of(params: Any) -> Motion | None:
    """Return the motion that the part with these parameters has between two steps, None where it has none."""
    motion = part_of(params).motion
    return None if motion is None else motion(params)


def motion_around(
    params: Any, within: str, inputs_of: Callable[[Any, Any, PlantInputs], PlantInputs] | None = None
) -> Motion | None:
    """Return the motion of a part that has another one within; None where that has none.

    Args:
        params: The parameters of the part.
        within: The field of its parameters, and of its state, that has the part within.
        inputs_of: Returns what acts on the part within, by parameters, state and inputs; None: the inputs themselves.
    """
    inner = motion_of(getattr(params, within))
    if inner is None:
        return None

    def settle(params: Any, state: Any, inputs: PlantInputs) -> tuple[Any, bool]:
        given = inputs if inputs_of is None else inputs_of(params, state, inputs)
        after, goes_on = inner.settle(getattr(params, within), getattr(state, within), given)
        return state._replace(**{within: after}), goes_on

    return Motion(settle, lambda state: inner.oscillation(getattr(state, within)))


# The parameters choose the step of their part, in plain Python and in compiled code.
part_step = chosen_step(lambda kind: _PARTS[kind].step)
