"""The dead band: what passes, what is kept back, and what the rate becomes."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from telenano.extend.laws import NO_SIGNAL, PortSignal
from telenano.laws.deadband import DeadbandParams, DeadbandState, deadband, initial_deadband_state
from telenano.sections.deadband_section import DeadbandConfig

T = 1e-3
PARAMS = DeadbandConfig(enabled=True).to_params()
ENDLESS = PARAMS._replace(keep_alive_s=1e9)


def passed(params: DeadbandParams, signals: list[PortSignal]) -> tuple[list[bool], DeadbandState]:
    state, flags = initial_deadband_state(NO_SIGNAL), []
    for signal in signals:
        state, send = deadband(params, state, signal, T)
        flags.append(send)
    return flags, state


def of(**fields: Any) -> PortSignal:
    return NO_SIGNAL._replace(**fields)


def test_first_signal_and_every_one_without_the_band_pass() -> None:
    assert passed(PARAMS, [NO_SIGNAL] * 3)[0] == [True, False, False]
    flags, state = passed(DeadbandConfig().to_params(), [NO_SIGNAL] * 9)
    assert (all(flags), state.offered, state.sent) == (True, 9, 9)


@pytest.mark.parametrize(
    ("field", "value", "step"),
    [
        ("force_n", 1e-8, 1e-9),
        ("velocity_m_per_s", 1e-8, 1e-9),
        ("wave_sqrt_w", 0.2, 0.02),
        ("position_m", 1e-8, 5e-11),
        ("force_n", 0.0, 1e-10),
    ],
)
def test_change_at_the_threshold_is_kept_and_one_just_past_it_passes(field: str, value: float, step: float) -> None:
    at, past = value + step * (1.0 - 1e-6), value + step * (1.0 + 1e-6)
    assert passed(ENDLESS, [of(**{field: value}), of(**{field: at})])[0] == [True, False]
    assert passed(ENDLESS, [of(**{field: value}), of(**{field: past})])[0] == [True, True]


@pytest.mark.parametrize("field", ["active", "in_contact", "separation_valid"])
def test_change_of_a_flag_passes_at_once(field: str) -> None:
    assert passed(ENDLESS, [NO_SIGNAL, NO_SIGNAL, of(**{field: True})])[0] == [True, False, True]


def test_silence_never_gets_longer_than_the_keep_alive() -> None:
    flags, state = passed(PARAMS, [NO_SIGNAL] * 1000)
    assert np.diff(np.flatnonzero(flags)).tolist() == [20] * 49
    assert (state.offered, state.sent) == (1000, 50)


def test_rate_on_a_growing_force_is_logarithmic() -> None:
    # F from 1 to 20 nN: a signal at every factor 1.1
    forces = np.geomspace(1e-8, 2e-7, 20_000)
    flags, _ = passed(ENDLESS, [of(force_n=force) for force in forces])
    assert sum(flags) == pytest.approx(1 + math.log(20.0) / math.log(1.1), abs=1.0)


@given(st.lists(st.floats(-2e-8, 2e-8), min_size=1, max_size=200), st.floats(0.0, 0.5))
def test_receiver_is_never_further_off_than_the_band(forces: list[float], weber: float) -> None:
    params = ENDLESS._replace(weber_fraction=weber)
    state = initial_deadband_state(NO_SIGNAL)
    for force in forces:
        state, _ = deadband(params, state, of(force_n=force), T)
        assert abs(force - state.last.force_n) <= max(weber * abs(state.last.force_n), params.force_n)


@pytest.mark.parametrize(("gap_s", "sent"), [(1e-3, 50), (1.9e-2, 500), (2e-2, 1000), (5e-2, 1000)])
def test_keep_alive_is_a_time_and_not_a_number(gap_s: float, sent: int) -> None:
    state = initial_deadband_state(NO_SIGNAL)
    for _ in range(1000):
        state, _ = deadband(PARAMS, state, NO_SIGNAL, gap_s)
    assert state.sent == sent


@pytest.mark.parametrize(
    "settings", [{"keep_alive_s": 0.05}, {"keep_alive_s": 0.0}, {"weber_fraction": 1.0}, {"weber_fraction": -0.1}]
)
def test_settings_that_break_it_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=next(iter(settings))):
        DeadbandConfig.model_validate(settings)
