"""The disturbed instrument: a part around another part, with a piezo that lags and creeps and a noisy read-out.

    x_piezo = S(x + hysteresis(x) + creep(x)) + drift + vibration
    zeta    = converter(zeta(x_piezo) + thermal + (white + 1/f) / gain of the read-out)

The base position reported is the commanded one, as with a real open-loop piezo, which has no sensor. The noise is an
input (`disturbances`): a node draws it step by step, and `NoisyParams` holds that of a whole run in lockstep.
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.afm.cantilever import Plant
from telenano.afm.disturbances import Noise, noise_start, noise_step
from telenano.afm.part import Part, part_start, part_step, register_part
from telenano.extend.samples import AfmSample, PlantInputs
from telenano.numerics.compiler import compiled
from telenano.settings.afm_disturbances import (
    CreepConfig,
    DisturbanceConfig,
    HysteresisConfig,
    ReadoutConfig,
    StageConfig,
)

Array = npt.NDArray[np.float64]

# Number of play operators of the hysteresis, and time constants of the creep.
_PLAYS = 8
_LAGS_S = (0.1, 1.0, 10.0, 100.0)
# The noise of a run in lockstep has one value a millisecond, like that of a node.
_NOISE_STEP_S = 1e-3
_NO_STAGE = StageConfig()


class PiezoParams(NamedTuple):
    """Plays r_i [m] and the weight of each; lags [s] and the share of each; arrays are empty for effects that are off.

    stage_rad_per_s, stage_damping: resonance w of the stage, 0 for none, and its damping ratio d, 0 < d < 1.
    """

    play_radii_m: Array
    play_weight: float
    lags_s: Array
    lag_share: float
    stage_rad_per_s: float
    stage_damping: float


class PiezoState(NamedTuple):
    """Play positions p_i and creep positions [m]; a step leaves those of an effect that is off unchanged.

    The last two elements of lags_m are of the stage: its position, and its position plus speed / w.
    """

    plays_m: Array
    lags_m: Array


class ConverterParams(NamedTuple):
    """Step of the converter [V], 0 without one; its range, from -range_v to range_v [V]; gain before it [V/m]."""

    step_v: float
    range_v: float
    volts_per_m: float


class DisturbedParams(NamedTuple):
    """The disturbed part, the piezo that moves it, the stiffness of its cantilever [N/m], and the converter."""

    tip: Any
    piezo: PiezoParams
    stiffness_n_per_m: float
    converter: ConverterParams


class DisturbedState(NamedTuple):
    """State of the disturbed part, and of the piezo."""

    tip: Any
    piezo: PiezoState


@lru_cache(maxsize=8)
def piezo_params(hysteresis: HysteresisConfig, creep: CreepConfig, stage: StageConfig = _NO_STAGE) -> PiezoParams:
    """Return the constants of a piezo; a motion over half the range takes up every play."""
    radii = [0.25 * hysteresis.range_m * (i + 0.5) / _PLAYS for i in range(_PLAYS)] if hysteresis.enabled else []
    return PiezoParams(
        np.array(radii, np.float64),
        4.0 * hysteresis.share / _PLAYS,
        np.array(_LAGS_S if creep.enabled else (), np.float64),
        creep.share_per_decade,
        2.0 * math.pi * stage.resonance_hz if stage.enabled else 0.0,
        stage.damping,
    )


def converter_params(config: ReadoutConfig, volts_per_m: float) -> ConverterParams:
    """Return the constants of a converter behind a gain [V/m]."""
    step_v = converter_step_v(config.converter_bits, config.converter_range_v) if config.enabled else 0.0
    return ConverterParams(step_v, config.converter_range_v, volts_per_m)


def disturbed_params(config: DisturbanceConfig, tip: Any, cantilever: Plant) -> DisturbedParams:
    """Return the constants of the part `tip`, read by this cantilever, under these disturbances."""
    return DisturbedParams(
        tip,
        piezo_params(config.hysteresis, config.creep, config.stage),
        cantilever.stiffness_n_per_m,
        converter_params(config.readout, cantilever.volts_per_m),
    )


def piezo_at_rest(base_m: float) -> PiezoState:
    """Return the state of a piezo that has rested at base_m [m] for a long time."""
    return PiezoState(np.full(_PLAYS, base_m), np.full(len(_LAGS_S) + 2, base_m))


def piezo_switched(state: PiezoState, before: DisturbanceConfig, after: DisturbanceConfig, base_m: float) -> PiezoState:
    """Return the state of a piezo after a change of settings; effects newly switched on begin at rest at base_m [m]."""
    rest, lags_m = piezo_at_rest(base_m), state.lags_m.copy()
    if after.creep.enabled and not before.creep.enabled:
        lags_m[:-2] = rest.lags_m[:-2]
    if after.stage.enabled and not before.stage.enabled:
        lags_m[-2:] = rest.lags_m[-2:]
    is_new = after.hysteresis.enabled and not before.hysteresis.enabled
    return PiezoState(rest.plays_m if is_new else state.plays_m, lags_m)


@compiled
def piezo_step(params: PiezoParams, state: PiezoState, base_m: float, dt: float) -> tuple[PiezoState, float]:
    """Return the new state and the true position [m] of a piezo sent to base_m [m], dt [s] after the last step."""
    plays, lags, x = state.plays_m, state.lags_m, base_m
    radii, lags_s = params.play_radii_m, params.lags_s
    if len(radii) > 0:
        plays = np.minimum(np.maximum(plays, base_m - radii), base_m + radii)
        apart = 0.0
        for i in range(len(plays)):
            apart += plays[i] - base_m
        x += params.play_weight * apart
    w = params.stage_rad_per_s
    if len(lags_s) > 0 or w > 0.0:
        lags = lags.copy()
    if len(lags_s) > 0:
        behind = 0.0
        for i in range(len(lags_s)):
            lags[i] += (base_m - lags[i]) * (1.0 - math.exp(-dt / lags_s[i]))
            behind += lags[i] - base_m
        x += params.lag_share * behind
    if w > 0.0:
        place, ahead = len(lags) - 2, len(lags) - 1
        speed = (lags[ahead] - lags[place]) * w
        lags[place], speed = _stage_step(w, params.stage_damping, lags[place], speed, x, dt)
        lags[ahead], x = lags[place] + speed / w, lags[place]
    return PiezoState(plays, lags), float(x)


@compiled
def _stage_step(w: float, d: float, x: float, v: float, target_m: float, dt: float) -> tuple[float, float]:
    """Return position [m] and speed [m/s] of x'' + 2 d w x' + w^2 (x - target) = 0 after dt [s], exactly.

    The command acts from the last sample to this one, so that a stage without a lag reaches its target within the step.
    """
    free = w * math.sqrt(1.0 - d * d)
    kept, c, s = math.exp(-d * w * dt), math.cos(free * dt), math.sin(free * dt)
    off = x - target_m
    after = kept * (off * (c + d * w / free * s) + v / free * s)
    return target_m + after, kept * (v * (c - d * w / free * s) - off * w * w / free * s)


def converter_step_v(bits: int, range_v: float) -> float:
    """Return the step [V] of a converter of this number of bits from -range_v to range_v."""
    return 2.0 * range_v / float(1 << bits)


@compiled
def converted_v(volts: float, step_v: float, range_v: float) -> float:
    """Return the voltage [V] that a converter with this step reads: rounded, and limited to its range.

    >>> converted_v(0.3, 0.125, 1.0), converted_v(7.0, 0.125, 1.0)
    (0.25, 0.875)
    """
    return min(max(round(volts / step_v) * step_v, -range_v), range_v - step_v)


@compiled
def read_out(params: ConverterParams, noise: Noise, deflection_m: float) -> float:
    """Return the deflection [m] that the read-out reports, with thermal noise and, behind a converter, its noise."""
    zeta = deflection_m + noise.thermal_m
    if params.step_v > 0.0:
        volts = params.volts_per_m * zeta + noise.white_v + noise.flicker_v
        zeta = converted_v(volts, params.step_v, params.range_v) / params.volts_per_m
    return zeta


@compiled
def _read_as(sample: AfmSample, base_m: float, deflection_m: float, force_n: float, voltage_v: float) -> AfmSample:
    """Return the sample with other readings: base [m], deflection [m], force [N] and voltage of the bridge [V]."""
    return AfmSample(
        base_m=base_m,
        deflection_m=deflection_m,
        force_n=force_n,
        bridge_voltage_v=voltage_v,
        distance_m=sample.distance_m,
        distance_valid=sample.distance_valid,
        in_contact=sample.in_contact,
        meniscus=sample.meniscus,
        lateral_x_n=sample.lateral_x_n,
        lateral_y_n=sample.lateral_y_n,
    )


@compiled
def disturbed_step(
    params: DisturbedParams, state: DisturbedState, inputs: PlantInputs, noise: Noise, dt: float
) -> tuple[DisturbedState, AfmSample]:
    """Send the piezo to the base position, step the part that it moves, and read the part out with the noise added."""
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
    force_n, voltage_v = params.stiffness_n_per_m * zeta, params.converter.volts_per_m * zeta
    return DisturbedState(tip, piezo), _read_as(sample, inputs.base_m, zeta, force_n, voltage_v)


class GaugedParams(NamedTuple):
    """A part that gives only a force, as a spring does, and the cantilever that reads this force.

    stiffness_n_per_m: stiffness of the cantilever [N/m]; volts_per_m: gain of its read-out [V/m].
    """

    tip: Any
    stiffness_n_per_m: float
    volts_per_m: float


@compiled
def _gauged_step(params: GaugedParams, state: Any, inputs: PlantInputs, dt: float) -> tuple[Any, AfmSample]:
    state, sample = part_step(params.tip, state, inputs, dt)
    zeta = sample.force_n / params.stiffness_n_per_m
    return state, _read_as(sample, sample.base_m, zeta, sample.force_n, params.volts_per_m * zeta)


def gauged(tip: Any, cantilever: Plant) -> GaugedParams:
    """Return a part whose force this cantilever reads; its deflection does not move the tip and so keeps the force."""
    return GaugedParams(tip, cantilever.stiffness_n_per_m, cantilever.volts_per_m)


register_part(GaugedParams, Part(lambda params, inputs: part_start(params.tip, inputs), _gauged_step))


class NoisyParams(NamedTuple):
    """A disturbed instrument, and the noise of a whole run: a row a millisecond, the columns the fields of `Noise`."""

    instrument: DisturbedParams
    noise: Array


class NoisyState(NamedTuple):
    """Time [s], and the state of the instrument."""

    time_s: float
    instrument: DisturbedState


def noisy_params(
    config: DisturbanceConfig, cantilever: Plant, duration_s: float, tip: Any = None, *, is_gauged: bool = False
) -> NoisyParams:
    """Draw the noise of a run of duration_s [s]; the seed of `config` alone decides it.

    Args:
        config: The disturbances.
        cantilever: The disturbed cantilever.
        duration_s: The length of the run [s].
        tip: The part that the cantilever reads; None is the cantilever itself, over a plane.
        is_gauged: Whether that part gives only a force.
    """
    read = cantilever if tip is None else gauged(tip, cantilever) if is_gauged else tip
    rows = _noise_rows(config, cantilever.stiffness_n_per_m, max(1, math.ceil(duration_s / _NOISE_STEP_S) + 1))
    return NoisyParams(disturbed_params(config, read, cantilever), rows)


@lru_cache(maxsize=8)
def _noise_rows(config: DisturbanceConfig, stiffness_n_per_m: float, count: int) -> Array:
    """Return the noise of `count` milliseconds, shape (count, 8); the runs of a study share it, none writes to it."""
    state, rows = noise_start(), []
    for _ in range(count):
        state, noise = noise_step(config, state, stiffness_n_per_m, _NOISE_STEP_S)
        rows.append(noise)
    return np.array(rows)


@compiled
def _noisy_step(params: NoisyParams, state: NoisyState, inputs: PlantInputs, dt: float) -> tuple[NoisyState, AfmSample]:
    time_s, rows = state.time_s + dt, params.noise
    row = rows[min(max(int(time_s / _NOISE_STEP_S + 0.5) - 1, 0), len(rows) - 1)]
    # At the start nothing has been drawn yet.
    drawn = 1.0 if time_s > 0.0 else 0.0
    noise = Noise(
        drift_m=drawn * row[0],
        vibration_m=drawn * row[1],
        voltage_v=drawn * row[2],
        thermal_m=drawn * row[3],
        white_v=drawn * row[4],
        flicker_v=drawn * row[5],
        sample_x_m=drawn * row[6],
        sample_y_m=drawn * row[7],
    )
    instrument, sample = disturbed_step(params.instrument, state.instrument, inputs, noise, dt)
    return NoisyState(time_s, instrument), sample


def _noisy_start(params: NoisyParams, inputs: PlantInputs) -> NoisyState:
    tip = part_start(params.instrument.tip, inputs)
    return NoisyState(0.0, DisturbedState(tip, piezo_at_rest(inputs.base_m)))


register_part(NoisyParams, Part(_noisy_start, _noisy_step, lateral=False))
