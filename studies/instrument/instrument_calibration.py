"""The two calibrations of a laboratory, on the simulated instrument: sensitivity of the read-out, stiffness by noise.

*Sensitivity*: the tip is pressed onto a sample much harder than the spring, so that the base's way is the deflection,
and the voltage is regressed on it (paper, under Eq. 3): S_c = 4 dV/dzeta / (V0 Gc).

*Stiffness*: the free cantilever shivers with <zeta^2> = k_B T / k (J. L. Hutter, J. Bechhoefer, Rev. Sci. Instrum. 64
(1993) 1868). White noise of the read-out would be counted too, so a resonance is fitted to the spectrum, with a floor,

    S(f) = S_w + P f0^4 / ((f^2 - f0^2)^2 + (f f0 / Q)^2),    <zeta^2> = pi/2 f0 Q P,

and k follows from its area with the Q that was found, and not from the whole noise.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from proto.errors import ConfigError
from services.afm_node.config import AfmConfig
from services.afm_node.physics.cantilever import deflection_m, equilibrium, initial_state
from services.afm_node.physics.disturbances import BOLTZMANN_J_PER_K
from services.afm_node.physics.disturbed import converted_v, converter_step_v
from services.afm_node.physics.dynamic import KICKS_PER_PERIOD, DynamicPlant, DynamicState, advance, steady_state
from services.numerics.compiled import compiled, compiled_form

Array = npt.NDArray[np.float64]

# the harder sample, and no water, which would hold the tip
_HARD = {"sample_modulus_pa": 1e12, "tip_modulus_pa": 1e12}
# one for each impulse of the noise
_SAMPLES_A_PERIOD = KICKS_PER_PERIOD
# in one compiled call, some 50 ms: a signal waits for its end
_CALL_SAMPLES = 200_000
# times that the scatter of a spectrum is taken from its fit
_REWEIGHTED = 4


class Sensitivity(NamedTuple):
    """S_c [1/m] with its standard error, the true one, points, and the noise of a point [V]."""

    sensitivity_per_m: float
    standard_error_per_m: float
    true_sensitivity_per_m: float
    points: int
    residual_v: float

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
    """Press onto a hard sample over way_m [m] and regress the voltage on the way of the base.

    Parameters: noise_v, white, of a point [V]; bits of a converter from -10 to 10 V. The sample takes a small part of
    the way, which makes the value a little too small, as in a laboratory.
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
    volts, step_v = np.empty(points), converter_step_v(bits, 10.0)
    for i, way in enumerate(ways.tolist()):
        state = equilibrium(plant, state, first + way)
        zeta = deflection_m(plant, state.distance_m, first + way)
        volts[i] = converted_v(plant.volts_per_m * zeta + noise_v * float(random.standard_normal()), step_v, 10.0)
    x = ways - ways.mean()
    slope = float((x * volts).sum() / (x * x).sum())
    residual = volts - volts.mean() - slope * x
    scatter = math.sqrt(float((residual**2).sum()) / (points - 2))
    c = config.cantilever
    factor = 4.0 / (c.bridge_supply_v * c.amplifier_gain)
    error = scatter / math.sqrt(float((x * x).sum()))
    return Sensitivity(factor * slope, factor * error, c.sensitivity_per_m, points, scatter)


def _without_defaults(document: dict[str, Any]) -> dict[str, Any]:
    """Return a configuration as a person would write it: two ways to say one thing are not both in it."""
    tip = {key: value for key, value in document["tip_sample"].items() if value is not None}
    if "relative_humidity" in tip:
        tip.pop("meniscus_radius_m", None)
    return document | {"tip_sample": tip}


@compiled
def _thermal_motion(plant: DynamicPlant, state: DynamicState, normals: Array, out: Array) -> DynamicState:
    steps = plant.drive.shape[0] // KICKS_PER_PERIOD
    for i in range(out.shape[0]):
        state, _ = advance(plant, state, state.base_m, 0.0, 0.0, steps, normals[2 * i : 2 * i + 2])
        out[i] = state.deflection_m
    return state


def _shiver(plant: DynamicPlant, state: DynamicState, random: np.random.Generator, out: Array) -> DynamicState:
    """Fill `out` with the deflection [m] that thermal noise gives at each sample; return the state after it."""
    thermal_motion = compiled_form(_thermal_motion)
    for first in range(0, len(out), _CALL_SAMPLES):
        part = out[first : first + _CALL_SAMPLES]
        state = thermal_motion(plant, state, random.standard_normal(2 * len(part)), part)
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
    Raises: ConfigError, if the time is too short for its resonance.
    """
    from scipy.optimize import curve_fit

    try:
        plant = config.to_dynamic(temperature_k=temperature_k)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    f0, q = config.cantilever.resonance_hz, config.cantilever.quality
    rate = f0 * _SAMPLES_A_PERIOD
    count = round(seconds * rate)
    # a spectrum of enough means, whose lines are narrower than the resonance
    length = 2 ** math.ceil(math.log2(16.0 * q * _SAMPLES_A_PERIOD))
    means = count // length
    if means < 8:
        raise ConfigError(f"{seconds:g} s are too short: a resonance with Q = {q:g} needs {8 * length / rate:.3g} s")
    random = np.random.Generator(np.random.PCG64(seed))
    state = steady_state(plant, -1e-6, 0.0)
    settling = np.empty(length * 2)
    state = _shiver(plant, state, random, settling)
    zeta = np.empty(means * length)
    _shiver(plant, state, random, zeta)
    zeta -= zeta.mean()
    zeta += floor_m_per_root_hz * math.sqrt(0.5 * rate) * random.standard_normal(len(zeta))
    frequencies, density = _spectrum(zeta, rate, length)
    near = (frequencies > 0.5 * f0) & (frequencies < 1.5 * f0)
    scale = float(density[near].max())

    def resonance(f: Array, floor: float, peak: float, centre: float, quality: float) -> Array:
        lorentz = centre**4 / ((f**2 - centre**2) ** 2 + (f * centre / quality) ** 2)
        return np.asarray(floor + peak * lorentz / quality**2)

    found: Array = np.array([1e-3, 1.0, frequencies[near][np.argmax(density[near])], 0.7 * q])
    covariance: Array = np.zeros((4, 4))
    expected = density[near] / scale
    for _ in range(_REWEIGHTED):
        # the scatter of a density is a share of what is expected there, not of what was found: points that happen to be
        # low would count for more, and of 14 means the stiffness come out 15 % too great
        found, covariance = curve_fit(
            resonance, frequencies[near], density[near] / scale, p0=found,
            sigma=np.maximum(expected, 1e-3) / math.sqrt(means), absolute_sigma=True,
            bounds=([0.0, 0.0, 0.5 * f0, 0.5], [10.0, 100.0, 1.5 * f0, 1e7]),
        )  # fmt: skip
        expected = resonance(frequencies[near], *found)
    floor, peak, centre, quality = (float(value) for value in found)
    area = 0.5 * math.pi * centre * peak / quality * scale
    # of peak over Q, whose errors go together
    gradient = np.array([0.0, 1.0 / peak, 1.0 / centre, -1.0 / quality])
    share = math.sqrt(max(float(gradient @ covariance @ gradient), 0.0))
    energy = BOLTZMANN_J_PER_K * temperature_k
    return ThermalStiffness(
        energy / area,
        energy / area * share,
        energy / float(np.mean(zeta**2)),
        config.cantilever.stiffness_n_per_m,
        centre,
        quality,
        floor * scale,
        len(zeta) / rate,
    )


def _spectrum(values: Array, rate_hz: float, length: int) -> tuple[Array, Array]:
    """Return frequencies [Hz] and one-sided density, the mean over pieces of a length with a Hann window."""
    window = np.hanning(length)
    pieces = values.reshape(-1, length)
    power = np.mean(np.abs(np.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2, axis=0)
    frequencies = np.asarray(np.fft.rfftfreq(length, 1.0 / rate_hz), dtype=np.float64)
    return frequencies, np.asarray(2.0 * power / (rate_hz * float((window**2).sum())), dtype=np.float64)
