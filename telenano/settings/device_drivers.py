"""Drivers of real and simulated devices that installed packages bring (entry points `telenano.devices`).

Their names come from the metadata of the packages; a package is imported when a scenario names its driver.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel
from pydantic_core import PydanticKnownError, core_schema

from telenano.settings.entries import Entries, missing_entry
from telenano.settings.plugins import installed


@dataclass(frozen=True)
class DeviceDriver:
    """A driver for one of the two nodes that have a device.

    `name` is the value of the node's key `driver`, and the name of the section with the settings of `config`.
    `build(settings, limits)` returns a `HapticDevice` or an `AfmDriver`, not yet open: limits are those of the guard,
    of the AFM node `AfmLimits` (all of `telenano.extend.devices`). The guard stays in front of it. `simulated`: its
    readings follow from what it was sent alone, so that its node can be run again from a recording.

    `told` names what build takes by keyword besides: `period_s`, the period of the loop [s]; for an instrument
    `attended`, whether a person stands by who retracts the tip; for a haptic device `coupling`, the settings of its
    coupling. `capabilities` says what an instrument can do (`AfmCapabilities` of `telenano.devices`), and so
    with which laws and programs it is used; one without them is not judged. `wire` is that of a device that takes a
    force (`impedance_driver`). `what` names the devices in a list. `calibration` is the model of a file whose key
    `controller` names this driver; the settings then have a key `calibration` with its path.
    """

    node: Literal["haptic_node", "afm_node"]
    name: str
    config: type[BaseModel]
    build: Callable[..., Any]
    simulated: bool = False
    told: tuple[str, ...] = ()
    capabilities: tuple[Any, ...] | None = None
    calibration: type[BaseModel] | None = None
    wire: Callable[[Any], Any] | None = None
    what: str = ""

    def device(self, settings: BaseModel | None, limits: Any, **told: Any) -> Any:
        """Return a device with these settings, or with the default ones, that was told what it wants to know."""
        return self.build(settings or self.config(), limits, **{name: told[name] for name in self.told})


class Drivers(Entries[DeviceDriver]):
    """The drivers of packages for a node, each imported when it is asked for.

    Args:
        node: The node that drives them.
        own: The names of the node's own drivers.
        taken: Those, and what else in the section of the node has a name.
    """

    def __init__(self, node: str, own: Collection[str], taken: Collection[str]) -> None:
        super().__init__("devices", "driver", self._checked, taken, own)
        self._node = node

    def is_absent(self, name: object) -> bool:
        """Return whether a driver is neither one of the node's own nor one of a package on this machine."""
        return isinstance(name, str) and name not in self._own and name not in installed("devices")

    def is_simulated(self, name: str) -> bool:
        driver = self.find(name)
        return driver is not None and driver.simulated

    def require_section(self, config: BaseModel, name: str) -> None:
        """Raise ValueError where a driver of a package has keys without a default and no section that gives them."""
        driver = self.find(name)
        fields = {} if driver is None else driver.config.model_fields
        needed = [key for key, field in fields.items() if field.is_required()]
        if needed and getattr(config, name) is None:
            raise ValueError(f"driver: {name} needs a section {name} with {', '.join(needed)}")

    def name_type(self) -> Any:
        """Return the type of the key `driver`."""
        return Annotated[str, _Name(self, self._own)]

    def _checked(self, name: str, value: Any) -> DeviceDriver | None:
        if not isinstance(value, DeviceDriver):
            raise TypeError(f"is a {type(value).__name__}, must be a DeviceDriver")
        if value.name != name:
            raise ValueError(f"calls itself {value.name}")
        return value if value.node == self._node else None


def missing_driver(name: object) -> str:
    """Return which package of this project has a driver and how it is installed; empty where none has."""
    return missing_entry("driver", name)


@dataclass(frozen=True)
class _Name:
    """The rule of the key `driver`."""

    drivers: Drivers
    own: tuple[str, ...]

    def _checked(self, value: str) -> str:
        if value in self.own or self.drivers.find(value) is not None:
            return value
        if hint := missing_driver(value):
            raise ValueError(hint)
        *known, last = map(repr, self._known())
        raise PydanticKnownError("literal_error", {"expected": f"{', '.join(known)} or {last}"})

    def _known(self) -> tuple[str, ...]:
        return (*self.own, *self.drivers.all().found)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        return {"enum": list(self._known()), "type": "string"}
