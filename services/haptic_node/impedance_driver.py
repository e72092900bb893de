"""A driver of the haptic node for a device that takes a force, as installed packages bring it."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from services.haptic_node.devices.impedance_wire import ImpedanceWire
from services.haptic_node.driver import HapticDevice
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
