"""What stands behind an emulated AFM controller: a simulated instrument, and converters in front of it."""

import logging
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, NamedTuple

from services.afm_node.driver import AfmDriver
from telenano.cli.commands.device_files import section_of, write_document


class SimulatedAfm(NamedTuple):
    """A simulated instrument to stand behind an emulated controller, opened; it has the shape of `AfmDriver`."""

    driver: AfmDriver
    volts_per_m: float
    stiffness_n_per_m: float


def simulated_afm(scenario: Path | None = None) -> SimulatedAfm:
    """Return the simulated instrument of a scenario that is named or a file, or the default one.

    Raises:
        ConfigError: There is no such scenario, or a key of it cannot be used.
    """
    from services.afm_node.config import AfmConfig
    from services.afm_node.instrument import driver_of

    config = section_of(scenario, "afm_node", AfmConfig).model_copy(update={"driver": "simulated"})
    afm, plant = driver_of(config), config.to_params().plant
    afm.open()
    return SimulatedAfm(afm, plant.volts_per_m, plant.stiffness_n_per_m)


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
    from services.afm_node.devices.t7_model import T7Model, calibration_of
    from services.afm_node.devices.t7_server import serve_t7

    write_document(calibration, calibration_of(behind.volts_per_m, behind.stiffness_n_per_m, *where))
    # pymodbus shows the last bytes of every connection that ends as an error.
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    return serve_t7(T7Model(driven, noise_v=1e-6), *where, 0.2e-3, on_ready)
