"""A scripted hand that steers the tip in rate control over a link, so that it pushes a particle to a goal.

It perceives the answers of the instrument, the place of the tip and the lateral force, and acts on them a reaction time
later, with errors of sight and touch and a tremor. It moves behind the believed place of the particle, pushes it, turns
it towards the goal (`steering`), slows down before the goal, and stops there. If the force vanishes before the goal, it
has lost the particle, and moves behind it again. After stopping it waits for the effect of its last motion, and
corrects the place if the remaining distance exceeds its tolerance.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.lockstep import HandSteps
from telenano.numerics import compiled
from telenano_lab.assembly.particles.push import KINETIC, RADIUS
from telenano_lab.assembly.particles.steering import steered
from telenano_lab.assembly.particles.tip_shape import touch_distance_m

Array = npt.NDArray[np.float64]

# Columns of `plan`: goal [m], d [m], kinetic friction [N], speed [m/s], gain of the speed before the goal [1/s], tick
# at which it begins, ticks that it waits, tolerance [m]; errors of force, place [m], speed and heading [rad].
GOAL_X, GOAL_Y, D, FRICTION, SPEED, GAIN, BEGINS, WAITS, LEAVES, FORCE_ERROR, PLACE_ERROR, TREMOR, HEADING = range(13)
PLAN = 13
# Columns of `state`: believed place of the particle [m], phase, ticks without force, ticks of waiting, losses, tick at
# which it was done, largest lateral and normal force [N], true place of the particle [m], mean of the felt force [N],
# and whether the particle was felt since the push began.
BELIEVED_X, BELIEVED_Y, PHASE, FAINT, WAITED, LOSSES, DONE_AT, PEAK_ACROSS, PEAK_ALONG, TRUE_X, TRUE_Y = range(11)
FELT_X, FELT_Y, TOUCHED = range(11, 14)
STATE = 14
APPROACHES, PUSHES, STANDS, DONE = range(4)

# A lateral force above this share of the friction is a contact.
_CONTACT = 0.3
# A contact is lost after this number of ticks below that share.
_FAINT_TICKS = 60
# The particle was missed if the tip comes nearer to its place than this multiple of d without a contact.
_MISSED = 0.7
# The felt force is a mean over this number of ticks.
_FELT_TICKS = 100.0
# The tip goes behind the particle by this multiple of d.
_BEHIND = 1.35
# On the way there the tip keeps this multiple of d from the particle.
_KEEPS = 1.25
# A particle that lies further aside than this angle is approached again; this is its cosine.
_MOST_ASIDE = math.cos(math.radians(75.0))
# Number of ticks for which the errors of the hand stay the same.
_HELD_TICKS = 20


class Hand(NamedTuple):
    """A hand and its link: `plan` and `state`, a row of columns each.

    seen: place and force in the newest answer, (4,) [m, N]; perceived: those of the reaction time, (ticks, 4); errors:
    standard normal numbers, (k, 6), in the order of their use.
    """

    plan: Array
    state: Array
    seen: Array
    perceived: Array
    errors: Array


class Push(NamedTuple):
    """The task of a hand, and its limits.

    goal_m, place_m: of the particle [m]; d_m: distance of the particle's centre from the axis of a touching tip [m];
    friction_n: kinetic friction of the particle [N]; speed_m_per_s: greatest speed of the tip; reaction_s: reaction
    time of the hand; answers_s: further delay until the hand sees the effect of its motion [s]; leaves_m: tolerance
    [m].
    """

    goal_m: tuple[float, float]
    place_m: tuple[float, float]
    d_m: float
    friction_n: float
    speed_m_per_s: float
    reaction_s: float
    answers_s: float
    leaves_m: float


# The standard error of the place of a particle in the first image.
_IMAGE_M = 10e-9
# The error with which the eye reads the tip's place.
_PLACE_M = 5e-9
# The errors of the felt force and of the hand's speed are shares of them.
_FORCE_SHARE = 0.1
_TREMOR = 0.15
# The error of the hand's heading [rad].
_TURN = 0.05
# The errors of the hand are drawn for this number of ticks.
_ERRORS = 2048


def new_hand(push: Push, random: np.random.Generator, begins: int, period_s: float) -> Hand:
    """Return a hand before its first tick.

    Args:
        push: Its task.
        random: The source of its errors.
        begins: The tick of the session at which it begins.
        period_s: The time between two ticks [s].
    """
    plan, state = np.zeros(PLAN), np.zeros(STATE)
    plan[[GOAL_X, GOAL_Y]], plan[D], plan[FRICTION] = push.goal_m, push.d_m, push.friction_n
    late_s = push.reaction_s + push.answers_s
    # The hand slows down early enough that the delay does not carry it past the goal.
    plan[SPEED], plan[GAIN] = push.speed_m_per_s, 0.35 / late_s
    plan[BEGINS], plan[LEAVES], plan[WAITS] = begins, push.leaves_m, round((late_s + 0.1) / period_s)
    plan[[FORCE_ERROR, PLACE_ERROR, TREMOR, HEADING]] = _FORCE_SHARE, _PLACE_M, _TREMOR, _TURN
    state[[BELIEVED_X, BELIEVED_Y]] = np.array(push.place_m) + _IMAGE_M * random.standard_normal(2)
    state[[TRUE_X, TRUE_Y]] = push.place_m
    return Hand(
        plan=plan,
        state=state,
        seen=np.zeros(4),
        perceived=np.zeros((round(push.reaction_s / period_s), 4)),
        errors=random.standard_normal((_ERRORS, 6)),
    )


def push_of(
    layer: Any,
    goal_m: tuple[float, float],
    speed_m_per_s: float,
    reaction_s: float,
    answers_s: float,
    leaves_m: float,
) -> Push:
    """Return the push of the first particle of a layer, given by its parameters (`particles.layer`).

    The other arguments are those of `Push`.
    """
    x_m, y_m = layer.start[0, :2].tolist()
    return Push(
        goal_m=goal_m,
        place_m=(x_m, y_m),
        d_m=touch_distance_m(layer.tip, float(layer.fixed[0, RADIUS]), 0.0),
        friction_n=float(layer.fixed[0, KINETIC]),
        speed_m_per_s=speed_m_per_s,
        reaction_s=reaction_s,
        answers_s=answers_s,
        leaves_m=leaves_m,
    )


class PushOutcome(NamedTuple):
    """The result of a hand: whether it is done, and at which tick; the true place of the particle [m].

    losses: number of times that it lost the particle; peak_n, press_n: the largest lateral and normal force on the tip
    [N].
    """

    done: bool
    done_tick: float
    place_m: Array
    losses: int
    peak_n: float
    press_n: float


def carried_out(hand: Hand) -> PushOutcome:
    """Return the result of a hand so far."""
    state = hand.state
    return PushOutcome(
        done=bool(state[PHASE] == DONE),
        done_tick=state[DONE_AT],
        place_m=state[[TRUE_X, TRUE_Y]],
        losses=int(state[LOSSES]),
        peak_n=float(state[PEAK_ACROSS]),
        press_n=float(state[PEAK_ALONG]),
    )


@compiled
def hand_moves(hand: Hand, tick: int) -> tuple[float, float]:
    """Return the velocity of the tip that the hand asks for at a tick of the session [m/s]."""
    plan, state = hand.plan, hand.state
    slot = tick % hand.perceived.shape[0]
    x, y, force_x, force_y = (
        hand.perceived[slot, 0],
        hand.perceived[slot, 1],
        hand.perceived[slot, 2],
        hand.perceived[slot, 3],
    )
    hand.perceived[slot] = hand.seen
    if tick < plan[BEGINS] or state[PHASE] == DONE:
        return 0.0, 0.0
    errors = hand.errors[(tick // _HELD_TICKS) % hand.errors.shape[0]]
    x, y = x + plan[PLACE_ERROR] * errors[0], y + plan[PLACE_ERROR] * errors[1]
    # The error of a felt force is a share of that force.
    error = plan[FORCE_ERROR] * math.sqrt(force_x * force_x + force_y * force_y)
    force_x, force_y = force_x + error * errors[2], force_y + error * errors[3]
    way_x, way_y, share = _wanted(plan, state, x, y, force_x, force_y, tick)
    # The tremor disturbs both speed and heading.
    share, turn = share * (1.0 + plan[TREMOR] * errors[4]), plan[HEADING] * errors[5]
    speed = plan[SPEED] * min(max(share, 0.0), 1.0)
    return speed * (way_x - turn * way_y), speed * (way_y + turn * way_x)


@compiled
def _wanted(
    plan: Array, state: Array, x: float, y: float, force_x: float, force_y: float, tick: int
) -> tuple[float, float, float]:
    """Return the direction in which the hand moves the tip, of length 1, and the share of its greatest speed."""
    d, least = plan[D], _CONTACT * plan[FRICTION]
    touches = force_x * force_x + force_y * force_y > least * least
    share = 1.0 / _FELT_TICKS if state[FAINT] == 0.0 else 1.0
    if touches:
        state[FELT_X] += share * (force_x - state[FELT_X])
        state[FELT_Y] += share * (force_y - state[FELT_Y])
    force_x, force_y = state[FELT_X], state[FELT_Y]
    size = max(math.sqrt(force_x * force_x + force_y * force_y), 1e-15)
    if touches:
        state[FAINT], state[TOUCHED] = 0.0, 1.0
        state[BELIEVED_X], state[BELIEVED_Y] = x - d * force_x / size, y - d * force_y / size
    else:
        state[FAINT] += 1.0
    to_x, to_y = plan[GOAL_X] - state[BELIEVED_X], plan[GOAL_Y] - state[BELIEVED_Y]
    left = max(math.sqrt(to_x * to_x + to_y * to_y), 1e-15)
    to_x, to_y = to_x / left, to_y / left
    if state[PHASE] == STANDS:
        state[WAITED] += 1.0
        if state[WAITED] > plan[WAITS]:
            state[PHASE] = DONE if left <= plan[LEAVES] else APPROACHES
            state[DONE_AT] = tick
        return 1.0, 0.0, 0.0
    if left <= 0.5 * plan[LEAVES]:
        state[PHASE], state[WAITED] = STANDS, 0.0
        return 1.0, 0.0, 0.0
    slow = plan[GAIN] / plan[SPEED]
    if touches:
        ahead_x, ahead_y = -force_x / size, -force_y / size
        if ahead_x * to_x + ahead_y * to_y > _MOST_ASIDE:
            state[PHASE] = PUSHES
            way_x, way_y = steered(ahead_x, ahead_y, to_x, to_y)
            return way_x, way_y, min(slow * left, 1.0)
        if state[PHASE] == PUSHES:
            # The tip has passed the goal, or the particle has slipped aside.
            state[PHASE] = STANDS if left <= plan[LEAVES] else APPROACHES
            state[WAITED] = 0.0
            state[LOSSES] += 0.0 if left <= plan[LEAVES] else 1.0
        return -ahead_x, -ahead_y, 0.5
    from_x, from_y = state[BELIEVED_X] - x, state[BELIEVED_Y] - y
    between = max(math.sqrt(from_x * from_x + from_y * from_y), 1e-15)
    if state[PHASE] == PUSHES:
        felt = state[TOUCHED] > 0.0
        if state[FAINT] <= _FAINT_TICKS if felt else from_x * to_x + from_y * to_y > _MISSED * d:
            return from_x / between, from_y / between, 0.5
        state[PHASE] = APPROACHES
        state[LOSSES] += state[TOUCHED]
    way_x, way_y = from_x - _BEHIND * d * to_x, from_y - _BEHIND * d * to_y
    way = max(math.sqrt(way_x * way_x + way_y * way_y), 1e-15)
    if way < 0.15 * d:
        state[PHASE], state[FAINT], state[TOUCHED] = PUSHES, 1.0, 0.0
        return from_x / between, from_y / between, 0.5
    share = min(slow * way + 0.1, 1.0)
    way_x, way_y = way_x / way, way_y / way
    inwards = (way_x * from_x + way_y * from_y) / between
    if between < _KEEPS * d and inwards > 0.0:
        # Move around the particle, and away from it if too near.
        out_x, out_y = -from_x / between, -from_y / between
        along_x, along_y = way_x + inwards * out_x, way_y + inwards * out_y
        length = math.sqrt(along_x * along_x + along_y * along_y)
        if length < 1e-3:
            along_x, along_y, length = -out_y, out_x, 1.0
        more = 4.0 * (_KEEPS - between / d)
        way_x, way_y = along_x / length + more * out_x, along_y / length + more * out_y
        length = math.sqrt(way_x * way_x + way_y * way_y)
        way_x, way_y = way_x / length, way_y / length
    return way_x, way_y, share


@compiled
def _sees(hand: Hand, answer: Array) -> None:
    hand.seen[:] = answer


@compiled
def _notes(hand: Hand, part: Any, force_n: float, across_n: tuple[float, float]) -> None:
    """Record the largest forces on the tip [N] and the true place of the first particle [m]."""
    state, across = hand.state, np.sqrt(across_n[0] * across_n[0] + across_n[1] * across_n[1])
    state[PEAK_ACROSS], state[PEAK_ALONG] = max(state[PEAK_ACROSS], across), max(state[PEAK_ALONG], force_n)
    state[TRUE_X], state[TRUE_Y] = part.moving[0, 0], part.moving[0, 1]


@compiled
def _ends(hand: Hand) -> bool:
    return bool(hand.state[PHASE] == DONE)


@compiled
def _writes(hand: Hand, row: Array) -> None:
    row[0], row[1] = hand.state[TRUE_X], hand.state[TRUE_Y]


_COLUMNS = {
    "particle_x_m": ("m", "Where the particle really is, x"),
    "particle_y_m": ("m", "Where the particle really is, y"),
}
HandSteps(hand_moves, _sees, _notes, _ends, _writes, _COLUMNS).register(Hand)
