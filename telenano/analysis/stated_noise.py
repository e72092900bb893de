"""The noise of a read-out that a simulated instrument states, for sessions in which the tip is never free."""

import math

from telenano.analysis.measured_noise import Noise
from telenano.sections.afm_section import AfmConfig


def stated_noise(section: AfmConfig, force_scale: float) -> Noise | None:
    """Return the noise of alpha_f F_s [N] that the section of a simulated instrument states; None if it does not.

    Vibration and the noise of a voltage move the tip, and are no noise of the read-out.
    """
    if section.driver != "simulated":
        return None
    # What only reads recordings of other instruments needs no model of the noise.
    from telenano.afm.disturbances import BOLTZMANN_J_PER_K, noise_start

    known, cantilever = section.disturbances, section.cantilever
    white_m2 = flicker_m2 = 0.0
    if known.thermal.enabled:
        white_m2 += BOLTZMANN_J_PER_K * known.thermal.temperature_k / cantilever.stiffness_n_per_m
    if known.readout.enabled:
        white_m2 += (known.readout.white_v / cantilever.volts_per_m) ** 2
        flicker_m2 = (known.readout.flicker_v / cantilever.volts_per_m) ** 2 / len(noise_start().flicker)
    scale = force_scale * cantilever.stiffness_n_per_m
    return Noise(scale * math.sqrt(white_m2), (scale * scale * flicker_m2,))
