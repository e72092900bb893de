"""`telenano device probe` and `monitor`: identity and readings of a device that is not driven."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli import JsonOption, Keys, Void, print_answer, report_errors, rules
from telenano.devices import driver_of
from telenano.extend.hands import MODE_OFF, DriveCommand
from telenano.sections import AfmConfig, HapticConfig, LimitsConfig
from telenano.settings import DeviceDriver, code_of, flag_overrides, installed, validate
from telenano.wire import ConfigError, known_names
from telenano_devices.acceptance.instrument.instruments import config_of
from telenano_devices.impedance.impedance import coupling_of, takes_force

_PERIOD_S = 1e-3
_ABILITIES = (
    "position mode",
    "force mode",
    "force sensor",
    "force is estimated",
    "e-stop input",
    "back-drivable",
    "current is sensed",
    "emulated",
)

PortOption = Annotated[str | None, typer.Option("--port", metavar="DEVICE", help="Serial port of a handle.")]
BaudOption = Annotated[int, typer.Option("--baud", min=115_200, help="Bits a second of the serial port.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the device, such as haptic_node.coupling.margin."),
]

_RULES = (
    Void("--baud", "the port whose rate it is", unless="--port"),
    Void("--set", "which has these keys", unless="--device"),
    Keys("--device", "haptic_node.driver, afm_node.driver"),
)

# A function that reads a device once, without driving it, and returns its readings by name.
Tick = Callable[[], dict[str, Any]]


@rules(*_RULES)
def probe(
    name: Annotated[str | None, typer.Argument(metavar="NAME", hidden=True)] = None,
    port: PortOption = None,
    baud: BaudOption = 1_000_000,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", metavar="FILE", help="stage.yaml of the instrument.")
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option(
            "--device",
            metavar="DRIVER",
            help="Driver of a device: simulated_impedance, or one of an installed package.",
        ),
    ] = None,
    settings: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Identify a handle (--port), an instrument (--calibration) or a driver's device (--device).

    An instrument is retracted; a device gets no force. The driver is that of a device that takes a force, or one of an
    installed package, for either node.
    """
    with report_errors(as_json):
        if name is not None:
            raise ConfigError(
                f"{name}: name a device by how it is reached: an instrument by its file, --calibration"
                f" {name}.yaml, a handle by --port /dev/serial/by-id/..., the driver of a package by --device {name}"
            )
        if (port is not None) + (calibration is not None) + (kind is not None) != 1:
            raise ConfigError(
                "give --port for a handle, or --calibration for an instrument, or --device simulated_impedance or the"
                " driver of a package"
            )
        if kind is not None:
            facts = _probe_driver(kind, settings or [])
        else:
            facts = _probe_handle(port, baud) if port is not None else _probe_instrument(calibration or Path())
    _print_facts(facts, as_json=as_json)


@rules(*_RULES)
def monitor(
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", metavar="FILE", help="handle.yaml of a handle (with --port), or stage.yaml."),
    ] = None,
    port: PortOption = None,
    baud: BaudOption = 1_000_000,
    device: Annotated[
        str | None, typer.Option("--device", metavar="DRIVER", help="Driver of an installed package, for either node.")
    ] = None,
    settings: SetOption = None,
    duration: Annotated[
        float, typer.Option("--duration", min=0.1, metavar="S", help="Time for which to look [s].")
    ] = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Read a device at 1 kHz without driving it, and report age of its samples, losses and bad frames."""
    with report_errors(as_json):
        if (device is None) == (calibration is None) or (device is not None and port is not None):
            raise ConfigError(
                "give --calibration for an instrument, with --port for a handle, or --device for a driver of a package"
            )
        if device is not None:
            driver_of_package = _driver_of_package(device)
            with code_of(installed("devices")[device].package):
                facts = _watch(*_opened_of_package(driver_of_package, settings or []), duration)
        elif port is not None:
            facts = _watch(*_opened_handle(port, baud, calibration or Path()), duration)
        else:
            driver = _instrument_of(calibration or Path())
            driver.open()
            facts = _watch(driver, _reads_instrument(driver), duration)
    _print_facts(facts, as_json=as_json)


def _print_facts(facts: Mapping[str, Any], *, as_json: bool) -> None:
    print_answer(facts, [{"": name, "found": value} for name, value in facts.items()], as_json=as_json)


def _probe_handle(port: str, baud: int) -> dict[str, Any]:
    from telenano.devices import SerialHandle

    driver = SerialHandle(port, baud, None, LimitsConfig())
    try:
        hello = driver.identify()
    finally:
        driver.close()
    return {
        "model": hello.model,
        "device_id": f"{hello.device_id:016x}",
        "firmware": f"{hello.firmware >> 8}.{hello.firmware & 0xFF}",
        "protocol": f"{hello.major}.{hello.minor}" + ("" if hello.is_understood else " (not that of this program)"),
        "abilities": ", ".join(name for bit, name in enumerate(_ABILITIES) if hello.flags & (1 << bit)),
        "max_rate_hz": hello.max_rate_hz,
        "nominal_m_per_count": hello.nominal_m_per_count,
        "nominal_n_per_count": hello.nominal_n_per_count,
        "nominal_drive_n_per_count": hello.nominal_drive_n_per_count,
    }


def _probe_instrument(calibration: Path) -> dict[str, Any]:
    driver = _instrument_of(calibration)
    try:
        driver.open()
        sample = driver.exchange(driver.safe_position_m)
        return {
            "identity": driver.identity,
            "base_m": sample.base_m,
            "input_v": sample.bridge_voltage_v,
            "force_n": sample.force_n,
            "declared_latency_s": driver.latency_s,
        }
    finally:
        driver.close()


def _probe_driver(name: str, settings: list[str]) -> dict[str, Any]:
    """Open the device of a driver without driving it; return its declaration, and the coupling of a force device."""
    driver = _driver_of_package(name)
    with code_of(installed("devices")[name].package):
        if takes_force(driver):
            return _probe_impedance(driver, settings)
        return _probe_package(driver, settings)


def _probe_impedance(driver: DeviceDriver, settings: list[str]) -> dict[str, Any]:
    """Open a force device without force, and return its capabilities with the coupling and its two bounds."""
    from telenano_devices.impedance.servo_process import wire_of

    chosen = flag_overrides([f"haptic_node.driver={driver.name}", *settings])
    config = validate(HapticConfig, chosen.get("haptic_node", {}), "--set", "haptic_node")
    if driver.in_lockstep:
        capabilities = driver.model(config).capabilities
    else:
        wire = wire_of(driver.name, driver.section(config).model_dump(mode="json"))
        try:
            capabilities = wire.open()
        finally:
            wire.close()
    bounds = coupling_of(config).bounds(capabilities)
    return {
        "identity": capabilities.identity,
        "max_force_n": capabilities.max_force_n,
        "declared_stiffness_n_per_m": capabilities.max_stiffness_n_per_m,
        "declared_damping_n_s_per_m": capabilities.max_damping_n_s_per_m,
        "workspace_m": f"{capabilities.workspace_min_m:g} to {capabilities.workspace_max_m:g} towards the sample",
        "servo_rate_hz": capabilities.rate_hz,
        "drive_delay_s": capabilities.drive_delay_s,
        "buttons": ", ".join(capabilities.buttons),
        "coupling": bounds.sentence(),
        "coupling_stiffness_n_per_m": bounds.stiffness_n_per_m,
        "passive_bound_n_per_m": bounds.passive_n_per_m,
        "stable_bound_n_per_m": bounds.stable_n_per_m,
        "least_mass_kg": bounds.least_mass_kg,
    }


def _probe_package(driver: DeviceDriver, settings: list[str]) -> dict[str, Any]:
    """Open the driver of a package without driving its device, and return its declaration and one reading."""
    device, tick = _opened_of_package(driver, settings)
    try:
        read = tick()
        if hasattr(device, "capabilities"):
            declared = device.capabilities._asdict()
        else:
            declared = {
                "calibration": device.calibration_identity,
                "declared_latency_s": device.latency_s,
                "safe_position_m": device.safe_position_m,
                "lateral_stage": device.stage is not None,
                "vibration": device.vibration is not None,
            }
        report = device.report
        state = {} if report is None else {"status": report.status, "sample_age_s": report.age_s, "text": report.text}
        return {**declared, **read, **state}
    finally:
        device.close()


def _driver_of_package(name: str) -> DeviceDriver:
    """Return the driver of a package; raise ConfigError, with the reason and a package that has it, if missing."""
    drivers = DeviceDriver.all().found
    if name not in drivers:
        raise ConfigError(f"--device {name}: {DeviceDriver.why_missing(name) or known_names(name, drivers)}")
    return drivers[name]


def _opened_of_package(driver: DeviceDriver, settings: list[str]) -> tuple[Any, Tick]:
    if driver.in_lockstep:
        raise ConfigError(f"--device {driver.name}: it is simulated, and has no samples to watch; probe it instead")
    name, node = driver.name, driver.node
    overrides = flag_overrides([f"{node}.driver={name}", *settings])
    if other := sorted(set(overrides) - {node}):
        raise ConfigError(f"--set {other[0]}: the driver {name} has keys {node}.{name}.* only")
    config: Any
    if node == "haptic_node":
        config = validate(HapticConfig, overrides[node], "--set", node)
        limits = config.limits
    else:
        config = validate(AfmConfig, overrides[node], "--set", node)
        config, limits = config.model_copy(update={"attended": True}), config.to_params().safety
    device = driver.device(config, limits, _PERIOD_S)
    device.open()
    return device, _reads_handle(device) if node == "haptic_node" else _reads_instrument(device)


def _opened_handle(port: str, baud: int, calibration: Path) -> tuple[Any, Tick]:
    from telenano.devices import HandleCalibration, SerialHandle

    driver = SerialHandle(port, baud, HandleCalibration.from_file(calibration), LimitsConfig())
    driver.open()
    read = _reads_handle(driver)

    def tick() -> dict[str, Any]:
        return {
            **read(),
            "frames_missing": driver.missed,
            "frames_bad": sum(driver.reader.errors.values()),
            "commands_dropped": driver.dropped,
        }

    return driver, tick


def _instrument_of(calibration: Path) -> Any:
    """Return the driver of an instrument by its calibration file, for reading it while it stays retracted."""
    return driver_of(config_of(calibration, {"attended": True}), _PERIOD_S)


def _reads_handle(device: Any) -> Tick:
    def tick() -> dict[str, Any]:
        device.write(DriveCommand(MODE_OFF, 0.0, 0.0))
        reading = device.read(-1.0, _PERIOD_S)
        return {"position_m": reading.position_m, "operator_force_n": reading.operator_force_n}

    return tick


def _reads_instrument(driver: Any) -> Tick:
    counted = ("exchanges", "late_answers", "refused_answers")

    def tick() -> dict[str, Any]:
        sample = driver.exchange(driver.safe_position_m)
        facts = {"base_m": sample.base_m, "input_v": sample.bridge_voltage_v, "force_n": sample.force_n}
        return facts | {name: getattr(driver, name) for name in counted if hasattr(driver, name)}

    return tick


def _watch(driver: Any, tick: Tick, duration_s: float) -> dict[str, Any]:
    """Read a device each millisecond for duration_s [s], close it, and return the statistics.

    A simulated device has no report, and so no age of its samples.
    """
    ages: list[float] = []
    spent_s: list[float] = []
    statuses: dict[str, int] = {}
    last: dict[str, Any] = {}
    try:
        began = due = time.monotonic()
        while due < began + duration_s:
            due += _PERIOD_S
            time.sleep(max(0.0, due - time.monotonic()))
            before = time.perf_counter()
            last = tick()
            spent_s.append(time.perf_counter() - before)
            report = driver.report
            if report is not None:
                ages.append(report.age_s)
                statuses[report.status] = statuses.get(report.status, 0) + 1
    finally:
        driver.close()
    return {
        "ticks": len(spent_s),
        **{f"ticks_{status}": count for status, count in sorted(statuses.items())},
        **_shares("sample_age", ages),
        **_shares("driver", spent_s),
        **last,
    }


def _shares(name: str, values: list[float]) -> dict[str, float]:
    ordered = sorted(values)
    return {f"{name}_p{share}_s": ordered[len(ordered) * share // 100] for share in (50, 99) if ordered}
