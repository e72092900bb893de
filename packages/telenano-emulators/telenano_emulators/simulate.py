"""`telenano device simulate handle` and `t7`: emulated devices in this terminal."""

import asyncio
import logging
import math
import os
import select
import signal
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from telenano_afm_controllers.calibration_files import write_document
from telenano_afm_controllers.simulated_instrument import SimulatedAfm

from telenano.cli import report_errors, run_ahead, section_of

_STANDARD_GRAVITY_M_PER_S2 = 9.80665

WriteOption = Annotated[
    Path | None,
    typer.Option("--calibration", metavar="FILE", help="Write a calibration file that fits the emulated device."),
]


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
        from telenano.hand import HapticConfig
        from telenano_emulators import avr_board, emulated_handle
        from telenano_emulators.handle_on_pty import EmulatedBoard, HandleOnPty

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

        def continues() -> bool:
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
            port.run(continues)
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
        float, typer.Option("--travel", min=1e-3, max=1e6, metavar="NM/V", help="Travel of the stage [nm/V].")
    ] = 80.0,
    calibration: WriteOption = None,
) -> None:
    """Serve the model of a LabJack T7 with stage and cantilever behind it, over Modbus TCP. Ctrl-C ends it."""
    with report_errors(as_json=False, interrupted="the model of the T7 has ended"):
        from telenano.afm import AfmConfig
        from telenano_emulators.t7_model import T7Model, calibration_of, instrument_of
        from telenano_emulators.t7_server import serve_t7

        config = section_of(scenario, "afm_node", AfmConfig)
        if calibration is not None:
            plant = config.to_params().plant
            write_document(
                calibration, calibration_of(plant.volts_per_m, plant.stiffness_n_per_m, host, port, 1e-9 * travel)
            )
        run_ahead()
        # pymodbus shows the last bytes of every connection that ends as an error.
        logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
        asyncio.run(
            serve_t7(
                T7Model(instrument_of(config), noise_v=noise, m_per_v=1e-9 * travel),
                host,
                port,
                latency,
                lambda: typer.echo(f"the model of a LabJack T7 is at {host}:{port}; Ctrl-C ends it"),
            )
        )


def t7_in_front_of(
    driven: Any, calibration: Path, behind: SimulatedAfm, where: tuple[str, int], on_ready: Callable[[], None]
) -> Coroutine[Any, Any, None]:
    """Return what serves a model of a LabJack T7 whose output drives a part, and write its calibration file.

    Args:
        driven: What is driven, such as the external input of a controller; it has the shape of an instrument.
        calibration: The file to write.
        behind: The instrument behind it.
        where: The address and TCP port to serve on.
        on_ready: Called once the port is bound.
    """
    from telenano_emulators.t7_model import T7Model, calibration_of
    from telenano_emulators.t7_server import serve_t7

    write_document(calibration, calibration_of(behind.volts_per_m, behind.stiffness_n_per_m, *where))
    # pymodbus shows the last bytes of every connection that ends as an error.
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    return serve_t7(T7Model(driven, noise_v=1e-6), *where, 0.2e-3, on_ready)


def _boot() -> int:
    """Return the number of a session; 0 represents none."""
    return int.from_bytes(os.urandom(2)) or 1
