"""A driver for a device that takes a force: it reads the device and writes the force in the process of the servo.

The coupling between the law and the device, its guard and the shared memory of both processes are telenano's own.
"""

from services.haptic_node.coupling import ZERO, Vector
from services.haptic_node.devices.impedance_wire import ImpedanceWire, Turn, quaternion_of
from services.haptic_node.driver import UPRIGHT, Capabilities, DeviceError, Quaternion
from services.haptic_node.impedance_driver import impedance_driver
from services.haptic_node.safety import MODE_OFF, MODE_POSITION
from services.haptic_node.servo import DeviceSample
from services.runtime.loop.log import StructuredLog
from services.runtime.settings.config import Settings, refused_code

__all__ = [
    "MODE_OFF",
    "MODE_POSITION",
    "UPRIGHT",
    "ZERO",
    "Capabilities",
    "DeviceError",
    "DeviceSample",
    "ImpedanceWire",
    "Quaternion",
    "Settings",
    "StructuredLog",
    "Turn",
    "Vector",
    "impedance_driver",
    "quaternion_of",
    "refused_code",
]
