"""`telenano device`: the real devices of a rig, and emulated ones to try without."""

import asyncio
import logging
import math
import os
import select
import signal
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
import yaml

from proto.errors import ConfigError
from proto.extras import how_to_install
from telenano.cli.commands.device_calibrate import calibrate_stage
from telenano.cli.commands.device_files import run_ahead, section_of, write_document
from telenano.cli.commands.device_impedance import KindOption, SetOption
from telenano.cli.commands.device_monitor import (
    BaudOption,
    PortOption,
    instrument_of,
    monitor,
    package_rows,
    print_facts,
    probe_driver,
)
from telenano.cli.options import JsonOption, command_group
from telenano.cli.output import print_json, print_rows, report_errors

app = command_group()
simulate = command_group()
guard = command_group()
calibrate = command_group()
calibrate.command("stage")(calibrate_stage)
app.command()(monitor)
app.add_typer(calibrate, name="calibrate", help="Measure a device, and write its calibration file.")
app.add_typer(simulate, name="simulate", help="Run an emulated device in this terminal.")
app.add_typer(guard, name="guard", help="Retract the tip of an AFM controller when the rig is silent.")

_BY_ID = Path("/dev/serial/by-id")

CalibrationOption = Annotated[
    Path | None, typer.Option("--calibration", metavar="FILE", help="stage.yaml of the instrument.")
]
WriteOption = Annotated[
    Path | None,
    typer.Option("--calibration", metavar="FILE", help="Write a calibration file that fits the emulated device."),
]


@app.command("list")
def list_devices(as_json: JsonOption = False) -> None:
    """List the serial ports, by names that stay, and the drivers of packages, with what each still needs."""
    with report_errors(as_json):
        rows, packages = serial_ports(), package_rows()
    if as_json:
        print_json({"ports": rows, "packages": packages})
        return
    if rows:
        print_rows(rows)
    else:
        typer.echo("no serial port is plugged in")
    if packages:
        print_rows(packages)


def serial_ports() -> list[dict[str, Any]]:
    """Return the serial ports of this machine: name that stays, device file, what it is, who holds it."""
    try:
        from serial.tools.list_ports import comports
    except ImportError as error:
        raise ConfigError(f"serial ports need pyserial: {how_to_install('haptic')}") from error
    from services.haptic_node.devices.port import holder_of

    names = {str(link.resolve()): str(link) for link in _BY_ID.iterdir()} if _BY_ID.is_dir() else {}
    return [
        {
            "port": names.get(found.device, found.device),
            "device": found.device,
            "what": found.description,
            "in use by": holder_of(found.device),
        }
        for found in comports()
    ]


@app.command()
def probe(
    port: PortOption = None,
    baud: BaudOption = 1_000_000,
    calibration: CalibrationOption = None,
    kind: KindOption = None,
    settings: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Ask a handle (--port), an instrument (--calibration) or what a driver drives (--device) who it is.

    An instrument is retracted; a device gets no force. The driver is that of a device that takes a force, or one of an
    installed package, for either node.
    """
    with report_errors(as_json):
        if (port is not None) + (calibration is not None) + (kind is not None) != 1:
            raise ConfigError(
                "give --port for a handle, or --calibration for an instrument, or --device simulated_impedance or the"
                " driver of a package"
            )
        if kind is not None:
            facts = probe_driver(kind, settings or [])
        else:
            facts = _probe_handle(port, baud) if port is not None else _probe_instrument(calibration or Path())
    print_facts(facts, as_json=as_json)


def _probe_handle(port: str, baud: int) -> dict[str, Any]:
    from services.haptic_node.config import LimitsConfig
    from services.haptic_node.devices import wire
    from services.haptic_node.devices.serial_driver import SerialHandle

    driver = SerialHandle(port, baud, None, LimitsConfig())
    try:
        hello = driver.identify()
    finally:
        driver.close()
    names = (
        "position mode",
        "force mode",
        "force sensor",
        "force is estimated",
        "e-stop input",
        "back-drivable",
        "current is sensed",
        "emulated",
    )
    return {
        "model": hello.model,
        "device_id": f"{hello.device_id:016x}",
        "firmware": f"{hello.firmware >> 8}.{hello.firmware & 0xFF}",
        "protocol": f"{hello.major}.{hello.minor}"
        + ("" if hello.major == wire.MAJOR else " (not that of this program)"),
        "abilities": ", ".join(name for bit, name in enumerate(names) if hello.flags & (1 << bit)),
        "max_rate_hz": hello.max_rate_hz,
        "nominal_m_per_count": hello.nominal_m_per_count,
        "nominal_n_per_count": hello.nominal_n_per_count,
        "nominal_drive_n_per_count": hello.nominal_drive_n_per_count,
    }


def _probe_instrument(calibration: Path) -> dict[str, Any]:
    driver = instrument_of(calibration)
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


@calibrate.command("handle")
def calibrate_handle(
    port: Annotated[str, typer.Option("--port", metavar="DEVICE", help="Serial port of the handle.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Calibration file to write, such as handle.yaml.")],
    gauges: Annotated[
        list[float], typer.Option("--gauge", metavar="M", help="Position of the arm [m], towards the sample (repeat).")
    ],
    masses: Annotated[
        list[float],
        typer.Option("--mass", metavar="KG", help="Mass that pulls towards the sample [kg] (repeat)."),
    ],
    stiffness: Annotated[
        float, typer.Option("--stiffness", min=1e-3, metavar="N/M", help="Gain of the device's servo [N/m].")
    ],
    max_force: Annotated[
        float, typer.Option("--max-force", min=1e-6, metavar="N", help="Most force that the drive may give [N].")
    ],
    saturation: Annotated[
        float, typer.Option("--saturation", min=1e-6, metavar="N", help="Force at which the sensor saturates [N].")
    ],
    baud: BaudOption = 1_000_000,
    duration: Annotated[float, typer.Option("--duration", min=0.2, metavar="S", help="Time for a point [s].")] = 1.0,
) -> None:
    """Measure a handle at gauges and with masses, step by step, and write its calibration file; it is never driven.

    A point off the line by more than 2 % is refused.
    """
    with report_errors(as_json=False):
        from services.haptic_node.devices.handle_calibration import STANDARD_GRAVITY_M_PER_S2, RawPoint, sample_raw
        from services.numerics.line_fit import fit_line

        hello = None
        points: list[RawPoint] = []
        for text in [*(f"put the arm at {x:g} m" for x in gauges), *(f"let {m:g} kg pull at the arm" for m in masses)]:
            typer.prompt(f"{text}, hands off, then Enter", default="", show_default=False)
            hello, point = sample_raw(port, baud, duration)
            points.append(point)
        placed, loaded = points[: len(gauges)], points[len(gauges) :]
        position = fit_line("position", [p.position for p in placed], [p.position_error for p in placed], gauges)
        forces = [mass * STANDARD_GRAVITY_M_PER_S2 for mass in masses]
        force = fit_line("force", [p.force for p in loaded], [p.force_error for p in loaded], forces)
        if hello is None:
            raise ConfigError("give two gauges and two masses at least")
        document: dict[str, object] = {
            "schema": 1,
            "device_id": f"{hello.device_id:016x}",
            "calibrated": datetime.now(UTC).replace(microsecond=0),
            "position": {
                "zero_raw": round(position.zero),
                "m_per_count": position.scale,
                "standard_error_m_per_count": position.scale_error,
            },
            "force": {
                "zero_raw": round(force.zero),
                "n_per_count": force.scale,
                "standard_error_n_per_count": force.scale_error,
                "saturation_n": saturation,
            },
            "drive": {"n_per_count": hello.nominal_drive_n_per_count},
            "servo": {"stiffness_n_per_m": stiffness},
            "max_force_n": max_force,
        }
        _check_and_write(out, document)
        typer.echo(f"position: {position.scale:.4g} m for a count, standard error {position.scale_error:.2g}")
        typer.echo(f"force: {force.scale:.4g} N for a count, standard error {force.scale_error:.2g}")


def _check_and_write(path: Path, document: dict[str, object]) -> None:
    from services.haptic_node.devices.calibration import HandleCalibration
    from services.runtime.settings.config import parse_yaml, validate

    validate(HandleCalibration, parse_yaml(yaml.safe_dump(document).encode(), str(path)), str(path))
    write_document(path, document)


@simulate.command("handle")
def simulate_handle(
    link: Annotated[
        Path, typer.Option("--link", metavar="FILE", help="Name of the port, a link as those of /dev/serial/by-id.")
    ] = Path("/tmp/telenano-handle"),
    scenario: Annotated[
        Path | None,
        typer.Option("--scenario", metavar="NAME|FILE", help="Scenario whose device and hand are emulated."),
    ] = None,
    board: Annotated[
        Literal["posix", "avr328p"],
        typer.Option("--board", help="posix: the core of the firmware; avr328p: its image, in simavr."),
    ] = "posix",
    calibration: WriteOption = None,
) -> None:
    """Run an emulated handle: the firmware, the motor and the hand, on a port of its own. Ctrl-C ends it.

    SIGUSR1, or the Enter key, pulls the cable out, and puts it in again; SIGUSR2 resets the board. For a calibration,
    `gauge M` puts the arm at a position [m] and `mass KG` hangs a mass at its sensor [kg].
    """
    with report_errors(as_json=False, interrupted="the emulated handle has ended"):
        from services.haptic_node.config import HapticConfig
        from services.haptic_node.devices import avr_board, emulated_handle
        from services.haptic_node.devices.handle_on_pty import EmulatedBoard, HandleOnPty

        config = section_of(scenario, "haptic_node", HapticConfig)
        handle: EmulatedBoard
        if board == "avr328p":
            handle, fitting = avr_board.AvrHandle(config), avr_board.calibration_of(config)
        else:
            handle, fitting = emulated_handle.EmulatedHandle(config, _boot()), emulated_handle.calibration_of(config)
        if calibration is not None:
            write_document(calibration, fitting)
        port = HandleOnPty(handle, link)
        received: list[int] = []
        for number in (signal.SIGUSR1, signal.SIGUSR2):
            signal.signal(number, lambda found, frame: received.append(found))
        typer.echo(f"an emulated handle is at {link}; Enter pulls its cable out and puts it in again, Ctrl-C ends it")
        if isinstance(handle, emulated_handle.EmulatedHandle):
            typer.echo("`gauge 0.005` puts its arm at 5 mm, `mass 0.2` lets 0.2 kg pull at it, for a calibration")
        run_ahead()
        has_keys = sys.stdin.isatty()

        def goes_on() -> bool:
            if has_keys and select.select([sys.stdin], [], [], 0.0)[0] and (line := sys.stdin.readline()):
                if line.strip():
                    typer.echo(handled(handle, line))
                else:
                    received.append(signal.SIGUSR1)
            while received:
                if received.pop(0) == signal.SIGUSR2:
                    handle.reset(_boot())
                    typer.echo("the board was reset")
                elif port.plugged:
                    port.pull_out()
                    typer.echo("the cable is out")
                else:
                    port.plug_in()
                    typer.echo("the cable is in")
            return True

        try:
            port.run(goes_on)
        finally:
            port.pull_out()


def handled(handle: Any, line: str) -> str:
    """Do at an emulated handle what a line says, and return what was done, or what would be right."""
    from services.haptic_node.devices.handle_calibration import STANDARD_GRAVITY_M_PER_S2

    word, _, text = line.strip().partition(" ")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if word not in ("gauge", "mass") or not math.isfinite(value) or not hasattr(handle, "place"):
        return f"{line.strip()!r} is not known: Enter, `gauge M` or `mass KG`, the latter two without --board avr328p"
    if word == "gauge":
        handle.place(value)
        return f"the arm stands at {value:g} m until it is driven"
    handle.load(value * STANDARD_GRAVITY_M_PER_S2)
    return f"{value:g} kg pull at the arm until it is driven"


@simulate.command("t7")
def simulate_t7(
    host: Annotated[str, typer.Option("--host", metavar="ADDRESS", help="Address to serve on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="TCP port; 502 needs privileges.")] = 5020,
    scenario: Annotated[
        Path | None,
        typer.Option("--scenario", metavar="NAME|FILE", help="Scenario whose AFM is behind the converters."),
    ] = None,
    latency: Annotated[
        float, typer.Option("--latency", min=0.0, max=1.0, metavar="S", help="Time that it takes for a request [s].")
    ] = 1.2e-3,
    noise: Annotated[
        float, typer.Option("--noise", min=0.0, max=1.0, metavar="V", help="Noise of the input [V], one sigma.")
    ] = 1e-6,
    travel: Annotated[
        float, typer.Option("--travel", min=1e-12, max=1e-3, metavar="M", help="Travel of the stage for a volt [m].")
    ] = 8.0e-8,
    calibration: WriteOption = None,
) -> None:
    """Serve the model of a LabJack T7 with stage and cantilever behind it, over Modbus TCP. Ctrl-C ends it."""
    with report_errors(as_json=False, interrupted="the model of the T7 has ended"):
        from services.afm_node.config import AfmConfig
        from services.afm_node.devices.t7_model import T7Model, calibration_of, instrument_of
        from services.afm_node.devices.t7_server import serve_t7

        config = section_of(scenario, "afm_node", AfmConfig)
        if calibration is not None:
            plant = config.to_params().plant
            write_document(calibration, calibration_of(plant.volts_per_m, plant.stiffness_n_per_m, host, port, travel))
        run_ahead()
        # pymodbus shows the last bytes of every connection that ends as an error.
        logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
        asyncio.run(
            serve_t7(
                T7Model(instrument_of(config), noise_v=noise, m_per_v=travel),
                host,
                port,
                latency,
                lambda: typer.echo(f"the model of a LabJack T7 is at {host}:{port}; Ctrl-C ends it"),
            )
        )


def _boot() -> int:
    """Return the number of a session; 0 stands for none."""
    return int.from_bytes(os.urandom(2)) or 1
