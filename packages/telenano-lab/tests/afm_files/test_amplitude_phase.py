"""The energy that an amplitude-phase curve tells of comes back, and a measured image gives what the document states."""

from pathlib import Path

import numpy as np
import pytest
from telenano_lab.afm_files.amplitude_phase import amplitude_phase, amplitude_phase_figure, read_amplitude_phase

from telenano.wire import ConfigError

SHARED = Path(__file__).parents[5] / "shared" / "data"
DATA, CURVE = SHARED / "spot_1-1000nm.ibw", SHARED / "SiN_FD_plot.ibw"


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("constant", "slope"), [(0.0, 0.0), (0.05, 0.3), (0.02, 0.0)])
def test_the_energy_of_a_made_curve_comes_back(side: float, constant: float, slope: float) -> None:
    random = np.random.default_rng(2)
    amplitude = random.uniform(0.6, 0.9, 6000)
    sine = amplitude + (constant + slope * (1.0 - amplitude)) / amplitude
    phase = 90.0 + side * np.degrees(np.arccos(sine)) + random.normal(0.0, 1.0, 6000)
    found = amplitude_phase(amplitude, phase)
    assert abs(found.constant - constant) < 4.0 * found.constant_error + 1e-3
    assert abs(found.slope - slope) < 4.0 * found.slope_error + 5e-3
    assert np.abs(found.phase_deg - found.model_deg).max() < 1.0
    assert found.still_deg == pytest.approx(90.0 + side * np.degrees(np.arccos(found.amplitude)))


def test_what_is_no_curve_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="4 are needed for a curve"):
        amplitude_phase(np.full(1000, 0.8), np.full(1000, 100.0))
    if CURVE.exists():
        with pytest.raises(ConfigError, match="it is not an image in tapping mode"):
            read_amplitude_phase(CURVE)


@pytest.mark.skipif(not DATA.exists(), reason="measured data are not beside the project: ../shared/data")
def test_a_measured_image_gives_what_the_document_states() -> None:
    found = amplitude_phase(*read_amplitude_phase(DATA))
    assert (found.amplitude[0], found.amplitude[-1]) == pytest.approx((0.715, 0.895))
    assert (found.constant, found.slope) == pytest.approx((0.065, 0.37), abs=0.005)
    assert np.sqrt(np.mean((found.phase_deg - found.model_deg) ** 2)) == pytest.approx(1.0, abs=0.05)
    assert amplitude_phase_figure(found).axes[1].get_ylabel() == "residual [degrees]"
