"""The whole AFM as one pure step: safety chain, piezo, equilibrium, read-out.

The lockstep simulator calls `step`. A node calls `safety_step` and gives its base position to a driver, whose
simulated form calls `measure`: the same two halves. The piezo follows its command at once, S(s) = 1 (as the paper
assumes under Eq. 17): the speed limit of the safety chain is its only lag.

The force limit acts on the force of the tick before, as it must with a measured one. In a tick of dt the base moves by
at most base_speed dt.
"""

from typing import NamedTuple

from services.afm_node.physics.cantilever import Plant, PlantState, deflection_m, equilibrium, initial_state
from services.afm_node.safety import (
    SafetyInputs,
    SafetyOutputs,
    SafetyParams,
    SafetyState,
    initial_safety_state,
    safety_step,
)
from services.numerics.compiled import compiled

# the guard's speed limit allows no more than this much motion at once, however long the process was held up
LONGEST_STEP_NS = 10_000_000


class AfmSample(NamedTuple):
    """What the device reports for one base position.

    base_m: base position applied [m]; deflection_m: zeta [m], positive away from the sample; force_n: on the tip [N],
    positive is repulsive; bridge_voltage_v: Eq. 3 [V]; distance_m: h [m], meaningful if distance_valid (a real
    instrument does not know it); in_contact; meniscus: a bridge exists (`as_printed`: the retract law is in force).
    """

    base_m: float
    deflection_m: float
    force_n: float
    bridge_voltage_v: float
    distance_m: float
    distance_valid: bool
    in_contact: bool
    meniscus: bool


class AfmParams(NamedTuple):
    """Limits and plant."""

    safety: SafetyParams
    plant: Plant


class AfmStepState(NamedTuple):
    """Safety chain, tip, and the force last measured [N]."""

    safety: SafetyState
    plant: PlantState
    force_n: float


class AfmInputs(NamedTuple):
    """One tick of inputs, as `SafetyInputs` without the force."""

    reference_m: float
    command_age_s: float
    action: int
    arm_requested: bool
    estop: bool


class AfmOutputs(NamedTuple):
    """Fields of `AfmSample` and of `SafetyOutputs`."""

    base_m: float
    distance_m: float
    deflection_m: float
    force_n: float
    bridge_voltage_v: float
    in_contact: bool
    meniscus: bool
    mode: int
    limited: int
    reason: int
    arm_refusal: int


@compiled
def command_wait_ns(period_ns: int) -> int:
    """Return how long after a commanded step the instrument steps by itself [ns].

    A command that is late by less than half a period still makes the step, so that there is one step a command.
    """
    return 3 * period_ns // 2


@compiled
def measure(plant: Plant, state: PlantState, base_m: float) -> tuple[PlantState, AfmSample]:
    """Move the base to base_m [m], find the equilibrium and read it out.

    The force is that of the cantilever, k zeta, which in equilibrium is F(h).
    """
    tip = equilibrium(plant, state, base_m)
    zeta = deflection_m(plant, tip.distance_m, base_m)
    force, voltage = plant.stiffness_n_per_m * zeta, plant.volts_per_m * zeta
    return tip, AfmSample(base_m, zeta, force, voltage, tip.distance_m, True, tip.contact, tip.meniscus)


@compiled
def guarded(
    params: SafetyParams, state: SafetyState, inputs: AfmInputs, force_n: float, dt: float
) -> tuple[SafetyState, SafetyOutputs]:
    """Guard a tick of a simulated instrument, on which the force was force_n [N]; such a device is never lost."""
    asked = SafetyInputs(
        inputs.reference_m,
        inputs.command_age_s,
        inputs.action,
        inputs.arm_requested,
        inputs.estop,
        force_n,
        False,
    )
    return safety_step(params, state, asked, dt)


@compiled
def step(params: AfmParams, state: AfmStepState, inputs: AfmInputs, dt: float) -> tuple[AfmStepState, AfmOutputs]:
    """Advance the AFM by dt [s].

    Raises: ValueError, if dt is not positive and finite.
    """
    safety, allowed = guarded(params.safety, state.safety, inputs, state.force_n, dt)
    tip, sample = measure(params.plant, state.plant, allowed.base_m)
    outputs = AfmOutputs(
        sample.base_m,
        sample.distance_m,
        sample.deflection_m,
        sample.force_n,
        sample.bridge_voltage_v,
        sample.in_contact,
        sample.meniscus,
        allowed.mode,
        allowed.limited,
        allowed.reason,
        allowed.arm_refusal,
    )
    return AfmStepState(safety, tip, sample.force_n), outputs


def initial_afm_state(params: AfmParams) -> AfmStepState:
    """Return the state in which an AFM starts: retracted, the tip in equilibrium there."""
    safety = initial_safety_state(params.safety)
    tip, sample = measure(params.plant, initial_state(params.plant, safety.base_m), safety.base_m)
    return AfmStepState(safety, tip, sample.force_n)
