"""`telenano device calibrate`: measures a handle at gauges and with masses, or a stage, step by step."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from telenano.cli import command_group, report_errors
from telenano.wire import ConfigError
from telenano_devices.calibration_files import write_document
from telenano_devices.t7.stage_command import calibrate_stage

app = command_group()
app.command("stage")(calibrate_stage)


@app.command("handle")
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
        float, typer.Option("--max-force", min=1e-6, metavar="N", help="Greatest force that the drive may give [N].")
    ],
    saturation: Annotated[
        float, typer.Option("--saturation", min=1e-6, metavar="N", help="Force at which the sensor saturates [N].")
    ],
    baud: Annotated[
        int, typer.Option("--baud", min=115_200, metavar="N", help="Baud rate of the serial port [bit/s].")
    ] = 1_000_000,
    duration: Annotated[
        float, typer.Option("--duration", min=0.2, metavar="S", help="Duration of each point [s].")
    ] = 1.0,
) -> None:
    """Measure a handle at gauges and with masses, step by step, and write its calibration file; it is never driven.

    A point off the line by more than 2 % is refused.
    """
    with report_errors(as_json=False):
        from telenano.devices import SerialHandle
        from telenano.sections import LimitsConfig
        from telenano_devices.handle.handle_calibration import STANDARD_GRAVITY_M_PER_S2, RawPoint, sample_raw
        from telenano_devices.line_fit import fit_line

        handle = SerialHandle(port, baud, None, LimitsConfig())
        points: list[RawPoint] = []
        for text in [*(f"put the arm at {x:g} m" for x in gauges), *(f"let {m:g} kg pull at the arm" for m in masses)]:
            typer.prompt(f"{text}, hands off, then Enter", default="", show_default=False)
            points.append(sample_raw(handle, duration))
        placed, loaded = points[: len(gauges)], points[len(gauges) :]
        position = fit_line("position", [p.position for p in placed], [p.position_error for p in placed], gauges)
        forces = [mass * STANDARD_GRAVITY_M_PER_S2 for mass in masses]
        force = fit_line("force", [p.force for p in loaded], [p.force_error for p in loaded], forces)
        if (hello := handle.hello) is None:
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
    from telenano.devices import HandleCalibration
    from telenano.settings import validate

    validate(HandleCalibration, document, str(path))
    write_document(path, document)
