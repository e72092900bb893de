"""A driver for a device that takes a force: it reads the device and writes the force in the process of the servo.

The coupling between the law and the device, its guard and the shared memory of both processes are telenano's own.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from telenano.devices.hand.impedance_wire import ImpedanceWire as ImpedanceWire
from telenano.devices.hand.impedance_wire import Turn as Turn
from telenano.devices.hand.impedance_wire import quaternion_of as quaternion_of
from telenano.hand.coupling import ZERO as ZERO
from telenano.hand.coupling import Vector as Vector
from telenano.hand.driver import UPRIGHT as UPRIGHT
from telenano.hand.driver import Capabilities as Capabilities
from telenano.hand.driver import DeviceError as DeviceError
from telenano.hand.driver import HapticDevice
from telenano.hand.driver import Quaternion as Quaternion
from telenano.hand.safety import MODE_OFF as MODE_OFF
from telenano.hand.safety import MODE_POSITION as MODE_POSITION
from telenano.hand.servo import DeviceSample as DeviceSample
from telenano.settings.device_drivers import DeviceDriver

if TYPE_CHECKING:
    # The process of the servo does not need it.
    from telenano.hand.impedance_config import CouplingConfig


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
        from telenano.devices.hand.impedance import ImpedanceDevice
        from telenano.devices.hand.servo_process import ProcessLink

        return ImpedanceDevice(ProcessLink(name, settings.model_dump(mode="json")), coupling, period_s)

    return DeviceDriver("haptic_node", name, config, build, told=("coupling", "period_s"), wire=wire, what=what)
