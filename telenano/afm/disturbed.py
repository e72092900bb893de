"""The disturbed instrument: a part around another, with a piezo that lags and creeps and a read-out with its noise.

    x_piezo = x + hysteresis(x) + creep(x) + drift + vibration
    zeta    = converter(zeta(x_piezo) + thermal + (white + 1/f) / gain of the read-out)

What is reported of the base is what it was sent to: an open-loop piezo knows no better. The noise is an input
(`disturbances`): a node draws it as it goes, and `NoisyParams` has that of a whole run in lockstep.
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.afm.cantilever import Plant
from telenano.afm.disturbances import (
    CreepConfig,
    DisturbanceConfig,
    HysteresisConfig,
    Noise,
    ReadoutConfig,
    noise_start,
    noise_step,
)
from telenano.afm.part import AfmSample, Part, PlantInputs, part_start, part_step, register_part
from telenano.numerics.compiler import compiled

Array = npt.NDArray[np.float64]

# play operators of the hysteresis, and lags of the creep
_PLAYS = 8
_LAGS_S = (0.1, 1.0, 10.0, 100.0)
# the noise of a run in lockstep has a value a millisecond, as that of a node has
_NOISE_STEP_S = 1e-3


class PiezoParams(NamedTuple):
    """Plays r_i [m] and the weight of each; lags [s] and the share of each. What is switched off has none."""

    play_radii_m: Array
    play_weight: float
    lags_s: Array
    lag_share: float


class PiezoState(NamedTuple):
    """Plays p_i and lags [m], which a step leaves alone where they are switched off."""

    plays_m: Array
    lags_m: Array


class ConverterParams(NamedTuple):
    """A step of the converter [V], 0 without one; it reads from -range_v to range_v; gain before it [V/m]."""

    step_v: float
    range_v: float
    volts_per_m: float


class DisturbedParams(NamedTuple):
    """The part that is disturbed, the piezo that moves it, the stiffness of its cantilever [N/m], and the converter."""

    tip: Any
    piezo: PiezoParams
    stiffness_n_per_m: float
    converter: ConverterParams


class DisturbedState(NamedTuple):
    """Of the part that is disturbed, and of the piezo."""

    tip: Any
    piezo: PiezoState


@lru_cache(maxsize=8)
def piezo_params(hysteresis: HysteresisConfig, creep: CreepConfig) -> PiezoParams:
    """Return the constants of a piezo. Of the plays all have turned round by the middle of the range."""
    radii = [0.25 * hysteresis.range_m * (i + 0.5) / _PLAYS for i in range(_PLAYS)] if hysteresis.enabled else []
    return PiezoParams(
        np.array(radii, np.float64),
        4.0 * hysteresis.share / _PLAYS,
        np.array(_LAGS_S if creep.enabled else (), np.float64),
        creep.share_per_decade,
    )


def converter_params(config: ReadoutConfig, volts_per_m: float) -> ConverterParams:
    """Return the constants of a converter behind a gain [V/m]."""
    step_v = converter_step_v(config.converter_bits, config.converter_range_v) if config.enabled else 0.0
    return ConverterParams(step_v, config.converter_range_v, volts_per_m)


def disturbed_params(config: DisturbanceConfig, tip: Any, cantilever: Plant) -> DisturbedParams:
    """Return the constants of a part, tip, with this cantilever and these disturbances."""
    return DisturbedParams(
        tip,
        piezo_params(config.hysteresis, config.creep),
        cantilever.stiffness_n_per_m,
        converter_params(config.readout, cantilever.volts_per_m),
    )


def piezo_at_rest(base_m: float) -> PiezoState:
    """Return the state of a piezo that has been at base_m [m] for long."""
    return PiezoState(np.full(_PLAYS, base_m), np.full(len(_LAGS_S), base_m))


@compiled
def piezo_step(params: PiezoParams, state: PiezoState, base_m: float, dt: float) -> tuple[PiezoState, float]:
    """Return where the piezo really is [m] when it was sent to base_m [m], dt [s] after the last step."""
    plays, lags, x = state.plays_m, state.lags_m, base_m
    radii, lags_s = params.play_radii_m, params.lags_s
    if len(radii) > 0:
        plays = np.minimum(np.maximum(plays, base_m - radii), base_m + radii)
        apart = 0.0
        for i in range(len(plays)):
            apart += plays[i] - base_m
        x += params.play_weight * apart
    if len(lags_s) > 0:
        lags = lags.copy()
        behind = 0.0
        for i in range(len(lags)):
            lags[i] += (base_m - lags[i]) * (1.0 - math.exp(-dt / lags_s[i]))
            behind += lags[i] - base_m
        x += params.lag_share * behind
    return PiezoState(plays, lags), float(x)


def converter_step_v(bits: int, range_v: float) -> float:
    """Return a step [V] of a converter of so many bits from -range_v to range_v."""
    return 2.0 * range_v / float(1 << bits)


@compiled
def converted_v(volts: float, step_v: float, range_v: float) -> float:
    """Return what a converter makes of a voltage [V] between -range_v and range_v.

    >>> converted_v(0.3, 0.125, 1.0), converted_v(7.0, 0.125, 1.0)
    (0.25, 0.875)
    """
    return min(max(round(volts / step_v) * step_v, -range_v), range_v - step_v)


@compiled
def read_out(params: ConverterParams, noise: Noise, deflection_m: float) -> float:
    """Return what the read-out says of a deflection [m]."""
    zeta = deflection_m + noise.thermal_m
    if params.step_v > 0.0:
        volts = params.volts_per_m * zeta + noise.white_v + noise.flicker_v
        zeta = converted_v(volts, params.step_v, params.range_v) / params.volts_per_m
    return zeta


@compiled
def disturbed_step(
    params: DisturbedParams, state: DisturbedState, inputs: PlantInputs, noise: Noise, dt: float
) -> tuple[DisturbedState, AfmSample]:
    """Send the piezo to the base position, step the part under it, and read it out with what the noise adds."""
    piezo, x = piezo_step(params.piezo, state.piezo, inputs.base_m, dt)
    moved = PlantInputs(
        base_m=x + noise.drift_m + noise.vibration_m,
        x_m=inputs.x_m - noise.sample_x_m,
        y_m=inputs.y_m - noise.sample_y_m,
        height_m=inputs.height_m,
        voltage_v=noise.voltage_v,
        amplitude_m=inputs.amplitude_m,
        temperature_k=inputs.temperature_k,
        seed=inputs.seed,
    )
    tip, sample = part_step(params.tip, state.tip, moved, dt)
    zeta = read_out(params.converter, noise, sample.deflection_m)
    return DisturbedState(tip, piezo), AfmSample(
        base_m=inputs.base_m,
        deflection_m=zeta,
        force_n=params.stiffness_n_per_m * zeta,
        bridge_voltage_v=params.converter.volts_per_m * zeta,
        distance_m=sample.distance_m,
        distance_valid=sample.distance_valid,
        in_contact=sample.in_contact,
        meniscus=sample.meniscus,
        lateral_x_n=sample.lateral_x_n,
        lateral_y_n=sample.lateral_y_n,
    )


class NoisyParams(NamedTuple):
    """A disturbed instrument, and the noise of a whole run, each row the fields of `Noise` of a millisecond."""

    instrument: DisturbedParams
    noise: Array


class NoisyState(NamedTuple):
    """Time [s], and the state of the instrument."""

    time_s: float
    instrument: DisturbedState


def noisy_params(config: DisturbanceConfig, cantilever: Plant, duration_s: float) -> NoisyParams:
    """Draw the noise of a run of duration_s [s] over a plane, the seed of `config` deciding all of it."""
    state, rows = noise_start(), []
    for _ in range(max(1, math.ceil(duration_s / _NOISE_STEP_S) + 1)):
        state, noise = noise_step(config, state, cantilever.stiffness_n_per_m, _NOISE_STEP_S)
        rows.append(noise)
    return NoisyParams(disturbed_params(config, cantilever, cantilever), np.array(rows))


@compiled
def _noisy_step(params: NoisyParams, state: NoisyState, inputs: PlantInputs, dt: float) -> tuple[NoisyState, AfmSample]:
    time_s, rows = state.time_s + dt, params.noise
    row = rows[min(max(int(time_s / _NOISE_STEP_S + 0.5) - 1, 0), len(rows) - 1)]
    # Nothing was drawn yet at the start.
    drawn = 1.0 if time_s > 0.0 else 0.0
    noise = Noise(
        drawn * row[0], drawn * row[1], drawn * row[2], drawn * row[3], drawn * row[4], drawn * row[5], 0.0, 0.0
    )
    instrument, sample = disturbed_step(params.instrument, state.instrument, inputs, noise, dt)
    return NoisyState(time_s, instrument), sample


def _noisy_start(params: NoisyParams, inputs: PlantInputs) -> NoisyState:
    tip = part_start(params.instrument.tip, inputs)
    return NoisyState(0.0, DisturbedState(tip, piezo_at_rest(inputs.base_m)))


register_part(NoisyParams, Part(_noisy_start, _noisy_step, lateral=False))
