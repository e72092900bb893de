import math

import numpy as np
import pytest

from telenano.afm import safety
from telenano.afm.cantilever import initial_state
from telenano.afm.cantilever import step as measure
from telenano.afm.part import inputs_at
from telenano.afm.safety import SafetyInputs, initial_safety_state, safety_step
from telenano.afm.sim import simulated_afm
from telenano.afm.step import AfmInputs, initial_afm_state, step
from telenano.extend.samples import AfmSample
from telenano.sections.afm_section import AfmConfig

DT = 1e-3


@pytest.fixture(scope="module")
def params():
    return AfmConfig().to_params()


def follow(params, references_m, state=None):
    state = initial_afm_state(params) if state is None else state
    rows = []
    for i, reference in enumerate(references_m):
        state, outputs = step(params, state, AfmInputs(reference, 0.0, safety.ACTION_POSITION, i == 0, False), DT)
        rows.append(outputs)
    return state, rows


def test_it_starts_retracted_with_the_tip_at_rest(params):
    state = initial_afm_state(params)
    assert state.safety == initial_safety_state(params.safety)
    assert math.isclose(state.plant.distance_m, 110e-9, rel_tol=1e-4)


def test_outputs_describe_one_equilibrium(params):
    _, rows = follow(params, np.full(100, 12e-9))
    last = rows[-1]
    assert last.sample.base_m == 12e-9
    assert last.allowed.mode == safety.MODE_FOLLOW and last.allowed.limited == 0
    assert last.sample.in_contact and last.sample.meniscus
    assert math.isclose(last.sample.force_n, 40.0 * last.sample.deflection_m, rel_tol=1e-12)
    assert math.isclose(last.sample.bridge_voltage_v, last.sample.deflection_m * 6.25e6, rel_tol=1e-12)
    assert math.isclose(last.sample.deflection_m, last.sample.distance_m + 12e-9 - 10e-9, rel_tol=1e-12)


def test_the_approach_from_the_safe_state_is_limited_in_speed(params):
    _, rows = follow(params, np.zeros(60))
    bases = np.array([r.sample.base_m for r in rows])
    assert np.diff(bases).max() <= 2e-9 * (1 + 1e-9)
    assert rows[0].allowed.limited == safety.LIMITED_BY_SPEED
    assert (bases[-1], rows[-1].allowed.limited) == (0.0, 0)


def test_the_tip_is_saved_from_a_crash(params):
    state, rows = follow(params, np.full(400, 200e-9))
    forces = np.array([r.sample.force_n for r in rows])
    tripped = int(np.flatnonzero(forces > params.safety.force_limit_n)[0])
    # one tick later it goes back, and the overshoot is what one tick of motion can do
    assert rows[tripped + 1].allowed.mode == safety.MODE_RETRACTING
    assert rows[tripped + 1].allowed.reason == safety.REASON_FORCE_LIMIT
    assert forces.max() <= params.safety.force_limit_n + 40.0 * 2e-9 + 1e-12
    assert rows[-1].allowed.mode == safety.MODE_RETRACTED
    assert state.safety.base_m == -100e-9


def test_the_limit_itself_is_allowed(params):
    # find the base at which the force is just the limit, and stand a picometre before it
    plant, limit = params.plant, params.safety.force_limit_n
    low, high = 10e-9, 30e-9
    for _ in range(60):
        mid = 0.5 * (low + high)
        force = measure(plant, initial_state(plant, mid), inputs_at(mid, 0.0, 0.0), DT)[1].force_n
        low, high = (mid, high) if force <= limit else (low, mid)
    _, rows = follow(params, np.full(300, low))
    assert rows[-1].allowed.mode == safety.MODE_FOLLOW
    _, rows = follow(params, np.full(300, high + 1e-12))
    assert rows[-1].allowed.mode != safety.MODE_FOLLOW


def test_the_driver_behind_the_guard_gives_what_the_step_gives(params):
    state = initial_afm_state(params)
    guard, force = initial_safety_state(params.safety), 0.0
    afm = simulated_afm(params)
    afm.open()
    rng = np.random.default_rng(1)
    reference = 0.0
    for i in range(2000):
        reference += rng.normal(0.0, 1e-9)
        age, action = (
            float(rng.choice([0.0, 0.06, 0.3], p=[0.98, 0.019, 0.001])),
            int(rng.choice([0, 1], p=[0.99, 0.01])),
        )
        arm = i % 50 == 0
        state, outputs = step(params, state, AfmInputs(reference, age, action, arm, False), DT)
        guard, allowed = safety_step(params.safety, guard, SafetyInputs(reference, age, action, arm, False, force), DT)
        sample = afm.exchange(allowed.base_m)
        force = sample.force_n
        assert outputs == (sample, allowed)
    afm.close()


def test_the_step_repeats_bit_for_bit(params):
    references = 9e-9 + 4e-9 * np.sin(np.arange(500) * 0.05)
    assert follow(params, references)[1] == follow(params, references)[1]


def virtual_impedance(params, seconds=8.0):
    """Fig. 12 in lockstep: virtual impedance loop with the SI preset of E8."""
    times = np.arange(round(seconds / DT)) * DT
    hand = np.interp(times, [0.8, 1.2, 2.6, 2.9, 4.5, 4.6], [0.0, 1.0, 1.0, 2.0, 2.0, 0.0])
    safe = params.safety._replace(retract_position_m=0.0)
    params = params._replace(safety=safe)
    state = initial_afm_state(params)
    x = v = force = 0.0
    rows = np.empty((len(times), 3))
    for i, F_m in enumerate(hand.tolist()):
        F_s = 1e8 * force
        v += DT * (20.0 * (F_m - F_s) - F_s - 2000.0 * v) / 10.0
        x += DT * v
        state, outputs = step(params, state, AfmInputs(1.5e-6 * x, 0.0, 0, i == 0, False), DT)
        force = outputs.sample.force_n
        rows[i] = x, F_m, force
        assert outputs.allowed.mode == safety.MODE_FOLLOW
    return times, rows


@pytest.mark.parametrize(("meniscus", "contact_cm"), [(True, 0.703), (False, 0.672)])
def test_figure_12(meniscus, contact_cm):
    times, rows = virtual_impedance(AfmConfig(meniscus=meniscus).to_params())
    held = (times >= 2.2) & (times < 2.5)
    assert round(float(np.mean(rows[held, 1] / (1e8 * rows[held, 2]))), 3) == 1.050
    assert round(float(rows[-1000:, 0].mean()) * 100, 3) == contact_cm
    assert abs(rows[-1000:, 2].mean()) < 1e-15
    if meniscus:
        assert round(rows[:, 2].min() * 1e9, 1) == -12.5


def test_the_simulated_device_is_a_driver(params):
    afm = simulated_afm(params)
    with pytest.raises(RuntimeError, match="not open"):
        afm.exchange(0.0)
    afm.retract()
    afm.open()
    with pytest.raises(RuntimeError, match="already open"):
        afm.open()
    sample = afm.exchange(12e-9)
    assert isinstance(sample, AfmSample)
    assert sample.in_contact and sample.distance_valid
    with pytest.raises(ValueError, match="finite"):
        afm.exchange(math.nan)
    afm.retract()
    assert afm.safe_position_m == -100e-9
    afm.close()
    afm.close()
    with pytest.raises(RuntimeError, match="not open"):
        afm.exchange(0.0)
