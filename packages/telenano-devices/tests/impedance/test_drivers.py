"""The entries of the package: its drivers with their settings, its command and its page."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from telenano_devices.impedance import hand_drivers as drivers
from telenano_devices.impedance.commands import COMMANDS
from telenano_devices.impedance.impedance import takes_force

DRIVERS = {driver.name: driver for driver in (drivers.HAPLY, drivers.DHD, drivers.HD)}
PAGE = (Path(__file__).parents[2] / "docs" / "haptic-devices.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["haply", "dhd", "hd"])
def test_a_driver_makes_its_wire_of_the_settings_that_its_page_names(name: str) -> None:
    driver = DRIVERS[name]
    assert driver.node == "haptic_node" and not driver.simulated and driver.what
    assert takes_force(driver)
    driver.own.wire(driver.config())
    for key, field in driver.config.model_fields.items():
        assert f"| `haptic_node.{name}.{key}` |" in PAGE
        assert field.description and field.description in PAGE


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


def test_the_command_is_where_the_list_of_commands_has_it() -> None:
    ((words, (target, about)),) = COMMANDS.items()
    assert words == "device simulate haply" and about.endswith(".")
    module, _, name = target.partition(":")
    assert callable(getattr(__import__(module, fromlist=[name]), name))
