"""Safety chain of the AFM: what may be sent to the base, whatever the controller commands. Guards any driver.

Modes: RETRACTED (safe state, where a node starts), FOLLOW, HOLD, RETRACTING, ESTOP. One tick is decided in this order:

1. e-stop pressed: ESTOP from every mode. It retracts, and stays when released, until armed.
2. device lost, repulsive force above the limit, or a force that is no number, in FOLLOW or HOLD: RETRACTING.
3. no command for longer than the deadline: FOLLOW -> HOLD (the base stays); for hold_time longer: RETRACTING.
4. a fresh command: retract -> RETRACTING, hold -> HOLD, position -> FOLLOW. An action code that is not known is a hold.
   From HOLD the base takes up its speed gradually: while it stood the reference may have gone on, and the tip must not
   jump after it.
5. RETRACTING ends in RETRACTED; both are left by arming only.

A command counts as fresh by the hand behind it: `command_age_s` is the age of the newest command that descends from a
sample in which the hand was armed. So the tip follows no hand that is stopped, lost or silent, whoever arms the tip and
in whatever order the devices are armed. A program of the instrument has no hand, and its references have no age.

Arming is a wish: it is accepted with a device that is there and the base retracted, in RETRACTED, or in ESTOP once
released; otherwise the outputs carry the reason of the refusal. The tip stays in RETRACTED, for the reason ARMED, until
a fresh position command comes, and FOLLOW begins with that. A stop, a retraction or the loss of the device ends the
wish.

`reason` is why the last transition happened. The arrival in RETRACTED keeps the reason of the retraction, so that it
can still be read when the operator comes back.
"""

import math
from typing import NamedTuple

from telenano.numerics.compiler import compiled

MODE_RETRACTED, MODE_FOLLOW, MODE_HOLD, MODE_RETRACTING, MODE_ESTOP = range(5)
MODE_NAMES: dict[int, str] = dict(enumerate(("retracted", "follow", "hold", "retracting", "estop")))

ACTION_POSITION, ACTION_HOLD, ACTION_RETRACT = range(3)
ACTION_NAMES: dict[int, str] = {ACTION_POSITION: "position", ACTION_HOLD: "hold", ACTION_RETRACT: "retract"}

REASON_START, REASON_ARMED, REASON_ESTOP, REASON_FORCE_LIMIT, REASON_FORCE_INVALID, REASON_COMMAND_DEADLINE = range(6)
REASON_HOLD_EXPIRED, REASON_COMMANDS_RESUMED, REASON_HOLD_REQUESTED, REASON_RETRACT_REQUESTED = range(6, 10)
REASON_DEVICE_LOST, REASON_LATERAL_LIMIT = range(10, 12)
# These are the names of the constants.
REASON_NAMES: dict[int, str] = {
    code: name.removeprefix("REASON_").lower() for name, code in [*globals().items()] if name.startswith("REASON_")
}

ARM_NOT_REFUSED, ARM_REFUSED_ESTOP, ARM_REFUSED_ALREADY_ARMED, ARM_REFUSED_RETRACTING = range(4)
ARM_REFUSED_DEVICE_LOST = 4
ARM_REFUSAL_NAMES: dict[int, str] = {
    ARM_NOT_REFUSED: "not_refused",
    ARM_REFUSED_ESTOP: "estop_active",
    ARM_REFUSED_ALREADY_ARMED: "already_armed",
    ARM_REFUSED_RETRACTING: "still_retracting",
    ARM_REFUSED_DEVICE_LOST: "device_lost",
}

LIMITED_BY_RANGE = 1  # bits of `limited`
LIMITED_BY_SPEED = 2


class SafetyParams(NamedTuple):
    """Limits; base positions and speeds along the paper's axis, towards the sample."""

    base_min_m: float
    base_max_m: float
    base_speed_m_per_s: float
    resume_acceleration_m_per_s2: float
    retract_position_m: float
    retract_speed_m_per_s: float
    force_limit_n: float
    command_deadline_s: float
    hold_time_s: float
    lateral_limit_n: float = math.inf


class SafetyState(NamedTuple):
    """Mode (MODE_*), base position last commanded [m] and reason (REASON_*) of the last transition.

    slower_m_per_s: what the base is still kept below its speed limit after a hold [m/s].
    """

    mode: int
    base_m: float
    reason: int
    slower_m_per_s: float = 0.0


class SafetyInputs(NamedTuple):
    """One tick of inputs.

    reference_m: base position asked for [m]; command_age_s: age of that command, and of the armed hand behind it [s],
    infinite if none ever came; action: ACTION_*; arm_requested: now; estop: pressed; force_n: tip force last measured
    [N], repulsive positive; device_lost: nothing is known of the tip, and nothing reaches the base; lateral_n: force
    across the tip [N].
    """

    reference_m: float
    command_age_s: float
    action: int
    arm_requested: bool
    estop: bool
    force_n: float
    device_lost: bool = False
    lateral_n: float = 0.0


class SafetyOutputs(NamedTuple):
    """Base position to apply [m], mode, `limited` (bits LIMITED_BY_*, 0 for none), reason, why arming was refused."""

    base_m: float
    mode: int
    limited: int
    reason: int
    arm_refusal: int


def initial_safety_state(params: SafetyParams) -> SafetyState:
    """Return the state in which every node starts: retracted."""
    return SafetyState(MODE_RETRACTED, params.retract_position_m, REASON_START)


@compiled
def safety_step(
    params: SafetyParams, state: SafetyState, inputs: SafetyInputs, dt: float
) -> tuple[SafetyState, SafetyOutputs]:
    """Decide mode and base position of one tick of dt [s].

    Raises:
        ValueError: dt is not positive and finite.
    """
    if not (dt > 0.0 and math.isfinite(dt)):
        raise ValueError("dt in s must be finite and > 0")
    mode, reason = _next_mode(params, state, inputs)
    refusal = ARM_NOT_REFUSED
    if inputs.arm_requested:
        refusal = _arm_refusal(params, state, inputs)
        if refusal == ARM_NOT_REFUSED:
            mode, reason = MODE_RETRACTED, REASON_ARMED
    if is_wished(mode, reason):
        if inputs.device_lost:
            reason = REASON_DEVICE_LOST
        elif _fresh(params, inputs):
            if inputs.action == ACTION_POSITION:
                mode = MODE_FOLLOW
            elif inputs.action == ACTION_RETRACT:
                reason = REASON_RETRACT_REQUESTED
    slower = _slower(params, state, mode, dt)
    speed = params.base_speed_m_per_s - slower
    base, limited = _next_base(params, state.base_m, mode, inputs.reference_m, speed, dt)
    if mode == MODE_RETRACTING and base <= params.retract_position_m:
        mode = MODE_RETRACTED
    return SafetyState(mode, base, reason, slower), SafetyOutputs(base, mode, limited, reason, refusal)


@compiled
def is_wished(mode: int, reason: int) -> bool:
    """Return whether the tip was armed, and waits, withdrawn, for a command that it may follow."""
    return mode == MODE_RETRACTED and reason == REASON_ARMED


def is_armed(mode: int, reason: int) -> bool:
    """Return whether the tip was armed, and that has not ended: it follows, is held, or waits for a command."""
    return mode in (MODE_FOLLOW, MODE_HOLD) or is_wished(mode, reason)


@compiled
def is_placed(allowed: SafetyOutputs) -> bool:
    """Return whether the commanded base has reached its reference after every limit: no speed limit holds it back.

    What the base does behind the command, such as drift and creep, is no part of it.
    """
    return allowed.mode == MODE_FOLLOW and allowed.limited & LIMITED_BY_SPEED == 0


def placing_s(params: SafetyParams, base_m: float, reference_m: float) -> float:
    """Return how long the commanded base takes from base_m to a reference that stands at reference_m [s]."""
    target = min(max(reference_m, params.base_min_m), params.base_max_m)
    return abs(target - base_m) / params.base_speed_m_per_s


@compiled
def _fresh(params: SafetyParams, inputs: SafetyInputs) -> bool:
    # Written so that an age or a reference that is no number counts as no command.
    return inputs.command_age_s <= params.command_deadline_s and math.isfinite(inputs.reference_m)


@compiled
def _next_mode(params: SafetyParams, state: SafetyState, inputs: SafetyInputs) -> tuple[int, int]:
    """Mode after this tick, arming and the arrival in RETRACTED apart, and its reason."""
    mode, reason = state.mode, state.reason
    if inputs.estop:
        return MODE_ESTOP, REASON_ESTOP
    if mode not in (MODE_FOLLOW, MODE_HOLD):
        return mode, reason
    if inputs.device_lost:
        return MODE_RETRACTING, REASON_DEVICE_LOST
    if not math.isfinite(inputs.force_n):
        return MODE_RETRACTING, REASON_FORCE_INVALID
    if inputs.force_n > params.force_limit_n:
        return MODE_RETRACTING, REASON_FORCE_LIMIT
    if inputs.lateral_n > params.lateral_limit_n:
        return MODE_RETRACTING, REASON_LATERAL_LIMIT
    if not inputs.command_age_s <= params.command_deadline_s + params.hold_time_s:
        return MODE_RETRACTING, REASON_HOLD_EXPIRED
    if not _fresh(params, inputs):
        return (MODE_HOLD, REASON_COMMAND_DEADLINE) if mode == MODE_FOLLOW else (mode, reason)
    if inputs.action == ACTION_RETRACT:
        return MODE_RETRACTING, REASON_RETRACT_REQUESTED
    if inputs.action == ACTION_POSITION:
        return (mode, reason) if mode == MODE_FOLLOW else (MODE_FOLLOW, REASON_COMMANDS_RESUMED)
    return (mode, reason) if mode == MODE_HOLD else (MODE_HOLD, REASON_HOLD_REQUESTED)


@compiled
def _arm_refusal(params: SafetyParams, state: SafetyState, inputs: SafetyInputs) -> int:
    if inputs.estop:
        return ARM_REFUSED_ESTOP
    if inputs.device_lost:
        return ARM_REFUSED_DEVICE_LOST
    if state.mode in (MODE_FOLLOW, MODE_HOLD):
        return ARM_REFUSED_ALREADY_ARMED
    if state.mode == MODE_RETRACTING or state.base_m > params.retract_position_m:
        return ARM_REFUSED_RETRACTING
    return ARM_NOT_REFUSED


@compiled
def _slower(params: SafetyParams, state: SafetyState, mode: int, dt: float) -> float:
    """Return by how much the speed of this tick stays below the limit: nearly all of it after a hold, then less."""
    if mode != MODE_FOLLOW:
        return 0.0
    before = params.base_speed_m_per_s if state.mode == MODE_HOLD else state.slower_m_per_s
    return max(before - params.resume_acceleration_m_per_s2 * dt, 0.0)


@compiled
def _next_base(
    params: SafetyParams, base_m: float, mode: int, reference_m: float, speed_m_per_s: float, dt: float
) -> tuple[float, int]:
    """Return the base position after this tick and the bits of the limits that changed it."""
    if mode == MODE_HOLD:
        return base_m, 0
    if mode != MODE_FOLLOW:
        # A base that is further away than the retract position stays there: retracting never goes towards the sample.
        return max(base_m - params.retract_speed_m_per_s * dt, min(base_m, params.retract_position_m)), 0
    target = min(max(reference_m, params.base_min_m), params.base_max_m)
    limited = LIMITED_BY_RANGE if target != reference_m else 0
    reach = speed_m_per_s * dt
    base = min(max(target, base_m - reach), base_m + reach)
    if base != target:
        limited |= LIMITED_BY_SPEED
    return base, limited
