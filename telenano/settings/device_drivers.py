"""Drivers of real and simulated devices that installed packages bring (entry points `telenano.devices`).

Their names come from the metadata of the packages; a package is imported when a scenario names its driver.
"""

import json
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field
from pydantic_core import PydanticKnownError, PydanticOmit, core_schema

from telenano.settings.known_packages import KNOWN_PACKAGES
from telenano.settings.plugins import Loaded, installed, load
from telenano.wire.extras import how_to_add_package


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


class Drivers:
    """The drivers of packages for a node, each imported when it is asked for.

    Args:
        node: The node that drives them.
        own: The names of the node's own drivers.
        taken: Those, and what else in the section of the node has a name.
    """

    def __init__(self, node: str, own: Collection[str], taken: Collection[str]) -> None:
        self._node, self._own, self._taken = node, tuple(own), frozenset(taken)
        self._asked: dict[str, DeviceDriver | None] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names that could be drivers of this node, of which only an import tells."""
        return tuple(name for name in installed("devices") if name not in self._taken)

    def find(self, name: str) -> DeviceDriver | None:
        """Return the driver of that name, imported now; None where no package has one for this node.

        Raises:
            ValueError: It cannot be used; the message says why.
        """
        if name in self._own:
            return None
        if name not in self._asked:
            loaded = load("devices", self._check, self._taken, name)
            if name in loaded.problems:
                raise ValueError(loaded.problems[name])
            self._asked[name] = loaded.found.get(name)
        return self._asked[name]

    def is_absent(self, name: object) -> bool:
        """Return whether a driver is neither one of the node's own nor one of a package on this machine."""
        return isinstance(name, str) and name not in self._own and name not in installed("devices")

    def all(self) -> Loaded[DeviceDriver]:
        """Return every driver for this node, all of them imported now."""
        return load("devices", self._check, self._taken)

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

    def sections(self) -> dict[str, Any]:
        """Return the fields of a section for the settings of each driver; its model is loaded at validation."""
        return {
            name: (Annotated[Any, _Section(self, name)], Field(None, description=f"Settings of driver {name}."))
            for name in self.names
        }

    def _check(self, name: str, value: Any) -> DeviceDriver | None:
        if not isinstance(value, DeviceDriver):
            raise TypeError(f"is a {type(value).__name__}, must be a DeviceDriver")
        if value.name != name:
            raise ValueError(f"calls itself {value.name}")
        return value if value.node == self._node else None


def missing_driver(name: object) -> str:
    """Return which package of this project has a driver and how it is installed; empty where none has."""
    package = KNOWN_PACKAGES.get(f"driver {name}", "")
    return f"the driver {name} is in the package {package}: {how_to_add_package(package)}" if package else ""


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


@dataclass(frozen=True)
class _Section:
    """The rule of a driver's section; what is written out of one node has those of the other's drivers, as None."""

    drivers: Drivers
    name: str

    def _checked(self, value: Any, info: core_schema.ValidationInfo) -> BaseModel | None:
        if value is None:
            return None
        driver = self.drivers.find(self.name)
        if driver is None:
            raise PydanticKnownError("extra_forbidden")
        if info.mode == "json":
            # A strict model takes a list for a tuple from JSON alone.
            return driver.config.model_validate_json(json.dumps(value))
        return driver.config.model_validate(value)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.with_info_plain_validator_function(self._checked)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        driver = self.drivers.all().found.get(self.name)
        if driver is None:
            raise PydanticOmit
        return {"anyOf": [handler(driver.config.__pydantic_core_schema__), {"type": "null"}]}
