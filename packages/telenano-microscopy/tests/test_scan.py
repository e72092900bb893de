"""Images in simulated time: what is imaged is what the tip sees, within the bound that the documentation states."""

from pathlib import Path

import numpy as np
import pytest
from telenano_microscopy.force_curve import force_curve
from telenano_microscopy.imaging import ERROR, FORCE, HEIGHT, LATERAL
from telenano_microscopy.scan import Noise, scan

from proto.errors import ConfigError
from services.afm_node.config import AfmConfig
from services.afm_node.physics.sample.made_samples import SampleConfig
from services.afm_node.physics.sample.surface import checked, grating
from services.afm_node.programs.scan import ScanSettings

DATA = Path(__file__).parents[4] / "shared" / "data" / "spot_1-1000nm.ibw"
DOTS = SampleConfig(name="dots", pixels=256)
CONFIG = AfmConfig()
simulated = ScanSettings.in_simulated_time


def test_contact_mode_follows_a_slope_at_its_force():
    ramp = checked(np.tile(np.linspace(0.0, 20e-9, 64), (8, 1)), 200e-9, 25e-9)
    found = scan(ramp, simulated(mode="contact", pixels=32, lines=2, dwell_s=2e-3), CONFIG)
    assert found.rms_error_m < 0.1e-9
    assert np.abs(found.trace[:, 4:, FORCE] - 5e-9).max() < 1.5e-9
    # the retrace is laid over the trace, and both see the slope
    assert np.abs(found.trace[:, 4:, HEIGHT] - found.retrace[:, 4:, HEIGHT])[:, :-4].max() < 0.3e-9


def test_a_contact_image_has_the_lateral_force_of_slope_and_friction_in_both_senses():
    # 1 N/m holds the force on a slope within some percent; the lateral stiffness takes up 50 pm of the way
    section = {"cantilever": {"stiffness_n_per_m": 1.0}, "friction": {"coefficient": 0.3}}
    config = AfmConfig.model_validate(section)
    ramp = checked(np.tile(np.linspace(0.0, 20e-9, 64), (8, 1)), 200e-9, 25e-9)
    found = scan(ramp, simulated(mode="contact", pixels=32, lines=1, dwell_s=2e-3), config)
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
    smooth = scan(ramp, simulated(mode="contact", pixels=32, lines=1, dwell_s=2e-3), CONFIG).trace[0, 8:24]
    assert smooth[:, LATERAL] == pytest.approx(-smooth[:, FORCE] * slope, rel=1e-3, abs=0.0)


def test_an_image_ends_when_it_is_asked_to_and_keeps_its_lines():
    request = simulated(mode="contact", pixels=8, lines=9, dwell_s=2e-4)
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
    found = scan(ridge, simulated(pixels=64, lines=1, dwell_s=2e-3), CONFIG)
    assert np.ptp(found.truth_m) > 9e-9
    assert found.rms_error_m < 0.5e-9
    assert np.sqrt(np.mean(found.trace[:, :, ERROR] ** 2)) < 0.5e-9


def swing(gain_per_s: float, monkeypatch: pytest.MonkeyPatch) -> float:
    """Give the error of the amplitude a millisecond after an edge of 1 nm, without a proportional gain."""
    monkeypatch.setattr("telenano_microscopy.scan.gain_fault", lambda *_: "")
    request = simulated(pixels=200, lines=1, dwell_s=2e-4, gain_per_s=gain_per_s, proportional=0.0)
    found = scan(grating(400e-9, 128, 400e-9, 1e-9), request, CONFIG)
    return float(np.abs(found.trace[0, -12:, ERROR]).max())


def test_a_quick_feedback_in_tapping_mode_is_stable_as_far_as_routh_says(monkeypatch: pytest.MonkeyPatch) -> None:
    most_per_s = 2.0 * np.pi * 150e3 / 100.0
    assert swing(0.7 * most_per_s, monkeypatch) < 1e-11
    with pytest.raises(ConfigError, match="make the feedback swing over the first point"):
        swing(1.5 * most_per_s, monkeypatch)


def image(*, temperature_k: float = 0.0, **changes):
    return scan(DOTS.build(), simulated(**changes), CONFIG, noise=Noise(temperature_k))


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"setpoint_share": 1.0}, r"setpoint_share: .* \(allowed is from 0.05 to below 1\), got 1.0"),
        ({"mode": "contact", "setpoint_n": -1e-6}, "is no force at which the contact"),
        ({"mode": "tunnelling"}, "mode: Input should be 'contact' or 'tapping'"),
        ({"pixels": 1}, r"pixels: .* \(allowed is from 2 to 4096\), got 1"),
        ({"dwell_s": 0.0}, r"dwell_s: .* \(allowed is from above 0 to 10\), got 0.0"),
        ({"amplitude_m": float("nan")}, "amplitude_m: Input should be a finite number, got nan"),
        ({"proportional": float("nan")}, "proportional: Input should be a finite number, got nan"),
        ({"proportional": -1.0}, r"proportional: .* \(allowed is from 0 to 100\), got -1.0"),
        ({"gain_per_s": float("inf")}, "gain_per_s: Input should be a finite number, got inf"),
        ({"x_m": 1e-9}, "the whole of a sample is imaged"),
        ({"width_m": 1e-7}, "the whole of a sample is imaged"),
        ({"mode": "contact", "gain_per_s": 40_000.0}, "contact mode at 20000 Hz .* must be below 40000 1/s"),
        ({"mode": "contact", "proportional": 1.0}, "contact mode at 20000 Hz: it must be below 1"),
        ({"gain_per_s": 2e4}, "= 20000 1/s makes .* in tapping mode at 150000 Hz .* must be below 18849.6 1/s"),
        ({"proportional": 100.0}, "unstable in tapping mode at 150000 Hz: it must be below 21.5"),
        ({"temperature_k": -1.0}, r"temperature \[K\] = -1 must be 0 or more"),
    ],
)
def test_what_cannot_be_imaged_is_refused(changes, what):
    with pytest.raises(ConfigError, match=what):
        image(**changes)


def test_steps_too_few_for_the_contact_of_a_soft_tip_are_refused_for_images_and_curves():
    hard = {"tip_sample": {"sample_modulus_pa": 1e13, "tip_modulus_pa": 1e13}}
    soft = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": 1e-3}, **hard})
    with pytest.raises(ConfigError, match=r"too few for a cantilever of 0\.001 N/m"):
        scan(DOTS.build(), simulated(), soft)
    with pytest.raises(ConfigError, match=r"too few for a cantilever .* or more would be needed"):
        force_curve(soft, 20e-9, 10e-9, 10, dynamic=True)


def test_gains_as_shipped_are_lowered_where_they_would_swing_and_others_are_refused():
    level = SampleConfig(name="flat", pixels=8).build()
    soft = {"meniscus": False, "cantilever": {"stiffness_n_per_m": 2.0, "quality": 150.0}}
    config = AfmConfig.model_validate(soft)
    request = simulated(pixels=16, lines=1, setpoint_share=0.5, dwell_s=1.0 / 150e3)
    found = scan(level, request, config)
    assert (found.gain_per_s, found.proportional) < (request.gain_per_s, request.proportional)
    assert np.ptp(found.trace[:, :, HEIGHT]) < 20e-12
    # with the gains as they are, at a gentle set-point, nothing swings and nothing is lowered
    gentle = scan(level, simulated(pixels=16, lines=1, setpoint_share=0.8), config)
    assert (gentle.gain_per_s, gentle.proportional) == (request.gain_per_s, request.proportional)
    with pytest.raises(ConfigError, match=r"swing over the first point; with scan\.gain_per_s .* it does not"):
        scan(level, simulated(pixels=16, lines=1, setpoint_share=0.5, gain_per_s=5000.0, proportional=0.9), config)


@pytest.mark.parametrize(
    "changes", [{"dwell_s": 1e300}, {"amplitude_m": 1e300}, {"temperature_k": 1e300}, {"temperature_k": float("nan")}]
)
def test_what_would_never_end_or_is_no_number_is_refused_with_the_most_that_is_possible(changes):
    with pytest.raises(ConfigError, match=r"and at most|allowed is from"):
        image(**changes)


def test_a_tip_too_large_for_the_map_is_refused():
    config = AfmConfig.model_validate({"tip_sample": {"tip_radius_m": 1e-6}})
    fine = checked(np.tile(np.linspace(0.0, 1e-6, 2048), (2048, 1)), 1e-6, 1e-6)
    with pytest.raises(ConfigError, match="take a coarser map or a smaller tip"):
        scan(fine, simulated(), config)


@pytest.mark.endurance
@pytest.mark.parametrize(("temperature_k", "bound_m"), [(0.0, 0.3e-9), (300.0, 0.5e-9)])
def test_the_dots_of_fig_8_are_within_their_bound(temperature_k, bound_m):
    found = scan(SampleConfig(name="dots").build(), simulated(), CONFIG, noise=Noise(temperature_k))
    assert found.rms_error_m < bound_m


@pytest.mark.endurance
@pytest.mark.skipif(not DATA.exists(), reason="measured data are not beside the project: ../shared/data")
def test_a_measured_topography_comes_out_as_it_is():
    surface = SampleConfig(name=str(DATA)).build()
    # soft, as for contact mode: a tip that has lost the surface comes back as fast as its set-point is a deflection
    soft = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": 1.0}})
    found = scan(surface, simulated(mode="contact", pixels=256, lines=256, dwell_s=2e-3), soft)
    assert found.correlation > 0.99


def test_the_defaults_of_simulated_time_are_in_the_model_of_an_image():
    tapping, contact, bus = simulated(), simulated(mode="contact"), ScanSettings()
    assert (tapping.mode, tapping.gain_per_s, tapping.proportional) == ("tapping", 5000.0, 1.0)
    assert (contact.gain_per_s, contact.proportional) == (12_500.0, 0.0)
    assert (bus.mode, bus.gain_per_s, bus.proportional) == ("contact", 400.0, 0.0)
    assert [(s.pixels, s.lines, s.dwell_s, s.settle_s) for s in (tapping, bus)] == [
        (128, 128, 1e-3, 0.03),
        (64, 64, 4e-3, 0.2),
    ]
    assert simulated(gain_per_s=7.0).gain_per_s == 7.0
    assert "Default: 400 on the bus; in simulated time 5000 in tapping mode" in str(
        ScanSettings.model_fields["gain_per_s"].description
    )
