"""Drivers of real and simulated devices from installed packages (entry points `telenano.devices`).

Their names come from the metadata of the packages; a package is imported when a scenario names its driver.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel

from telenano.settings.config import section_of, validate
from telenano.settings.entries import Entries, SharedSection
from telenano.settings.known_packages import where_it_is
from telenano.settings.plugins import LoadedEntries, installed


@dataclass(frozen=True)
class DeviceDriver:
    """A driver for one of the two nodes that have a device.

    Attributes:
        node: The node that uses it.
        name: The value of the node's key `driver`, and the name of the driver's section.
        config: The model of that section.
        build: `build(settings, limits)` returns a `HapticDevice` (`telenano.extend.hands`) or an `AfmDriver`
            (`telenano.extend.instruments`), not yet open. The limits are those of the guard, which stays in front of
            it; for the AFM node they are `SafetyParams`.
        simulated: Whether its readings depend on the commands alone, so that its node can be run again from a
            recording.
        in_lockstep: Whether it is simulated by a model that needs no rig. `build` then returns a `SimulatedHand`
            (`telenano.extend.hands`), of which the haptic node makes its device and which `telenano.simulate` runs.
        keywords: Further arguments of `build`, by keyword: `period_s`, the period of the loop [s], and keys of the
            node's section, such as `operator` of `haptic_node`, or `attended` of `afm_node`: whether a person stands by
            who retracts the tip.
        capabilities: The abilities of an instrument (`AfmCapabilities` of `telenano.devices`), which decide with which
            laws and programs it is used; an instrument without them is not judged.
        calibration: The model of a file whose key `controller` names this driver; the settings then have a key
            `calibration` with the path of the file.
        own: An object for the package's own processes, which find the driver by its name (`DeviceDriver.haptic`).
        what: The devices, as a list names them.
        experimental: Whether it has driven an emulator and never a real device, which its node reports when it starts.
    """

    node: Literal["haptic_node", "afm_node"]
    name: str
    config: type[BaseModel]
    build: Callable[..., Any]
    simulated: bool = False
    in_lockstep: bool = False
    keywords: tuple[str, ...] = ()
    capabilities: tuple[Any, ...] | None = None
    calibration: type[BaseModel] | None = None
    own: Any = None
    what: str = ""
    experimental: bool = False

    def section(self, node: BaseModel) -> BaseModel:
        """Return the settings of the driver in the section of its node, or the default ones."""
        settings_of_driver: BaseModel | None = section_of(node, self.name)
        return settings_of_driver or self.config()

    def device(self, node: BaseModel, limits: Any, period_s: float, settings: BaseModel | None = None) -> Any:
        """Return the device of a node.

        Args:
            node: The section of the node, with the driver's section and the keys in `keywords`.
            limits: The limits of the guard.
            period_s: The period of the loop [s].
            settings: The settings of the driver; None takes those of its section.
        """
        named = {name: period_s if name == "period_s" else section_of(node, name) for name in self.keywords}
        return self.build(settings or self.section(node), limits, **named)

    def model(self, node: BaseModel) -> Any:
        """Return the `SimulatedHand` of a driver that runs in lockstep, for the section of its node."""
        return self.build(self.section(node), None, **{name: section_of(node, name) for name in self.keywords})

    def settings(self, values: dict[str, Any]) -> BaseModel:
        """Return the settings of the driver's section from plain values; ConfigError names the key at fault."""
        return validate(self.config, values, self.node, self.name)

    @staticmethod
    def all() -> "LoadedEntries[DeviceDriver]":
        """Return the drivers of installed packages for both nodes, all imported now: `DeviceDriver.all().found`."""
        loaded = Drivers("haptic_node", (), ()).all()
        instruments = Drivers("afm_node", (), ()).all()
        return LoadedEntries({**loaded.found, **instruments.found}, {**loaded.problems, **instruments.problems})

    @staticmethod
    def why_missing(name: str) -> str:
        """Return why a driver is missing: the fault of its package, or which package to install; empty if unknown.

        DeviceDriver.why_missing(config.driver)    # "the driver … is in the package …: pip install …"
        """
        return DeviceDriver.all().problems.get(name) or where_it_is(f"driver {name}")

    @staticmethod
    def haptic(name: str) -> "DeviceDriver | None":
        """Return the driver of an installed package for the haptic node, importing it now; None if there is none.

        Raises:
            ValueError: The driver cannot be used; the message says why.
        """
        return Drivers("haptic_node", (), ()).find(name)


class Drivers(Entries[DeviceDriver]):
    """The drivers of packages for a node, each imported when it is first asked for.

    An entry that is a model of settings and no driver is a section of the hand's node. Drivers of any package get it by
    its name among their `keywords`.

    Args:
        node: The node that uses them.
        own: The names of the node's own drivers.
        taken: The names that no package may use: those of `own` and the other keys of the node's section.
        experimental: The node's own drivers that have driven an emulator and never a real device.
    """

    def __init__(
        self, node: str, own: Collection[str], taken: Collection[str], experimental: Collection[str] = ()
    ) -> None:
        absent = "section" if node == "haptic_node" else ""
        super().__init__("devices", "device", self._checked, taken, own, absent, called="driver")
        self._node = node
        self._experimental = experimental

    def is_absent(self, name: object) -> bool:
        """Return whether a driver is neither one of the node's own nor one of a package on this machine."""
        return isinstance(name, str) and name not in self._own and name not in installed("devices")

    def is_simulated(self, name: str) -> bool:
        driver = self.find(name)
        return driver is not None and driver.simulated

    def caution(self, name: str | None) -> str:
        """Return the warning of a driver that never drove a real device; empty for every other and for None."""
        driver = None if name is None else self.find(name)
        if name not in self._experimental and (driver is None or not driver.experimental):
            return ""
        return (
            f"{self._node}.driver: {name} is experimental: it has driven an emulator and never a real device, so keep "
            "a hand at the switch of its power; `telenano device trial` tries it step by step"
        )

    def require_section(self, config: BaseModel, name: str) -> None:
        """Raise ValueError where a driver of a package has keys without a default and no section that gives them."""
        driver = self.find(name)
        fields = {} if driver is None else driver.config.model_fields
        needed = [key for key, field in fields.items() if field.is_required()]
        if needed and section_of(config, name) is None:
            raise ValueError(f"driver: {name} needs a section {name} with {', '.join(needed)}")

    def _checked(self, name: str, value: Any) -> "DeviceDriver | SharedSection | None":
        if isinstance(value, type) and issubclass(value, BaseModel):
            return SharedSection(value) if self._node == "haptic_node" else None
        if not isinstance(value, DeviceDriver):
            raise TypeError(f"is a {type(value).__name__}, must be a DeviceDriver or a model of settings")
        if value.name != name:
            raise ValueError(f"is registered under another name than its own, {value.name}")
        if value.in_lockstep and not (value.simulated and value.node == "haptic_node"):
            raise ValueError("in_lockstep is for a driver of the haptic node that is simulated as well")
        if value.in_lockstep and "period_s" in value.keywords:
            raise ValueError("keywords: a driver that runs in lockstep has no period_s, for a model has no loop")
        return value if value.node == self._node else None
