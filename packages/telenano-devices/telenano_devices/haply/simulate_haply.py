"""`telenano device simulate haply`: runs an emulated Inverse Service."""

import asyncio
import sys
from pathlib import Path
from typing import Annotated

import typer

from telenano.cli import report_errors, run_ahead


def simulate_haply(
    host: Annotated[str, typer.Option("--host", metavar="ADDRESS", help="Address to serve on.")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, help="Port of the emulated service; 0: any that is free.")
    ] = 10_001,
    scenario: Annotated[
        Path | None, typer.Option("--scenario", metavar="NAME|FILE", help="Scenario whose hand holds the device.")
    ] = None,
    device_id: Annotated[str, typer.Option("--device-id", metavar="ID", help="Id of the Inverse3.")] = "049D",
    grip: Annotated[bool, typer.Option("--grip/--no-grip", help="Whether there is a wireless VerseGrip.")] = True,
    force_gate: Annotated[
        float, typer.Option("--force-gate", min=0.0, max=1.0, help="Gain of the force gate at the start.")
    ] = 0.3,
    damping: Annotated[
        float, typer.Option("--damping", min=0.0, max=100.0, metavar="N S/M", help="Damper at the start [N s/m].")
    ] = 0.0,
    person: Annotated[
        bool,
        typer.Option(
            "--person", help="Simulate a person who goes through the motion of `device accept`, instead of the hand."
        ),
    ] = False,
    mass: Annotated[
        float, typer.Option("--mass", min=0.0, max=5.0, metavar="KG", help="Mass that the person hangs at the handle.")
    ] = 0.0,
) -> None:
    """Run an emulated Inverse Service with an Inverse3, a VerseGrip and a hand on it. Ctrl-C ends it.

    A line on its input injects a fault: pull, plug, freeze, thaw, nan, number, jump M, sign, late S, drive-late S,
    sleep, wake, press a, release a, lose-home, home. The hand is that of the scenario, and begins with the session;
    `push N`, `arm M` and `loose` replace it by another one.
    """
    with report_errors(as_json=False, interrupted="the emulated service has ended"):
        from telenano_devices.haply.haply import ARM
        from telenano_devices.haply.haply_messages import BUTTONS
        from telenano_devices.haply.haply_service import HaplyService, serve_haply
        from telenano_devices.impedance.emulated_arm import RADIUS_M, EmulatedArm, hand_of
        from telenano_devices.impedance.emulated_service import typed_lines

        hand = None
        if person:
            from telenano_devices.acceptance.haptic_device.person import person as person_of
            from telenano_devices.acceptance.haptic_device.take import steps_of

            hand = person_of((RADIUS_M,) * 3, len(BUTTONS) * grip, 1, steps_of(mass), mass)
        operator = hand_of(scenario)
        service = HaplyService(EmulatedArm(operator, ARM, hand), device_id, grip)
        service.gate, service.damping = force_gate, damping
        run_ahead()

        async def serve() -> None:
            lines = typed_lines()
            await serve_haply(service, host, port, ready, lines, typer.echo)

        def ready(at: int) -> None:
            typer.echo(f"an emulated Inverse Service is at ws://{host}:{at}, with the Inverse3 {device_id}")
            typer.echo("Ctrl-C ends it; a line such as `pull`, `plug`, `freeze` or `late 0.1` puts a fault in")
            sys.stdout.flush()

        asyncio.run(serve())
