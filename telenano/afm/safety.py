"""Safety chain of the AFM: limits the base position sent to any driver, whatever the controller commands.

A command comes from `services/afm_node/node.py`, and the base position that the chain permits goes to the driver, which
is a part of `telenano/afm/part.py` where the instrument is simulated.

Modes: RETRACTED (safe state, where a node starts), FOLLOW, HOLD, RETRACTING, ESTOP. A tick is decided in this order:

1. E-stop pressed: ESTOP from every mode. The base retracts; the mode remains after the release, until armed.
2. In FOLLOW or HOLD, device lost, repulsive or lateral force above its limit, or a force that is no finite number:
   RETRACTING.
3. No command for longer than the deadline: FOLLOW -> HOLD (the base stays); for hold_time longer: RETRACTING.
4. A fresh command: retract -> RETRACTING, hold -> HOLD, position -> FOLLOW. An unknown action code counts as hold.
   After HOLD the speed limit of the base rises gradually: the reference may have moved on while the base stood, and the
   tip must not jump after it.
5. RETRACTING ends in RETRACTED, which only arming (or an e-stop) leaves.

Whether a command is fresh depends on the hand behind it: `command_age_s` is the age of the newest command that descends
from a sample in which the hand was armed. So the tip follows no hand that is stopped, lost or silent, no matter who
arms the tip and in which order the devices are armed. A program of the instrument has no hand: its references have no
age.

Arming is a request. The chain accepts it if the device is present and the base retracted, in RETRACTED or in a released
ESTOP; otherwise the outputs carry the reason of the refusal. After that the tip stays in RETRACTED with the reason
ARMED until a fresh position command comes, which begins FOLLOW. An e-stop, a retract command or the loss of the device
cancels the request.

What comes back stays where it was made safe: the base of an instrument that was lost, or that another process drove, is
where its own read-out finds it (`found_at`).

Arming moves nothing. The references of a hand (`of_hand`) count from the position of the base when FOLLOW begins: the
base is at reference - offset, and the offset is chosen so that the base stays there. Only the permission `goes` lets
the base move towards the sample by itself, as far as `place_m`; this motion is called a way:

- at `speed_m_per_s` to its rest point (z = 0), but no nearer than a clearance in front of the surface it last met;
- if the place lies further, from there at the speed of the paper's approach (Fig. 12), until the tip feels the sample.

Another command ends this motion; if its target is a stated place, so does a hand that moves or presses. The base then
stays where it is (`ended`). A place that is not finite means the position of the hand, as at the start of a session:
the base goes there and moves with the hand. Such a way never ends in contact, because nobody may hold the hand: it ends
a clearance in front of the surface, even of one that it met itself, and the offset to a hand that is beyond stays.

The law sees the base without the offset, so that the offset looks to it like a sample that lies deeper by as much. The
references of a program (`of_hand` false) are positions of the base, without an offset.

`reason` is the cause of the last transition. The arrival in RETRACTED keeps the reason of the retraction, so that the
operator can still read it later.
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
# The names are those of the constants, in lower case and without the prefix.
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

# The ends of a way of the base to a place.
NOT_ENDED, ENDED_THERE, ENDED_BY_COMMAND, ENDED_BY_MOTION, ENDED_BY_FORCE = range(5)
ENDED_BY_SILENCE, ENDED_BY_CONTACT = range(5, 7)
# The causes that end a way before the base is there, in words.
ENDINGS: dict[int, str] = {
    ENDED_BY_COMMAND: "another command came",
    ENDED_BY_MOTION: "the hand moved",
    ENDED_BY_FORCE: "the hand pressed",
    ENDED_BY_SILENCE: "no fresh command of the hand came",
    ENDED_BY_CONTACT: "the tip felt the sample",
}

# The speed beyond the rest point of the base, or close to a surface [m/s]: that of the approach of Fig. 12 for 1 N at
# the hand.
LET_IN_M_PER_S = 15e-9
# A force on the tip above this, of either sign, means that the tip has met the sample [N].
SMALL_FORCE_N = 1e-9
# A force above this shows the surface at once [N], and one above SMALL_FORCE_N where it lasts for this time [s]: the
# noise of an instrument would otherwise be taken for a surface.
CLEAR_FORCE_N, TOUCHED_S = 5e-9, 0.02
# The pull of the water film begins within this distance of a surface [m]; a meniscus breaks at 4 nm in Table 2.
CLEARANCE_M = 5e-9
# A reference that moves further than this during a way shows that the hand moves [m]: it is 1 mm at the hand.
MOVED_M = 1.5e-9
# A force of the hand above this, of either sign, shows that the hand is not at rest [N].
PRESSED_N = 0.5
# The permission to go lapses if no armed hand comes within this time [s]: arming the hand later is no such permission.
WORD_WAITS_S = 5.0
# Positions of the base that differ by less count as equal [m].
_SAME_M = 1e-12


class SafetyState(NamedTuple):
    """Mode (MODE_*), base position last commanded [m] and reason (REASON_*) of the last transition.

    slower_m_per_s: reduction of the speed limit that is left after a hold [m/s]. offset_m: reference of the hand minus
    base [m]; surface_m: base position at which the tip last met a surface [m], infinite for never. goes: the base goes
    to place_m [m] at speed_m_per_s [m/s], or will when FOLLOW begins; from_m: the reference when it began [m];
    waited_s: time for which the permission to go has waited for a hand, or in FOLLOW for which a small force has lasted
    [s].
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
    """The inputs of one tick.

    reference_m: requested base position [m]; command_age_s: age of that command, and of the armed hand behind it [s],
    infinite if none ever came; action: ACTION_*; arm_requested: arming is requested in this tick; estop: the e-stop is
    pressed; force_n: tip force last measured [N], repulsive positive; device_lost: the tip is not measured and the base
    not reached; lateral_n: force across the tip [N]. of_hand: the reference is that of a hand, not a base position.
    goes, with arm_requested: the base may go to place_m [m], infinite for the position of the hand, at speed_m_per_s
    [m/s], infinite for the speed limit. interrupted: another command has come. hand_force_n: force of the hand [N].
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
    """Base position to apply [m], mode, `limited` (bits LIMITED_BY_*, 0 for none), reason, arm_refusal (ARM_*).

    offset_m: reference of the hand minus base [m]; ended: end of a way in this tick (ENDED_*, NOT_ENDED for none).
    """

    base_m: float
    mode: int
    limited: int
    reason: int
    arm_refusal: int
    offset_m: float = 0.0
    ended: int = NOT_ENDED


def found_at(state: SafetyState, base_m: float) -> SafetyState:
    """Return the state in which the base stays where the instrument says that it is [m], if that is further away.

    An instrument that comes back may have been made safe by itself, or by somebody else, at another place than the
    guard would choose. It stays there until a person arms it.
    """
    return state._replace(base_m=min(state.base_m, base_m)) if math.isfinite(base_m) else state


def initial_safety_state(params: SafetyParams) -> SafetyState:
    """Return the state in which every node starts: retracted."""
    return SafetyState(MODE_RETRACTED, params.retract_position_m, REASON_START)


@compiled
def safety_step(
    params: SafetyParams, state: SafetyState, inputs: SafetyInputs, dt: float
) -> tuple[SafetyState, SafetyOutputs]:
    """Decide mode and base position of one tick of dt [s]; return the state after it, and the outputs.

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
    """Return whether the tip is armed but still retracted, waiting for a fresh command to follow."""
    return mode == MODE_RETRACTED and reason == REASON_ARMED


def is_armed(mode: int, reason: int) -> bool:
    """Return whether the tip is armed: it follows, is held, or waits for a command."""
    return mode in (MODE_FOLLOW, MODE_HOLD) or is_wished(mode, reason)


@compiled
def is_placed(allowed: SafetyOutputs) -> bool:
    """Return whether the commanded base has reached its reference, up to the limits of range: it is not speed-limited.

    Only the command counts, not drift and creep of the real base behind it.
    """
    return allowed.mode == MODE_FOLLOW and allowed.limited & LIMITED_BY_SPEED == 0


@compiled
def nearest_m(surface_m: float) -> float:
    """Return the base position [m] up to which a way goes at full speed, for the surface that the base last met [m]."""
    return min(0.0, surface_m - CLEARANCE_M)


def way_s(
    params: SafetyParams,
    base_m: float,
    place_m: float,
    surface_m: float = math.inf,
    speed_m_per_s: float = math.inf,
) -> float:
    """Return the time [s] that the commanded base takes from base_m to place_m [m] if nothing ends its way.

    surface_m is the base position [m] at which the tip last met a surface, speed_m_per_s the speed of the way [m/s].
    """
    target = min(max(place_m, params.base_min_m), params.base_max_m)
    quick_m = max(min(target, nearest_m(surface_m)), min(base_m, target))
    speed = min(speed_m_per_s, params.base_speed_m_per_s)
    return abs(quick_m - base_m) / speed + max(target - quick_m, 0.0) / min(speed, LET_IN_M_PER_S)


@compiled
def _changed(state: SafetyState, offset_m: float, surface_m: float, goes: bool, waited_s: float) -> SafetyState:
    """Return the state with new values of the fields of a way that a tick changes."""
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
    """Return the state with the permission to go that came with an arming: place and speed."""
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
    """Return the state in which the base begins to follow a hand, or a way to a place, without a jump of the base.

    A retracted base that may go to the position of the hand gets the offset of that position instead, or of the nearest
    position that a way reaches at full speed.
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
    """Return the state with offset and way of this tick, and the end of a way in it (ENDED_*)."""
    if mode == MODE_HOLD:
        # A way to the position of the hand continues when its commands come again, unless a command ends it.
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
        # An arming request keeps its permission to go until another command comes, or WORD_WAITS_S have passed.
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
    # On a way to the hand, attraction shows the surface as well. A small force has to last, because noise exceeds it.
    force = abs(inputs.force_n) if state.goes and not math.isfinite(state.place_m) else inputs.force_n
    touched = state.waited_s + dt if force > SMALL_FORCE_N else 0.0
    surface = state.base_m if touched >= TOUCHED_S or force > CLEAR_FORCE_N else state.surface_m
    offset, goes = state.offset_m, state.goes
    if ended == NOT_ENDED and goes:
        offset, ended = _way(params, state, inputs, dt)
    if ended > ENDED_THERE:
        offset = inputs.reference_m - state.base_m
    return _changed(state, offset, surface, goes and ended == NOT_ENDED, touched), ended


@compiled
def _is_on_the_way(way: SafetyState, base_m: float) -> bool:
    """Return whether a base that goes has not arrived: at a stated place, or where full speed ends before the hand.

    A base that has met a surface on its way has arrived once it is in front of that again.
    """
    if math.isfinite(way.place_m):
        return True
    beyond_m = base_m - nearest_m(way.surface_m)
    return way.offset_m > 0.0 and (beyond_m < -_SAME_M or (math.isfinite(way.surface_m) and beyond_m > _SAME_M))


@compiled
def _ending(state: SafetyState, inputs: SafetyInputs) -> int:
    """Return the input that ends a way in this tick (ENDED_BY_*), or NOT_ENDED."""
    if inputs.interrupted or (inputs.arm_requested and not inputs.goes):
        return ENDED_BY_COMMAND
    if not math.isfinite(state.place_m):
        return NOT_ENDED
    # The comparisons are written so that a reference or a force that is NaN also ends the way.
    if not abs(inputs.reference_m - state.from_m) <= MOVED_M:
        return ENDED_BY_MOTION
    return NOT_ENDED if abs(inputs.hand_force_n) <= PRESSED_N else ENDED_BY_FORCE


@compiled
def _way(params: SafetyParams, state: SafetyState, inputs: SafetyInputs, dt: float) -> tuple[float, int]:
    """Return the offset [m] at this tick of a motion to a place, and how that ended (ENDED_*, NOT_ENDED)."""
    reference, offset = inputs.reference_m, state.offset_m
    goal = 0.0
    if math.isfinite(state.place_m):
        goal = reference - min(max(state.place_m, params.base_min_m), params.base_max_m)
    speed = min(state.speed_m_per_s, params.base_speed_m_per_s)
    is_stated = math.isfinite(state.place_m)
    least = max(reference - nearest_m(state.surface_m), goal)
    # A base that goes to the hand stays clear of a surface that is known, also of one that it meets on its way.
    is_near = not is_stated and math.isfinite(state.surface_m) and offset < least
    if not is_stated and not is_near and abs(inputs.force_n) > SMALL_FORCE_N:
        # The base waits where a force begins, until that has lasted for long enough to show a surface, or has gone.
        return max(reference - state.base_m, offset), NOT_ENDED
    way_m, reach_m = reference - offset - state.base_m, params.base_speed_m_per_s * dt
    if way_m > reach_m or (way_m < -reach_m and not is_stated):
        # The base has not yet reached reference - offset.
        return least if is_near else offset, NOT_ENDED
    if is_near:
        offset = min(offset + speed * dt, least)
        return offset, ENDED_THERE if offset == least else NOT_ENDED
    if offset < goal:
        offset = min(offset + speed * dt, goal)
        return offset, ENDED_THERE if offset == goal else NOT_ENDED
    if offset > least:
        offset = max(offset - speed * dt, least)
    elif offset > goal:
        if not is_stated and math.isfinite(state.surface_m):
            return offset, ENDED_THERE
        if abs(inputs.force_n) > SMALL_FORCE_N:
            return offset, ENDED_BY_CONTACT if is_stated else NOT_ENDED
        offset = max(offset - min(speed, LET_IN_M_PER_S) * dt, goal)
    return offset, ENDED_THERE if offset == goal else NOT_ENDED


@compiled
def _fresh(params: SafetyParams, inputs: SafetyInputs) -> bool:
    # The comparison is written so that an age or a reference that is NaN counts as no command.
    return inputs.command_age_s <= params.command_deadline_s and math.isfinite(inputs.reference_m)


@compiled
def _next_mode(params: SafetyParams, state: SafetyState, inputs: SafetyInputs) -> tuple[int, int]:
    """Return the mode after this tick, without arming and the arrival in RETRACTED, and its reason."""
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
    """Return the reduction of the speed limit in this tick [m/s]: nearly all of it after a hold, then less."""
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
        # A base further away than the retract position stays there: retracting never moves towards the sample.
        return max(base_m - params.retract_speed_m_per_s * dt, min(base_m, params.retract_position_m)), 0
    # A base that was found below its range comes up only as far as its reference does: the range drives nothing.
    target = min(max(reference_m, min(params.base_min_m, base_m)), params.base_max_m)
    limited = LIMITED_BY_RANGE if target != reference_m else 0
    reach = speed_m_per_s * dt
    base = min(max(target, base_m - reach), base_m + reach)
    if base != target:
        limited |= LIMITED_BY_SPEED
    return base, limited
