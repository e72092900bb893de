"""`telenano device simulate gwyscope` and `device guard gwyscope`."""

import asyncio
import time
from typing import Annotated

import typer

from telenano.cli import report_errors, run_ahead
from telenano_devices.controllers.command_options import (
    GuardedOption,
    HostOption,
    NoiseOption,
    ScenarioOption,
    WriteOption,
    run_guard,
    write_fitting,
)


def simulate_gwyscope(
    host: HostOption = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="TCP port.")] = 51000,
    scenario: ScenarioOption = None,
    tick: Annotated[
        float, typer.Option("--tick", min=1e-4, max=1.0, metavar="S", help="Tick of the server [s]; 0.5 ms is fine.")
    ] = 3e-3,
    noise: NoiseOption = 0.0,
    calibration: WriteOption = None,
) -> None:
    """Serve an emulated Gwyscope with stage and cantilever behind it. Ctrl-C ends it, with z at 0."""
    with report_errors(as_json=False, interrupted="the emulated Gwyscope has ended, with z at 0"):
        from telenano_devices.controllers.request_server import serve_requests
        from telenano_devices.controllers.simulated_instrument import simulated_afm
        from telenano_devices.gwyscope import gwyscope_model, gwyscope_wire

        afm = simulated_afm(scenario)
        model = gwyscope_model.GwyscopeModel(afm.driver, tick_s=tick, noise_v=noise, now_ns=time.monotonic_ns())
        write_fitting(calibration, gwyscope_model.calibration_of, afm, host, port)
        run_ahead()

        def respond(request: bytes, now_ns: int) -> bytes:
            return gwyscope_wire.encode(model.respond(gwyscope_wire.decode(request), now_ns))

        text = f"an emulated Gwyscope is at {host}:{port}, a sample every {tick * 1e3:g} ms; Ctrl-C ends it"
        serving = serve_requests(gwyscope_wire.cut, respond, model.pass_time, host, [port], lambda: typer.echo(text))
        try:
            asyncio.run(serving)
        finally:
            model.end()


def guard_gwyscope(
    calibration: GuardedOption,
    controller: Annotated[
        str, typer.Option("--controller", metavar="HOST:PORT", help="Address of the Gwyscope's server.")
    ] = "127.0.0.1:51000",
    host: Annotated[str, typer.Option("--host", metavar="ADDRESS", help="Address to listen at.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="TCP port for the rig.")] = 51001,
) -> None:
    """Stand between rig and Gwyscope, and retract the tip when the rig is silent. Ctrl-C ends it, retracted."""
    with report_errors(as_json=False):
        from telenano_devices.gwyscope.gwyscope_calibration import GwyscopeCalibration
        from telenano_devices.gwyscope.gwyscope_guard import GuardedGwyscope

        run_guard(GuardedGwyscope(GwyscopeCalibration.from_file(calibration)), controller, (host, port))
