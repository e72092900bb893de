"""The devices that a take can be made of, by the name of their driver."""

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from proto.errors import ConfigError
from services.haptic_node.acceptance.simulated_person import person, reach_of
from services.haptic_node.acceptance.take import Step, Take, record_take
from services.haptic_node.config import DRIVERS, SIMULATED_IMPEDANCE, HapticConfig
from services.haptic_node.devices.servo_process import ProcessLink
from services.haptic_node.devices.simulated_link import DeviceFaults, SimulatedLink


class Circumstances(NamedTuple):
    """What the person says of a take: mass at the handle [kg], and how the drives are stopped without the computer."""

    mass_kg: float = 0.0
    independent_stop: str = ""


def make_take(
    config: HapticConfig,
    steps: tuple[Step, ...],
    said: Circumstances,
    say: Callable[[Step], None],
    faults: Mapping[str, Any] | None = None,
) -> Take:
    """Lead a person, or a simulated one, through the steps at the device that a section names.

    Args:
        config: The section `haptic_node`.
        steps: Those of `steps_of`.
        said: What the person says beforehand.
        say: Tells the person of each step as it begins.
        faults: Those of `DeviceFaults` to put into a simulated device, by name.

    Raises:
        ConfigError: The driver is none of a device that takes a force, or faults were asked of a real one.
        DeviceError: The device is not ready.
    """
    if config.driver == SIMULATED_IMPEDANCE:
        return _simulated(config, steps, said, say, faults or {})
    if faults:
        raise ConfigError(f"faults can be put into {SIMULATED_IMPEDANCE} only, not into {config.driver}")
    driver = DRIVERS.find(config.driver)
    if driver is None or driver.wire is None:
        known = ", ".join((SIMULATED_IMPEDANCE, *(name for name, one in DRIVERS.all().found.items() if one.wire)))
        raise ConfigError(f"haptic_node.driver = {config.driver} is no device that takes a force: {known}")
    settings_of_driver = getattr(config, driver.name) or driver.config()
    link = ProcessLink(driver.name, settings_of_driver.model_dump(mode="json"))
    link.open()
    try:
        settings = config.coupling.to_settings(link.capabilities)
        return record_take(link, settings, steps, now_ns=time.monotonic_ns, wait=_wait, say=say, **said._asdict())
    finally:
        link.close()


def _wait(deadline_ns: int) -> None:
    time.sleep(max(0.0, (deadline_ns - time.monotonic_ns()) * 1e-9))


def _simulated(
    config: HapticConfig,
    steps: tuple[Step, ...],
    said: Circumstances,
    say: Callable[[Step], None],
    faults: Mapping[str, Any],
) -> Take:
    """Make a take in virtual time: the simulated device has three buttons, the first a dead-man, and a wrist."""
    able = config.impedance.capabilities()
    able = able._replace(buttons=("a", "b", "c"), deadman="a", has_orientation=True)
    hand = person(reach_of(able), len(able.buttons), 1, steps, said.mass_kg)
    link = SimulatedLink(able, hand, _faults_of(faults))
    settings = config.coupling.to_settings(able)
    return record_take(link, settings, steps, now_ns=link.now_ns, say=say, **said._asdict())


def _faults_of(given: Mapping[str, Any]) -> DeviceFaults:
    """Return the faults of these names; ConfigError says what is wrong with one."""
    good = DeviceFaults()
    for name, value in given.items():
        if name not in DeviceFaults._fields:
            raise ConfigError(f"--fault {name}: no such fault; there are {', '.join(DeviceFaults._fields)}")
        default = getattr(good, name)
        parts, wanted = (value, len(default)) if isinstance(default, tuple) else ((value,), 1)
        if (
            not isinstance(parts, tuple)
            or len(parts) != wanted
            or not all(isinstance(part, int | float) for part in parts)
        ):
            what = f"a list of {wanted} numbers" if isinstance(default, tuple) else "a number, true or false"
            raise ConfigError(f"--fault {name}: must be {what}, not {value!r}")
    return good._replace(**given)
