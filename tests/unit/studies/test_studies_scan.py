"""Images in simulated time: what is imaged is what the tip sees, within the bound that the documentation states."""

from pathlib import Path

import numpy as np
import pytest

from proto.errors import ConfigError
from services.afm_node.config import AfmConfig
from services.afm_node.imaging import ERROR, FORCE, HEIGHT, LATERAL
from services.afm_node.sample import SampleConfig
from services.afm_node.surface import checked
from studies.scan import ScanRequest, scan

DATA = Path(__file__).parents[4] / "shared" / "data" / "spot_1-1000nm.ibw"
DOTS = SampleConfig(name="dots", pixels=256)
CONFIG = AfmConfig()


def test_contact_mode_follows_a_slope_at_its_force():
    ramp = checked(np.tile(np.linspace(0.0, 20e-9, 64), (8, 1)), 200e-9, 25e-9)
    found = scan(ramp, ScanRequest(mode="contact", pixels=32, lines=2, dwell_s=2e-3), CONFIG)
    assert found.rms_error_m < 0.1e-9
    assert np.abs(found.trace[:, 4:, FORCE] - 5e-9).max() < 1.5e-9
    # the retrace is laid over the trace, and both see the slope
    assert np.abs(found.trace[:, 4:, HEIGHT] - found.retrace[:, 4:, HEIGHT])[:, :-4].max() < 0.3e-9


def test_a_contact_image_has_the_lateral_force_of_slope_and_friction_in_both_senses():
    # 1 N/m holds the force on a slope within some percent; the lateral stiffness takes up 50 pm of the way
    section = {"cantilever": {"stiffness_n_per_m": 1.0}, "friction": {"coefficient": 0.3}}
    config = AfmConfig.model_validate(section)
    ramp = checked(np.tile(np.linspace(0.0, 20e-9, 64), (8, 1)), 200e-9, 25e-9)
    found = scan(ramp, ScanRequest(mode="contact", pixels=32, lines=1, dwell_s=2e-3), config)
    slope, friction = 20e-9 / 63 / (200e-9 / 64), config.to_friction_params()
    cosine = 1.0 / np.sqrt(1.0 + slope**2)
    for image, sense in ((found.trace, 1.0), (found.retrace, -1.0)):
        # away from the ends, where the ramp begins and the tip turns; Ogletree, Carpick, Salmeron 1996
        load = image[0, 8:24, FORCE]
        needed = (load * slope * cosine * sense + 0.3 * (load * cosine + friction.adhesion_n)) / (
            cosine - 0.3 * slope * cosine * sense
        )
        assert image[0, 8:24, LATERAL] == pytest.approx(-sense * needed, rel=1e-3, abs=0.0)
    # without friction the slope alone is left
    smooth = scan(ramp, ScanRequest(mode="contact", pixels=32, lines=1, dwell_s=2e-3), CONFIG).trace[0, 8:24]
    assert smooth[:, LATERAL] == pytest.approx(-smooth[:, FORCE] * slope, rel=1e-3, abs=0.0)


def test_an_image_ends_when_it_is_asked_to_and_keeps_its_lines():
    request = ScanRequest(mode="contact", pixels=8, lines=9, dwell_s=2e-4)
    found = scan(DOTS.build(), request, CONFIG, lambda n, of: n < 3)
    assert found.trace.shape[:2] == (3, 8)
    assert found.depth_m == pytest.approx(150e-9 / 3, rel=1e-12, abs=0)
    assert np.isfinite(found.height_m).all()
    again = scan(DOTS.build(), request, CONFIG)
    assert np.array_equal(again.trace[:3], found.trace)


def test_tapping_holds_its_amplitude_over_a_dot():
    surface = DOTS.build()
    row = int(np.argmax(surface.height_m.max(axis=1)))
    ridge = checked(np.tile(surface.height_m[row], (4, 1)), 150e-9, 2e-9)
    found = scan(ridge, ScanRequest(pixels=64, lines=1, dwell_s=2e-3), CONFIG)
    assert np.ptp(found.truth_m) > 9e-9
    assert found.rms_error_m < 0.5e-9
    assert np.sqrt(np.mean(found.trace[:, :, ERROR] ** 2)) < 0.5e-9


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"setpoint_share": 1.0}, "the set-point is 1 of the free amplitude"),
        ({"mode": "contact", "setpoint_n": -1e-6}, "is no force at which the contact"),
        ({"pixels": 1}, "an image of 1 x 128 is outside"),
        ({"dwell_s": 0.0}, r"dwell \[s\] = 0 must be positive"),
        ({"amplitude_m": float("nan")}, r"amplitude \[m\] = nan must be positive"),
        ({"proportional": float("nan")}, "proportional gain = nan must be 0 or more"),
        ({"temperature_k": -1.0}, r"temperature \[K\] = -1 must be 0 or more"),
    ],
)
def test_what_cannot_be_imaged_is_refused(changes, what):
    with pytest.raises(ConfigError, match=what):
        scan(DOTS.build(), ScanRequest(**changes), CONFIG)


def test_a_tip_too_large_for_the_map_is_refused():
    config = AfmConfig.model_validate({"tip_sample": {"tip_radius_m": 1e-6}})
    fine = checked(np.tile(np.linspace(0.0, 1e-6, 2048), (2048, 1)), 1e-6, 1e-6)
    with pytest.raises(ConfigError, match="take a coarser map or a smaller tip"):
        scan(fine, ScanRequest(), config)


@pytest.mark.endurance
@pytest.mark.parametrize(("temperature_k", "bound_m"), [(0.0, 0.3e-9), (300.0, 0.5e-9)])
def test_the_dots_of_fig_8_are_within_their_bound(temperature_k, bound_m):
    found = scan(SampleConfig(name="dots").build(), ScanRequest(temperature_k=temperature_k), CONFIG)
    assert found.rms_error_m < bound_m


@pytest.mark.endurance
@pytest.mark.skipif(not DATA.exists(), reason="measured data are not beside the project: ../shared/data")
def test_a_measured_topography_comes_out_as_it_is():
    surface = SampleConfig(name=str(DATA)).build()
    # soft, as for contact mode: a tip that has lost the surface comes back as fast as its set-point is a deflection
    soft = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": 1.0}})
    found = scan(surface, ScanRequest(mode="contact", pixels=256, lines=256, dwell_s=2e-3), soft)
    assert found.correlation > 0.99
