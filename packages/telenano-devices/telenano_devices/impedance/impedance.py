"""Declares drivers of devices that take a force: the simulated one, and real ones with the coupling in a process."""

from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from telenano.extend.hands import SimulatedHand
from telenano.settings import DeviceDriver, Settings, section_of
from telenano_devices.impedance.impedance_config import CouplingConfig, SimulatedImpedanceConfig
from telenano_devices.impedance.impedance_wire import Impedance

if TYPE_CHECKING:
    from telenano_devices.impedance.impedance_device import ImpedanceDevice


def impedance_driver(
    name: str, config: type[BaseModel], wire: str, what: str = "", *, experimental: bool = False
) -> DeviceDriver:
    """Return the driver of a device that takes a force.

    Args:
        name: The value of `haptic_node.driver`, and the name of the section with its settings.
        config: The model of that section.
        wire: The class or function that makes the wire from the settings, such as `my_package.wire:MyWire`. Only the
            process of the servo imports it, where the coupling runs at the rate of the device.
        what: The devices in words, for a list.
        experimental: Whether the driver has driven only an emulator and no real device, which the node then reports.
    """

    def build(
        settings: BaseModel, limits: Any, *, coupling: CouplingConfig | None, period_s: float
    ) -> "ImpedanceDevice":
        from telenano_devices.impedance.impedance_device import ImpedanceDevice
        from telenano_devices.impedance.servo_process import ProcessLink

        link = ProcessLink(name, settings.model_dump(mode="json"))
        return ImpedanceDevice(link, coupling or CouplingConfig(), period_s)

    keywords = ("coupling", "period_s")
    return DeviceDriver(
        "haptic_node", name, config, build, keywords=keywords, own=Impedance(wire), what=what, experimental=experimental
    )


def takes_force(driver: DeviceDriver | None) -> bool:
    """Return whether a driver comes from `impedance_driver`, or is that of the simulated device."""
    return driver is not None and (driver is SIMULATED or isinstance(driver.own, Impedance))


def force_drivers() -> list[str]:
    """Return the names of the installed drivers whose devices take a force, the simulated one first."""
    found = DeviceDriver.all().found
    return sorted((name for name in found if takes_force(found[name])), key=lambda name: name != SIMULATED_IMPEDANCE)


def coupling_of(config: BaseModel) -> CouplingConfig:
    """Return the coupling of a section `haptic_node`, or the default one."""
    return section_of(config, "coupling") or CouplingConfig()


SIMULATED_IMPEDANCE = "simulated_impedance"


class _NoKeys(Settings):
    """The section of the simulated device's own name; its settings are in `haptic_node.impedance`."""


def _simulated(
    settings: BaseModel,
    limits: Any,
    *,
    impedance: SimulatedImpedanceConfig | None,
    coupling: CouplingConfig | None,
    operator: Any,
) -> SimulatedHand:
    device, spring = impedance or SimulatedImpedanceConfig(), coupling or CouplingConfig()
    able = device.capabilities()
    about = f"{able.identity}; {spring.bounds(able).sentence()}"
    return SimulatedHand(device.to_params(spring, operator.to_params()), able, about)


SIMULATED = DeviceDriver(
    "haptic_node",
    SIMULATED_IMPEDANCE,
    _NoKeys,
    _simulated,
    simulated=True,
    in_lockstep=True,
    keywords=("impedance", "coupling", "operator"),
    what="a simulated device of three axes",
)
