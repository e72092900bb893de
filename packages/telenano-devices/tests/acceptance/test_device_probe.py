"""`telenano device probe`: who a handle is, what each driver drives, with its coupling and both bounds."""

import json
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from telenano_devices.doubles import libraries
from telenano_devices.doubles.served import ServedPort
from telenano_devices.impedance.coupling import passive_stiffness_n_per_m, stable_stiffness_n_per_m
from telenano_devices.t7.t7_model import calibration_of

from telenano.sections import HapticConfig
from telenano.testing import invoke

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler: apt install gcc libc6-dev")

IDENTITIES = {
    "simulated_impedance": "simulated inverse3: mass and damping are chosen, not measured",
    "haply": "Haply inverse3 049D, firmware 3.5, emulated",
    "dhd": "Force Dimension omega.3, serial number 4711, emulated",
    "hd": "3D Systems Touch, serial number 0815, emulated",
}


@pytest.fixture
def told(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[list[str]]:
    """Yield the options with which a kind of device is found here."""
    kind = request.param
    if kind == "haply":
        served = ServedPort()
        yield ["--device", kind, "--set", f"haptic_node.haply.service={served.address}"]
        served.close()
        return
    options = ["--device", kind]
    if kind in ("dhd", "hd"):
        if shutil.which("cc") is None:
            pytest.skip("the doubles of vendors' libraries need a C compiler: apt install gcc")
        library = shutil.copy(libraries.build(kind), tmp_path / f"{kind}.so")
        options += ["--set", f"haptic_node.{kind}.library={library}"]
    yield options


@pytest.mark.parametrize("told", IDENTITIES, indirect=True)
def test_probe_names_the_device_and_prints_both_bounds(told: list[str]) -> None:
    done = invoke(["device", "probe", *told, "--json"])
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    assert found["identity"] == IDENTITIES[told[1]]
    damping = 0.5 * found["declared_damping_n_s_per_m"]
    # of the emulated mechanics: Inverse3, omega, Touch
    b = {"haply": 0.2, "simulated_impedance": 0.2, "dhd": 0.5, "hd": 0.05}[told[1]]
    timing = b, damping, 1.0 / found["servo_rate_hz"], found["drive_delay_s"]
    assert found["passive_bound_n_per_m"] == pytest.approx(passive_stiffness_n_per_m(*timing), rel=1e-9, abs=1e-12)
    assert found["stable_bound_n_per_m"] == pytest.approx(stable_stiffness_n_per_m(*timing), rel=1e-9)
    assert "passive up to" in found["coupling"] and "stable up to" in found["coupling"]
    table = invoke(["device", "probe", *told]).stdout
    assert f"{found['least_mass_kg']:.3g} kg" in found["coupling"]
    for name in ("least_mass_kg", "passive_bound_n_per_m", "stable_bound_n_per_m", "coupling_stiffness_n_per_m"):
        assert name in table


@pytest.mark.parametrize("command", ["probe", "accept"])
def test_device_whose_damper_acts_too_late_is_refused_with_the_numbers(command: str, tmp_path: Path) -> None:
    late = ["--set", "haptic_node.impedance.model=omega", "--set", "haptic_node.impedance.delay_s=0.03"]
    out = ["--out", str(tmp_path)] if command == "accept" else []
    done = invoke(["device", command, "--device", "simulated_impedance", *late, *out])
    assert done.exit_code == 2, done.output
    assert "needs a moving mass above 0.464 kg" in " ".join(done.output.split())


def test_probe_asks_for_one_kind_of_device() -> None:
    done = invoke(["device", "probe"])
    assert done.exit_code == 2
    assert "--device simulated_impedance or the driver of a package" in " ".join(done.output.split())


@needs_compiler
def test_probe_tells_who_a_handle_is(tmp_path: Path) -> None:
    from telenano_devices.handle.emulated_handle import EmulatedHandle
    from telenano_devices.handle.handle_on_pty import HandleOnPty

    port = HandleOnPty(EmulatedHandle(HapticConfig(), session=7), tmp_path / "handle")
    running = threading.Event()
    running.set()
    thread = threading.Thread(target=lambda: port.run(running.is_set))
    thread.start()
    try:
        until = time.monotonic() + 120.0
        done = invoke(["device", "probe", "--port", str(tmp_path / "handle"), "--json"])
        # a machine that is busy may hold the board up for longer than the three seconds of the handshake
        while done.exit_code and time.monotonic() < until:
            done = invoke(["device", "probe", "--port", str(tmp_path / "handle"), "--json"])
    finally:
        running.clear()
        thread.join()
        port.pull_out()
    found = json.loads(done.stdout)
    assert (found["device_id"], found["protocol"], found["firmware"]) == ("0102030405060708", "1.0", "1.0")
    assert found["abilities"] == "position mode, force sensor, current is sensed, emulated"


def test_what_is_not_there_is_a_sentence_and_exit_code_2(tmp_path: Path) -> None:
    missing = invoke(["device", "probe", "--port", str(tmp_path / "none")])
    assert missing.exit_code == 2
    assert "there is no such port" in missing.output
    neither = invoke(["device", "probe"])
    assert neither.exit_code == 2
    assert "--port for a handle, or --calibration for an instrument" in neither.output
    # a port that nothing listens at: the connection is refused at once
    stage = tmp_path / "stage.yaml"
    stage.write_text(yaml.safe_dump(calibration_of(6.25e6, 40.0, port=1)))
    silent = invoke(["device", "probe", "--calibration", str(stage)])
    assert silent.exit_code == 2
    assert "127.0.0.1:1: LabJack T7" in silent.output


def test_a_device_that_is_named_without_an_option_is_told_how_it_is_named() -> None:
    done = invoke(["device", "probe", "nanonis"])
    assert done.exit_code == 2
    text = " ".join(done.output.split())
    assert "nanonis: name a device by how it is reached" in text
    assert "--calibration nanonis.yaml" in text and "--device nanonis" in text
