"""Calibrations find what the simulated instrument has, within the errors that they state."""

import pytest

from proto.errors import ConfigError
from services.afm_node.config import AfmConfig
from studies.instrument.instrument_calibration import calibrate_sensitivity, calibrate_stiffness

# Q of 20: a resonance that is wide needs a short record
QUICK = AfmConfig.model_validate({"cantilever": {"quality": 20.0}})


def test_the_sensitivity_is_found_within_its_error_and_what_the_sample_takes():
    found = calibrate_sensitivity(AfmConfig(), noise_v=5e-3)
    assert found.true_sensitivity_per_m == 1e3
    # 5 mV on 125 mV, 200 points
    assert found.standard_error_per_m == pytest.approx(1e3 * 5e-3 / (0.125 / 12**0.5 * 200**0.5), rel=0.15)
    assert abs(found.sensitivity_per_m - 1e3) < 3.0 * found.standard_error_per_m + 0.06e3
    # the sample gives way, so that the deflection is less than the way
    exact = calibrate_sensitivity(AfmConfig(), noise_v=0.0, bits=32)
    assert 0.94e3 < exact.sensitivity_per_m < 1e3
    with pytest.raises(ConfigError, match="three points"):
        calibrate_sensitivity(AfmConfig(), points=2)


def test_the_stiffness_is_found_from_the_noise_also_above_a_floor():
    found = calibrate_stiffness(QUICK, seconds=0.1)
    assert found.true_stiffness_n_per_m == 40.0
    assert abs(found.stiffness_n_per_m - 40.0) < 4.0 * found.standard_error_n_per_m
    assert found.standard_error_n_per_m < 2.0
    assert found.by_total_noise_n_per_m == pytest.approx(40.0, rel=0.05)
    assert found.resonance_hz == pytest.approx(150e3, rel=2e-3)
    assert found.quality == pytest.approx(20.0, rel=0.1)
    # with a floor the whole noise is more than that of the cantilever, and the resonance is not
    noisy = calibrate_stiffness(QUICK, seconds=0.1, floor_m_per_root_hz=20e-15)
    assert noisy.by_total_noise_n_per_m < 0.8 * 40.0
    assert abs(noisy.stiffness_n_per_m - 40.0) < 4.0 * noisy.standard_error_n_per_m
    # of few spectra as well, whose low points would count for more by their own scatter: that gave 46 N/m
    few = [calibrate_stiffness(QUICK, seconds=0.05, seed=seed).stiffness_n_per_m for seed in range(4)]
    assert sum(few) / 4 == pytest.approx(40.0, rel=0.07, abs=0.0)
    with pytest.raises(ConfigError, match="are too short"):
        calibrate_stiffness(AfmConfig(), seconds=1e-3)
