"""A device that takes a force comes in by an entry point, of a package that nothing in the core names."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from telenano.hand.config import DRIVERS, HapticConfig
from telenano.settings import entries
from telenano.settings.config import validate
from telenano.wire.errors import ConfigError
from telenano.wire.extras import how_to_add_package

ROOT = Path(__file__).parents[3]
DRIVER = """
from telenano.settings import Settings
from telenano.extend.impedance import impedance_driver

class Config(Settings):
    force_n: float = 2.0

def wire(settings):
    from my_knob.wire import KnobWire

    return KnobWire(settings.force_n)

KNOB = impedance_driver("knob", Config, wire, "a knob")
"""
WIRE = """
import time

from telenano.extend.impedance import MODE_OFF, MODE_POSITION, Capabilities, DeviceSample

class KnobWire:
    def __init__(self, force_n):
        self.force_n = force_n

    def open(self):
        modes = (MODE_OFF, MODE_POSITION)
        return Capabilities(
            self.force_n, 500.0, 5.0, -0.1, 0.1, modes, "a knob", kind="impedance", axes=3, rate_hz=1000.0,
            damping_n_s_per_m=0.2, drive_delay_s=1e-3,
        )

    def run(self, turn):
        while turn(DeviceSample((0.0, 0.0, -0.01), time.monotonic_ns())) is not None:
            time.sleep(1e-3)

    def session(self, runs):
        pass

    def close(self):
        pass
"""
PROGRAM = """
import json, sys, time
from services.haptic_node.__main__ import _device
from telenano.hand.config import HapticConfig
from telenano.settings.config import validate

def imported():
    return sorted(name for name in sys.modules if name.startswith(("my_knob", "telenano_haptic_devices")))

found = {"imported": [imported()]}
config = validate(HapticConfig, {"driver": "knob", "knob": {"force_n": 3.0}}, "file", "haptic_node")
found["simulated"] = config.simulated
device = _device(config)
device.open()
try:
    found["max_force_n"] = device.capabilities.max_force_n
    end_s = time.monotonic() + 60.0
    while device.report.status != "ok" and time.monotonic() < end_s:
        found["position_m"] = device.read(-1.0, 1e-3).position_m
finally:
    device.close()
found["imported"].append(imported())

from typer.testing import CliRunner
from telenano.cli.root import app

def said(*words):
    done = CliRunner().invoke(app, ["device", *words, "--json"])
    return {"code": done.exit_code, **json.loads(done.stdout)}

found["list"] = [row for row in said("list")["packages"] if row["driver"] == "knob"]
found["probe"] = said("probe", "--device", "knob", "--set", "haptic_node.knob.force_n=1.5")
found["monitor"] = said("monitor", "--device", "knob", "--duration", "0.2")
found["misspelt"] = said("probe", "--device", "knop")
found["of_no_force"] = said("accept", "--device", "serial", "--set", "haptic_node.serial.port=p", "--set",
                            "haptic_node.serial.calibration=c")
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what a node and the commands do with the device of a package."""
    site = tmp_path_factory.mktemp("site")
    info = site / "my_knob-1.0.dist-info"
    for folder in (site / "my_knob", info):
        folder.mkdir()
    (site / "my_knob" / "__init__.py").write_text(DRIVER)
    (site / "my_knob" / "wire.py").write_text(WIRE)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-knob\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[telenano.devices]\nknob = my_knob:KNOB\n")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, cwd=site, env=environment, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    return document


def test_a_device_of_a_package_has_its_servo_in_a_process_of_its_own(found: dict[str, Any]) -> None:
    assert found["max_force_n"] == 3.0
    assert found["position_m"] == pytest.approx(0.01, rel=1e-9)
    assert not found["simulated"]


def test_a_node_imports_the_driver_that_its_scenario_names_and_no_wire(found: dict[str, Any]) -> None:
    assert found["imported"] == [[], ["my_knob"]]


def test_commands_know_it_by_its_entry(found: dict[str, Any]) -> None:
    (row,) = found["list"]
    assert (row["device"], row["node"], row["found"]) == ("a knob", "haptic_node", "can be used")
    assert (found["probe"]["code"], found["probe"]["max_force_n"]) == (0, 1.5)
    assert "passive up to" in found["probe"]["coupling"]
    assert found["monitor"]["code"] == 0
    assert found["monitor"]["position_m"] == pytest.approx(0.01, rel=1e-9)
    assert found["misspelt"]["error"].endswith("; did you mean knob?")
    error = found["of_no_force"]["error"]
    assert error.startswith("haptic_node.driver = serial is no device that takes a force: simulated_impedance, ")
    assert "knob" in error


def test_without_its_package_a_driver_gets_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing: entries.Loaded[Any] = entries.Loaded({}, {})
    monkeypatch.setattr(entries, "load", lambda *given: nothing)
    # what was found before
    monkeypatch.setattr(DRIVERS, "_asked", {})
    for name in ("haply", "dhd", "hd"):
        how = re.escape(how_to_add_package("telenano-haptic-devices"))
        words = f"driver: the driver {name} is in the package telenano-haptic-devices: {how}"
        with pytest.raises(ConfigError, match=words):
            validate(HapticConfig, {"driver": name}, "file", "haptic_node")
