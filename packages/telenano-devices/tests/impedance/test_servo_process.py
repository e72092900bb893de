"""The memory of a servo and its node, and the wire of a driver by its name."""

import time

import pytest
from telenano_devices.impedance import servo_process
from telenano_devices.impedance.coupling import ZERO, CouplingSettings
from telenano_devices.impedance.servo import ServoCommand
from telenano_devices.impedance.servo_process import SharedServo

from telenano.extend.hands import DeviceError
from telenano.sections import HapticConfig
from telenano.settings import LoadedScenario, find_scenario

SETTINGS = CouplingSettings((0.0, 0.0, 300.0), (0.5, 0.5, 2.0), 3.0, 1000.0)


def command(counter: int = 1) -> ServoCommand:
    return ServoCommand(counter, time.monotonic_ns(), ZERO, ZERO, ZERO, False, 0, False, SETTINGS)


def test_half_written_values_are_never_taken() -> None:
    buffer = bytearray(SharedServo.SIZE)
    node, servo = SharedServo(buffer), SharedServo(buffer)
    assert servo.command() is None
    assert node.sample() is None
    node.write_command(command(7))
    node.flag(True, False)
    assert servo.command() == node.command()
    assert servo.session_runs
    assert not servo.stops
    buffer[5] ^= 0xFF
    kept = servo.command()
    assert kept is not None
    assert kept.counter == 7


def test_device_by_its_name_is_the_driver_of_that_name() -> None:
    flags = ("haptic_node.device=simulated_impedance", "haptic_node.driver=simulated_impedance")
    device, driver = (
        LoadedScenario.load(find_scenario("fig12"), [flag]).section("haptic_node", HapticConfig) for flag in flags
    )
    assert device == driver


def test_wire_that_is_not_known_is_refused() -> None:
    with pytest.raises(DeviceError, match="there is no wire called 'x'"):
        servo_process.wire_of("x", {})
