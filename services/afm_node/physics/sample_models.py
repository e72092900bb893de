"""Samples that installed packages bring (entry points `telenano.samples`), behind the guard of the AFM.

A sample answers a position of the base with what the instrument measures there, force and distance. It is quasi-static,
as the tip and sample of Table 2 are: it may remember where it was, such as for hysteresis, and knows no time.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from pydantic import BaseModel

from presets.plugins import load
from services.afm_node.physics.step import AfmInputs, AfmOutputs, AfmSample, guarded
from services.afm_node.safety import SafetyParams, SafetyState, initial_safety_state
from services.numerics.compiled import chosen_step, compiled

Step = Callable[..., Any]


@dataclass(frozen=True)
class SampleModel:
    """A sample under the tip.

    config: settings with `to_params()`, which gives a `params`; params: a NamedTuple of the sample's own;
    `start(params, base_m) -> state`; `measure(params, state, base_m) -> (state, AfmSample)`, pure and compiled, for a
    base at base_m [m] towards the sample. stiffness_n_per_m: of the contact where it is pressed, nominal, for whoever
    has to know how far to press; where config has a field of that name, studies set it.
    """

    name: str
    config: type[BaseModel]
    params: type
    start: Step
    measure: Step
    stiffness_n_per_m: float


def _checked(name: str, value: Any) -> SampleModel:
    if not isinstance(value, SampleModel):
        raise TypeError(f"is a {type(value).__name__}, must be a SampleModel")
    if value.name != name:
        raise ValueError(f"calls itself {value.name}")
    if not isinstance(value.config().to_params(), value.params):  # type: ignore[attr-defined]
        raise TypeError(f"to_params() of its settings gives no {value.params.__name__}")
    return value


# what the section `afm_node` has already
_TAKEN = (
    "spring", "driver", "modbus", "environment", "cantilever", "tip_sample", "mode", "meniscus", "rest_distance_m",
    "safety", "allow_replay", "wall", "contact", "body", "simulated",
)  # fmt: skip
SAMPLES = load("samples", _checked, _TAKEN)
_SAMPLE_OF = {model.params: model for model in SAMPLES.found.values()}
_measure = chosen_step(lambda kind: _SAMPLE_OF[kind].measure)


class SampleParams(NamedTuple):
    """Limits, and the constants of the sample."""

    safety: SafetyParams
    sample: Any


class SampleState(NamedTuple):
    """Safety chain, the sample's own state, and the force last measured [N]."""

    safety: SafetyState
    sample: Any
    force_n: float


def initial_state(params: SampleParams) -> SampleState:
    """Return the state at the start: retracted, at the force there."""
    safety = initial_safety_state(params.safety)
    state, found = _moved(params.sample, _start(params.sample, safety.base_m), safety.base_m)
    return SampleState(safety, state, found.force_n)


@compiled
def step(params: SampleParams, state: SampleState, inputs: AfmInputs, dt: float) -> tuple[SampleState, AfmOutputs]:
    """Advance guard and sample by dt [s]. Raises ValueError if dt is not positive and finite."""
    safety, allowed = guarded(params.safety, state.safety, inputs, state.force_n, dt)
    sample, found = _measure(params.sample, state.sample, allowed.base_m)
    outputs = AfmOutputs(
        found.base_m,
        found.distance_m,
        found.deflection_m,
        found.force_n,
        found.bridge_voltage_v,
        found.in_contact,
        found.meniscus,
        allowed.mode,
        allowed.limited,
        allowed.reason,
        allowed.arm_refusal,
    )
    return SampleState(safety, sample, found.force_n), outputs


def _start(sample: Any, base_m: float) -> Any:
    return _SAMPLE_OF[type(sample)].start(sample, base_m)


def _moved(sample: Any, state: Any, base_m: float) -> tuple[Any, AfmSample]:
    moved: tuple[Any, AfmSample] = _SAMPLE_OF[type(sample)].measure(sample, state, base_m)
    return moved


class SimulatedSample:
    """An `AfmDriver` whose tip meets a sample of an installed package."""

    def __init__(self, params: SampleParams) -> None:
        self._params = params
        self._state: Any = None
        self._opened = False

    @property
    def safe_position_m(self) -> float:
        return self._params.safety.retract_position_m

    @property
    def latency_s(self) -> float:
        return 0.0

    @property
    def calibration_identity(self) -> str:
        return ""

    @property
    def report(self) -> None:
        return None

    @property
    def stage(self) -> None:
        return None

    def open(self) -> None:
        """Start at the safe position. Raises RuntimeError if it is already open."""
        if self._opened:
            raise RuntimeError("the simulated sample is already open")
        self._state, self._opened = _start(self._params.sample, self.safe_position_m), True

    def exchange(self, base_m: float) -> AfmSample:
        if not self._opened:
            raise RuntimeError("the simulated sample is not open: call open() first")
        if not math.isfinite(base_m):
            raise ValueError(f"base position {base_m} m must be finite")
        self._state, found = _moved(self._params.sample, self._state, base_m)
        return found

    def retract(self) -> bool:
        """Retract to the safe position at once: the base has no way to go."""
        if self._opened:
            self.exchange(self.safe_position_m)
        return True

    def close(self) -> None:
        self.retract()
        self._opened = False
