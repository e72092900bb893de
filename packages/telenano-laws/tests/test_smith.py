"""The Smith predictor: with the right model the delay leaves the loop, with the wrong one it comes back."""

from typing import Any

import numpy as np
import pytest
from telenano_laws.smith import (
    HISTORY,
    Estimate,
    SmithConfig,
    estimated,
    master_receive,
    master_resume,
    master_send,
    master_start,
    reference_then,
    retune,
)

from telenano.extend.laws import NO_SIGNAL, HandSample
from telenano.testing import run_law

T = 1e-3
PARAMS = SmithConfig().to_params(T)
EXACT = {"environment_stiffness_n_per_m": 20.0, "estimate": False, "stiffness_rate_n_per_m_s": 1e9}


def spring(x: float) -> float:
    # a preload, so that the tip is in contact from the first tick
    return 20.0 * (x + 1e-10)


@pytest.fixture(scope="module")
def undelayed() -> dict[str, Any]:
    """Keep the loop without a delay, which is run once."""
    return {}


@pytest.mark.parametrize(("forward", "backward"), [(10, 0), (0, 30), (100, 150)])
def test_exact_model_gives_the_undelayed_loop_shifted(undelayed: dict[str, Any], forward: int, backward: int) -> None:
    if not undelayed:
        undelayed["run"] = run_law("smith", lambda n: 1.0 if n >= 1200 else 0.01, spring, 3000, **EXACT)
    direct = undelayed["run"]
    late = run_law(
        "smith", lambda n: 1.0 if n >= 1200 else 0.01, spring, 3000, lambda n: forward, lambda n: backward, **EXACT
    )
    # before the first answer the hand is not coupled: the two runs meet once both have settled
    hand = late.reference_m - late.reference_m[1190] - (direct.reference_m - direct.reference_m[1190])
    assert np.abs(hand[1200:]).max() < 1e-6 * np.ptp(direct.reference_m[1200:])
    tip_late = late.base_m[1200 + forward :] - late.base_m[1199]
    tip = direct.base_m[1200 : 3000 - forward] - direct.base_m[1199]
    assert np.abs(tip_late - tip).max() < 1e-5 * np.ptp(tip)


def test_wrong_model_brings_the_delay_back() -> None:
    # K_e = 0 is the virtual impedance alone: past its margin of 45.5 ms it grows, with 60 % of K it does not
    growth = []
    for stiffness in (0.0, 12.0):
        settings = {**EXACT, "environment_stiffness_n_per_m": stiffness}
        run = run_law("smith", lambda n: 0.1, spring, 3000, lambda n: 30, lambda n: 30, **settings)
        growth.append(np.ptp(run.force_n[-300:]) / np.ptp(run.force_n[600:900]))
    assert growth[0] > 10.0
    assert growth[1] < 0.1


@pytest.mark.parametrize("stiffness", [5.0, 20.0, 38.0])
def test_stiffness_is_estimated_from_what_returns(stiffness: float) -> None:
    run = run_law(
        "smith",
        lambda n: 1.0 + 0.5 * np.sin(0.02 * n),
        lambda x: stiffness * (x + 1e-10),
        3000,
        lambda n: 20,
        lambda n: 20,
    )
    assert run.masters[-1].estimate.stiffness_n_per_m == pytest.approx(stiffness, rel=1e-3, abs=0.0)


def test_jitter_and_loss_do_not_disturb_an_exact_model() -> None:
    rng = np.random.default_rng(3)
    fate = rng.integers(-2, 60, size=(2, 3000)).clip(-1)
    run = run_law(
        "smith",
        lambda n: 1.0,
        spring,
        3000,
        lambda n: int(fate[0, n]),
        lambda n: int(fate[1, n]),
        **EXACT,
    )
    assert 1e8 * run.force_n[-1] == pytest.approx(1.0 / 1.05, rel=1e-3, abs=0.0)


def test_history_is_exact_and_bounded() -> None:
    state = master_start(PARAMS, HandSample(0.0, 0.0, 0.0, True))
    for n in range(3 * HISTORY):
        inner = state.impedance._replace(position_m=1e-3 * n)
        state, _ = master_send(PARAMS, state._replace(impedance=inner), HandSample(0.0, 0.0, 0.0, True), T)
    newest = 3 * HISTORY - 1
    for age in (0, 1, 500, HISTORY - 1, HISTORY + 5):
        expected = 1.5e-6 * 1e-3 * (newest - min(age, HISTORY - 1))
        assert reference_then(state, age * T, T) == pytest.approx(expected, rel=1e-14, abs=0.0)


def test_several_periods_fill_as_many_places() -> None:
    state = master_resume(PARAMS, HandSample(0.0, 0.0, 0.0, True), 1e-8)
    state, _ = master_send(PARAMS, state, HandSample(0.0, 0.0, 0.0, True), 3 * T)
    assert state.newest == 3


def test_estimate_is_frozen_without_motion_and_restarts_with_contact() -> None:
    touching = NO_SIGNAL._replace(in_contact=True, force_n=1e-8)
    estimate = Estimate(0.0, 0.0, 0.0, 0.0, 17.0, False)
    for _ in range(1000):
        estimate = estimated(PARAMS, estimate, 9e-9, touching)
    assert estimate.stiffness_n_per_m == 17.0
    assert estimate.in_contact
    free = estimated(PARAMS, estimate, 9e-9, NO_SIGNAL)
    assert free == Estimate(0.0, 0.0, 0.0, 0.0, 17.0, False)


def test_model_comes_in_and_goes_out_at_its_rate() -> None:
    hand = HandSample(0.0, 0.0, 0.0, True)
    state = master_start(PARAMS, hand)
    touching = NO_SIGNAL._replace(in_contact=True, active=True, silence_s=0.0)
    for n in range(1, 11):
        state, _ = master_receive(PARAMS, state, hand, touching, T)
        assert state.in_use_n_per_m == pytest.approx(0.2 * n, rel=1e-12, abs=0.0)
    state, _ = master_receive(PARAMS, state, hand, touching._replace(in_contact=False), 2 * T)
    assert state.in_use_n_per_m == pytest.approx(1.6, rel=1e-12, abs=0.0)


def test_retune_keeps_the_tip() -> None:
    state = master_resume(PARAMS, HandSample(5e-3, 0.0, 0.0, True), 1.1e-8)
    other = SmithConfig(position_scale=1e-7).to_params(T)
    _, signal = master_send(other, retune(PARAMS, other, state), HandSample(5e-3, 0.0, 0.0, True), T)
    assert signal.position_m == pytest.approx(1.1e-8, rel=1e-13, abs=0.0)
