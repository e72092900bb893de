"""`telenano device simulate t7`: serves the model of a LabJack T7 from this terminal."""

import asyncio
import logging
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli import report_errors, run_ahead, section_of
from telenano_devices.calibration_files import WriteOption, write_document
from telenano_devices.controllers.simulated_instrument import SimulatedAfm


def simulate_t7(
    host: Annotated[str, typer.Option("--host", metavar="ADDRESS", help="Address to serve on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="TCP port; 502 needs privileges.")] = 5020,
    scenario: Annotated[
        Path | None,
        typer.Option("--scenario", metavar="NAME|FILE", help="Scenario whose AFM is behind the converters."),
    ] = None,
    latency: Annotated[
        float,
        typer.Option("--latency", min=0.0, max=1.0, metavar="S", help="Time that the device takes for a request [s]."),
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
        from telenano.sections import AfmConfig
        from telenano_devices.t7.t7_model import T7Model, calibration_of, instrument_of
        from telenano_devices.t7.t7_server import serve_t7

        config = section_of(scenario, "afm_node", AfmConfig)
        if calibration is not None:
            plant = config.to_params().plant
            write_document(
                calibration, calibration_of(plant.volts_per_m, plant.stiffness_n_per_m, host, port, 1e-9 * travel)
            )
        run_ahead()
        # pymodbus would report the end of every connection as an error.
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
    """Return the coroutine that serves a model of a LabJack T7 in front of a plant, and write its calibration file.

    Args:
        driven: The plant that the output drives (`BridgePlant`), such as the external input of a controller.
        calibration: The file to write.
        behind: The instrument behind the plant, whose scales the calibration gets.
        where: The address and TCP port to serve on.
        on_ready: The function that is called once the port is bound.
    """
    from telenano_devices.t7.t7_model import T7Model, calibration_of
    from telenano_devices.t7.t7_server import serve_t7

    write_document(calibration, calibration_of(behind.volts_per_m, behind.stiffness_n_per_m, *where))
    # pymodbus would report the end of every connection as an error.
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    return serve_t7(T7Model(driven, noise_v=1e-6), *where, 0.2e-3, on_ready)
