"""The simulated instrument behind an emulated AFM controller."""

from pathlib import Path
from typing import NamedTuple

from telenano.cli import section_of
from telenano.extend.instruments import AfmDriver


class SimulatedAfm(NamedTuple):
    """An open simulated instrument for an emulated controller, with read-out gain [V/m] and stiffness [N/m]."""

    driver: AfmDriver
    volts_per_m: float
    stiffness_n_per_m: float


def simulated_afm(scenario: Path | None = None) -> SimulatedAfm:
    """Return the opened simulated instrument of a scenario (a name or a file), or the default one.

    with contextlib.closing(simulated_afm(Path("image")).driver) as afm: ...

    Raises:
        ConfigError: There is no such scenario, or a key of it cannot be used.
    """
    from telenano.devices import driver_of
    from telenano.sections import AfmConfig

    config = section_of(scenario, "afm_node", AfmConfig).model_copy(update={"driver": "simulated"})
    afm, plant = driver_of(config), config.to_params().plant
    afm.open()
    return SimulatedAfm(afm, plant.volts_per_m, plant.stiffness_n_per_m)
