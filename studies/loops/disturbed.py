"""The instrument with its disturbances for the lockstep: `afm_node.physics.disturbances`, compiled.

What does not depend on the motion (vibration, drift, noise of read-out and cantilever, a wandering voltage) is made
before the run, a value a millisecond, by the very steps of the node; what does (hysteresis, creep, the converter, the
force of the voltage) is in the step.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from services.afm_node.physics.cantilever import PlantState, deflection_m, equilibrium
from services.afm_node.physics.contact.electrostatic import (
    MOST_TURNS,
    SETTLED_M,
    electrostatic_force_n,
    electrostatic_strength_n_m2,
)
from services.afm_node.physics.disturbances import (
    LAGS_S,
    DisturbanceConfig,
    ReadoutConfig,
    begun,
    charged,
    displaced,
    play_radii_m,
    read_out,
    sines_of,
)
from services.afm_node.physics.step import AfmInputs, AfmOutputs, AfmParams, guarded, initial_afm_state
from services.afm_node.safety import SafetyState
from services.numerics.compiled import compiled
from services.numerics.normal_numbers import NormalNumbers

Array = npt.NDArray[np.float64]

_STEP_S = 1e-3
# bits of a converter that rounds nothing that matters, within a range that is never reached: noise alone is left
_FINE_BITS, _WIDE_V = 52, 1e3


class DisturbedParams(NamedTuple):
    """Limits and plant; what is added a millisecond: to the base [m], to the deflection [m]; pi eps0 R^2 V^2 [N m^2].

    play_radii_m, with the weight of each; lag_s, with the share of each; lsb_m and range_m, of the converter as a
    deflection, 0 without one.
    """

    afm: AfmParams
    added_base_m: Array
    added_deflection_m: Array
    charge_n_m2: Array
    play_radii_m: Array
    play_weight: float
    lag_s: Array
    lag_share: float
    lsb_m: float
    range_m: float


class DisturbedState(NamedTuple):
    """Safety chain, tip, the force last read [N], time [s], plays and lags of the piezo [m]."""

    safety: SafetyState
    plant: PlantState
    force_n: float
    time_s: float
    plays_m: Array
    lags_m: Array


def disturbed_params(afm: AfmParams, config: DisturbanceConfig, duration_s: float) -> DisturbedParams:
    """Make the series of a run of duration_s [s], the seed of `config` deciding all of them."""
    count = max(1, math.ceil(duration_s / _STEP_S) + 1)
    plant, normals, sines = afm.plant, NormalNumbers(config.seed), sines_of(config)
    # without what depends on the motion: that is in the step
    alone = config.model_copy(
        update={
            "hysteresis": config.hysteresis.model_copy(update={"enabled": False}),
            "creep": config.creep.model_copy(update={"enabled": False}),
            "readout": _unrounded(config.readout),
        }
    )
    base, zeta, charge = np.zeros((3, count))
    state = begun()
    for n in range(count):
        state, base[n] = displaced(alone, sines, state, 0.0, _STEP_S)
        state, volts = charged(config.electrostatic, normals, state, _STEP_S)
        charge[n] = electrostatic_strength_n_m2(volts, plant.tip.radius_m)
        state, zeta[n] = read_out(alone, normals, state, 0.0, plant.stiffness_n_per_m, plant.volts_per_m, _STEP_S)
    radii, lags = np.array(play_radii_m(config.hysteresis)), np.array(LAGS_S)
    has_converter, r = config.readout.enabled, config.readout
    return DisturbedParams(
        afm,
        base,
        zeta,
        charge,
        radii,
        4.0 * config.hysteresis.share / len(radii) if config.hysteresis.enabled else 0.0,
        lags,
        config.creep.share_per_decade if config.creep.enabled else 0.0,
        2.0 * r.converter_range_v / float(1 << r.converter_bits) / plant.volts_per_m if has_converter else 0.0,
        r.converter_range_v / plant.volts_per_m,
    )


def _unrounded(config: ReadoutConfig) -> ReadoutConfig:
    return config.model_copy(update={"converter_bits": _FINE_BITS, "converter_range_v": _WIDE_V})


def initial_state(params: DisturbedParams) -> DisturbedState:
    """Return the state at the start: retracted, the piezo at rest there for long."""
    start = initial_afm_state(params.afm)
    base = start.safety.base_m
    plays, lags = np.full(len(params.play_radii_m), base), np.full(len(params.lag_s), base)
    return DisturbedState(start.safety, start.plant, start.force_n, 0.0, plays, lags)


# compiled here, and plain Python where nodes without a compiler call it
_electrostatic = compiled(electrostatic_force_n)


@compiled
def step(
    params: DisturbedParams, state: DisturbedState, inputs: AfmInputs, dt: float
) -> tuple[DisturbedState, AfmOutputs]:
    """Advance guard, piezo, cantilever and read-out by dt [s].

    What is reported of the base is what it was sent to, and the guard judges the force that is read. Raises:
    ValueError, if dt is not positive and finite.
    """
    safety, allowed = guarded(params.afm.safety, state.safety, inputs, state.force_n, dt)
    plant, time_s = params.afm.plant, state.time_s + dt
    tip_sample, k = plant.tip, plant.stiffness_n_per_m
    sent = allowed.base_m
    n = min(max(int(time_s / _STEP_S + 0.5) - 1, 0), len(params.added_base_m) - 1)
    base, plays, lags = sent + params.added_base_m[n], state.plays_m, state.lags_m
    if params.play_weight > 0.0:
        plays = np.minimum(np.maximum(plays, sent - params.play_radii_m), sent + params.play_radii_m)
        for i in range(len(plays)):
            base += params.play_weight * (plays[i] - sent)
    if params.lag_share > 0.0:
        lags = lags.copy()
        for i in range(len(lags)):
            lags[i] += (sent - lags[i]) * (1.0 - math.exp(-dt / params.lag_s[i]))
            base += params.lag_share * (lags[i] - sent)
    tip, pull_m, charge = state.plant, 0.0, params.charge_n_m2[n]
    for _ in range(MOST_TURNS):
        before_m = tip.distance_m
        if charge > 0.0:
            pull_m = _electrostatic(charge, tip_sample.radius_m, tip_sample.contact_distance_m, before_m) / k
        tip = equilibrium(plant, tip, base - pull_m)
        if charge == 0.0 or abs(tip.distance_m - before_m) < SETTLED_M:
            break
    zeta = deflection_m(plant, tip.distance_m, base) + params.added_deflection_m[n]
    if params.lsb_m > 0.0:
        zeta = min(max(round(zeta / params.lsb_m) * params.lsb_m, -params.range_m), params.range_m - params.lsb_m)
    force = k * zeta
    outputs = AfmOutputs(
        sent,
        tip.distance_m,
        zeta,
        force,
        plant.volts_per_m * zeta,
        tip.contact,
        tip.meniscus,
        allowed.mode,
        allowed.limited,
        allowed.reason,
        allowed.arm_refusal,
    )
    return DisturbedState(safety, tip, force, time_s, plays, lags), outputs
