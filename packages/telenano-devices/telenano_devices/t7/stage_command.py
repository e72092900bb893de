"""`telenano device calibrate stage`: measures an instrument behind converters, step by step."""

import threading
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli import report_errors
from telenano.wire import ConfigError
from telenano_devices.calibration_files import write_document

_PERIOD_S = 1e-3


def calibrate_stage(
    host: Annotated[str, typer.Option("--host", metavar="ADDRESS", help="Address of the instrument.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Calibration file to write.")],
    outputs: Annotated[
        list[float], typer.Option("--output", metavar="V", help="Voltage at which the gauge is read [V] (repeat).")
    ],
    range_v: Annotated[
        float, typer.Option("--range", min=1e-3, max=100.0, metavar="V", help="Range of the input, plus and minus [V].")
    ],
    stiffness: Annotated[
        float, typer.Option("--stiffness", min=1e-3, metavar="N/M", help="Spring constant of the cantilever [N/m].")
    ],
    stiffness_error: Annotated[
        float,
        typer.Option("--stiffness-error", min=0.0, metavar="N/M", help="Standard error of the spring constant [N/m]."),
    ],
    rest: Annotated[float, typer.Option("--rest", metavar="V", help="Voltage at x_s = 0, near the sample [V].")] = 2.5,
    serial: Annotated[
        int | None, typer.Option("--serial", min=0, metavar="N", help="Serial number on the device's label.")
    ] = None,
    registers: Annotated[str, typer.Option("--map", metavar="NAME", help="Register map: t7, t8, or a file.")] = "t7",
    port: Annotated[int, typer.Option("--port", min=1, max=65535, metavar="N", help="TCP port.")] = 502,
    dac: Annotated[int, typer.Option("--dac", min=0, metavar="N", help="Channel of the output.")] = 0,
    channel: Annotated[int, typer.Option("--channel", min=0, metavar="N", help="Channel of the input.")] = 0,
    max_v: Annotated[float, typer.Option("--max", metavar="V", help="Greatest voltage of the output [V].")] = 5.0,
    slew: Annotated[
        float, typer.Option("--slew", min=1e-3, metavar="V/S", help="Fastest change of the output [V/s].")
    ] = 25.0,
    step: Annotated[float, typer.Option("--step", min=1e-6, metavar="V", help="Step while pressing [V].")] = 0.01,
    press_nm: Annotated[
        float, typer.Option("--press", min=1e-3, max=1e5, metavar="NM", help="Distance to press after touch [nm].")
    ] = 10.0,
) -> None:
    """Measure a stage with a gauge, press on a hard sample, and write the calibration file; the tip ends retracted.

    Lift the tip off for the gauge. The file has standard errors; a point off its line by more than 2 % is refused.
    """
    with report_errors(as_json=False):
        document: dict[str, Any] = {
            "schema": 1,
            "instrument": {"map": registers, "serial": serial},
            "calibrated": datetime.now(UTC).replace(microsecond=0),
            "network": {"host": host, "port": port},
            "stage": {
                "dac": dac,
                # The scale is not known yet: until the gauge is read, 1 um stands for 1 V.
                "m_per_v": 1e-6,
                "rest_v": rest,
                "retract_v": 0.0,
                "min_v": 0.0,
                "max_v": max_v,
                "slew_v_per_s": slew,
            },
            "deflection": {
                "channel": channel,
                "range_v": range_v,
                "resolution_index": 1,
                "zero_v": 0.0,
                "v_per_m": 1e6,
            },
            "cantilever": {"stiffness_n_per_m": stiffness, "standard_error_n_per_m": stiffness_error},
        }
        _measure_travel(document, outputs)
        _measure_deflection(document, step, 1e-9 * press_nm)
        write_document(out, document)


def _measure_travel(document: dict[str, Any], outputs: list[float]) -> None:
    from telenano_devices.t7.stage_calibration import fit_travel

    if len(outputs) < 2:
        raise ConfigError("give --output twice or more: the travel is the slope between readings of the gauge")
    driver, mover, _ = _opened(document)
    found_v: list[float] = []
    gauges_m: list[float] = []
    try:
        # After it was opened, a driver stays retracted until it is once commanded to be retracted.
        mover.settle(document["stage"]["retract_v"])
        _ask(mover, document["stage"]["retract_v"], "lift the tip off the sample and set up the gauge, then Enter", "")
        for output_v in outputs:
            mover.settle(output_v)
            text = f"{mover.output_v:.4f} V: what does the gauge read, towards the sample [nm]"
            gauges_m.append(_metres(_ask(mover, output_v, text, None)))
            found_v.append(mover.output_v)
    finally:
        driver.close()
    fit = fit_travel(found_v, gauges_m, driver.registers.output_step_v)
    document["stage"].update(m_per_v=fit.scale, standard_error_m_per_v=fit.scale_error)
    typer.echo(f"travel: {fit.scale:.4g} m/V, standard error {fit.scale_error:.2g}")


def _measure_deflection(document: dict[str, Any], step_v: float, press_m: float) -> None:
    from telenano_devices.t7.stage_calibration import press

    driver, mover, calibration = _opened(document)
    try:
        _ask(mover, calibration.stage.retract_v, "approach a hard sample (mica, silicon, sapphire), then Enter", "")
        slope = press(mover, calibration, step_v, press_m)
    finally:
        driver.close()
    document["deflection"].update(
        zero_v=slope.zero_v, v_per_m=slope.v_per_m, standard_error_v_per_m=slope.standard_error_v_per_m
    )
    typer.echo(
        f"deflection: {slope.v_per_m:.4g} V/m, standard error {slope.standard_error_v_per_m:.2g}, {slope.points} points"
    )


def _metres(text: str) -> float:
    try:
        return 1e-9 * float(text)
    except ValueError as error:
        raise ConfigError(f"{text!r} is not a reading of a gauge: give nanometres, such as 160") from error


def _opened(document: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Return an open driver, its mover, and the provisional calibration of both."""
    from telenano.devices import InstrumentCalibration, ModbusAfm
    from telenano.sections import AfmConfig
    from telenano.settings import validate
    from telenano_devices.t7.stage_calibration import Mover

    calibration = validate(InstrumentCalibration, document, "the options")
    stage = calibration.stage
    limits = (
        AfmConfig()
        .to_params()
        .safety._replace(
            base_min_m=calibration.base_m(stage.min_v),
            base_max_m=calibration.base_m(stage.max_v),
            retract_position_m=calibration.base_m(stage.retract_v),
        )
    )
    driver = ModbusAfm.of(calibration, limits)
    driver.open()
    return driver, Mover(driver, calibration, lambda: time.sleep(_PERIOD_S)), calibration


def _ask(mover: Any, output_v: float, text: str, default: str | None) -> str:
    """Return a person's answer, holding the output at output_v [V] meanwhile: without requests it would retract."""
    answers: list[str | Exception] = []

    def ask() -> None:
        try:
            answers.append(str(typer.prompt(text, default=default, show_default=False)))
        except (typer.Abort, EOFError, OSError, ValueError) as error:
            answers.append(error)

    # The thread is a daemon, because Ctrl-C must retract and end the program while the prompt waits.
    threading.Thread(target=ask, daemon=True).start()
    while not answers:
        mover.hold(output_v)
    answer = answers[0]
    if isinstance(answer, Exception):
        raise answer
    return answer
