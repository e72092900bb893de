"""The drivers of real devices that take a force: their settings, and what declares them."""

import json
import subprocess
import sys

import pytest
from telenano_devices.force_dimension.dhd_device import DHD
from telenano_devices.haply.haply_device import HAPLY
from telenano_devices.impedance.impedance import takes_force
from telenano_devices.touch.hd_device import HD

DRIVERS = {driver.name: driver for driver in (HAPLY, DHD, HD)}


@pytest.mark.parametrize("name", ["haply", "dhd", "hd"])
def test_a_driver_makes_its_wire_of_its_settings_and_each_of_them_says_what_it_is(name: str) -> None:
    driver = DRIVERS[name]
    assert driver.node == "haptic_node" and not driver.simulated and driver.what
    assert takes_force(driver)
    driver.own.wire(driver.config())
    assert [key for key, field in driver.config.model_fields.items() if not field.description] == []


def test_a_declared_driver_needs_neither_wire_nor_websockets_nor_library() -> None:
    program = """
import json, sys
import telenano_devices.force_dimension.dhd_device, telenano_devices.touch.hd_device
import telenano_devices.haply.haply_device
print(json.dumps(sorted(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    modules = set(json.loads(done.stdout))
    names = ("haply.haply", "force_dimension.dhd", "touch.hd", "impedance.servo_process", "impedance.impedance_device")
    wires = {f"telenano_devices.{name}" for name in names}
    assert not {"websockets", "ctypes.util", "numba", "services.afm_node", *wires} & modules
