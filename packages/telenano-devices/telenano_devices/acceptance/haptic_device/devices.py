"""Makes a take of a device that takes a force, chosen by the name of its driver."""

import gc
from collections.abc import Mapping
from typing import Any

from telenano.sections import HapticConfig
from telenano.settings import DeviceDriver
from telenano.wire import ConfigError
from telenano_devices.acceptance.haptic_device.person import person, reach_of
from telenano_devices.acceptance.haptic_device.simulated_link import DeviceFaults, SimulatedLink
from telenano_devices.acceptance.haptic_device.take import Facts, record_take, steps_of
from telenano_devices.acceptance.take import MACHINE, SILENT, Clock, Guide, Take
from telenano_devices.impedance.impedance import SIMULATED_IMPEDANCE, coupling_of, force_drivers, takes_force
from telenano_devices.impedance.servo_process import ProcessLink


def make_take(
    config: HapticConfig,
    mass_kg: float = 0.0,
    independent_stop: str = "",
    *,
    pace: float = 1.0,
    faults: Mapping[str, Any] | None = None,
    guide: Guide = SILENT,
) -> Take[Facts]:
    """Lead a person, or a simulated one, through the motion at the device of a section, and return the take.

    Args:
        config: The section `haptic_node`.
        mass_kg: The mass that is hung at the handle [kg]; 0.0 for none.
        independent_stop: The way to stop the drives without the computer, in words; empty if there is none.
        pace: The factor by which all steps are stretched.
        faults: Faults (fields of `DeviceFaults`) to put into a simulated device, by name.
        guide: The guide of the person.

    Raises:
        ConfigError: The driver is not that of a device that takes a force, or faults were given for a real device.
        DeviceError: The device is not ready.
    """
    steps = steps_of(mass_kg, pace)
    driver, coupling = DeviceDriver.haptic(config.driver), coupling_of(config)
    if driver is not None and driver.name == SIMULATED_IMPEDANCE:
        # In virtual time. The simulated device gets three buttons, the first a dead-man, and a wrist.
        able = driver.model(config).capabilities
        able = able._replace(buttons=("a", "b", "c"), deadman="a", has_orientation=True)
        hand = person(reach_of(able), len(able.buttons), 1, steps, mass_kg)
        simulated = SimulatedLink(able, hand, _faults_of(faults or {}))
        facts = Facts(able, coupling.to_settings(able), mass_kg, independent_stop)
        return record_take(simulated, facts, steps, Clock(simulated.now_ns), guide)
    if faults:
        raise ConfigError(f"faults can be put into {SIMULATED_IMPEDANCE} only, not into {config.driver}")
    if driver is None or not takes_force(driver):
        names = ", ".join(force_drivers())
        raise ConfigError(
            f"haptic_node.driver = {config.driver} is not a device that takes a force; take one of {names}"
        )
    link = ProcessLink(driver.name, driver.section(config).model_dump(mode="json"))
    # As in run_ahead for the other devices: a full garbage collection would halt the motion for a tenth of a second.
    gc.collect()
    gc.freeze()
    link.open()
    try:
        facts = Facts(link.capabilities, coupling.to_settings(link.capabilities), mass_kg, independent_stop)
        return record_take(link, facts, steps, MACHINE, guide)
    finally:
        link.close()


def _faults_of(options: Mapping[str, Any]) -> DeviceFaults:
    """Return the faults of these names; raise ConfigError for an unknown name or a wrong value."""
    good, fields = DeviceFaults(), dict[str, Any]()
    for name, value in options.items():
        if name not in DeviceFaults._fields:
            raise ConfigError(f"--fault {name}: no such fault; there are {', '.join(DeviceFaults._fields)}")
        default = getattr(good, name)
        is_list = isinstance(default, tuple)
        parts = value if is_list and isinstance(value, list | tuple) else (value,)
        if len(parts) != (len(default) if is_list else 1) or not all(isinstance(part, int | float) for part in parts):
            what = f"a list of {len(default)} numbers" if is_list else "a number, true or false"
            raise ConfigError(f"--fault {name}: must be {what}, not {value!r}")
        fields[name] = tuple(parts) if is_list else value
    return good._replace(**fields)
