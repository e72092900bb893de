"""Fig. 12 and an image by emulated AFM controllers, with their guards: processes of their own, over real sockets."""

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import machine
import numpy as np
import pytest
import yaml
from emulated_controllers import PATIENCE_S, Gwyscope, Nanonis
from stack_rig import Rig, judged

from telenano.recording.reader import Recording
from telenano.sections.afm_section import AfmConfig
from telenano.sections.surface_files import read_surface
from telenano.testing import free_ports

pytestmark = [pytest.mark.stack, pytest.mark.endurance]
SCAN = ("scan", "--live", "--json", "--pixels", "32", "--lines", "6", "--size", "60")
# a tick of 3 ms and the driver's cycle: gains and dwell that the default of a simulated instrument is too quick for
SLOWER = ("--gain", "150", "--dwell", "20")


@pytest.fixture
def gwyscope(tmp_path: Path, request: Any) -> Iterator[Gwyscope]:
    found = Gwyscope(tmp_path, request.param)
    yield found
    found.close()


@pytest.fixture
def nanonis(tmp_path: Path, request: Any) -> Iterator[Nanonis]:
    found = Nanonis(tmp_path, request.param)
    yield found
    found.close()


@pytest.mark.parametrize("gwyscope", ["fig12"], indirect=True)
def test_fig12_by_a_gwyscope(rig: Rig, gwyscope: Gwyscope) -> None:
    summary = rig.run(*gwyscope.options)
    recording = Recording(rig.out / "session.mcap")
    health = [message.decode() for message in recording.messages(["node/health"])]
    ages = [found.device_age_s for found in health if found.device_age_s is not None]
    machine.note(
        f"fig12 by a Gwyscope: hold {summary['hold_ratio']:.3f}, contact {summary['contact_x_cm']:.3f} cm, samples"
        f" {1e3 * np.median(ages):.1f} ms old"
    )
    if judged(summary, "Fig. 12 by a Gwyscope"):
        assert summary["hold_ratio"] == pytest.approx(1.050, abs=0.01)
        assert summary["contact_x_cm"] == pytest.approx(0.703, abs=0.01)
    assert min(ages) > 3e-3
    latencies = [found.device_latency_s for found in health if found.device_latency_s is not None]
    assert latencies == [pytest.approx(4e-3, abs=1e-6)] * len(latencies)
    assert gwyscope.z_m == 0.0


def image_of(rig: Rig, folder: Path, *options: str) -> "np.ndarray[Any, np.dtype[np.float64]]":
    """Take an image by a running rig; return its heights, levelled to their mean [m]."""
    done = rig.telenano(*SCAN, *options, "--out", str(folder), patience_s=180.0)
    assert done.returncode == 0, done.stderr + rig.logs()
    document = json.loads(done.stdout)
    assert (document["state"], document["lines"]) == ("finished", 6)
    heights = read_surface(folder / "scan.gsf").height_m
    return heights - heights.mean()


def truth() -> "np.ndarray[Any, np.dtype[np.float64]]":
    """Return the heights of the sample where the pixels are [m]."""
    surface = AfmConfig.model_validate({"sample": {"name": "dots"}}).to_surface()
    assert surface is not None
    xs = (-30e-9 + (np.arange(32) + 0.5) * 60e-9 / 32 + 75e-9) / surface.step_x_m
    ys = (-30e-9 + (np.arange(6) + 0.5) * 10e-9 + 75e-9) / surface.step_y_m
    return surface.height_m[np.ix_(ys.astype(int), xs.astype(int))]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the image of the same part by the simulated instrument, on a rig of its own."""
    folder = tmp_path_factory.mktemp("simulated")
    rig = Rig(folder)
    try:
        rig.start(scenario="image")
        rig.wait_until(rig.running, "the session")
        found = image_of(rig, folder / "scan", "--dwell", "20")
        assert rig.stop()[0] == 0
        return found
    finally:
        rig.close()


def agreement(name: str, image: Any, simulated: Any) -> float:
    """Tell how an image agrees with that of the simulated instrument, and with the sample; return the correlation."""
    alike, with_sample = (float(np.corrcoef(image.ravel(), other.ravel())[0, 1]) for other in (simulated, truth()))
    rms_m = float(np.sqrt(np.mean((image - simulated) ** 2)))
    machine.note(
        f"image by a {name}: correlation with that of the simulated instrument {alike:.4f}, rms difference"
        f" {1e9 * rms_m:.2f} nm of {1e9 * np.ptp(simulated):.1f} nm; correlation with the sample {with_sample:.3f}"
    )
    return alike


@pytest.mark.parametrize("gwyscope", ["image"], indirect=True)
def test_image_by_a_gwyscope_and_a_gain_that_its_latency_forbids(
    rig: Rig, gwyscope: Gwyscope, simulated: Any, tmp_path: Path
) -> None:
    rig.start(*gwyscope.options, scenario="image")
    rig.wait_until(rig.running, "the session")
    refused = rig.telenano(*SCAN, "--dwell", "20", "--out", str(tmp_path / "refused"))
    assert refused.returncode != 0
    assert "scan.gain_per_s (--gain) = 400 1/s makes the feedback unstable" in refused.stdout + refused.stderr
    assert agreement("Gwyscope", image_of(rig, tmp_path / "scan", *SLOWER), simulated) > 0.95
    code, _, err = rig.stop()
    assert code == 0, err + rig.logs()


@pytest.mark.parametrize("nanonis", ["image"], indirect=True)
def test_image_by_the_own_scan_of_a_nanonis_in_a_rig(
    rig: Rig, nanonis: Nanonis, simulated: Any, tmp_path: Path
) -> None:
    rig.start(*nanonis.options, "--set", "controller.law=model_mediated", scenario="image")
    rig.wait_until(rig.running, "the session")
    # its z-controller swings at the gain for a stiff cantilever no more than with this one
    assert agreement("Nanonis", image_of(rig, tmp_path / "scan", "--dwell", "20"), simulated) > 0.95
    rig.wait_until(lambda: nanonis.client.call("ZCtrl.StatusGet") == [1], "the end of the withdrawal")
    assert nanonis.client.call("Scan.StatusGet") == [0]
    refused = rig.telenano("session", "set", "law=wave", "--target", "controller")
    assert refused.returncode != 0
    assert "wave closes a loop through the instrument, and nanonis gives 50 samples" in refused.stdout + refused.stderr
    code, _, err = rig.stop()
    assert code == 0, err + rig.logs()


def test_fast_path_through_a_t7_into_a_nanonis(rig: Rig, tmp_path: Path) -> None:
    stage, (port,) = tmp_path / "stage.yaml", free_ports(1)
    nanonis = Nanonis(tmp_path, "fig12", "--fast-path", str(stage), "--fast-path-port", str(port))
    nanonis.client.close()
    try:
        direct = tmp_path / "direct.yaml"
        document = yaml.safe_load(nanonis.file.read_text())
        # the guard has the first of the four ports
        document["network"]["port"] = nanonis.port + 2
        direct.write_text(yaml.safe_dump(document))
        found = rig.telenano("device", "approach", "--calibration", str(direct), "--setpoint", "5e-3")
        assert found.returncode == 0, found.stderr
        assert "210 nm above the surface" in found.stdout
        settings = ("--set", "afm_node.driver=modbus", "--set", f"afm_node.modbus.calibration={stage}")
        summary = rig.run(*settings)
        machine.note(
            f"fig12 by the fast path into a Nanonis: hold {summary['hold_ratio']:.3f}, contact"
            f" {summary['contact_x_cm']:.3f} cm"
        )
        held = summary["hold_ratio"] == pytest.approx(1.050, abs=0.04)
        assert held or not judged(summary, "Fig. 12 by the fast path into a Nanonis"), summary["hold_ratio"]
        # a session later the controller images by itself
        command = ("--setpoint", "5e-3", "--pixels", "16", "--lines", "2", "--line-time", "0.2", "--size", "20")
        done = rig.telenano("device", "image", "--calibration", str(direct), *command, "--out", str(tmp_path / "image"))
        assert done.returncode == 0, done.stderr
        assert np.ptp(read_surface(tmp_path / "image" / "scan.gsf").height_m) < 1e-9
    finally:
        nanonis.close()


@pytest.mark.parametrize("gwyscope", ["fig12"], indirect=True)
def test_killed_node_is_retracted_by_the_guard_and_a_person_who_moves_the_tip_is_an_event(
    rig: Rig, gwyscope: Gwyscope
) -> None:
    rig.start(*gwyscope.options, "--duration", "600")
    rig.wait_until(lambda: rig.running() and gwyscope.z_m > 1.95e-6, "an approach")

    def seized() -> bool:
        # the rig's next z replaces it within two milliseconds, and the tick has to fall between the two
        gwyscope.ask(todo="set_feedback", feedback=False, zpiezo=1.5e-6)
        return rig.log_has("afm_node@slave", "another program has moved the tip")

    rig.wait_until(seized, "the event")
    rig.wait_until(lambda: rig.log_has("afm_node@slave", "is ready and retracted", 2), "the recovery")
    assert gwyscope.z_m < 1.95e-6
    assert rig.telenano("session", "arm").returncode == 0
    rig.wait_until(lambda: gwyscope.z_m > 1.95e-6, "the tip")
    killed_ns = time.monotonic_ns()
    rig.kill("afm_node@slave")
    while gwyscope.z_m > 0.0:
        assert time.monotonic_ns() - killed_ns < PATIENCE_S * 1e9
    machine.note(
        f"kill -9 of the AFM node: its guard had retracted after {(time.monotonic_ns() - killed_ns) / 1e6:.0f} ms"
    )
    assert rig.process is not None
    os.kill(rig.process.pid, signal.SIGINT)
    rig.finish()


@pytest.mark.parametrize("nanonis", ["fig12"], indirect=True)
def test_fig12_by_a_nanonis_with_a_model_and_a_loop_that_is_refused(rig: Rig, nanonis: Nanonis) -> None:
    rig.start(*nanonis.options)
    code, _, err = rig.finish()
    assert code == 2
    assert "virtual_impedance closes a loop through the instrument, and nanonis gives 50 samples a second" in err
    summary = rig.run(*nanonis.options, "--set", "controller.law=model_mediated")
    recording = Recording(rig.out / "session.mcap")
    texts = [message.decode().text for message in recording.messages(["session/event"])]
    assert any("what a hand feels is a model that these correct" in text for text in texts)
    health = [message.decode() for message in recording.messages(["node/health"])]
    ages = [found.device_age_s for found in health if found.device_age_s is not None]
    states = [message.decode() for message in recording.messages(["afm/state"])]
    force_n = max(state.tip_force_n[2] for state in states)
    machine.note(
        f"fig12 by a Nanonis with a model: contact {summary['contact_x_cm']:.3f} cm, {force_n * 1e9:.1f} nN at most,"
        f" samples {1e3 * np.median(ages):.1f} ms old"
    )
    assert {state.mode for state in states} & {"estop"} == set()
    assert force_n < 100e-9
    assert any(state.in_contact for state in states)
    assert min(ages) > 20e-3
    assert nanonis.z_m == pytest.approx(5e-7)


@pytest.mark.parametrize("nanonis", ["fig12"], indirect=True)
def test_killed_node_is_withdrawn_by_the_guard_of_a_nanonis(rig: Rig, nanonis: Nanonis) -> None:
    rig.start(*nanonis.options, "--set", "controller.law=model_mediated", "--duration", "600")
    rig.wait_until(lambda: rig.running() and nanonis.z_m < 5e-8, "an approach")
    nanonis.client.call("ZCtrl.OnOffSet", 1)
    rig.wait_until(lambda: rig.log_has("afm_node@slave", "The Z-Controller must be off"), "the event")
    rig.wait_until(lambda: rig.log_has("afm_node@slave", "is ready and retracted", 2), "the recovery")
    assert rig.telenano("session", "arm").returncode == 0
    rig.wait_until(lambda: nanonis.z_m < 5e-8, "the tip")
    killed_ns = time.monotonic_ns()
    rig.kill("afm_node@slave")
    while nanonis.z_m < 4.99e-7:
        assert time.monotonic_ns() - killed_ns < PATIENCE_S * 1e9
    waited_ms = (time.monotonic_ns() - killed_ns) / 1e6
    machine.note(f"kill -9 of the AFM node: the guard of a Nanonis had withdrawn after {waited_ms:.0f} ms")
    assert rig.process is not None
    os.kill(rig.process.pid, signal.SIGINT)
    rig.finish()
