"""A driver for a device that takes a force: it reads the device and writes the force in the process of the servo.

The coupling between the law and the device, its guard and the shared memory of both processes are telenano's own.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from services.haptic_node.coupling import ZERO, Vector
from services.haptic_node.devices.impedance_wire import ImpedanceWire, Turn, quaternion_of
from services.haptic_node.driver import UPRIGHT, Capabilities, DeviceError, HapticDevice, Quaternion
from services.haptic_node.safety import MODE_OFF, MODE_POSITION
from services.haptic_node.servo import DeviceSample
from services.runtime.loop.log import StructuredLog
from services.runtime.settings.config import Settings, refused_code
from services.runtime.settings.device_drivers import DeviceDriver

if TYPE_CHECKING:
    # The process of the servo does not need it.
    from services.haptic_node.impedance_config import CouplingConfig

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


def impedance_driver(
    name: str, config: type[BaseModel], wire: Callable[[Any], ImpedanceWire], what: str = ""
) -> DeviceDriver:
    """Return the driver of a device that takes a force.

    Args:
        name: The value of `haptic_node.driver`, and the name of the section with its settings.
        config: The model of that section.
        wire: Makes the wire of the settings, not yet open. It is called in the process of the servo, where the coupling
            runs at the rate of the device: import there what the wire needs.
        what: The devices, for a list.
    """

    def build(settings: BaseModel, limits: Any, *, coupling: "CouplingConfig", period_s: float) -> HapticDevice:
        from services.haptic_node.devices.servo_process import ProcessLink
        from services.haptic_node.impedance import ImpedanceDevice

        return ImpedanceDevice(ProcessLink(name, settings.model_dump(mode="json")), coupling, period_s)

    return DeviceDriver("haptic_node", name, config, build, told=("coupling", "period_s"), wire=wire, what=what)
