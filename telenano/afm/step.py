"""The guarded instrument as one pure step: the safety chain, and behind it any part (`part`).

The lockstep simulator calls `step`. A node calls `safety_step` and gives its base position to a driver, whose
simulated form (`sim`) steps the same part. The piezo follows its command at once, S(s) = 1 (as the paper assumes under
Eq. 17): the speed limit of the safety chain is its only lag.

The force limit acts on the force of the tick before, as with any measured force. In a tick of dt the base moves by at
most base_speed dt.
"""

import math
from typing import Any, NamedTuple

from telenano.afm.part import inputs_at, part_start, part_step
from telenano.afm.safety import SafetyInputs, SafetyOutputs, SafetyState, initial_safety_state, safety_step
from telenano.extend.instruments import SafetyParams
from telenano.extend.samples import AfmSample
from telenano.numerics.compiler import compiled

# The longest step: the speed limit of the guard allows no more motion at once, however long the process was held up.
LONGEST_STEP_NS = 10_000_000


class AfmParams(NamedTuple):
    """Limits of the guard, and the parameters of the part behind it: a cantilever over its sample, or another part."""

    safety: SafetyParams
    plant: Any


class AfmStepState(NamedTuple):
    """States of safety chain and part, and the force last measured [N]: vertical, and lateral (its magnitude)."""

    safety: SafetyState
    plant: Any
    force_n: float
    lateral_n: float


class AfmInputs(NamedTuple):
    """The inputs of one tick: as `SafetyInputs` without the force, and the place of the tip over the sample [m].

    of_hand: the reference is that of a hand; the base goes to it once it is armed.
    """

    reference_m: float
    command_age_s: float
    action: int
    arm_requested: bool
    estop: bool
    x_m: float = 0.0
    y_m: float = 0.0
    of_hand: bool = False


class AfmOutputs(NamedTuple):
    """The measurement, and the output of the guard."""

    sample: AfmSample
    allowed: SafetyOutputs


@compiled
def command_wait_ns(period_ns: int) -> int:
    """Return the time after a commanded step at which the instrument steps without a command [ns].

    A command that is late by less than half a period still makes the step, so that there is one step a command.
    """
    return 3 * period_ns // 2


@compiled
def _across(sample: AfmSample) -> float:
    return math.sqrt(sample.lateral_x_n * sample.lateral_x_n + sample.lateral_y_n * sample.lateral_y_n)


@compiled
def step(params: AfmParams, state: AfmStepState, inputs: AfmInputs, dt: float) -> tuple[AfmStepState, AfmOutputs]:
    """Advance the guard and the part behind it by dt [s]; a simulated device is never lost.

    Raises:
        ValueError: dt is not positive and finite.
    """
    asked = SafetyInputs(
        reference_m=inputs.reference_m,
        command_age_s=inputs.command_age_s,
        action=inputs.action,
        arm_requested=inputs.arm_requested,
        estop=inputs.estop,
        force_n=state.force_n,
        device_lost=False,
        lateral_n=state.lateral_n,
        of_hand=inputs.of_hand,
        goes=inputs.of_hand,
        # Compiled code cannot use the defaults of a named tuple.
        place_m=math.inf,
        speed_m_per_s=math.inf,
        interrupted=False,
        hand_force_n=0.0,
    )
    safety, allowed = safety_step(params.safety, state.safety, asked, dt)
    moved = inputs_at(allowed.base_m, inputs.x_m, inputs.y_m)
    plant, sample = part_step(params.plant, state.plant, moved, dt)
    return AfmStepState(safety, plant, sample.force_n, _across(sample)), AfmOutputs(sample, allowed)


def initial_afm_state(params: AfmParams) -> AfmStepState:
    """Return the state in which an instrument starts: retracted, at rest, with the force there as measured."""
    safety = initial_safety_state(params.safety)
    inputs = inputs_at(safety.base_m, 0.0, 0.0)
    plant, sample = part_step(params.plant, part_start(params.plant, inputs), inputs, 0.0)
    return AfmStepState(safety, plant, sample.force_n, _across(sample))
