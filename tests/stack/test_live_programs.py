"""Images and curves by a running rig, as a person asks for them: the files, and where the tip is at the end."""

import json
from pathlib import Path

import machine
import numpy as np
import numpy.typing as npt
import pytest
from stack_rig import Rig, held_up, judged

from telenano.afm.sample.surface import Surface
from telenano.cli.exit_codes import EXIT_INCOMPLETE
from telenano.recording.reader import Recording
from telenano.rerun.rerun import rerun
from telenano.sections.afm_section import AfmConfig
from telenano.sections.surface_files import read_surface
from telenano.wire.messages import AfmState

pytestmark = [pytest.mark.stack, pytest.mark.endurance]
SCAN = ("scan", "--live", "--json", "--pixels", "32", "--lines", "6", "--size", "60")


@pytest.fixture
def imaging(rig: Rig) -> Rig:
    rig.start(scenario="image")
    rig.wait_until(rig.running, "the session")
    return rig


def newest_state(rig: Rig) -> AfmState:
    found = rig.newest("afm/state")
    assert isinstance(found, AfmState)
    return found


def truth_of(surface: Surface) -> npt.NDArray[np.float64]:
    """Give what the tip sees at the pixels of SCAN."""
    xs = (-30e-9 + (np.arange(32) + 0.5) * 60e-9 / 32 + 75e-9) / surface.step_x_m
    ys = (-30e-9 + (np.arange(6) + 0.5) * 10e-9 + 75e-9) / surface.step_y_m
    return surface.height_m[np.ix_(ys.astype(int), xs.astype(int))]


def test_a_running_rig_images_its_sample_and_takes_a_curve_and_the_tip_is_away_after_each(
    imaging: Rig, tmp_path: Path
) -> None:
    done = imaging.telenano(*SCAN, "--proportional", "0.3", "--out", str(tmp_path / "scan"), patience_s=90.0)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert (document["state"], document["lines"]) == ("finished", 6)
    surface = AfmConfig.model_validate({"sample": {"name": "dots"}}).to_surface()
    assert surface is not None
    image = read_surface(tmp_path / "scan" / "scan.gsf")
    assert image.width_m == pytest.approx(60e-9, rel=1e-6)
    truth = truth_of(surface)
    # a dot of 10 nm among them, with flanks of a few pixels
    assert truth.max() - truth.min() > 3e-9
    assert np.corrcoef(image.height_m.ravel(), truth.ravel())[0, 1] > 0.9
    imaging.wait_until(lambda: newest_state(imaging).mode == "retracted", "a retracted tip")
    done = imaging.telenano("curve", "--live", "--json", "--out", str(tmp_path / "curve"), patience_s=90.0)
    assert done.returncode == 0, done.stderr
    marks = json.loads(done.stdout)
    # Table 2 with 1 N/m: the pull-off is that of the sample, whatever the spring
    assert marks["pull_off_force_n"] == pytest.approx(-12.8e-9, rel=0.05)
    assert marks["snap_in_base_m"] is not None
    assert marks["stiffness_n_per_m"] == pytest.approx(1.0, rel=1e-6)
    done = imaging.telenano(*SCAN, "--out", str(tmp_path / "no"), "--dwell", "0.5")
    assert (done.returncode, newest_state(imaging).mode) == (1, "retracted")
    assert "a dwell" in done.stderr or "dwell_s" in done.stderr
    done = imaging.telenano(*SCAN, "--out", str(tmp_path / "no"), "--gain", "5000")
    assert (done.returncode, newest_state(imaging).mode) == (1, "retracted")
    assert "(--gain) = 5000 1/s makes the feedback unstable in contact mode at 1000 Hz" in done.stderr
    imaging.stop()


def test_an_image_of_a_rig_at_a_lower_rate_needs_no_dwell(rig: Rig, tmp_path: Path) -> None:
    rig.start(scenario="image", rate=machine.LOWER_RATE)
    rig.wait_until(rig.running, "the session")
    done = rig.telenano(*SCAN, "--gain", "300", "--out", str(tmp_path / "no"), "--dwell", "4", patience_s=90.0)
    assert done.returncode == 1
    assert "a dwell of 0.008 s or more" in done.stderr
    done = rig.telenano(*SCAN, "--gain", "300", "--out", str(tmp_path / "scan"), patience_s=90.0)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["state"] == "finished"
    rig.stop()


def test_the_dynamic_cantilever_taps_a_sample_on_the_bus_and_runs_again_from_the_recording(
    rig: Rig, tmp_path: Path
) -> None:
    rig.start("--set", "afm_node.model=dynamic", scenario="image")
    rig.wait_until(rig.running, "the session")
    tapping = (*SCAN, "--mode", "tapping", "--gain", "500", "--proportional", "0.2")
    done = rig.telenano(*tapping, "--out", str(tmp_path / "scan"), patience_s=90.0)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert (document["mode"], document["state"], document["lines"]) == ("tapping", "finished", 6)
    surface = AfmConfig.model_validate({"sample": {"name": "dots"}}).to_surface()
    assert surface is not None
    image = read_surface(tmp_path / "scan" / "scan.gsf")
    assert np.corrcoef(image.height_m.ravel(), truth_of(surface).ravel())[0, 1] > 0.9
    amplitude = read_surface(tmp_path / "scan" / "scan.gwy", "Amplitude")
    assert np.median(amplitude.height_m) == pytest.approx(16e-9, rel=0.02, abs=0.0)
    done = rig.telenano("curve", "--live", "--json", "--out", str(tmp_path / "curve"), patience_s=90.0)
    assert done.returncode == 0, done.stderr
    # as of the quasi-static cantilever
    assert json.loads(done.stdout)["pull_off_force_n"] == pytest.approx(-12.8e-9, rel=0.05)
    code, summary, _ = rig.stop()
    if code == EXIT_INCOMPLETE and (cause := held_up(summary)):
        machine.note(f"a dynamic cantilever is not run again from a recording that lacks messages: {cause}")
        return
    found = rerun(Recording(rig.out / "session.mcap"), "afm_node@slave")
    assert found.identical, found.verdict()
    assert found.compared["afm/scanline"] == 12


def test_a_hand_holds_the_contact_of_the_dynamic_cantilever_as_in_fig_12(rig: Rig) -> None:
    summary = rig.run_undisturbed("--set", "afm_node.model=dynamic")
    if judged(summary, "Fig. 12 of a dynamic cantilever"):
        assert summary["stable"] is True
        assert summary["hold_ratio"] == pytest.approx(1.050, abs=0.005)
