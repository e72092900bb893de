"""The noise of a read-out that a simulated instrument states, for sessions in which the tip is never free."""

import math

from telenano.analysis.measured_noise import Noise
from telenano.sections.afm_section import AfmConfig

# octaves over which the 1/f noise of a read-out has its root mean square [1]: see `telenano.afm.disturbances`
_OCTAVES = 12
_BOLTZMANN_J_PER_K = 1.380649e-23


def stated_noise(section: AfmConfig, force_scale: float) -> Noise | None:
    """Return the noise of alpha_f F_s [N] that the section of a simulated instrument states; None if it does not.

    Vibration and the noise of a voltage move the tip, and are no noise of the read-out.
    """
    if section.driver != "simulated":
        return None
    known, cantilever = section.disturbances, section.cantilever
    volts_per_m = section.to_params().plant.volts_per_m
    white_m2 = flicker_m2 = 0.0
    if known.thermal.enabled:
        white_m2 += _BOLTZMANN_J_PER_K * known.thermal.temperature_k / cantilever.stiffness_n_per_m
    if known.readout.enabled:
        white_m2 += (known.readout.white_v / volts_per_m) ** 2
        flicker_m2 = (known.readout.flicker_v / volts_per_m) ** 2 / _OCTAVES
    scale = force_scale * cantilever.stiffness_n_per_m
    return Noise(scale * math.sqrt(white_m2), (scale * scale * flicker_m2,))
