"""The dynamic cantilever of `dynamic` as a part that runs in the time of the node (ADR 0010); it needs numba.

The simulation advances in whole periods of the drive. Most of a millisecond can be simulated before the next command
comes, because the base stands still: `settle` does so while nothing waits for it. A step simulates the rest: in its
first half the base moves to the commanded position, and over its second half deflection and, for a driven tip,
amplitude and phase are averaged. Thermal noise acts as impulses on the tip.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.afm.cantilever import Plant, initial_state
from telenano.afm.contact.electrostatic import electrostatic_strength_n_m2
from telenano.afm.dynamic import NO_NOISE, DynamicState, Reading, advance, free_amplitude_m, lag_rad, steady_state
from telenano.afm.dynamic_plant import KICKS_PER_PERIOD, NORMALS_PER_PERIOD, DynamicPlant
from telenano.afm.part import Motion, Part, register_part
from telenano.extend.samples import AfmSample, Oscillation, PlantInputs
from telenano.numerics.compiler import always_compiled

# This much of the millisecond between two exchanges is simulated while nothing waits for it [s].
_AHEAD_S = 0.9e-3
# `settle` simulates this number of steps at once, some 100 us, so that other tasks of the processor can run in between.
_SLICE_STEPS = 4500
# The longest time simulated in one step [s], however late the process is: a machine that is too slow falls behind.
_MOST_S = 2e-3
_LEAST_PERIODS = 8
# Steps a period of a tip that is not driven: without a phase to resolve, it comes to rest at any step.
_RESTING_STEPS = 32
# The angle of the contact's own motion in a step [rad]; the impulses are unstable beyond 2.
_MOST_ANGLE_A_STEP = 1.5
# The Philox counter of the thermal impulses; the other random numbers of the seed use 0 and 1.
_KICKS = 2


class Exchange(NamedTuple):
    """Number of steps in which base and surface move evenly to their targets, then of steps that are averaged."""

    moving: int
    reading: int


@always_compiled
def exchanged(
    plant: DynamicPlant,
    state: DynamicState,
    base_m: float,
    surface_m: float,
    drive_m: float,
    steps: Exchange,
    normals: npt.NDArray[np.float64],
) -> tuple[DynamicState, Reading, float, float]:
    """Return the state after an exchange, the reading of its second part, and two values of the whole exchange.

    These are the energy that the sample took from the tip [J], and the share of the time in contact.
    """
    split = steps.moving * NORMALS_PER_PERIOD // plant.drive.shape[0] if normals.size > 0 else 0
    taken, touched = 0.0, 0.0
    if steps.moving > 0:
        state, before = advance(plant, state, base_m, surface_m, drive_m, steps.moving, normals[:split])
        taken, touched = before.dissipated_j, before.contact_share * steps.moving
    state, reading = advance(plant, state, base_m, surface_m, drive_m, steps.reading, normals[split:])
    touched += reading.contact_share * steps.reading
    return state, reading, taken + reading.dissipated_j, touched / (steps.moving + steps.reading)


def least_steps(plant: DynamicPlant) -> int:
    """Return the least number of steps a period at which a tip in the steepest force of its sample gains no energy.

    In the stiffest contact of the grid, c, the tip swings at w0 sqrt(1 + c / k), and impulses of the force are stable
    for steps of up to 2 rad (Verlet). Attraction is steepest, 2 A / h^3, where contact begins.
    """
    grid, k = plant.grid, plant.stiffness_n_per_m
    contact_n_per_m = float(np.abs(grid.cubics[2:, :, 1]).max()) * grid.cells_per_m
    attraction_n_per_m = 2.0 * grid.attraction_n_m2 / plant.passages.onset_m**3
    steepest_n_per_m = max(contact_n_per_m, attraction_n_per_m)
    steps = 2.0 * math.pi * math.sqrt(1.0 + steepest_n_per_m / k) / _MOST_ANGLE_A_STEP
    return KICKS_PER_PERIOD * math.ceil(steps / KICKS_PER_PERIOD)


def require_steps(plant: DynamicPlant) -> None:
    """Raise ValueError where the shortest parts of a step are too long for a tip in contact."""
    steps, least = int(plant.finer.turns.shape[0]), least_steps(plant)
    if steps < least:
        raise ValueError(
            f"{steps} steps a period, the shortest that there are, are too few for a cantilever of"
            f" {plant.stiffness_n_per_m:g} N/m, which the sample makes swing faster: {least} or more would be needed"
        )


def settled_tip(plant: DynamicPlant, begin_m: float, settle: int) -> Callable[[float], float]:
    """Return a function from a base [m] to the mean deflection [m] of an undriven tip that has settled there.

    The tip begins at begin_m [m]; each call moves on from the last one, settles for `settle` steps, and averages over
    one period.

    Raises:
        ValueError: The shortest parts of a step are too long for a tip in contact.
    """
    require_steps(plant)
    state = steady_state(plant, begin_m, 0.0)

    def measure(base_m: float) -> float:
        nonlocal state
        state, _ = advance(plant, state, base_m, 0.0, 0.0, settle, NO_NOISE)
        state, reading = advance(plant, state, base_m, 0.0, 0.0, plant.drive.shape[0], NO_NOISE)
        return reading.mean_deflection_m

    return measure


def resting_steps(driven: DynamicPlant) -> int:
    """Return the steps a period of an undriven tip, which are never divided: as few as its contact allows."""
    return max(_RESTING_STEPS, least_steps(driven))


def with_exact_rest(plant: DynamicPlant) -> DynamicPlant:
    """Return a cantilever whose impulses hold a resting tip exactly where a constant force would.

    Between two impulses of a force F the spring swings by the angle w0 dt, so that the tip would rest at F / k times
    (w0 dt / 2) cot(w0 dt / 2), 0.3 % too little at 32 steps a period. The mass in the impulses is scaled to correct it.
    """
    half = 0.5 * math.sqrt(plant.stiffness_n_per_m / plant.mass_kg) * plant.step_s
    return plant._replace(mass_kg=plant.mass_kg * half / math.tan(half))


class DynamicParams(NamedTuple):
    """The quasi-static cantilever, for rest distance and read-out; the dynamic one, driven and resting.

    free_gain is the amplitude of the tip without a sample for unit amplitude of the base. Both dynamic cantilevers are
    built for thermal impulses at 1 K.
    """

    plant: Plant
    driven: DynamicPlant
    resting: DynamicPlant
    free_gain: float


class DynamicTip(NamedTuple):
    """Motion; whether it is driven; time still to be simulated [s]; number of simulated pieces, which seeds impulses.

    in_phase_m and quadrature_m of the deflection [m] and the energy dissipated_j a period [J] are those of the last
    step; taken_j [J] and periods are the energy taken by the sample and the periods simulated since then.
    """

    motion: DynamicState
    is_driven: bool = False
    due_s: float = 0.0
    calls: int = 0
    in_phase_m: float = 0.0
    quadrature_m: float = 0.0
    dissipated_j: float = 0.0
    taken_j: float = 0.0
    periods: int = 0


def dynamic_params(plant: Plant, driven: DynamicPlant, resting: DynamicPlant) -> DynamicParams:
    """Return the constants of a dynamic cantilever; raise ValueError if its period has too few steps."""
    require_steps(driven)
    return DynamicParams(plant, driven, with_exact_rest(resting), free_amplitude_m(driven, 1.0))


def _start(params: DynamicParams, inputs: PlantInputs) -> DynamicTip:
    base, height = inputs.base_m, inputs.height_m
    tip = initial_state(params.plant, base + height)
    zeta = tip.distance_m + base + height - params.plant.rest_distance_m
    return DynamicTip(DynamicState(zeta, 0.0, base, 0.0, height, tip.contact, tip.meniscus, 0))


def _tuned(params: DynamicParams, state: DynamicTip, inputs: PlantInputs) -> tuple[DynamicPlant, DynamicTip]:
    """Return the cantilever for these inputs, and the state; a change of drive puts it at the beginning of a period."""
    is_driven = inputs.amplitude_m > 0.0
    if is_driven != state.is_driven:
        # The number of steps a period has changed, so a new period begins.
        state = state._replace(is_driven=is_driven, motion=state.motion._replace(phase_step=0))
    plant = params.driven if is_driven else params.resting
    if inputs.voltage_v != 0.0:
        strength = electrostatic_strength_n_m2(inputs.voltage_v, plant.tip_radius_m)
        plant = plant._replace(electrostatic_n_m2=strength)
    return plant, state


class _Way(NamedTuple):
    """Targets of base and surface [m], the steps to them, and the number of periods that these are."""

    base_m: float
    surface_m: float
    steps: Exchange
    periods: int


def _gone_on(
    params: DynamicParams, plant: DynamicPlant, state: DynamicTip, inputs: PlantInputs, way: _Way
) -> tuple[DynamicTip, Reading, float]:
    """Return the state after a way, the reading of its second part, and the share of the time in contact."""
    motion, reading, taken_j, touched = exchanged(
        plant,
        state.motion,
        way.base_m,
        way.surface_m,
        inputs.amplitude_m / params.free_gain,
        way.steps,
        _kicks(inputs, state.calls, way.periods),
    )
    state = state._replace(
        motion=motion,
        calls=state.calls + 1,
        taken_j=state.taken_j + taken_j,
        periods=state.periods + way.periods,
    )
    return state, reading, touched


def _kicks(inputs: PlantInputs, calls: int, periods: int) -> npt.NDArray[np.float64]:
    """Return the normal numbers of the thermal impulses of some periods, scaled from the 1 K of the plant."""
    if inputs.temperature_k <= 0.0:
        return NO_NOISE
    source = np.random.Philox(key=inputs.seed, counter=[0, 0, calls, _KICKS])
    scale = math.sqrt(inputs.temperature_k)
    return scale * np.random.Generator(source).standard_normal(periods * NORMALS_PER_PERIOD)


def _settle(params: DynamicParams, state: DynamicTip, inputs: PlantInputs) -> tuple[DynamicTip, bool]:
    plant, state = _tuned(params, state, inputs)
    n, period_s = int(plant.drive.shape[0]), 1.0 / plant.drive_hz
    ahead_s, slice_s = state.due_s + _AHEAD_S, _SLICE_STEPS // n * period_s
    periods = int(min(ahead_s, slice_s) / period_s)
    if periods > 0:
        due_s = state.due_s - periods * period_s
        way = _Way(state.motion.base_m, state.motion.surface_m, Exchange(0, periods * n), periods)
        state = _gone_on(params, plant, state, inputs, way)[0]._replace(due_s=due_s)
    # A small remainder is left for the step of the next command.
    return state, ahead_s - periods * period_s > 0.5 * slice_s


def _step(params: DynamicParams, state: DynamicTip, inputs: PlantInputs, dt: float) -> tuple[DynamicTip, AfmSample]:
    plant, state = _tuned(params, state, inputs)
    base, height, due_s, period_s = inputs.base_m, inputs.height_m, state.due_s + dt, 1.0 / plant.drive_hz
    most = max(int(_MOST_S / period_s), _LEAST_PERIODS)
    periods = min(max(int(due_s / period_s), _LEAST_PERIODS), most)
    # Neither a growing delay nor a large lead is carried over.
    due_s = min(max(due_s - periods * period_s, -_MOST_S), period_s)
    n, moving = int(plant.drive.shape[0]), periods // 2
    way = _Way(base, height, Exchange(moving * n, (periods - moving) * n), periods)
    state, reading, touched = _gone_on(params, plant, state, inputs, way)
    zeta = reading.mean_deflection_m
    return state._replace(
        due_s=due_s,
        in_phase_m=reading.in_phase_m,
        quadrature_m=reading.quadrature_m,
        # The mean is over all periods since the last step, because a meniscus may form and break in each second or
        # third of them only.
        dissipated_j=state.taken_j / state.periods,
        taken_j=0.0,
        periods=0,
    ), AfmSample(
        base_m=base,
        deflection_m=zeta,
        force_n=plant.stiffness_n_per_m * zeta,
        bridge_voltage_v=params.plant.volts_per_m * zeta,
        distance_m=plant.rest_distance_m + zeta - base - height,
        distance_valid=True,
        in_contact=touched > 0.0,
        meniscus=state.motion.meniscus,
    )


def _oscillation(state: DynamicTip) -> Oscillation:
    if not state.is_driven:
        return Oscillation(0.0, 0.0)
    x, y = state.in_phase_m, state.quadrature_m
    return Oscillation(math.hypot(x, y), lag_rad(x, y), state.dissipated_j)


_MOTION = Motion(_settle, _oscillation)
register_part(DynamicParams, Part(_start, _step, motion=lambda params: _MOTION))
