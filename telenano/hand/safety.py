"""The guard between any command and any haptic driver: deadline, limits, latched e-stop.

A command comes from `services/haptic_node/node.py`, after its way through both halves, and what is permitted of it goes
to the driver, which steps `telenano/hand/step.py` where the hand is simulated.

The guard decides from the command, its age and the present position alone, so that it is the same for a simulated and
a real device. It never trusts the controller: the driver gets only commands that have passed the guard.

The hand feels no jump: whenever position control begins (at start, after a lost link, after an e-stop), the applied
reference starts at the present position and moves towards the commanded one, at most at the speed limit. So control
resumes by itself as soon as commands are fresh, over any distance.

Arming concerns the tip: it follows only a hand that a person has armed since the start of the hand's node and since its
last emergency stop (`telenano.afm.safety`). The motor of a hand that was never armed is off for another reason: nothing
follows it.
"""

import math
from typing import NamedTuple

from telenano.extend.hands import MODE_FORCE, MODE_OFF, MODE_POSITION
from telenano.numerics.compiler import compiled

REASON_NONE, REASON_ESTOP, REASON_COMMAND_STALE, REASON_MODE_UNKNOWN, REASON_MODE_REFUSED = range(5)
REASON_REFERENCE_INVALID, REASON_TRAVEL_LIMIT, REASON_SPEED_LIMIT, REASON_FORCE_LIMIT = range(5, 9)
REASON_DEVICE_LOST, REASON_DEVICE_WAITS = range(9, 11)
REASONS: dict[int, str] = {
    REASON_NONE: "the motor follows the commands",
    REASON_ESTOP: "emergency stop is latched: off until armed",
    REASON_COMMAND_STALE: "no command within the deadline: off until commands are fresh",
    REASON_MODE_UNKNOWN: "mode code is not one of 0 (off), 1 (position), 2 (force): off",
    REASON_MODE_REFUSED: "this device does not have the commanded mode: off",
    REASON_REFERENCE_INVALID: "reference is not a finite number: off",
    REASON_TRAVEL_LIMIT: "reference held at the end of the allowed travel",
    REASON_SPEED_LIMIT: "reference moves at the speed limit towards the commanded position",
    REASON_FORCE_LIMIT: "reference held at the force limit",
    REASON_DEVICE_LOST: "the device is lost: off until it is back",
    REASON_DEVICE_WAITS: "the device gives no force for a reason of its own: off until it may be driven",
}


class SafetyParams(NamedTuple):
    """Limits of the guard and the modes that the guarded device has."""

    command_deadline_s: float
    position_min_m: float
    position_max_m: float
    max_speed_m_per_s: float
    max_force_n: float
    has_position_mode: bool
    has_force_mode: bool


class SafetyState(NamedTuple):
    """State of the guard: latch of the e-stop, mode and position reference that it applied last [m].

    armed: a person has armed the hand since its start, and no emergency stop has come since.
    """

    estop_latched: bool
    mode: int
    position_reference_m: float
    armed: bool = False


class SafetyInputs(NamedTuple):
    """The newest command, its age (infinite if there never was one), stop and arm requests, measured position.

    device_lost: position_m is not the present position of the arm, and nothing drives it. device_waits: the coupling of
    an impedance device gives no force, for example until the hand has been at rest.
    """

    command_mode: int
    position_reference_m: float
    force_reference_n: float
    command_age_s: float
    estop: bool
    arm_requested: bool
    position_m: float
    device_lost: bool = False
    device_waits: bool = False


class SafetyOutputs(NamedTuple):
    """The command to the driver. A reference that the mode does not use is the present position, or zero force.

    armed: the hand is armed and its device not lost, so that a tip may follow it.
    """

    mode: int
    position_reference_m: float
    force_reference_n: float
    reason: int
    estop_latched: bool
    armed: bool


@compiled
def _refusal(params: SafetyParams, inputs: SafetyInputs, latched: bool) -> int:
    """Return the reason why the device must be off instead of in the commanded mode, or REASON_NONE."""
    if latched:
        return REASON_ESTOP
    if inputs.device_lost:
        return REASON_DEVICE_LOST
    if inputs.device_waits:
        return REASON_DEVICE_WAITS
    # The comparison is written so that an age that is NaN counts as stale.
    if not inputs.command_age_s <= params.command_deadline_s:
        return REASON_COMMAND_STALE
    if inputs.command_mode == MODE_POSITION:
        if not params.has_position_mode:
            return REASON_MODE_REFUSED
        return REASON_NONE if math.isfinite(inputs.position_reference_m) else REASON_REFERENCE_INVALID
    if inputs.command_mode == MODE_FORCE:
        if not params.has_force_mode:
            return REASON_MODE_REFUSED
        return REASON_NONE if math.isfinite(inputs.force_reference_n) else REASON_REFERENCE_INVALID
    return REASON_NONE if inputs.command_mode == MODE_OFF else REASON_MODE_UNKNOWN


@compiled
def _limited_position(params: SafetyParams, start: float, wanted: float, dt: float) -> tuple[float, int]:
    reason = REASON_NONE
    target = min(max(wanted, params.position_min_m), params.position_max_m)
    if target != wanted:
        reason = REASON_TRAVEL_LIMIT
    reach = params.max_speed_m_per_s * dt
    if abs(target - start) > reach:
        target = start + math.copysign(reach, target - start)
        # The travel limit is the lasting cause: report it even while the reference is still moving there.
        reason = REASON_SPEED_LIMIT if reason == REASON_NONE else reason
    return target, reason


@compiled
def step(
    params: SafetyParams, state: SafetyState, inputs: SafetyInputs, dt: float
) -> tuple[SafetyState, SafetyOutputs]:
    """Guard one command over a period dt [s]; the module gives the rules, and REASONS the reasons in the outputs.

    An e-stop takes precedence over arming in the same step. A command exactly at the deadline is still fresh, and a
    reference exactly at a limit still allowed.
    """
    latched = inputs.estop or (state.estop_latched and not inputs.arm_requested)
    armed = not latched and (state.armed or inputs.arm_requested)
    reason = _refusal(params, inputs, latched)
    mode = inputs.command_mode if reason == REASON_NONE else MODE_OFF
    position, force = inputs.position_m, 0.0
    if mode == MODE_POSITION:
        start = state.position_reference_m if state.mode == MODE_POSITION else inputs.position_m
        position, reason = _limited_position(params, start, inputs.position_reference_m, dt)
    elif mode == MODE_FORCE:
        force = min(max(inputs.force_reference_n, -params.max_force_n), params.max_force_n)
        reason = REASON_NONE if force == inputs.force_reference_n else REASON_FORCE_LIMIT
    after = SafetyState(latched, mode, position, armed)
    return after, SafetyOutputs(mode, position, force, reason, latched, armed and not inputs.device_lost)
