"""`telenano device simulate nanonis`, `device guard nanonis` and `device approach`."""

import asyncio
import time
from collections.abc import Coroutine
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli import report_errors, run_ahead
from telenano_devices.controllers.command_options import (
    GuardedOption,
    HostOption,
    ScenarioOption,
    WriteOption,
    run_guard,
    write_fitting,
)


def simulate_nanonis(
    host: HostOption = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=1, max=65532, help="First of the four TCP ports.")] = 6501,
    log_port: Annotated[int, typer.Option("--log-port", min=1, max=65535, help="Port of the TCP Logger.")] = 6590,
    scenario: ScenarioOption = None,
    tap: Annotated[
        float, typer.Option("--tap", min=1e-3, max=10.0, metavar="S", help="Period in which values are published [s].")
    ] = 20e-3,
    calibration: WriteOption = None,
    t7: Annotated[
        Path | None,
        typer.Option(
            "--fast-path", metavar="FILE", help="Serve a T7 at its external input too, and write its calibration."
        ),
    ] = None,
    t7_port: Annotated[int, typer.Option("--fast-path-port", min=1, max=65535, help="TCP port of that T7.")] = 5020,
) -> None:
    """Serve an emulated Nanonis controller with stage and cantilever behind it. Ctrl-C ends it."""
    with report_errors(as_json=False, interrupted="the emulated Nanonis has ended"):
        from telenano_devices.controllers.request_server import PushedStream, serve_requests
        from telenano_devices.controllers.simulated_instrument import simulated_afm
        from telenano_devices.nanonis import nanonis_model, nanonis_wire

        afm = simulated_afm(scenario)
        model = nanonis_model.NanonisModel(afm.driver, tap_s=tap, now_ns=time.monotonic_ns())
        write_fitting(calibration, nanonis_model.calibration_of, afm, host, port)
        run_ahead()
        ports = [port + number for number in range(len(nanonis_model.PORTS))]
        text = (
            f"an emulated Nanonis is at {host}:{ports[0]} to {ports[-1]}, its TCP Logger at {log_port}, values every"
            f" {tap * 1e3:g} ms; Ctrl-C ends it"
        )
        pushed = PushedStream(log_port, model.log.take)
        serving = []
        if t7 is not None:
            from telenano_devices.t7.simulate_t7 import t7_in_front_of

            ready = f"a model of a LabJack T7 at its external input is at {host}:{t7_port}"
            part = nanonis_model.ExternalInput(model)
            serving.append(t7_in_front_of(part, t7, afm, (host, t7_port), lambda: typer.echo(ready)))
        # A port serves one client, as on the instrument.
        serving.append(
            serve_requests(
                nanonis_wire.cut, model.serve, model.pass_time, host, ports, lambda: typer.echo(text), 1, pushed
            )
        )
        asyncio.run(_all_of(serving))


async def _all_of(serving: "list[Coroutine[Any, Any, None]]") -> None:
    """Run the servers together; an error in one ends them all."""
    async with asyncio.TaskGroup() as group:
        for each in serving:
            group.create_task(each)


def approach_nanonis(
    calibration: Annotated[Path, typer.Option("--calibration", metavar="FILE", help="nanonis.yaml of the controller.")],
    setpoint: Annotated[
        float, typer.Option("--setpoint", metavar="X", help="Set-point, in the unit of the controller's signal.")
    ],
    lift: Annotated[
        float,
        typer.Option("--lift", min=0.0, max=1000.0, metavar="NM", help="Distance by which it then lifts the tip [nm]."),
    ] = 210.0,
) -> None:
    """Let a Nanonis controller approach, switch its z-controller off and lift the tip: for its external input."""
    with report_errors(as_json=False):
        from telenano_devices.nanonis.nanonis_calibration import NanonisCalibration
        from telenano_devices.nanonis.nanonis_client import NanonisClient, approach

        controller = NanonisCalibration.from_file(calibration)
        client = NanonisClient(controller.network.host, controller.network.port)
        try:
            z_m = approach(client, setpoint, lift * 1e-9)
        finally:
            client.close()
        typer.echo(f"the z-controller is off, and z = {z_m * 1e9:.4g} nm is {lift:g} nm above the surface")


def guard_nanonis(
    calibration: GuardedOption,
    controller: Annotated[
        str, typer.Option("--controller", metavar="HOST:PORT", help="One of the four ports of the controller.")
    ] = "127.0.0.1:6501",
    host: Annotated[str, typer.Option("--host", metavar="ADDRESS", help="Address to listen at.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="TCP port for the rig.")] = 6511,
) -> None:
    """Stand between rig and Nanonis, and withdraw the tip when the rig is silent. Ctrl-C ends it, withdrawn."""
    with report_errors(as_json=False):
        from telenano_devices.nanonis.nanonis_calibration import NanonisCalibration
        from telenano_devices.nanonis.nanonis_guard import GuardedNanonis

        run_guard(GuardedNanonis(NanonisCalibration.from_file(calibration)), controller, (host, port))
