"""The driver of a device that takes a force, whose coupling runs in a process of its own."""

import importlib
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import BaseModel

from telenano.extend.hands import HapticDevice
from telenano.hand import CouplingConfig
from telenano.settings import DeviceDriver

if TYPE_CHECKING:
    from telenano_haptic_devices.impedance_wire import ImpedanceWire


class Impedance(NamedTuple):
    """What the process of the servo needs of a driver: `module:name` of what makes the wire of its settings."""

    path: str

    def wire(self, settings: BaseModel) -> "ImpedanceWire":
        """Return the wire of these settings, not yet open; its module is imported now."""
        module, _, name = self.path.partition(":")
        wire: ImpedanceWire = getattr(importlib.import_module(module), name)(settings)
        return wire


def impedance_driver(
    name: str, config: type[BaseModel], wire: str, what: str = "", *, experimental: bool = False
) -> DeviceDriver:
    """Return the driver of a device that takes a force.

    Args:
        name: The value of `haptic_node.driver`, and the name of the section with its settings.
        config: The model of that section.
        wire: The class or function that makes the wire of the settings, as `my_package.wire:MyWire`. It is imported in
            the process of the servo alone, where the coupling runs at the rate of the device.
        what: The devices, for a list.
        experimental: Whether it has driven an emulator and never a real device, which the node then reports.
    """

    def build(settings: BaseModel, limits: Any, *, coupling: CouplingConfig, period_s: float) -> HapticDevice:
        from telenano_haptic_devices.impedance_device import ImpedanceDevice
        from telenano_haptic_devices.servo_process import ProcessLink

        return ImpedanceDevice(ProcessLink(name, settings.model_dump(mode="json")), coupling, period_s)

    keywords = ("coupling", "period_s")
    return DeviceDriver(
        "haptic_node", name, config, build, keywords=keywords, own=Impedance(wire), what=what, experimental=experimental
    )


def takes_force(driver: DeviceDriver | None) -> bool:
    """Return whether a driver is one of `impedance_driver`."""
    return driver is not None and isinstance(driver.own, Impedance)
