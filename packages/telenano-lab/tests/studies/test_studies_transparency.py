"""Transparency against what the paper's law must give by its equations."""

import math
from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.loops.cells import Cell
from telenano_lab.studies.loops.transparency import FREQUENCY_HZ, Spectrum, hand_force_profile, measure, spectrum

from telenano.sections import HapticConfig


def cell(delay_ms: float, **more: Any) -> Cell:
    return Cell(law="virtual_impedance", environment="spring", round_trip_ms=delay_ms, stiffness_n_per_m=10.0, **more)


def test_numbers_of_the_papers_law_without_delay() -> None:
    found = measure(cell(0.0))
    omega = 2.0 * math.pi * FREQUENCY_HZ
    assert found.verdict == "stable"
    assert found.true_stiffness_n_per_m == pytest.approx(1500.0, rel=1e-12, abs=0.0)
    # F_m = Z v / K_f + (1 + 1/K_f) alpha_f F_s, at the reference; the servo turns the hand's phase by about 2 degrees
    assert found.rendered_stiffness_n_per_m == pytest.approx(1.05 * 1500.0, rel=0.02, abs=0.0)
    assert found.free_impedance_n_s_per_m == pytest.approx(2000.0 / 20.0, rel=0.01, abs=0.0)
    pressed = abs(complex(1.05 * 1500.0, 100.0 * omega)) / omega
    assert found.contrast_db == pytest.approx(20.0 * math.log10(pressed / 100.0), rel=0.01, abs=0.0)


def test_perceived_delay_grows_by_the_round_trip() -> None:
    without, with_delay = measure(cell(0.0)), measure(cell(30.0))
    assert without.perceived_delay_ms is not None
    assert with_delay.perceived_delay_ms is not None
    assert with_delay.perceived_delay_ms - without.perceived_delay_ms == pytest.approx(30.0, rel=0.02, abs=0.0)


def test_tracking_error_is_that_of_the_lag() -> None:
    # half the round trip, less the device's own lag of about 11 ms: |1 - e^(-j omega t)|
    found = measure(cell(40.0))
    lag_s = 0.5 * 40e-3 - 11e-3
    expected = 100.0 * abs(1.0 - np.exp(-2j * math.pi * FREQUENCY_HZ * lag_s))
    assert found.tracking_error_percent == pytest.approx(expected, rel=0.1, abs=0.0)


def test_what_is_unstable_has_no_numbers() -> None:
    found = measure(cell(200.0))
    assert found.verdict != "stable"
    assert found.rendered_stiffness_n_per_m is None
    assert found.contrast_db is None


def test_programme_is_a_sine_on_a_ramp() -> None:
    points, begin_s = hand_force_profile(1.0, 0.5)
    times, forces = np.array(points).T
    assert (np.diff(times) > 0.0).all()
    assert begin_s == pytest.approx(1.0 + 3 / FREQUENCY_HZ, rel=1e-12, abs=0.0)
    sine = forces[2:] - 1.0
    assert np.abs(sine).max() == pytest.approx(0.3, rel=1e-4, abs=0.0)
    assert abs(sine.mean()) < 1e-6


def servo(omega: float) -> complex:
    """Return x_m/x_mr of the device, whose command acts a period after the force that it answers."""
    square, damping = HapticConfig().device.to_params().closed_loop_coefficients()
    return complex(square * np.exp(-1e-3j * omega)) / complex(square - omega**2, damping * omega)


def test_hybrid_matrix_is_that_of_the_law_and_its_device() -> None:
    delay_s, omega = 30e-3, 2.0 * math.pi * 5.0
    found = spectrum(cell(30.0), (5.0,))
    assert found.hybrid[0] is not None
    h11, h12, h21, h22 = found.hybrid[0]
    # at the device the motion is D v; the hold is worth half a period, and what the tip feels is noted at a tick's end
    assert h11 == pytest.approx(complex(2000.0, 10.0 * omega) / 20.0 / servo(omega), rel=0.02, abs=0.0)
    assert h12 == pytest.approx(1.05 * np.exp(-1j * omega * (0.5 * delay_s - 0.5e-3)), rel=0.02, abs=0.0)
    assert h21 == pytest.approx(-np.exp(-1j * omega * 0.5 * delay_s) / servo(omega), rel=0.03, abs=0.0)
    assert abs(h22) < 5e-2 / abs(h11)


def passive_to(round_trip_s: float, frequencies_hz: tuple[float, ...]) -> float:
    """Return K [N/m] from which Re Z < 0 at one of the frequencies, Z = (Z_v + G e^(-sT)/s) / (K_f D)."""

    def least(stiffness: float) -> float:
        shares = []
        for omega in (2.0 * math.pi * frequency for frequency in frequencies_hz):
            held = 21.0 * 150.0 * stiffness * np.exp(-1j * omega * (round_trip_s + 0.5e-3)) / (1j * omega)
            impedance = (complex(2000.0, 10.0 * omega) + held) / servo(omega)
            shares.append(impedance.real / abs(impedance))
        return min(shares) + 2e-3

    low, high = 0.5, 400.0
    for _ in range(50):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if least(middle) >= 0.0 else (low, middle)
    return low


def test_z_width_ends_where_the_impedance_turns_active() -> None:
    frequencies = (2.0,)
    found: Spectrum = spectrum(cell(60.0), frequencies)
    # seven halvings of a factor of 800 leave 5 %
    assert found.passive_n_per_m == pytest.approx(passive_to(0.06, frequencies), rel=0.08, abs=0.0)
    assert found.z_width_db is not None


def test_a_law_with_an_energy_account_moves_without_delay_and_its_figures_make_sense() -> None:
    # with a channel that let nothing through the table had 103 %, -2032 N/m and -681 ms beside the verdict stable
    found = measure(cell(0.0).model_copy(update={"law": "passivity"}))
    assert found.verdict == "stable"
    assert found.tracking_error_percent is not None
    assert found.tracking_error_percent < 75.0
    assert found.rendered_stiffness_n_per_m is not None
    assert 0.25 * found.true_stiffness_n_per_m < found.rendered_stiffness_n_per_m < 1.1 * found.true_stiffness_n_per_m
    assert found.perceived_delay_ms is not None
    assert abs(found.perceived_delay_ms) < 50.0
