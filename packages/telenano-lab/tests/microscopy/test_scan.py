"""Images in simulated time: what is imaged is what the tip sees, within the bound that the documentation states."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.microscopy.force_curve import force_curve
from telenano_lab.microscopy.simulated_image import SimulatedImage, take_image

from telenano.devices import VirtualInstrument
from telenano.sections import AfmConfig
from telenano.wire import ConfigError

DATA = Path(__file__).parents[5] / "shared" / "data" / "spot_1-1000nm.ibw"
SOFT = {"cantilever": {"stiffness_n_per_m": 1.0}}
GRATING = {"name": "grating", "size_m": 120e-9, "period_m": 60e-9, "height_m": 3e-9, "pixels": 64}
DOTS = {"name": "dots", "pixels": 256}


def image(sample: dict[str, Any], section: dict[str, Any] | None = None, progress: Any = None, **keys: Any) -> Any:
    """Take an image in the mode that is given, with a cantilever that can do it."""
    model = "dynamic" if keys.get("mode") == "tapping" else "quasi_static"
    config = AfmConfig.model_validate({"model": model, "sample": sample, **(section or {})})
    scan = {f"scan.{name}": value for name, value in keys.items()}
    return take_image(config, scan) if progress is None else take_image(config, scan, progress)


def test_contact_mode_of_a_soft_cantilever_follows_a_grating() -> None:
    found: SimulatedImage = image(GRATING, SOFT, pixels=48, lines=2, dwell_s=20e-3, gain_per_s=800.0)
    assert np.ptp(found.truth_m) > 2.9e-9
    assert found.rms_error_m < 0.3e-9
    # both ways see the same grating, and each lags behind it in its own sense
    there, back = (found.lines.trace_m, found.lines.retrace_m)
    assert np.sqrt(np.mean((there - back) ** 2)) < 0.6e-9


def test_an_image_ends_when_it_is_asked_to_and_keeps_its_lines() -> None:
    keys = {"pixels": 8, "lines": 5, "dwell_s": 2e-3}
    whole, part = image(GRATING, SOFT, **keys), image(GRATING, SOFT, lambda n, of: n < 3, **keys)
    assert (whole.lines.partial, part.lines.partial) == ("", "3 of 5 lines")
    assert np.array_equal(part.lines.trace_m[:3], whole.lines.trace_m[:3])
    assert part.height_m.shape == (3, 8)
    assert part.simulated_s < whole.simulated_s


def test_a_signal_before_the_first_line_leaves_nothing_and_later_keeps_what_is_finished(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: Any) -> bool:
        raise KeyboardInterrupt

    with monkeypatch.context() as early:
        early.setattr(VirtualInstrument, "run", interrupted)
        with pytest.raises(KeyboardInterrupt):
            image(GRATING, SOFT, pixels=8, lines=3, dwell_s=2e-3)
    assert image(GRATING, SOFT, interrupted, pixels=8, lines=3, dwell_s=2e-3).lines.finished == 1


@pytest.mark.check("the dynamic cantilever takes its time")
def test_tapping_over_the_dots_of_fig_8_is_within_its_bound() -> None:
    found = image(DOTS, mode="tapping", pixels=64, lines=8, dwell_s=8e-3, width_m=75e-9, depth_m=10e-9)
    assert np.ptp(found.truth_m) > 5e-9
    assert found.rms_error_m < 0.4e-9
    assert found.correlation > 0.98
    assert np.isfinite(found.lines.amplitude_m).all()


@pytest.mark.parametrize(
    ("keys", "what"),
    [
        ({"mode": "tapping", "setpoint_share": 1.0}, r"setpoint_share: .* \(allowed is from 0.05 to below 1\)"),
        ({"mode": "tunnelling"}, "mode: Input should be 'contact' or 'tapping'"),
        ({"pixels": 1}, r"pixels: .* \(allowed is from 2 to 4096\), got 1"),
        ({"dwell_s": 0.0}, r"dwell_s: .* \(allowed is from above 0 to 10\), got 0.0"),
        ({"proportional": -1.0}, r"proportional: .* \(allowed is from 0 to 100\), got -1.0"),
        ({"gain_per_s": 2000.0}, "contact mode at 1000 Hz .* must be below 2000 1/s"),
        ({"x_m": 5e-5}, "lateral.reach_m"),
        ({"setpoint_n": 1e-4}, "force"),
    ],
)
def test_what_cannot_be_imaged_is_refused(keys: dict[str, Any], what: str) -> None:
    with pytest.raises(ConfigError, match=what):
        image(GRATING, SOFT, **keys)


def test_steps_too_few_for_the_contact_of_a_soft_tip_are_refused_for_curves() -> None:
    hard = {"tip_sample": {"sample_modulus_pa": 1e13, "tip_modulus_pa": 1e13}}
    soft = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": 1e-3}, **hard})
    with pytest.raises(ConfigError, match=r"too few for a cantilever .* or more would be needed"):
        force_curve(soft, 20e-9, 10e-9, 10, dynamic=True)


@pytest.mark.check("takes 30 s")
@pytest.mark.drawn(0.0, "telenano/afm/", "packages/telenano-lab/telenano_lab/microscopy/")
@pytest.mark.skipif(not DATA.exists(), reason="measured data are not beside the project: ../shared/data")
def test_a_measured_topography_comes_out_as_it_is() -> None:
    # Its highest grain stands 211 nm above its middle, and the tip is raised clear of it, as the refusal says.
    raised = {"safety": {"retract_position_m": -250e-9, "base_min_m": -300e-9}}
    found = image({"name": str(DATA)}, {**SOFT, **raised}, pixels=128, lines=64, dwell_s=20e-3)
    assert found.correlation > 0.99
