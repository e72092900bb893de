"""The interface of a sample under the tip: settings, and a pure step from base position to force and distance."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from pydantic import BaseModel

Step = Callable[..., Any]


class PlantInputs(NamedTuple):
    """Inputs of the simulated instrument's parts in one step.

    base_m: base position towards the sample [m]; x_m, y_m: place of the tip over the sample [m], (0, 0) is its centre;
    height_m: height of the surface under the tip [m]; voltage_v: voltage between tip and sample [V]; amplitude_m:
    amplitude of the tip without a sample, from the drive of the base [m], 0 without a drive; temperature_k: of a
    cantilever with thermal motion [K], 0 without thermal impulses; seed: seed of these impulses.
    """

    base_m: float
    x_m: float = 0.0
    y_m: float = 0.0
    height_m: float = 0.0
    voltage_v: float = 0.0
    amplitude_m: float = 0.0
    temperature_k: float = 0.0
    seed: int = 0


class AfmSample(NamedTuple):
    """Sample of the device for one base position.

    base_m: base position applied [m]; deflection_m: zeta [m], positive away from the sample; force_n: force on the tip
    [N], repulsive positive; bridge_voltage_v: Eq. 3 [V]; distance_m: h [m], meaningful if distance_valid (a real
    instrument does not know it); in_contact: whether the tip touches; meniscus: whether a liquid bridge exists
    (`as_printed`: whether the retract law is in force); lateral_x_n, lateral_y_n: force on the tip by the sample in x
    and y [N].
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

    The lag is pi/2 in free motion at resonance, more in attraction and less in repulsion (`dynamic.lag_rad`).
    dissipated_j: energy dissipated by the sample in a period [J].
    """

    amplitude_m: float
    phase_rad: float
    dissipated_j: float = 0.0


@dataclass(frozen=True)
class SampleModel:
    """A sample under the tip.

    config: settings with `to_params()`, which returns a `params`; params: the sample's NamedTuple;
    `start(params, base_m) -> state`, for a base at base_m [m] towards the sample;
    `measure(params, state, inputs, dt) -> (state, AfmSample)`, pure and compiled, with inputs.base_m, the place of the
    tip over the sample inputs.x_m and inputs.y_m [m], and the time since the last step dt [s], which is 0 at the start.
    stiffness_n_per_m: nominal stiffness of the pressed contact, for code that must know how far to press; if config has
    a field of that name, studies set it.
    """

    name: str
    config: type[BaseModel]
    params: type
    start: Step
    measure: Step
    stiffness_n_per_m: float
