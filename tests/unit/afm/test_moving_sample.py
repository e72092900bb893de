"""The test of the instrument's design: a sample with a state of its own in x, y and time, written outside of the tree.

A particle lies on a surface, and the tip pushes it aside where it is low enough. A dent that the tip leaves heals with
time. The sample is a part like any other: the driver of a node and the guarded step of the lockstep take it as it is.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from services.afm_node.node import AfmNode
from telenano.afm import safety, sample_models
from telenano.afm.sim import SimulatedInstrument
from telenano.afm.step import AfmInputs, AfmParams, initial_afm_state, step
from telenano.extend.samples import AfmSample, PlantInputs, SampleModel
from telenano.numerics import compiled
from telenano.numerics.compiler import always_compiled
from telenano.sections.afm_section import AfmConfig
from telenano.settings.config import Settings


class Params(NamedTuple):
    stiffness_n_per_m: float
    radius_m: float
    height_m: float
    healing_s: float


class State(NamedTuple):
    x_m: float
    y_m: float
    dent_m: float


class Config(Settings):
    def to_params(self) -> Params:
        return Params(10.0, 5e-9, 4e-9, 0.05)


def start(params: Params, base_m: float) -> State:
    return State(0.0, 0.0, 0.0)


@compiled
def measure(params: Params, state: State, inputs: PlantInputs, dt: float) -> tuple[State, AfmSample]:
    """A tip below the top of the particle pushes it to its rim; elsewhere it meets the surface and leaves a dent."""
    dx, dy = state.x_m - inputs.x_m, state.y_m - inputs.y_m
    apart = math.hypot(dx, dy)
    x, y, pushed_n = state.x_m, state.y_m, 0.0
    if inputs.base_m > -params.height_m and 0.0 < apart < params.radius_m:
        share = params.radius_m / apart
        x, y, pushed_n = inputs.x_m + share * dx, inputs.y_m + share * dy, 1e-9
    dent = state.dent_m * math.exp(-dt / params.healing_s)
    depth = inputs.base_m - dent
    force = params.stiffness_n_per_m * max(depth, 0.0)
    sample = AfmSample(
        base_m=inputs.base_m,
        deflection_m=0.0,
        force_n=force,
        bridge_voltage_v=0.0,
        distance_m=max(-depth, 0.0),
        distance_valid=True,
        in_contact=depth > 0.0,
        meniscus=False,
        lateral_x_n=-pushed_n * dx / apart if apart > 0.0 else 0.0,
        lateral_y_n=-pushed_n * dy / apart if apart > 0.0 else 0.0,
    )
    return State(x, y, dent + 0.1 * max(depth, 0.0)), sample


MODEL = SampleModel("particle", Config, Params, start, measure, 10.0)
sample_models.register_sample(MODEL)
LIMITS = AfmConfig().to_params().safety
AFM = AfmParams(LIMITS, Config().to_params())


def course() -> np.ndarray:
    """Base, x and y [m] and the time of a step [s]: down beside the particle, across it, deeper and up again."""
    rows = np.zeros((400, 4))
    rows[:, 0] = np.interp(np.arange(400), [0, 80, 250, 300, 400], [-60e-9, -2e-9, -2e-9, 3e-9, -20e-9])
    rows[:, 1] = np.interp(np.arange(400), [0, 100, 250, 400], [-20e-9, -20e-9, 12e-9, 12e-9])
    rows[:, 2] = 1e-9
    rows[:, 3] = np.where(np.arange(400) % 7 == 0, 2e-3, 1e-3)
    return rows


@always_compiled
def lockstep(params: Any, state: Any, rows: np.ndarray, found: np.ndarray) -> Any:
    """Take the guarded steps in one compiled call, as a study does."""
    for n in range(len(rows)):
        row = rows[n]
        asked = AfmInputs(row[0], 0.0, 0, n == 0, False, row[1], row[2], False)
        state, out = step(params, state, asked, row[3])
        found[n, 0], found[n, 1], found[n, 2] = out.sample.base_m, out.sample.force_n, out.sample.distance_m
    return state


@pytest.mark.check("takes 0.9 s")
def test_the_tip_pushes_a_particle_in_the_driver_of_a_node_and_in_lockstep_alike() -> None:
    rows, found = course(), np.zeros((400, 3))
    state = lockstep(AFM, initial_afm_state(AFM), rows, found)
    plain, device = initial_afm_state(AFM), SimulatedInstrument(AFM)
    device.open()
    # the guard measures once where it starts
    device.exchange(plain.safety.base_m)
    assert device.stage is not None
    lateral_n = []
    for n, (reference_m, x_m, y_m, dt) in enumerate(rows.tolist()):
        plain, (out, _) = step(AFM, plain, AfmInputs(reference_m, 0.0, 0, n == 0, False, x_m, y_m), dt)
        device.stage.move_to(x_m, y_m)
        device.elapse(dt)
        sample = device.exchange(out.base_m)
        assert sample == out
        assert (sample.base_m, sample.force_n, sample.distance_m) == tuple(found[n])
        lateral_n.append(device.stage.lateral_force_n[0])
    assert device.state.part == plain.plant == state.plant
    # it went ahead of the tip, then aside of the line y = 1 nm on which the tip goes, and lies there
    assert plain.plant.x_m > 1e-9
    assert 4.9e-9 < abs(plain.plant.y_m - 1e-9) < 6e-9
    assert min(lateral_n) < -0.5e-9
    assert found[:, 1].max() > 1e-9


def test_a_dent_heals_with_the_time_that_passes() -> None:
    forces = []
    for healed_s in (0.0, 1.0):
        device = SimulatedInstrument(AFM)
        device.open()
        for base_m, dt in ((5e-9, 1e-3), (0.0, healed_s), (5e-9, 1e-3)):
            device.elapse(dt)
            forces.append(device.exchange(base_m).force_n)
    fresh, _, dented, again, _, healed = forces
    assert dented < 0.95 * fresh == 0.95 * again
    assert healed == pytest.approx(fresh, rel=1e-6, abs=0.0)


def test_the_node_tells_the_sample_its_place_and_its_time(bench_of: Any) -> None:
    bench, device = bench_of("afm_node@slave"), SimulatedInstrument(AFM)
    node = AfmNode(bench.context, AfmConfig(), device)
    fields = {"id": "a", "command": "set", "target": "afm_node", "parameters": {"lateral.x_m": -3e-9}}
    assert "x = -3 nm" in node.on_control(bench.make("session/control", "console@master", **fields))
    before = device.state
    assert before.part is not None
    bench.clock.advance_ns(1_000_000)
    node.on_deadline(bench.clock.monotonic_ns())
    assert device.state.elapsed_s == 0.0
    assert device.relief is None
    assert device.vibration is None
    assert safety.MODE_NAMES[node._memory.guard.mode] == "retracted"


def test_a_sample_of_the_older_form_and_one_with_parameters_of_another_are_refused() -> None:
    def older(params: Params, state: State, base_m: float) -> tuple[State, AfmSample]:
        raise AssertionError("never called")

    def refused(model: SampleModel) -> str:
        with pytest.raises(TypeError) as error:
            sample_models.checked_sample(model.name, model)
        return str(error.value)

    class OtherParams(NamedTuple):
        stiffness_n_per_m: float

    class OtherConfig(Settings):
        def to_params(self) -> OtherParams:
            return OtherParams(1.0)

    assert "(params, state, inputs, dt)" in refused(SampleModel("old", OtherConfig, OtherParams, start, older, 1.0))
    assert "another part has the parameters" in refused(SampleModel("copy", Config, Params, start, measure, 1.0))
