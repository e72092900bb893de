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

Arming starts nothing. The references of a hand (`of_hand`) count from where the base is when FOLLOW begins: the base is
at reference - offset, and the offset is chosen so that it stays there. Only the word for it (`goes`) lets the base go
towards the sample by itself, as far as `place_m`:

- at `speed_m_per_s` to its rest point (z = 0), and no nearer than a clearance in front of the surface it last met;
- further, where the place lies beyond, at the speed of the paper's approach (Fig. 12), until it feels the sample.

A way ends by another command, and one to a stated place by a hand that moves or presses too: the base stays where it is
then (`ended`). A place that is not finite is where the hand stands, as at the start of a session: the base goes there
with the hand.

The law sees the base where it would be without the offset, so the offset is to it a sample that lies deeper by as much.
The references of a program (`of_hand` false) are places of the base, and no offset acts on them.

`reason` is why the last transition happened. The arrival in RETRACTED keeps the reason of the retraction, so that it
can still be read when the operator comes back.
"""

import math
from typing import NamedTuple

from telenano.extend.instruments import SafetyParams
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

# How a way of the base to a place has ended.
NOT_ENDED, ENDED_THERE, ENDED_BY_COMMAND, ENDED_BY_MOTION, ENDED_BY_FORCE = range(5)
ENDED_BY_SILENCE, ENDED_BY_CONTACT = range(5, 7)
# What ends a way before the base is there, in words.
ENDINGS: dict[int, str] = {
    ENDED_BY_COMMAND: "another command came",
    ENDED_BY_MOTION: "the hand moved",
    ENDED_BY_FORCE: "the hand pressed",
    ENDED_BY_SILENCE: "no fresh command of the hand came",
    ENDED_BY_CONTACT: "the tip felt the sample",
}

# The speed beyond the rest point of the base, or in front of a surface: of the approach of Fig. 12 for 1 N at the hand
# [m/s].
LET_IN_M_PER_S = 15e-9
# A tip that is pressed or pulled with more than this has met the sample [N].
SMALL_FORCE_N = 1e-9
# The pull of the water film begins within this distance of a surface [m]; a meniscus breaks at 4 nm in Table 2.
CLEARANCE_M = 5e-9
# A reference that goes further than this while the base is on its way is of a hand that moves [m]: 1 mm at the hand.
MOVED_M = 1.5e-9
# A hand that presses or pulls with more than this is no hand at rest [N].
PRESSED_N = 0.5
# A word to go is void when no armed hand has come for this time [s]: who arms the hand later means no more than that.
WORD_WAITS_S = 5.0
# Places of the base that differ by less are the same [m].
_SAME_M = 1e-12


class SafetyState(NamedTuple):
    """Mode (MODE_*), base position last commanded [m] and reason (REASON_*) of the last transition.

    slower_m_per_s: what the base is still kept below its speed limit after a hold [m/s]. offset_m: how far the base is
    away from the sample of the reference of a hand [m]; surface_m: where the base last met a surface [m], infinite for
    never. goes: the base goes to place_m [m], or will when FOLLOW begins; from_m: the reference when it began [m];
    waited_s: for how long its word has waited for a hand [s].
    """

    mode: int
    base_m: float
    reason: int
    slower_m_per_s: float = 0.0
    offset_m: float = 0.0
    surface_m: float = math.inf
    goes: bool = False
    place_m: float = math.inf
    speed_m_per_s: float = math.inf
    from_m: float = 0.0
    waited_s: float = 0.0


class SafetyInputs(NamedTuple):
    """One tick of inputs.

    reference_m: base position asked for [m]; command_age_s: age of that command, and of the armed hand behind it [s],
    infinite if none ever came; action: ACTION_*; arm_requested: now; estop: pressed; force_n: tip force last measured
    [N], repulsive positive; device_lost: nothing is known of the tip, and nothing reaches the base; lateral_n: force
    across the tip [N]. of_hand: the reference is that of a hand, and no place of the base. goes, with arm_requested:
    the base may go to place_m [m] at speed_m_per_s [m/s], where infinite means that of the hand, and the speed limit.
    interrupted: another command has come. hand_force_n: what the hand presses with [N].
    """

    reference_m: float
    command_age_s: float
    action: int
    arm_requested: bool
    estop: bool
    force_n: float
    device_lost: bool = False
    lateral_n: float = 0.0
    of_hand: bool = False
    goes: bool = False
    place_m: float = math.inf
    speed_m_per_s: float = math.inf
    interrupted: bool = False
    hand_force_n: float = 0.0


class SafetyOutputs(NamedTuple):
    """Base position to apply [m], mode, `limited` (bits LIMITED_BY_*, 0 for none), reason, why arming was refused.

    offset_m: how far the base is away from the sample of the hand's reference [m]; ended: how a way to a place has
    ended in this tick (ENDED_*).
    """

    base_m: float
    mode: int
    limited: int
    reason: int
    arm_refusal: int
    offset_m: float = 0.0
    ended: int = NOT_ENDED


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
            state = _worded(state, inputs)
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
    way, ended = _next_way(params, state, inputs, mode, reason, dt)
    base, limited = _next_base(params, state.base_m, mode, inputs.reference_m - way.offset_m, speed, dt)
    if way.goes and mode == MODE_FOLLOW and _is_on_the_way(way, base):
        limited |= LIMITED_BY_SPEED
    if mode == MODE_RETRACTING and base <= params.retract_position_m:
        mode = MODE_RETRACTED
    after = SafetyState(
        mode,
        base,
        reason,
        slower,
        way.offset_m,
        way.surface_m,
        way.goes,
        way.place_m,
        way.speed_m_per_s,
        way.from_m,
        way.waited_s,
    )
    return after, SafetyOutputs(base, mode, limited, reason, refusal, way.offset_m, ended)


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


@compiled
def nearest_m(surface_m: float) -> float:
    """Return how near the base goes to the sample at the speed of a way [m], for a surface that it last met [m]."""
    return min(0.0, surface_m - CLEARANCE_M)


def way_s(
    params: SafetyParams,
    base_m: float,
    place_m: float,
    surface_m: float = math.inf,
    speed_m_per_s: float = math.inf,
) -> float:
    """Return how long the commanded base takes from base_m to a place [s], where nothing ends its way."""
    target = min(max(place_m, params.base_min_m), params.base_max_m)
    quick_m = max(min(target, nearest_m(surface_m)), min(base_m, target))
    speed = min(speed_m_per_s, params.base_speed_m_per_s)
    return abs(quick_m - base_m) / speed + max(target - quick_m, 0.0) / min(speed, LET_IN_M_PER_S)


@compiled
def _changed(state: SafetyState, offset_m: float, surface_m: float, goes: bool, waited_s: float) -> SafetyState:
    """Return the state with other values of what a tick changes of a way."""
    return SafetyState(
        state.mode,
        state.base_m,
        state.reason,
        state.slower_m_per_s,
        offset_m,
        surface_m,
        goes,
        state.place_m,
        state.speed_m_per_s,
        state.from_m,
        waited_s,
    )


@compiled
def _worded(state: SafetyState, inputs: SafetyInputs) -> SafetyState:
    """Return the state with the word of an arming: where the base may go."""
    return SafetyState(
        state.mode,
        state.base_m,
        state.reason,
        state.slower_m_per_s,
        state.offset_m,
        state.surface_m,
        inputs.goes,
        inputs.place_m,
        inputs.speed_m_per_s,
        inputs.reference_m,
        0.0,
    )


@compiled
def _begun(state: SafetyState, inputs: SafetyInputs) -> SafetyState:
    """Return the state with which the base begins to follow a hand, or to go to a place: it stays where it is.

    A withdrawn base that goes where the hand is goes there, or to where the hand is let in from, with the hand.
    """
    offset = inputs.reference_m - state.base_m
    if state.goes and not math.isfinite(state.place_m) and state.mode != MODE_FOLLOW:
        offset = max(inputs.reference_m - nearest_m(state.surface_m), 0.0)
    return SafetyState(
        state.mode,
        state.base_m,
        state.reason,
        state.slower_m_per_s,
        offset,
        state.surface_m,
        state.goes,
        state.place_m,
        state.speed_m_per_s,
        inputs.reference_m,
        0.0,
    )


@compiled
def _next_way(
    params: SafetyParams, state: SafetyState, inputs: SafetyInputs, mode: int, reason: int, dt: float
) -> tuple[SafetyState, int]:
    """Return the state with offset and way of this tick, and how a way has ended in it."""
    if mode == MODE_HOLD:
        # A base that goes to the place of the hand goes on when its commands come again, unless a command ends that.
        ended = NOT_ENDED
        if state.goes and (inputs.interrupted or (inputs.arm_requested and not inputs.goes)):
            ended = ENDED_BY_COMMAND
        elif state.goes and math.isfinite(state.place_m):
            ended = ENDED_BY_SILENCE
        if ended == NOT_ENDED:
            return state, NOT_ENDED
        reference = inputs.reference_m if math.isfinite(inputs.reference_m) else state.from_m
        return _changed(state, reference - state.base_m, state.surface_m, False, 0.0), ended
    if mode != MODE_FOLLOW or not inputs.of_hand:
        # A wish keeps its word until another command comes, and for as long as a person waits for it.
        waited = state.waited_s + dt if state.goes else 0.0
        goes = state.goes and not inputs.interrupted and is_wished(mode, reason) and waited <= WORD_WAITS_S
        return _changed(state, 0.0, state.surface_m, goes, waited if goes else 0.0), NOT_ENDED
    ended = NOT_ENDED
    if state.mode == MODE_RETRACTED or state.mode == MODE_ESTOP:
        state = _begun(state, inputs)
    elif inputs.arm_requested and inputs.goes and (math.isfinite(inputs.place_m) or state.offset_m != 0.0):
        state = _begun(_worded(state, inputs), inputs)
    elif state.goes:
        ended = _ending(state, inputs)
    surface = state.base_m if inputs.force_n > SMALL_FORCE_N else state.surface_m
    offset, goes = state.offset_m, state.goes
    if ended == NOT_ENDED and goes:
        offset, ended = _way(params, state, inputs, dt)
    if ended > ENDED_THERE:
        offset = inputs.reference_m - state.base_m
    return _changed(state, offset, surface, goes and ended == NOT_ENDED, 0.0), ended


@compiled
def _is_on_the_way(way: SafetyState, base_m: float) -> bool:
    """Return whether a base that goes is not where it is placed: at a stated place, or where a hand is let in from."""
    return math.isfinite(way.place_m) or (way.offset_m > 0.0 and base_m < nearest_m(way.surface_m) - _SAME_M)


@compiled
def _ending(state: SafetyState, inputs: SafetyInputs) -> int:
    """Return by which input a way ends now."""
    if inputs.interrupted or (inputs.arm_requested and not inputs.goes):
        return ENDED_BY_COMMAND
    if not math.isfinite(state.place_m):
        return NOT_ENDED
    # Written so that a reference or a force that is no number ends it too.
    if not abs(inputs.reference_m - state.from_m) <= MOVED_M:
        return ENDED_BY_MOTION
    return NOT_ENDED if abs(inputs.hand_force_n) <= PRESSED_N else ENDED_BY_FORCE


@compiled
def _way(params: SafetyParams, state: SafetyState, inputs: SafetyInputs, dt: float) -> tuple[float, int]:
    """Return the offset of this tick of a way, and whether and how the way has ended with it."""
    reference, offset = inputs.reference_m, state.offset_m
    goal = 0.0
    if math.isfinite(state.place_m):
        goal = reference - min(max(state.place_m, params.base_min_m), params.base_max_m)
    speed = min(state.speed_m_per_s, params.base_speed_m_per_s)
    if reference - offset > state.base_m + params.base_speed_m_per_s * dt:
        # The base has still to come to where the offset lets it be.
        return offset, NOT_ENDED
    if offset < goal:
        offset = min(offset + speed * dt, goal)
        return offset, ENDED_THERE if offset == goal else NOT_ENDED
    least = max(reference - nearest_m(state.surface_m), goal)
    if offset > least:
        offset = max(offset - speed * dt, least)
    elif offset > goal:
        if abs(inputs.force_n) > SMALL_FORCE_N:
            return offset, ENDED_BY_CONTACT
        offset = max(offset - min(speed, LET_IN_M_PER_S) * dt, goal)
    return offset, ENDED_THERE if offset == goal else NOT_ENDED


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
