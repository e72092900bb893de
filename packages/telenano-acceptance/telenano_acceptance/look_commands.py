"""`telenano device monitor`, and how a device is read undriven: of this project, or of an installed package."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from presets.plugins import fault_of_package, installed
from proto.errors import ConfigError, TelenanoError, known_names
from telenano.cli.commands.device_impedance import SIMULATED, SetOption, probe_impedance
from telenano.cli.options import JsonOption
from telenano.cli.output import print_answer, report_errors

_PERIOD_S = 1e-3

PortOption = Annotated[str | None, typer.Option("--port", metavar="DEVICE", help="Serial port of a handle.")]
BaudOption = Annotated[int, typer.Option("--baud", min=115_200, help="Bits a second of the serial port.")]

# what reads a device once, undriven, and returns what it said
Tick = Callable[[], dict[str, Any]]


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
    duration: Annotated[float, typer.Option("--duration", min=0.1, metavar="S", help="How long to look [s].")] = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Read a device a thousand times a second, undriven, and tell age of its samples, losses and bad frames."""
    with report_errors(as_json):
        if (device is None) == (calibration is None) or (device is not None and port is not None):
            raise ConfigError(
                "give --calibration for an instrument, with --port for a handle, or --device for a driver of a package"
            )
        if device is not None:
            with errors_of_package():
                facts = _watch(*_opened_of_package(device, settings or []), duration)
        elif port is not None:
            facts = _watch(*_opened_handle(port, baud, calibration or Path()), duration)
        else:
            facts = _watch(*_opened_instrument(calibration or Path()), duration)
    print_facts(facts, as_json=as_json)


def print_facts(facts: Mapping[str, Any], *, as_json: bool) -> None:
    """Print what was found of a device."""
    print_answer(facts, [{"": name, "found": value} for name, value in facts.items()], as_json=as_json)


def instrument_of(calibration: Path) -> Any:
    """Return the driver of an instrument by its calibration file, to be looked at while it stays retracted."""
    from services.afm_node.config import AfmConfig
    from services.afm_node.instrument import driver_of_file

    return driver_of_file(calibration, AfmConfig(attended=True))


def package_rows() -> list[dict[str, Any]]:
    """Return the drivers that installed packages bring, and whether what each needs is here.

    That is what a check of `telenano doctor` with the name of the driver found.
    """
    from telenano.doctor.report import checks_of_packages

    found, problems = _package_drivers()
    checked = {finding.name: finding for finding in checks_of_packages()}
    rows = []
    for name, row in installed("devices").items():
        finding = checked.get(name)
        rows.append(
            {
                "driver": name,
                "device": found[name].what if name in found else "",
                "node": found[name].node if name in found else "",
                "package": f"{row.package} {row.version}",
                "found": problems[name] if name not in found else finding.found if finding else "can be used",
                "advice": finding.advice if finding else "",
            }
        )
    return rows


def probe_driver(name: str, settings: list[str]) -> dict[str, Any]:
    """Open what a driver drives, undriven, and return what it declares; of one that takes a force its coupling too."""
    if name != SIMULATED:
        driver = _driver_of_package(name)
        if driver.wire is None:
            return probe_package(name, settings)
    with errors_of_package():
        return probe_impedance(name, settings)


def probe_package(name: str, settings: list[str]) -> dict[str, Any]:
    """Open the driver of a package without driving its device, and return what it declares and reads."""
    with errors_of_package():
        device, tick = _opened_of_package(name, settings)
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
            state = (
                {} if report is None else {"status": report.status, "sample_age_s": report.age_s, "said": report.text}
            )
            return {**declared, **read, **state}
        finally:
            device.close()


@contextmanager
def errors_of_package() -> Iterator[None]:
    """Turn what the code of a package raises into a sentence that names the package and the place in it."""
    try:
        yield
    except TelenanoError:
        raise
    # its code may raise anything
    except Exception as error:
        raise TelenanoError(fault_of_package(error) or f"{type(error).__name__}: {error}") from error


def _package_drivers() -> tuple[dict[str, Any], dict[str, str]]:
    """Return the drivers for both nodes by name, and what is wrong with the others."""
    from services.afm_node.config import DRIVERS as INSTRUMENTS
    from services.haptic_node.config import DRIVERS as HANDLES

    handles, instruments = HANDLES.all(), INSTRUMENTS.all()
    return {**handles.found, **instruments.found}, {**handles.problems, **instruments.problems}


def _driver_of_package(name: str) -> Any:
    """Return the driver of a package; ConfigError says why there is none, and which package would have it."""
    from services.runtime.settings.device_drivers import missing_driver

    found, problems = _package_drivers()
    if name not in found:
        why = problems.get(name) or missing_driver(name) or known_names(name, (SIMULATED, *found))
        raise ConfigError(f"--device {name}: {why}")
    return found[name]


def _opened_of_package(name: str, settings: list[str]) -> tuple[Any, Tick]:
    from services.afm_node.config import AfmConfig
    from services.haptic_node.config import HapticConfig
    from services.runtime.settings.config import flag_overrides, validate

    driver = _driver_of_package(name)
    given = flag_overrides([f"{driver.node}.driver={name}", *settings])
    if other := sorted(set(given) - {driver.node}):
        raise ConfigError(f"--set {other[0]}: the driver {name} has keys {driver.node}.{name}.* only")
    config: Any
    if driver.node == "haptic_node":
        config = validate(HapticConfig, given[driver.node], "--set", driver.node)
        limits, told = config.limits, {"coupling": config.coupling}
    else:
        config = validate(AfmConfig, given[driver.node], "--set", driver.node)
        limits, told = config.to_params().safety, {"attended": True}
    device = driver.device(getattr(config, name), limits, period_s=_PERIOD_S, **told)
    device.open()
    return device, _reads_handle(device) if driver.node == "haptic_node" else _reads_instrument(device)


def _opened_handle(port: str, baud: int, calibration: Path) -> tuple[Any, Tick]:
    from services.haptic_node.config import LimitsConfig
    from services.haptic_node.devices.calibration import read_calibration
    from services.haptic_node.devices.serial_driver import SerialHandle

    driver = SerialHandle(port, baud, read_calibration(calibration), LimitsConfig())
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


def _opened_instrument(calibration: Path) -> tuple[Any, Tick]:
    driver = instrument_of(calibration)
    driver.open()
    return driver, _reads_instrument(driver)


def _reads_handle(device: Any) -> Tick:
    from services.haptic_node.driver import DriveCommand
    from services.haptic_node.safety import MODE_OFF

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
    """Read a device each millisecond and close it; a simulated one has no report, and so no age of its samples."""
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
