"""Shared parts of the commands of AFM controllers: options, running a guard, and writing a calibration file."""

import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from telenano.cli import run_ahead
from telenano.wire import ConfigError

if TYPE_CHECKING:
    from telenano_devices.controllers.simulated_instrument import SimulatedAfm

HostOption = Annotated[str, typer.Option("--host", metavar="ADDRESS", help="Address to serve on.")]
ScenarioOption = Annotated[
    Path | None, typer.Option("--scenario", metavar="NAME|FILE", help="Scenario whose AFM is behind the controller.")
]
NoiseOption = Annotated[
    float, typer.Option("--noise", min=0.0, max=1.0, metavar="V", help="Noise of the deflection [V], one sigma.")
]
WriteOption = Annotated[
    Path | None, typer.Option("--calibration", metavar="FILE", help="Write a calibration file that fits the emulator.")
]
GuardedOption = Annotated[
    Path, typer.Option("--calibration", metavar="FILE", help="Calibration file of the controller; z of retraction.")
]


def run_guard(guarded: Any, controller: str, listen: tuple[str, int]) -> None:
    """Run a guard between a rig and a controller at HOST:PORT until a signal ends it.

    Raises:
        ConfigError: The controller is not given as HOST:PORT, or the guard cannot listen at its address.
    """
    from telenano_devices.controllers.retract_guard import RetractGuard

    name, _, number = controller.rpartition(":")
    if not (name and number.isdigit() and 0 < int(number) < 65536):
        raise ConfigError(f"--controller {controller}: must be HOST:PORT, such as 127.0.0.1:51000")
    try:
        made = RetractGuard(guarded, (name, int(number)), listen, typer.echo)
    except OSError as error:
        raise ConfigError(f"{listen[0]}:{listen[1]}: cannot be listened at: {error.strerror}") from error
    ended: list[int] = []
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, lambda found, frame: ended.append(found))
    run_ahead()
    typer.echo(
        f"the guard listens at {listen[0]}:{listen[1]} for {controller}: it retracts the tip after"
        f" {guarded.heartbeat_s * 1e3:.0f} ms without a request; Ctrl-C ends it"
    )
    made.run(lambda: not ended)
    typer.echo("the guard has ended" + (", and the tip was not retracted" if made.judge.driven else ", tip retracted"))


def write_fitting(
    path: Path | None, calibration_of: Callable[..., dict[str, object]], afm: "SimulatedAfm", host: str, port: int
) -> None:
    """Write the calibration file that fits an emulated controller; do nothing if path is None."""
    if path is not None:
        from telenano_devices.calibration_files import write_document

        write_document(path, calibration_of(afm.volts_per_m, afm.stiffness_n_per_m, host, port))
