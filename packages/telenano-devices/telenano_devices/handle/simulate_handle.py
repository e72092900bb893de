"""`telenano device simulate handle`: runs an emulated handle in this terminal."""

import math
import os
import select
import signal
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from telenano.cli import report_errors, run_ahead, section_of
from telenano_devices.calibration_files import WriteOption, write_document

_STANDARD_GRAVITY_M_PER_S2 = 9.80665


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

    SIGUSR1, or the Enter key, unplugs the cable, and plugs it in again; SIGUSR2 resets the board. For a calibration,
    `gauge M` puts the arm at a position [m] and `mass KG` hangs a mass at its sensor [kg].
    """
    with report_errors(as_json=False, interrupted="the emulated handle has ended"):
        from telenano.sections import HapticConfig
        from telenano_devices.handle import avr_board, emulated_handle
        from telenano_devices.handle.handle_on_pty import EmulatedBoard, HandleOnPty

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
    """Apply a typed line (gauge or mass) to an emulated handle, and return a sentence about it or the usage."""
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


def _boot() -> int:
    """Return a random session number, which is not 0, because 0 means none."""
    return int.from_bytes(os.urandom(2)) or 1
