"""`telenano device`: devices that take a force, by their vendors' services and libraries, and an emulated Inverse3."""

import asyncio
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli.commands.device_files import run_ahead, section_of
from telenano.cli.output import report_errors

KindOption = Annotated[
    str | None,
    typer.Option(
        "--device",
        metavar="DRIVER",
        help="haply: Inverse3; dhd: Force Dimension and Falcon; hd: Touch; simulated_impedance; or one of a package.",
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the device, such as haptic_node.haply.service."),
]
_SIMULATED = "simulated_impedance"
_WHAT = {"haply": "Haply Inverse3", "dhd": "Force Dimension, Novint Falcon", "hd": "3D Systems Touch"}
# the drivers of devices that take a force
DEVICES = (*_WHAT, _SIMULATED)


def known_devices() -> list[dict[str, Any]]:
    """Return the drivers of devices that take a force, and whether what they need is here."""
    from telenano.doctor.devices import check_impedance_devices

    found = {finding.name: finding for finding in check_impedance_devices()}
    rows = []
    for kind, what in _WHAT.items():
        finding = found[kind]
        rows.append({"driver": kind, "device": what, "found": finding.found, "advice": finding.advice})
    return rows


def probe_impedance(kind: str, settings: list[str]) -> dict[str, Any]:
    """Open a device without force and return what it declares, with the coupling and its two bounds."""
    from services.haptic_node.config import HapticConfig
    from services.haptic_node.devices.servo_process import wire_of
    from services.runtime.settings.config import flag_overrides, validate

    chosen = flag_overrides([f"haptic_node.driver={kind}", *settings])
    config = validate(HapticConfig, chosen.get("haptic_node", {}), "--set", "haptic_node")
    if kind == _SIMULATED:
        found = config.impedance.capabilities()
    else:
        wire = wire_of(kind, getattr(config, kind).model_dump())
        try:
            found = wire.open()
        finally:
            wire.close()
    bounds = config.coupling.bounds(found)
    return {
        "identity": found.identity,
        "max_force_n": found.max_force_n,
        "declared_stiffness_n_per_m": found.max_stiffness_n_per_m,
        "declared_damping_n_s_per_m": found.max_damping_n_s_per_m,
        "workspace_m": f"{found.workspace_min_m:g} to {found.workspace_max_m:g} towards the sample",
        "servo_rate_hz": found.rate_hz,
        "drive_delay_s": found.drive_delay_s,
        "buttons": ", ".join(found.buttons),
        "coupling": bounds.sentence(),
        "coupling_stiffness_n_per_m": bounds.stiffness_n_per_m,
        "passive_bound_n_per_m": bounds.passive_n_per_m,
        "stable_bound_n_per_m": bounds.stable_n_per_m,
    }


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
        bool, typer.Option("--person", help="A person goes through the motion of `device accept`, instead of the hand.")
    ] = False,
    mass: Annotated[
        float, typer.Option("--mass", min=0.0, max=5.0, metavar="KG", help="Mass that the person hangs at the handle.")
    ] = 0.0,
) -> None:
    """Run an emulated Inverse Service with an Inverse3, a VerseGrip and a hand on it. Ctrl-C ends it.

    A line on its input puts a fault in: pull, plug, freeze, thaw, nan, number, jump M, sign, late S, drive-late S,
    sleep, wake, press a, release a, lose-home, home. The hand is that of the scenario, and begins with the session;
    `push N`, `arm M` and `loose` put another one in its place.
    """
    with report_errors(as_json=False, interrupted="the emulated service has ended"):
        from services.haptic_node.acceptance.simulated_person import person as person_of
        from services.haptic_node.acceptance.take import steps_of
        from services.haptic_node.config import HapticConfig
        from services.haptic_node.devices.emulated_arm import INVERSE3, EmulatedArm
        from services.haptic_node.devices.haply import BUTTONS
        from services.haptic_node.devices.haply_service import HaplyService, serve_haply

        config = section_of(scenario, "haptic_node", HapticConfig)
        reach_m = (INVERSE3.radius_m,) * 3
        hand = person_of(reach_m, len(BUTTONS) * grip, 1, steps_of(mass), mass) if person else None
        service = HaplyService(EmulatedArm(INVERSE3, config.operator.to_params(), hand), device_id, grip)
        service.gate, service.damping = force_gate, damping
        run_ahead()

        async def serve() -> None:
            lines: asyncio.Queue[str] = asyncio.Queue()
            loop = asyncio.get_running_loop()

            begun = bytearray()

            def read() -> None:
                typed = whole_lines(sys.stdin.fileno(), begun)
                if typed is None:
                    loop.remove_reader(sys.stdin)
                for line in typed or ():
                    lines.put_nowait(line)

            # A file or the null device cannot be waited for, and gives no lines.
            if not sys.stdin.closed and (sys.stdin.isatty() or Path("/dev/stdin").is_fifo()):
                loop.add_reader(sys.stdin, read)
            await serve_haply(service, host, port, ready, lines, typer.echo)

        def ready(at: int) -> None:
            typer.echo(f"an emulated Inverse Service is at ws://{host}:{at}, with the Inverse3 {device_id}")
            typer.echo("Ctrl-C ends it; a line such as `pull`, `plug`, `freeze` or `late 0.1` puts a fault in")
            sys.stdout.flush()

        asyncio.run(serve())


def whole_lines(descriptor: int, begun: bytearray) -> list[str] | None:
    """Return every line that waits at a descriptor, None at its end; what is begun of another is kept in `begun`.

    A file object would give the first, keep the others, and nothing would be left to wait for.
    """
    data = os.read(descriptor, 65_536)
    begun += data
    *lines, rest = bytes(begun).split(b"\n")
    begun[:] = rest
    return [line.decode(errors="replace") for line in lines] if data else None
