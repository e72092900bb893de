"""Drivers of real and simulated devices that installed packages bring (entry points `telenano.devices`)."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel

from presets.plugins import Loaded, load


@dataclass(frozen=True)
class DeviceDriver:
    """A driver for one of the two nodes that have a device.

    `name` is the value of the node's key `driver`, and the name of the section with the settings of `config`.
    `build(settings, limits)` returns a device with the shape of `services/<node>/driver.py`, not yet open: limits is
    `LimitsConfig` of the haptic node, `SafetyParams` of the AFM node. The guard stays in front of it. `simulated`: its
    readings follow from what it was sent alone, so that its node can be run again from a recording.
    """

    node: Literal["haptic_node", "afm_node"]
    name: str
    config: type[BaseModel]
    build: Callable[[Any, Any], Any]
    simulated: bool = False


def drivers_of(node: str, taken: Collection[str]) -> Loaded[DeviceDriver]:
    """Return the drivers for a node; `taken` are the names of its own drivers and sections."""

    def check(name: str, value: Any) -> DeviceDriver | None:
        if not isinstance(value, DeviceDriver):
            raise TypeError(f"is a {type(value).__name__}, must be a DeviceDriver")
        if value.name != name:
            raise ValueError(f"calls itself {value.name}")
        return value if value.node == node else None

    return load("devices", check, taken)
