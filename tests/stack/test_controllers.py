"""Fig. 12 and an image by emulated AFM controllers, with their guards: processes of their own, over real sockets."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import machine
import numpy as np
import pytest
import yaml
from stack_rig import ROOT, Rig

from recording.reader import Recording
from services.afm_node.config import AfmConfig
from services.afm_node.devices import gwyscope_wire
from services.afm_node.devices.nanonis_client import NanonisClient
from services.afm_node.devices.request_answer import Incoming
from services.afm_node.physics.sample.surface_files import read_surface

pytestmark = [pytest.mark.stack, pytest.mark.endurance]
PATIENCE_S = 60.0
SCAN = ("scan", "--live", "--json", "--pixels", "32", "--lines", "6", "--size", "60")
# a tick of 3 ms and the driver's cycle: gains and dwell that the default of a simulated instrument is too quick for
SLOWER = ("--gain", "150", "--dwell", "20")


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


class Emulated:
    """An emulated controller and its guard, and what a rig needs to use them."""

    name = ""

    def __init__(self, folder: Path, scenario: str, *options: str) -> None:
        self.file = folder / f"{self.name}.yaml"
        self.port, self.guard_port = free_port(), free_port()
        where = ("--port", str(self.port), "--calibration", str(self.file), *options)
        self.server = self._start("simulate", *where, "--scenario", f"presets/scenarios/{scenario}.yaml")
        self._wait(self.port)
        document = yaml.safe_load(self.file.read_text())
        document["network"]["port"] = self.guard_port
        # a machine that is shared holds processes up for the 50 ms of the default
        document["heartbeat_s"] = 0.2
        self.file.write_text(yaml.safe_dump(document))
        to = ("--controller", f"127.0.0.1:{self.port}", "--port", str(self.guard_port))
        self.guard = self._start("guard", "--calibration", str(self.file), *to)
        self._wait(self.guard_port)

    def _start(self, what: str, *arguments: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", "telenano", "device", what, self.name, *arguments]
        return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)

    def _wait(self, port: int) -> None:
        end = time.monotonic() + PATIENCE_S
        while True:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    return
            assert time.monotonic() < end, f"nobody listens at {port}"
            time.sleep(0.05)

    @property
    def options(self) -> list[str]:
        settings = {"afm_node.driver": self.name, f"afm_node.{self.name}.calibration": self.file}
        return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]

    def close(self) -> None:
        for process in (self.guard, self.server):
            process.kill()
            process.wait()


class Gwyscope(Emulated):
    """A Gwyscope, which other programs may ask as well."""

    name = "gwyscope"

    def __init__(self, folder: Path, scenario: str) -> None:
        super().__init__(folder, scenario)
        self._line = socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE_S)
        self._incoming = Incoming(gwyscope_wire.cut)

    def ask(self, **message: Any) -> dict[str, Any]:
        """Ask the server itself, as another program would."""
        self._line.sendall(gwyscope_wire.encode(message))
        while (answer := self._incoming.take()) is None:
            self._incoming.add(self._line.recv(65536))
        return gwyscope_wire.decode(answer)

    @property
    def z_m(self) -> float:
        return float(self.ask(todo="read")["z"])

    def close(self) -> None:
        self._line.close()
        super().close()


class Nanonis(Emulated):
    """A Nanonis controller; the vendor's software, and this test, are at another of its ports."""

    name = "nanonis"

    def __init__(self, folder: Path, scenario: str) -> None:
        super().__init__(folder, scenario, "--log-port", str(free_port()))
        self.client = NanonisClient("127.0.0.1", self.port + 1)

    @property
    def z_m(self) -> float:
        return float(self.client.call("ZCtrl.ZPosGet")[0])

    def close(self) -> None:
        self.client.close()
        super().close()


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
    assert summary["hold_ratio"] == pytest.approx(1.050, abs=0.01)
    assert summary["contact_x_cm"] == pytest.approx(0.703, abs=0.01)
    assert min(ages) > 3e-3
    latencies = [found.device_latency_s for found in health if found.device_latency_s is not None]
    assert latencies == [pytest.approx(4e-3, abs=1e-6)] * len(latencies)
    assert gwyscope.z_m == 0.0


@pytest.mark.parametrize("gwyscope", ["image"], indirect=True)
def test_image_by_a_gwyscope_and_a_gain_that_its_latency_forbids(rig: Rig, gwyscope: Gwyscope, tmp_path: Path) -> None:
    rig.start(*gwyscope.options, scenario="image")
    rig.wait_until(rig.running, "the session")
    refused = rig.telenano(*SCAN, "--dwell", "20", "--out", str(tmp_path / "refused"))
    assert refused.returncode != 0
    assert "scan.gain_per_s (--gain) = 400 1/s makes the feedback unstable" in refused.stdout + refused.stderr
    done = rig.telenano(*SCAN, *SLOWER, "--out", str(tmp_path / "scan"), patience_s=120.0)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert (document["state"], document["lines"]) == ("finished", 6)
    surface = AfmConfig.model_validate({"sample": {"name": "dots"}}).to_surface()
    assert surface is not None
    image = read_surface(tmp_path / "scan" / "scan.gsf")
    xs = (-30e-9 + (np.arange(32) + 0.5) * 60e-9 / 32 + 75e-9) / surface.step_x_m
    ys = (-30e-9 + (np.arange(6) + 0.5) * 10e-9 + 75e-9) / surface.step_y_m
    truth = surface.height_m[np.ix_(ys.astype(int), xs.astype(int))]
    likeness = float(np.corrcoef(image.height_m.ravel(), truth.ravel())[0, 1])
    machine.note(f"image by a Gwyscope: correlation with the sample {likeness:.3f}")
    assert likeness > 0.9
    code, _, err = rig.stop()
    assert code == 0, err + rig.logs()


@pytest.mark.parametrize("gwyscope", ["fig12"], indirect=True)
def test_killed_node_is_retracted_by_the_guard_and_a_person_who_moves_the_tip_is_an_event(
    rig: Rig, gwyscope: Gwyscope
) -> None:
    rig.start(*gwyscope.options, "--duration", "600")
    rig.wait_until(lambda: rig.running() and gwyscope.z_m > 1.95e-6, "an approach")

    def seized() -> bool:
        # the rig's next z replaces it within two milliseconds, and the tick has to fall between the two
        gwyscope.ask(todo="set_feedback", feedback=False, zpiezo=1.5e-6)
        return rig.log_has("afm_node@slave", "somebody else has moved the tip")

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
