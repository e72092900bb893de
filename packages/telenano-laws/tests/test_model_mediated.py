"""The model-mediated law: it learns the surface, changes it safely, and guards the tip."""

import random
from typing import Any

import numpy as np
import pytest
from compact_surface import force_nn, potential
from hypothesis import given
from hypothesis import strategies as st
from telenano_laws.model_mediated import (
    ModelMediatedConfig,
    master_energy_account,
    master_receive,
    master_resume,
    master_send,
    master_start,
    retune,
    slave_energy_account,
    slave_receive,
    slave_retune,
    slave_start,
    updated,
)
from telenano_laws.surface import Surface

from telenano.extend.laws import NO_SIGNAL, HandSample, TipMeasurement
from telenano.extend.virtual_mass import tip_reference
from telenano.testing import run_law

T = 1e-3
PARAMS = ModelMediatedConfig().to_params(T)
K, RANGE = PARAMS.fit.cantilever, PARAMS.fit.range_nm
JOULES = 1e-18 * 1e8 / 1.5e-6

surfaces = st.builds(Surface, st.floats(-5.0, 5.0), st.floats(1.0, 100.0), st.floats(0.0, 30.0))


@given(surfaces, surfaces, st.floats(-10e-9, 10e-9), st.floats(0.0, 1e-3))
def test_update_never_uses_more_energy_than_there_is(old: Surface, new: Surface, x: float, store: float) -> None:
    model, used, force = updated(PARAMS, old, new, PARAMS.follow, x, store)
    assert force == force_nn(model, K, RANGE, x / 1e-9)
    rise = (potential(model, K, RANGE, 1e9 * x) - potential(old, K, RANGE, 1e9 * x)) * JOULES
    assert rise <= store + 1e-18
    assert used == pytest.approx(max(rise, 0.0), rel=1e-9, abs=1e-18)
    change = abs(force_nn(model, K, RANGE, 1e9 * x) - force_nn(old, K, RANGE, 1e9 * x)) * 0.1
    assert change <= PARAMS.force_step_n * (1.0 + 1e-12)


def test_update_at_the_bound_passes_and_a_millionth_past_it_does_not() -> None:
    # pressed 1 nm in, the surface rises by a millionth of the way to the goal, well below the limit of the force
    old, x = Surface(0.0, 18.0, 0.0), 1e-9
    goal = Surface(-1e-3, 18.0, 0.0)
    model, used, force = updated(PARAMS, old, goal, PARAMS.follow, x, 1.0)
    assert used > 0.0
    assert updated(PARAMS, old, goal, PARAMS.follow, x, used) == (model, used, force)
    less, cost, _ = updated(PARAMS, old, goal, PARAMS.follow, x, used * (1.0 - 1e-6))
    assert cost < used
    assert abs(less.contact_nm) < abs(model.contact_nm)


def between(value: float) -> Any:
    """Leave a value between the ends of its range to the endurance tests."""
    return pytest.param(value, marks=pytest.mark.endurance)


@pytest.mark.parametrize("delay", [*map(between, [0, 20, 100]), 250])
def test_surface_is_learnt_and_held(delay: int) -> None:
    truth = Surface(5.0, 18.2, 12.0)

    def environment(x: float) -> float:
        return force_nn(truth, K, RANGE, 1e9 * x) * 1e-9

    run = run_law(
        "model_mediated",
        lambda n: 1.0 + 0.5 * np.sin(0.004 * n),
        environment,
        12_000,
        lambda n: delay,
        lambda n: delay,
    )
    model = run.masters[-1].model
    reach = np.linspace(6.45, 6.9, 8)
    for x in reach:
        assert force_nn(model, K, RANGE, x) == pytest.approx(force_nn(truth, K, RANGE, x), rel=0.02, abs=0.1)
    # the hand feels what the tip will, a delay later
    shown, felt = run.shown_n[8000 : 12_000 - 2 * delay], 1e8 * run.force_n[8000 + delay : 12_000 - delay]
    assert np.abs(shown - felt).max() < 0.06


@pytest.mark.parametrize("stiffness", [10.0, between(20.0), 38.0])
@pytest.mark.parametrize("delay", [0, between(50), 250])
def test_spring_is_held_at_any_delay(stiffness: float, delay: int) -> None:
    run = run_law("model_mediated", lambda n: 1.0, lambda x: stiffness * x, 6000, lambda n: delay, lambda n: delay)
    assert np.ptp(1e8 * run.force_n[-500:]) < 1e-2
    assert 1e8 * run.force_n[-1] == pytest.approx(1.0, rel=0.03, abs=0.0)
    assert master_energy_account(PARAMS, run.masters[-1]).dissipated_j >= 0.0


def test_updates_are_paid_from_the_damper_at_all_times() -> None:
    run = run_law(
        "model_mediated", lambda n: 2.0, lambda x: max(38.0 * (x - 5e-9), 0.0), 6000, lambda n: 250, lambda n: 9
    )
    injected = np.array([state.injected_j for state in run.masters])
    dissipated = np.array([state.dissipated_j for state in run.masters])
    assert injected[-1] > 0.0
    assert (injected <= dissipated * (1.0 + 1e-12)).all()


def test_surface_met_late_begins_under_the_hand_almost_without_force() -> None:
    hand = HandSample(8e-3, 0.0, 1.0, True)
    state = master_start(PARAMS, hand)
    answer = NO_SIGNAL._replace(position_m=9e-9, force_n=-1.2e-8, in_contact=True, active=True, silence_s=0.0)
    state, reference = master_receive(PARAMS, state, hand, answer, T)
    assert state.rendered
    assert abs(reference.force_n) <= PARAMS.force_step_n
    assert state.model.contact_nm >= 12.0


@pytest.mark.parametrize("beyond_m", [1e-3, 4.7e-3, 8e-3])
@pytest.mark.parametrize("interrupted", ["off", "silent"])
def test_a_surface_that_was_learnt_while_the_hand_was_let_go_begins_under_it_too(
    interrupted: str, beyond_m: float
) -> None:
    """The tip is armed in contact and heard of while the device is off, or was known before a silence."""
    hand = HandSample(0.0, 0.0, 1.0, True)
    answer = NO_SIGNAL._replace(position_m=9e-9, force_n=-1.2e-8, in_contact=True, active=True, silence_s=0.0)
    state = master_start(PARAMS, hand)
    off = hand._replace(following=False)
    for tick in range(10):
        signal = answer if tick < 5 or interrupted == "off" else answer._replace(silence_s=1.0)
        state, _ = master_receive(PARAMS, state, off if interrupted == "off" else hand, signal, T)
    # something else moves the device meanwhile, far into the surface
    hand = hand._replace(position_m=6e-3 + beyond_m)
    state, reference = master_receive(PARAMS, state, hand, answer, T)
    assert state.fit.known and state.rendered
    assert abs(reference.force_n) <= PARAMS.force_step_n


def test_guard_presses_no_harder_than_the_hand() -> None:
    tip = TipMeasurement(9e-9, 0.0, 0.0, False, True, True, 0.0)
    state = slave_start(PARAMS, tip)
    signal = NO_SIGNAL._replace(position_m=15e-9, force_n=1e-8, active=True, silence_s=0.0)
    for _ in range(300):
        force = 30.0 * (state.position_m - 9e-9)
        assert force <= 1e-8 * (1.0 + 1e-9)
        moved = tip._replace(force_n=force, base_position_m=state.position_m)
        state, _ = slave_receive(PARAMS, state, signal, moved, T)
    assert force == pytest.approx(1e-8, rel=1e-6, abs=0.0)


@pytest.mark.parametrize("seed", range(3))
def test_the_tip_never_takes_more_than_the_hand_has_worked(seed: int) -> None:
    """A hand that pulled felt nothing of a spring, and the tip took the energy of it from nowhere."""
    draw = random.Random(seed)
    stiffness, delay, size = draw.uniform(5.0, 150.0), draw.randrange(10, 150), draw.uniform(0.5, 3.0)
    mean, rate = draw.uniform(-1.0, 1.0) * size, draw.uniform(4e-3, 8e-3)
    run = run_law(
        "model_mediated",
        lambda n: mean + size * np.sin(rate * n),
        lambda x: stiffness * x,
        1600,
        lambda n: delay,
        lambda n: -1 if n % 5 == 0 else delay,
    )
    assert (run.left_j <= PARAMS.start_j + np.maximum.accumulate(run.entered_j) + 1e-9).all()


def listening(tip: TipMeasurement, signal: Any) -> Any:
    """Return the state of a slave half that has heard of the hand once."""
    return slave_receive(PARAMS, slave_start(PARAMS, tip), signal, tip, T)[0]


def test_a_tip_with_nothing_left_stays_and_may_always_give_way() -> None:
    pulled = TipMeasurement(-5e-9, -2e-8, 0.0, False, True, True, 0.0)
    signal = NO_SIGNAL._replace(position_m=-6e-9, energy_j=3e-3, active=True, silence_s=0.0)
    state = listening(pulled, signal)
    assert slave_energy_account(PARAMS, state) == (PARAMS.start_j, 0.0, PARAMS.start_j)
    spent = state._replace(port=state.port._replace(energy_j=-1e-4), position_m=-5e-9)
    assert slave_receive(PARAMS, spent, signal, pulled, T)[1].position_m == -5e-9
    assert slave_receive(PARAMS, spent, signal._replace(position_m=-4e-9), pulled, T)[1].position_m > -5e-9
    in_air = pulled._replace(force_n=0.0, in_contact=False)
    assert slave_receive(PARAMS, spent, signal, in_air, T)[1].position_m == pytest.approx(-6e-9, rel=1e-9, abs=0.0)
    # what the hand works from now on is paid for, and what it takes back is taken back
    paid = slave_receive(PARAMS, spent, signal._replace(energy_j=4e-3), pulled, T)[0]
    assert paid.port.energy_j == pytest.approx(9e-4, rel=1e-9, abs=0.0)
    assert (
        slave_receive(PARAMS, spent, signal._replace(energy_j=2e-3), pulled, T)[0].port.energy_j < spent.port.energy_j
    )


def test_each_arming_grants_the_tip_what_it_lacks_and_no_more() -> None:
    tip = TipMeasurement(0.0, 0.0, 0.0, False, False, True, 0.0)
    signal = NO_SIGNAL._replace(active=True, silence_s=0.0)
    state = listening(tip, signal)
    state = state._replace(port=state.port._replace(energy_j=0.25 * PARAMS.start_j))
    for _ in range(3):
        state, _ = slave_receive(PARAMS, state, signal, tip._replace(following=False), T)
    assert state.port.energy_j == PARAMS.start_j
    assert state.granted_j == pytest.approx(1.75 * PARAMS.start_j, rel=1e-9, abs=0.0)


def test_other_scales_keep_the_port_of_the_tip_and_a_lower_cap_cuts_what_is_left() -> None:
    tip = TipMeasurement(3e-9, 1e-8, 0.0, False, True, True, 0.0)
    state = listening(tip, NO_SIGNAL._replace(active=True, silence_s=0.0))
    new = ModelMediatedConfig(position_scale=3e-6, force_scale=5e7, tip_energy_cap_j=1e-4).to_params(T)
    port = slave_retune(PARAMS, new, state).port
    assert port.position_m == pytest.approx(1e-3, rel=1e-9, abs=0.0)
    assert port.force_n == pytest.approx(0.5, rel=1e-9, abs=0.0)
    assert port.energy_j == 1e-4


def test_the_reference_stops_ahead_of_a_device_that_is_stuck() -> None:
    state, hand = master_start(PARAMS, HandSample(0.0, 0.0, -2.0, True)), HandSample(0.0, 0.0, -2.0, True)
    answer = NO_SIGNAL._replace(active=True, silence_s=0.0)
    for _ in range(2000):
        state, reference = master_receive(PARAMS, state, hand, answer, T)
    assert reference.position_m == -2e-3
    # and the hand has not worked at a device that stands
    assert master_send(PARAMS, state, hand, T)[1].energy_j == 0.0


def test_guard_takes_long_gaps_without_pressing_through() -> None:
    tip = TipMeasurement(9e-9, 0.0, 0.0, False, True, True, 0.0)
    signal = NO_SIGNAL._replace(position_m=1e-7, force_n=1e-8, active=True, silence_s=0.0)
    state, _ = slave_receive(PARAMS, slave_start(PARAMS, tip), signal, tip, 0.05)
    assert 20.0 * (state.position_m - 9e-9) <= 1e-8


def test_uncoupled_tip_stays_and_a_retracted_one_gets_the_reference() -> None:
    tip = TipMeasurement(9e-9, 0.0, 0.0, False, True, True, 0.0)
    signal = NO_SIGNAL._replace(position_m=15e-9, silence_s=0.0)
    assert slave_receive(PARAMS, slave_start(PARAMS, tip), signal, tip, T)[1].position_m == 9e-9
    away = tip._replace(following=False)
    assert slave_receive(PARAMS, slave_start(PARAMS, tip), signal, away, T)[1].position_m == 15e-9


def test_resume_and_retune_keep_the_tip() -> None:
    state = master_resume(PARAMS, HandSample(5e-3, 0.01, 0.0, True), 1.1e-8)
    _, signal = master_send(PARAMS, state, HandSample(5e-3, 0.01, 0.0, True), T)
    assert signal.position_m == pytest.approx(1.1e-8, rel=1e-14, abs=0.0)
    other = ModelMediatedConfig(position_scale=1e-7).to_params(T)
    after = tip_reference(other.mass, retune(PARAMS, other, state).mass)
    assert after == pytest.approx(1.1e-8, rel=1e-13, abs=0.0)
