"""A driver for a device that takes a force: it reads the device and writes the force in the process of the servo.

The coupling between the law and the device, its guard and the shared memory of both processes are telenano's own.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from services.haptic_node.coupling import ZERO as ZERO
from services.haptic_node.coupling import Vector as Vector
from services.haptic_node.devices.impedance_wire import ImpedanceWire as ImpedanceWire
from services.haptic_node.devices.impedance_wire import Turn as Turn
from services.haptic_node.devices.impedance_wire import quaternion_of as quaternion_of
from services.haptic_node.driver import UPRIGHT as UPRIGHT
from services.haptic_node.driver import Capabilities as Capabilities
from services.haptic_node.driver import DeviceError as DeviceError
from services.haptic_node.driver import HapticDevice
from services.haptic_node.driver import Quaternion as Quaternion
from services.haptic_node.safety import MODE_OFF as MODE_OFF
from services.haptic_node.safety import MODE_POSITION as MODE_POSITION
from services.haptic_node.servo import DeviceSample as DeviceSample
from services.runtime.loop.log import StructuredLog as StructuredLog
from services.runtime.settings.config import Settings as Settings
from services.runtime.settings.config import refused_code as refused_code
from services.runtime.settings.device_drivers import DeviceDriver

if TYPE_CHECKING:
    # The process of the servo does not need it.
    from services.haptic_node.impedance_config import CouplingConfig


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
