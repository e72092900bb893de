"""The two calibrations of a laboratory, on the simulated instrument: sensitivity of the read-out, stiffness by noise.

*Sensitivity*: the tip is pressed onto a sample much harder than the spring, and the voltage is regressed on the
deflection (paper, under Eq. 3): S_c = 4 dV/dzeta / (V0 Gc). The deflection is the way of the base less what tip and
sample give way by, which the contact mechanics of both tells. Without that correction, as laboratories do it, S_c comes
out too small by the share of the way that the contact takes; both are returned.

*Stiffness*: the free cantilever shivers with <zeta^2> = k_B T / k (J. L. Hutter, J. Bechhoefer, Rev. Sci. Instrum. 64
(1993) 1868). White noise of the read-out would be counted too, so the resonance is fitted to the periodogram with a
floor, by Whittle's likelihood (`resonance`), and k follows from its mean square and not from the whole noise.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from services.afm_node.config import AfmConfig
from services.afm_node.physics.cantilever import deflection_m, equilibrium, initial_state
from services.afm_node.physics.disturbances import BOLTZMANN_J_PER_K
from services.afm_node.physics.disturbed import converted_v, converter_step_v
from services.afm_node.physics.dynamic import DynamicState, steady_state, thermal_motion
from services.afm_node.physics.dynamic_plant import KICKS_PER_PERIOD, DynamicPlant
from services.numerics.compiled import compiled_form
from telenano.extend.commands import ConfigError
from telenano_calibration.line_fit import regressed
from telenano_calibration.resonance import fit_resonance

Array = npt.NDArray[np.float64]

# the harder sample, and no water, which would hold the tip
_HARD = {"sample_modulus_pa": 1e12, "tip_modulus_pa": 1e12}
# one for each impulse of the noise
_SAMPLES_A_PERIOD = KICKS_PER_PERIOD
# in one compiled call, some 50 ms: a signal waits for its end
_CALL_SAMPLES = 200_000
# a shorter record has too few of the correlation times Q / pi f0 for its lines to be independent
_LEAST_PERIODS_A_Q = 128.0


class Sensitivity(NamedTuple):
    """S_c [1/m] with its standard error, the true one, points, and the noise of a point [V].

    uncorrected_per_m: the slope over the way of the base, as if nothing gave way [1/m]; contact_share: the share of the
    way that tip and sample take, by which that is too small.
    """

    sensitivity_per_m: float
    standard_error_per_m: float
    true_sensitivity_per_m: float
    points: int
    residual_v: float
    uncorrected_per_m: float
    contact_share: float

    def as_dict(self) -> dict[str, Any]:
        return self._asdict()


class ThermalStiffness(NamedTuple):
    """k [N/m] by the fitted resonance with its standard error, and by the whole noise; what was found on the way."""

    stiffness_n_per_m: float
    standard_error_n_per_m: float
    by_total_noise_n_per_m: float
    true_stiffness_n_per_m: float
    resonance_hz: float
    quality: float
    floor_m2_per_hz: float
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        return self._asdict()


def calibrate_sensitivity(
    config: AfmConfig, way_m: float = 20e-9, points: int = 200, noise_v: float = 1e-3, bits: int = 16, seed: int = 0
) -> Sensitivity:
    """Press onto a hard sample over way_m [m] and regress the voltage on the deflection.

    Parameters: noise_v, white, of a point [V]; bits of a converter from -10 to 10 V.
    """
    if not (points >= 3 and way_m > 0.0 and noise_v >= 0.0):
        raise ConfigError("a calibration needs three points or more, a way above 0 m and a noise of 0 V or more")
    # what is measured is far above what the force limit would allow
    load_n = 1.5 * config.cantilever.stiffness_n_per_m * way_m
    hard = config.model_dump() | {"meniscus": False}
    hard["tip_sample"] = hard["tip_sample"] | _HARD
    hard["safety"] = hard["safety"] | {"force_limit_n": max(config.safety.force_limit_n, load_n)}
    plant = AfmConfig.model_validate(_without_defaults(hard)).to_params().plant
    state = initial_state(plant, plant.rest_distance_m - 5e-9)
    first = plant.rest_distance_m + 1e-9
    ways = np.linspace(0.0, way_m, points)
    random = np.random.Generator(np.random.PCG64(seed))
    volts, bent_m, step_v = np.empty(points), np.empty(points), converter_step_v(bits, 10.0)
    for i, way in enumerate(ways.tolist()):
        state = equilibrium(plant, state, first + way)
        bent_m[i] = zeta = deflection_m(plant, state.distance_m, first + way)
        volts[i] = converted_v(plant.volts_per_m * zeta + noise_v * float(random.standard_normal()), step_v, 10.0)
    slope, error, scatter = regressed(bent_m, volts)
    c = config.cantilever
    factor = 4.0 / (c.bridge_supply_v * c.amplifier_gain)
    by_way = factor * regressed(ways, volts)[0]
    share = 1.0 - regressed(ways, bent_m)[0]
    return Sensitivity(factor * slope, factor * error, c.sensitivity_per_m, points, scatter, by_way, share)


def _without_defaults(document: dict[str, Any]) -> dict[str, Any]:
    """Return a configuration as a person would write it: two ways to say one thing are not both in it."""
    tip = {key: value for key, value in document["tip_sample"].items() if value is not None}
    if "relative_humidity" in tip:
        tip.pop("meniscus_radius_m", None)
    return document | {"tip_sample": tip}


def _shiver(plant: DynamicPlant, state: DynamicState, random: np.random.Generator, out: Array) -> DynamicState:
    """Fill `out` with the deflection [m] that thermal noise gives at each sample; return the state after it."""
    motion = compiled_form(thermal_motion)
    for first in range(0, len(out), _CALL_SAMPLES):
        part = out[first : first + _CALL_SAMPLES]
        state = motion(plant, state, random.standard_normal(2 * len(part)), part)
    return state


def calibrate_stiffness(
    config: AfmConfig,
    seconds: float = 0.2,
    temperature_k: float = 300.0,
    floor_m_per_root_hz: float = 0.0,
    seed: int = 0,
) -> ThermalStiffness:
    """Let the free cantilever shiver for a time [s] and find its stiffness from its noise.

    Parameters: floor_m_per_root_hz, white noise of the read-out [m/sqrt(Hz)].
    Raises: ConfigError, if the time is too short for its resonance, or the fit ends at a bound, which it names.
    """
    try:
        plant = config.to_dynamic(temperature_k=temperature_k)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    f0, q = config.cantilever.resonance_hz, config.cantilever.quality
    rate = f0 * _SAMPLES_A_PERIOD
    count = round(seconds * rate)
    least = math.ceil(_LEAST_PERIODS_A_Q * q * _SAMPLES_A_PERIOD)
    if count < least:
        raise ConfigError(f"{seconds:g} s are too short: a resonance with Q = {q:g} needs {least / rate:.3g} s")
    random = np.random.Generator(np.random.PCG64(seed))
    state = steady_state(plant, -1e-6, 0.0)
    settling = np.empty(least // 4)
    state = _shiver(plant, state, random, settling)
    zeta = np.empty(count)
    _shiver(plant, state, random, zeta)
    zeta -= zeta.mean()
    zeta += floor_m_per_root_hz * math.sqrt(0.5 * rate) * random.standard_normal(len(zeta))
    try:
        found = fit_resonance(zeta, rate, f0, q)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    energy = BOLTZMANN_J_PER_K * temperature_k
    k = energy / found.mean_square_m2
    return ThermalStiffness(
        k,
        k * found.share,
        energy / float(np.mean(zeta**2)),
        config.cantilever.stiffness_n_per_m,
        found.resonance_hz,
        found.quality,
        found.floor_m2_per_hz,
        len(zeta) / rate,
    )
