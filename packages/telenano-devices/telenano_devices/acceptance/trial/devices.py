"""The devices that can be tried, by the names that a person gives, with the function that records each."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from telenano.cli import run_ahead
from telenano.sections import HapticConfig, LimitsConfig
from telenano.settings import DeviceDriver, validate
from telenano.wire import ConfigError, known_names
from telenano_devices.acceptance.accept_command import section_named
from telenano_devices.acceptance.take import MACHINE, Guide, Take
from telenano_devices.impedance.impedance import force_drivers

_INSTRUMENTS = {"t7": "modbus", "nanonis": "nanonis", "gwyscope": "gwyscope"}
_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_BAUD = 1_000_000
# Keys whose values name a machine, a file or a person's device.
_NAMING = ("host", "service", "library", "name", "calibration", "port")


class TriedDevice(NamedTuple):
    """A device to be tried.

    record: makes its recording; given: texts of the command line that name a person, machine or file, to be scrubbed;
    is_emulated: whether the address of the device is this machine, which marks an emulator that does not say so.
    """

    record: Callable[[Guide], Take[Any]]
    given: tuple[str, ...]
    is_emulated: bool = False


def tried(
    name: str,
    options: dict[str, Any],
    calibration: Path | None,
    port: str | None,
    mass_kg: float,
    independent_stop: str,
) -> TriedDevice:
    """Return the device of a name.

    Args:
        name: haply, dhd, hd, nanonis, gwyscope, t7, serial, simulated_impedance, or the driver of a package.
        options: The keys of `--set`.
        calibration: The calibration file of an instrument or a handle.
        port: The serial port of a handle.
        mass_kg: The mass that is hung at the handle [kg].
        independent_stop: The way to stop the drives without the computer, in words.

    Raises:
        ConfigError: There is no such device, or a file or key is missing or cannot be used.
    """
    named = (*_named(options), *(str(each) for each in (calibration, port) if each is not None))
    if name in _INSTRUMENTS:
        return _instrument(name, section_named(options, "afm_node"), calibration, named)
    if name == "serial":
        return _handle(port, calibration, named)
    names = force_drivers()
    if name not in names:
        why = DeviceDriver.why_missing(name) or known_names(name, (*names, *_INSTRUMENTS, "serial"))
        raise ConfigError(f"{name}: {why}")
    if calibration is not None or port is not None:
        raise ConfigError(f"--calibration and --port are not for {name}: its settings are haptic_node.{name}.* (--set)")
    config = validate(HapticConfig, {"driver": name} | section_named(options, "haptic_node"), "--set", "haptic_node")

    def record(guide: Guide) -> Take[Any]:
        from telenano_devices.acceptance.haptic_device.devices import make_take

        return make_take(config, mass_kg, independent_stop, guide=guide)

    return TriedDevice(record, named)


def _instrument(name: str, section: dict[str, Any], calibration: Path | None, named: tuple[str, ...]) -> TriedDevice:
    from telenano.devices import driver_of
    from telenano_devices.acceptance.instrument.instruments import config_of, make_take

    if calibration is None:
        raise ConfigError(f"{name}: give its calibration file by --calibration FILE")
    config = config_of(calibration, section)
    if config.driver != _INSTRUMENTS[name]:
        raise ConfigError(f"--calibration {calibration}: is that of the driver {config.driver}, not of {name}")
    driver: Any = driver_of(config)
    host = str(driver.calibration.network.host)

    def record(guide: Guide) -> Take[Any]:
        # A guard takes a pause of this process for its death and retracts the tip.
        run_ahead()
        return make_take(config, guide)

    return TriedDevice(record, (*named, host), host in _LOOPBACK)


def _handle(port: str | None, calibration: Path | None, named: tuple[str, ...]) -> TriedDevice:
    from telenano.devices import HandleCalibration, SerialHandle
    from telenano_devices.acceptance.handle.take import facts_of, record_take

    if port is None or calibration is None:
        raise ConfigError("serial: give the port of the handle by --port, and its calibration file by --calibration")
    handle_calibration = HandleCalibration.from_file(calibration)

    def record(guide: Guide) -> Take[Any]:
        run_ahead()
        driver = SerialHandle(port, _BAUD, handle_calibration, LimitsConfig())
        try:
            driver.open()
            return record_take(driver, facts_of(driver, handle_calibration), MACHINE, guide)
        finally:
            driver.close()

    return TriedDevice(record, named)


def _named(options: dict[str, Any], key: str = "") -> list[str]:
    """Return the texts of `--set` that name a machine, a file or a person's device."""
    if isinstance(options, dict):
        return [text for name, value in options.items() for text in _named(value, name)]
    return [options] if isinstance(options, str) and key in _NAMING else []
