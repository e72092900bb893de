"""`telenano device simulate t7`: the model of a LabJack T7, served from this terminal."""

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
    from telenano_devices.t7.t7_model import T7Model, calibration_of
    from telenano_devices.t7.t7_server import serve_t7

    write_document(calibration, calibration_of(behind.volts_per_m, behind.stiffness_n_per_m, *where))
    # pymodbus shows the last bytes of every connection that ends as an error.
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    return serve_t7(T7Model(driven, noise_v=1e-6), *where, 0.2e-3, on_ready)
