"""The paper's law against its closed form, its steady state and its rules of coupling."""

import math

import numpy as np
import pytest

from telenano.extend.laws import NO_SIGNAL, HandSample, PortSignal, TipMeasurement, measured_tip
from telenano.extend.pass_through import slave_receive, slave_start
from telenano.laws.virtual_impedance import (
    ImpedanceState,
    master_receive,
    master_send,
    master_start,
    retune,
)
from telenano.sections import VirtualImpedanceConfig

PERIOD_S = 1e-3
PARAMS = VirtualImpedanceConfig().to_params(PERIOD_S)


def pressing(force_n: float, position_m: float = 0.0, following: bool = True) -> HandSample:
    return HandSample(position_m, 0.0, force_n, following)


def answer(force_n: float, silence_s: float = 0.0, active: bool = True) -> PortSignal:
    return NO_SIGNAL._replace(force_n=force_n, active=active, silence_s=silence_s)


def test_free_motion_is_the_closed_form_of_the_impedance() -> None:
    # M x'' + B x' = K_f F from rest: x = (u/B) (t - tau (1 - e^(-t/tau))), tau = M/B
    state, u, tau = ImpedanceState(0.0, 0.0, 0.0), 20.0 * 0.7, 10.0 / 2000.0
    for n in range(1, 301):
        state, reference = master_receive(PARAMS, state, pressing(0.7), answer(0.0), PERIOD_S)
        t = n * PERIOD_S
        expected = u / 2000.0 * (t - tau * (1.0 - math.exp(-t / tau)))
        assert reference.position_m == pytest.approx(expected, rel=1e-11, abs=0.0)
    assert reference.velocity_m_per_s == pytest.approx(u / 2000.0, rel=1e-11, abs=0.0)


def test_virtual_spring_settles_at_force_over_stiffness() -> None:
    params = VirtualImpedanceConfig(stiffness_n_per_m=5000.0).to_params(PERIOD_S)
    state = ImpedanceState(0.0, 0.0, 0.0)
    for _ in range(20_000):
        state, reference = master_receive(params, state, pressing(1.0), answer(0.0), PERIOD_S)
    assert reference.position_m == pytest.approx(20.0 / 5000.0, rel=1e-9, abs=0.0)


@pytest.mark.parametrize("stiffness", [10.0, 20.0, 38.0])
@pytest.mark.parametrize("gain", [5.0, 20.0])
def test_steady_state_on_a_spring_is_equation_17(stiffness: float, gain: float) -> None:
    params = VirtualImpedanceConfig(force_gain=gain).to_params(PERIOD_S)
    state = ImpedanceState(0.0, 0.0, 0.0)
    for _ in range(5000):
        state, signal = master_send(params, state, pressing(1.0), PERIOD_S)
        force = stiffness * signal.position_m
        state, _ = master_receive(params, state, pressing(1.0), answer(force), PERIOD_S)
    assert 1.0 / (1e8 * force) == pytest.approx(1.0 + 1.0 / gain, rel=1e-9, abs=0.0)


def test_many_periods_at_once_are_as_many_single_ones() -> None:
    start = ImpedanceState(1e-3, 2e-3, 0.0)
    together, _ = master_receive(PARAMS, start, pressing(0.4), answer(1e-9), 7 * PERIOD_S)
    for _ in range(7):
        start, _ = master_receive(PARAMS, start, pressing(0.4), answer(1e-9), PERIOD_S)
    np.testing.assert_allclose(together, start, rtol=1e-13, atol=0.0)


def test_reference_is_the_scaled_position() -> None:
    _, signal = master_send(PARAMS, ImpedanceState(7e-3, 1e-3, 0.0), pressing(1.0), PERIOD_S)
    assert signal.position_m == 1.5e-6 * 7e-3
    assert signal.velocity_m_per_s == 1.5e-6 * 1e-3
    assert signal.force_n == 1.0 / 1e8
    assert signal.active


@pytest.mark.parametrize(
    ("hand", "signal"),
    [
        (pressing(1.0, 5e-3, following=False), answer(1e-9)),
        (pressing(1.0, 5e-3), answer(1e-9, silence_s=math.nextafter(0.05, 1.0))),
        (pressing(1.0, 5e-3), NO_SIGNAL),
    ],
)
def test_uncoupled_mass_stays_with_the_hand_and_the_tip_stays_put(hand: HandSample, signal: PortSignal) -> None:
    state = ImpedanceState(7e-3, 4e-3, 1e-10)
    before = master_send(PARAMS, state, hand, PERIOD_S)[1].position_m
    state, reference = master_receive(PARAMS, state, hand, signal, PERIOD_S)
    after = master_send(PARAMS, state, hand, PERIOD_S)[1].position_m
    assert (state.position_m, state.velocity_m_per_s) == (5e-3, 0.0)
    assert reference.position_m == 5e-3
    assert after == pytest.approx(before, rel=1e-14, abs=0.0)


def test_tip_that_is_retracted_will_be_where_the_hand_is() -> None:
    state, hand = ImpedanceState(7e-3, 4e-3, 1e-10), pressing(1.0, 5e-3)
    state, reference = master_receive(PARAMS, state, hand, answer(1e-9, active=False), PERIOD_S)
    assert reference.position_m == 5e-3
    sent = master_send(PARAMS, state, hand, PERIOD_S)[1].position_m
    assert sent == pytest.approx(PARAMS.position_scale * 5e-3, rel=1e-14, abs=0.0)


def test_hand_is_let_go_just_past_the_silence_limit_and_not_at_it() -> None:
    state = master_start(PARAMS, pressing(1.0))
    assert master_receive(PARAMS, state, pressing(1.0), answer(0.0, silence_s=0.05), PERIOD_S)[1].active
    late = answer(0.0, silence_s=math.nextafter(0.05, 1.0))
    assert not master_receive(PARAMS, state, pressing(1.0), late, PERIOD_S)[1].active


def test_hand_that_does_not_follow_yet_is_asked_to() -> None:
    state = master_start(PARAMS, pressing(0.0, 2e-3, following=False))
    _, reference = master_receive(PARAMS, state, pressing(0.0, 2e-3, following=False), answer(0.0), PERIOD_S)
    assert reference.active
    assert reference.position_m == 2e-3


def test_change_of_position_scale_does_not_move_the_tip() -> None:
    state = ImpedanceState(7e-3, 1e-3, 0.0)
    other = VirtualImpedanceConfig(position_scale=3e-7).to_params(PERIOD_S)
    before = master_send(PARAMS, state, pressing(0.0), PERIOD_S)[1].position_m
    carried = retune(PARAMS, other, state)
    assert carried[:2] == state[:2]
    after = master_send(other, carried, pressing(0.0), PERIOD_S)[1].position_m
    assert after == pytest.approx(before, rel=1e-14, abs=0.0)


def test_slave_half_passes_through() -> None:
    tip = TipMeasurement(9e-9, -3e-9, 2e-10, True, True, True, 0.0)
    state = slave_start(PARAMS, tip)
    assert state.position_m == 9e-9
    state, reference = slave_receive(PARAMS, state, answer(0.0)._replace(position_m=1.1e-8), tip, PERIOD_S)
    assert (reference.position_m, reference.active) == (1.1e-8, True)
    _, signal = measured_tip(PARAMS, state, tip, PERIOD_S)
    assert (signal.position_m, signal.force_n, signal.separation_m) == (9e-9, -3e-9, 2e-10)
    assert (signal.separation_valid, signal.in_contact, signal.active) == (True, True, True)
