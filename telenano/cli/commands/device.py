"""`telenano device`: the devices that are there, and emulated ones to try without."""

import asyncio
import logging
import math
import os
import select
import signal
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from presets.plugins import installed
from proto.errors import ConfigError
from proto.extras import how_to_install
from telenano.cli.commands.device_files import run_ahead, section_of, write_document
from telenano.cli.options import JsonOption, command_group
from telenano.cli.output import print_json, print_rows, report_errors

app = command_group()
simulate = command_group()
guard = command_group()
app.add_typer(simulate, name="simulate", help="Run an emulated device in this terminal.")
app.add_typer(guard, name="guard", help="Retract the tip of an AFM controller when the rig is silent.")

_BY_ID = Path("/dev/serial/by-id")
_STANDARD_GRAVITY_M_PER_S2 = 9.80665

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


def package_rows() -> list[dict[str, Any]]:
    """Return the drivers that installed packages bring, and whether what each needs is here.

    That is what a check of `telenano doctor` with the name of the driver found.
    """
    from services.afm_node.config import DRIVERS as INSTRUMENTS
    from services.haptic_node.config import DRIVERS as HANDLES
    from telenano.doctor.report import checks_of_packages

    handles, instruments = HANDLES.all(), INSTRUMENTS.all()
    found, problems = {**handles.found, **instruments.found}, {**handles.problems, **instruments.problems}
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
    handle.load(value * _STANDARD_GRAVITY_M_PER_S2)
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
