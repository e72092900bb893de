"""A device that takes a force comes in by an entry point, of a package that nothing in the core names."""

from typing import Any

import pytest

from telenano.testing import install_package, said_with

DRIVER = """
from telenano.settings import Settings
from telenano_devices.impedance import impedance_driver

class Config(Settings):
    force_n: float = 2.0

KNOB = impedance_driver("knob", Config, "my_knob.wire:KnobWire", "a knob")
"""
WIRE = """
import time

from telenano_devices.impedance import Cadence, Declared, Frame, declared

FRAME = Frame("x -z y")

class KnobWire:
    def __init__(self, settings):
        self.force_n = settings.force_n

    def open(self):
        return declared("a knob", Declared(self.force_n, 500.0, 5.0, 0.1), 1000.0)

    def run(self, turn):
        cadence = Cadence(1000.0)
        while turn(FRAME.sample((0.0, -0.01, 0.0), time.monotonic_ns())) is not None:
            cadence.wait()

    def session(self, runs):
        pass

    def close(self):
        pass
"""
PROGRAM = """
import json, sys, time
from telenano.testing import haptic_config, haptic_device_of, invoke

def imported():
    return sorted(name for name in sys.modules if name.startswith(("my_knob", "telenano_devices.impedance")))

found = {"imported": [imported()]}
section = {"driver": "knob", "knob": {"force_n": 3.0}}
config = haptic_config(section)
found["simulated"] = config.simulated
device = haptic_device_of(config)
device.open()
try:
    found["max_force_n"] = device.capabilities.max_force_n
    end_s = time.monotonic() + 60.0
    while device.report.status != "ok" and time.monotonic() < end_s:
        found["position_m"] = device.read(-1.0, 1e-3).position_m
finally:
    device.close()
found["imported"].append(imported())


def said(*words):
    done = invoke(["device", *words, "--json"])
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
    files = {"__init__.py": DRIVER, "wire.py": WIRE}
    install_package(site, "my_knob", files, {"devices": {"knob": "my_knob:KNOB"}})
    document: dict[str, Any] = said_with(PROGRAM, site)
    return document


def test_a_device_of_a_package_has_its_servo_in_a_process_of_its_own(found: dict[str, Any]) -> None:
    assert found["max_force_n"] == 3.0
    assert found["position_m"] == pytest.approx(0.01, rel=1e-9)
    assert not found["simulated"]


def test_a_node_imports_the_driver_that_its_scenario_names_and_no_wire(found: dict[str, Any]) -> None:
    before, after = found["imported"]
    assert before == []
    makers = {f"telenano_devices.{name}" for name in ("haply.haply", "force_dimension.dhd", "touch.hd")}
    assert "my_knob" in after and not {"my_knob.wire", *makers} & set(after)


def test_commands_know_it_by_its_entry(found: dict[str, Any]) -> None:
    (row,) = found["list"]
    assert (row["device"], row["node"], row["found"]) == ("a knob", "haptic_node", "can be used")
    assert (found["probe"]["code"], found["probe"]["max_force_n"]) == (0, 1.5)
    assert "passive up to" in found["probe"]["coupling"]
    assert found["monitor"]["code"] == 0
    assert found["monitor"]["position_m"] == pytest.approx(0.01, rel=1e-9)
    assert "did you mean knob? Known are " in found["misspelt"]["error"]
    error = found["of_no_force"]["error"]
    assert error.startswith(
        "haptic_node.driver = serial is not a device that takes a force; take one of simulated_impedance, "
    )
    assert "knob" in error
