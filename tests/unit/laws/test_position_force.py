"""Direct reflection: steady state, and the delay that its phase margin allows."""

import math
from typing import Any

import numpy as np
import pytest

from telenano.extend.laws import NO_SIGNAL, HandSample, TipMeasurement, measured_tip
from telenano.extend.pass_through import slave_receive, slave_start
from telenano.extend.virtual_mass import tip_reference
from telenano.laws.position_force import master_receive, master_resume, master_send, master_start, retune
from telenano.sections.own_laws import PositionForceConfig

PARAMS = PositionForceConfig().to_params(1e-3)


def critical_ticks(stiffness: float) -> float:
    """Give the delay [ms] at the phase margin of K_h e^(-sT) / (M s^2 + B s), less the half period of the hold."""
    k, m, b = 150.0 * stiffness, 0.5, 100.0
    w2 = (-(b * b) + math.sqrt(b**4 + 4.0 * m * m * k * k)) / (2.0 * m * m)
    w = math.sqrt(w2)
    return 1e3 * (math.pi / 2.0 - math.atan(m * w / b)) / w - 0.5


def rest_of(run: Any) -> tuple[float, float]:
    return float(np.ptp(1e8 * run.force_n[1500:2000])), float(np.ptp(1e8 * run.force_n[-500:]))


@pytest.mark.check("takes 0.9 s")
@pytest.mark.parametrize("stiffness", [10.0, 20.0, 38.0])
def test_force_is_reflected_as_it_is(run_loop: Any, stiffness: float) -> None:
    run = run_loop("position_force", lambda n: 1.0, lambda x: stiffness * x, 3000)
    assert 1e8 * run.force_n[-1] == pytest.approx(1.0, rel=1e-9, abs=0.0)


@pytest.mark.check("takes 2.0 s")
@pytest.mark.parametrize("stiffness", [10.0, 20.0, 38.0])
def test_oscillation_dies_just_below_the_delay_margin_and_grows_just_above(run_loop: Any, stiffness: float) -> None:
    margin = critical_ticks(stiffness)
    below, above = math.floor(0.97 * margin), math.ceil(1.03 * margin)
    run = run_loop("position_force", lambda n: 0.1, lambda x: stiffness * x, 4000, backward=lambda n: below)
    earlier, later = rest_of(run)
    assert later < 0.9 * earlier
    run = run_loop("position_force", lambda n: 0.1, lambda x: stiffness * x, 4000, backward=lambda n: above)
    earlier, later = rest_of(run)
    assert later > 1.1 * earlier


def test_channel_makes_energy_past_the_margin(run_loop: Any) -> None:
    run = run_loop("position_force", lambda n: 1.0, lambda x: 20.0 * x, 3000, backward=lambda n: 100)
    assert (run.entered_j - run.left_j).min() < -1e-3


def test_half_that_does_not_follow_keeps_the_tip() -> None:
    state = master_start(PARAMS, HandSample(5e-3, 0.0, 0.0, True))
    before = tip_reference(PARAMS.mass, state)
    hand = HandSample(6e-3, 0.0, 1.0, False)
    state, reference = master_receive(PARAMS, state, hand, NO_SIGNAL._replace(active=True, silence_s=0.0), 1e-3)
    assert reference.position_m == 6e-3
    state, signal = master_send(PARAMS, state, hand, 1e-3)
    assert signal.position_m == pytest.approx(before, rel=1e-14, abs=0.0)
    assert not signal.active


def test_slave_passes_reference_and_force() -> None:
    tip = TipMeasurement(9e-9, -3e-9, 2e-10, True, True, True, 0.0)
    state, reference = slave_receive(PARAMS, slave_start(PARAMS, tip), NO_SIGNAL._replace(position_m=1e-8), tip, 1e-3)
    assert reference == (1e-8, True)
    _, signal = measured_tip(PARAMS, state, tip, 1e-3)
    assert (signal.force_n, signal.position_m, signal.in_contact, signal.active) == (-3e-9, 9e-9, True, True)


def test_resume_and_retune_keep_the_tip() -> None:
    state = master_resume(PARAMS, HandSample(5e-3, 0.02, 0.0, True), 1.1e-8)
    assert tip_reference(PARAMS.mass, state) == pytest.approx(1.1e-8, rel=1e-14, abs=0.0)
    other = PositionForceConfig(position_scale=1e-7).to_params(1e-3)
    after = tip_reference(other.mass, retune(PARAMS, other, state))
    assert after == pytest.approx(1.1e-8, rel=1e-13, abs=0.0)
