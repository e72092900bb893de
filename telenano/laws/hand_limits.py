"""The limits of hand and tip act on every law like a stop that bears a part of the operator's force.

The guard of the hand carries out no reference beyond its travel, and none faster than its speed limit; a device that is
stuck carries out none at all, and a tip at the end of its range does not follow one. A law that integrated the
operator's force there would send the reference on alone, and would have to come all the way back before hand and tip
moved again. A stop lets through the force F' with which, after the step,

    x + max(x', 0) c <= x_max,   |x'| <= v_max,   and likewise at the other end,

where x is the reference of the hand, x_max the nearest of three ends (`ends`), and c, two periods, makes it come to
rest there without a bounce. The law takes its ordinary step with F', so its state is one that it reaches by itself, and
what it promises for any force of the hand it promises at a limit too: the stop takes energy from the mass, and gives
none. The force that the law sends to the tip is F' too. When the hand is drawn back, F_m acts again at once, from where
hand and tip are.

A step of a law is pure, so F' is found by repeating it, with the secant of two forces (`tried`). The reference of
nearly every law is linear in the force over a period, and two repetitions suffice; where energy runs out a step is not
linear, and the search goes on between a force that keeps the limit and one that does not. A reference that does not
depend on the force, as in tactile feedback, is cut at the end of the travel (`cut`).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from telenano.extend.laws import HandSample, MasterReference, PortSignal
from telenano.extend.virtual_mass import LONGEST_LEAD_M, bounded
from telenano.numerics.compiler import compiled

# Distance from a limit at which a force is accepted, at the hand [m]: far below the resolution of any device.
_NEAR_M = 1e-9
# Distance within a limit at which it is accepted, because a smaller one would not be felt [m].
_INSIDE_M = 1e-8
# Greatest number of steps of a search; the last one takes a force that is known to keep the limit.
_MOST_TRIALS = 8
# Number of steps after which a reference that does not follow from the force is left as it is.
_MOST_FLAT = 4
# Least share of the interval between two forces by which a trial narrows it.
_LEAST_SHARE = 0.05
# Greatest force that a stop bears, as that of a message [N].
_MOST_N = 1e6
# Look-ahead c of the stop [periods].
_AHEAD_PERIODS = 2.0
# A device in motion lags its reference by its speed times at most this time [s], besides LONGEST_LEAD_M.
_LAG_S = 0.25
# Greatest lead over a tip that carries out each reference as it is, at the hand [m]: that of a period or two.
PASSED_LEAD_M = 3e-4
_WITHIN, _ABOVE, _BELOW = 0, 1, -1


class HandLimits(NamedTuple):
    """The travel of the hand's reference [m], its greatest speed [m/s], the look-ahead c [s], and its lead on the tip.

    position_scale: metres at the tip per metre at the hand; 0 for a law whose signals do not have the places of the
    tip, as those of waves, so that the tip bounds nothing. tip_lead_m: greatest lead over the tip at the hand [m],
    besides the way of the hand during a round trip of the line.
    """

    low_m: float
    high_m: float
    speed_m_per_s: float
    ahead_s: float
    position_scale: float
    tip_lead_m: float


class Ends(NamedTuple):
    """The ends between which the reference of the hand must be after a step [m]."""

    low_m: float
    high_m: float


class Trial(NamedTuple):
    """The search for the force that a stop lets through.

    side: 1 beyond the upper end, -1 below the lower one, 0 within the limits; force_n, over_m: force of the last step
    [N], and distance by which its reference passes the limit [m]; outer_n, outer_m: the same of the nearest force that
    is too much; inner_n, inner_m: of the nearest one that is not, if `has_inner`; next_n: force to try next [N]; steps:
    number of steps so far; done: the last one counts.
    """

    side: int
    force_n: float
    over_m: float
    outer_n: float
    outer_m: float
    inner_n: float
    inner_m: float
    has_inner: bool
    next_n: float
    steps: int
    done: bool


def hand_limits(
    low_m: float, high_m: float, speed_m_per_s: float, period_s: float, position_scale: float, *, passes: bool
) -> HandLimits:
    """Return the limits of a hand with a travel [m] and a greatest speed [m/s], for a period [s] and a scale.

    passes: the slave half passes each reference on as it is.
    """
    lead_m = PASSED_LEAD_M if passes else LONGEST_LEAD_M
    return HandLimits(low_m, high_m, speed_m_per_s, _AHEAD_PERIODS * period_s, position_scale, lead_m)


@compiled
def free() -> Trial:
    """Return the search of a hand that is at no limit."""
    return Trial(_WITHIN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False, 0.0, 0, True)


@compiled
def _room_m(limits: HandLimits, side: int, hand: HandSample, before_m: float, ahead_m: float, trip_s: float) -> float:
    """Return the place of the end at one side, along that side [m]; other arguments as in `ends`.

    ahead_m: distance by which the reference leads the tip, at the hand's scale [m], 0 if that is unknown.
    """
    end = limits.high_m if side > 0 else -limits.low_m
    speed, before = max(side * hand.velocity_m_per_s, 0.0), side * before_m
    if side * hand.force_n >= 0.0:
        # A hand that a spring couples to its reference stands F / K beyond it, and is led by nothing that way.
        end = min(end, side * hand.position_m + LONGEST_LEAD_M + _LAG_S * speed)
    if ahead_m != 0.0:
        end = min(end, before - side * ahead_m + limits.tip_lead_m + trip_s * limits.speed_m_per_s)
    return max(end, before)


@compiled
def ends(limits: HandLimits, hand: HandSample, before_m: float, tip_reference_m: float, signal: PortSignal) -> Ends:
    """Return the ends of the reference in a step: of the travel, of its lead over the hand, and of that over the tip.

    A reference leads a device that follows it by little. It is led no further from one that is stuck, slow, or at the
    end of its own range, and one that is further away than that already may stay where it is.

    Args:
        limits: The limits.
        hand: The sample of the hand with which the step is taken.
        before_m: The reference of the hand before the step [m].
        tip_reference_m: The reference of the tip that belongs to it [m].
        signal: The newest signal of the tip.
    """
    ahead = 0.0
    if limits.position_scale > 0.0 and signal.active:
        ahead = (tip_reference_m - signal.position_m) / limits.position_scale
    low = _room_m(limits, _BELOW, hand, before_m, ahead, signal.round_trip_s)
    return Ends(0.0 - low, _room_m(limits, _ABOVE, hand, before_m, ahead, signal.round_trip_s))


@compiled
def _over_m(limits: HandLimits, within: Ends, side: int, reference: MasterReference) -> float:
    """Return the distance by which a reference passes the limits at one side [m], negative within them."""
    x, v = side * reference.position_m, side * reference.velocity_m_per_s
    end = within.high_m if side > 0 else -within.low_m
    return max(x + max(v, 0.0) * limits.ahead_s - end, (v - limits.speed_m_per_s) * limits.ahead_s)


@compiled
def begun(limits: HandLimits, within: Ends, reference: MasterReference, hand: HandSample) -> Trial:
    """Return the search after the step with the whole force of the hand; `done` if its reference is within the limits.

    Args:
        limits: The limits.
        within: The ends of the reference in this step.
        reference: The reference after the step.
        hand: The sample of the hand with which the step was taken.
    """
    force = hand.force_n
    if reference.active and hand.following:
        above = _over_m(limits, within, _ABOVE, reference)
        if above > 0.0:
            return _passed(_ABOVE, force, above)
        below = _over_m(limits, within, _BELOW, reference)
        if below > 0.0:
            return _passed(_BELOW, force, below)
    return free()


@compiled
def _passed(side: int, force_n: float, over_m: float) -> Trial:
    """Return the search after the first step, whose reference passes the limit of a side by over_m [m]."""
    wanted = force_n - side * max(1.0, abs(force_n))
    return Trial(side, force_n, over_m, force_n, over_m, 0.0, 0.0, False, wanted, 1, False)


@compiled
def tried(limits: HandLimits, within: Ends, trial: Trial, reference: MasterReference) -> Trial:
    """Return the search after a repetition of the step with the force `trial.next_n`; other arguments as in `begun`."""
    side, force, steps = trial.side, trial.next_n, trial.steps + 1
    over = _over_m(limits, within, side, reference)
    change = side * (force - trial.force_n)
    slope = (over - trial.over_m) / change if change != 0.0 else 0.0
    outer, outer_m, inner, inner_m = trial.outer_n, trial.outer_m, trial.inner_n, trial.inner_m
    has_inner = trial.has_inner
    if over > _NEAR_M:
        outer, outer_m = force, over
    else:
        inner, inner_m, has_inner = force, over, True
    done = -_INSIDE_M <= over <= _NEAR_M or (slope == 0.0 and steps > _MOST_FLAT) or steps > _MOST_TRIALS
    if done:
        wanted = force
    elif not has_inner:
        # The force is still too much: go on along the secant, or by twice as much where the step bends the other way.
        way = over / slope if slope > 0.0 else 2.0 * abs(change)
        wanted = bounded(force - side * way, _MOST_N)
    elif steps == _MOST_TRIALS:
        wanted = inner
    else:
        share = inner_m / (inner_m - outer_m)
        wanted = inner + min(max(share, _LEAST_SHARE), 1.0 - _LEAST_SHARE) * (outer - inner)
    return Trial(side, force, over, outer, outer_m, inner, inner_m, has_inner, wanted, steps, done)


@compiled
def with_force(hand: HandSample, force_n: float) -> HandSample:
    """Return the sample with another force [N]."""
    return HandSample(hand.position_m, hand.velocity_m_per_s, force_n, hand.following)


@compiled
def let_through(trial: Trial, hand: HandSample) -> HandSample:
    """Return a later sample with the force that the stop lets through, by the search of the sample before."""
    if trial.side == _WITHIN or trial.side * (hand.force_n - trial.force_n) <= 0.0:
        return hand
    return with_force(hand, trial.force_n)


@compiled
def cut(limits: HandLimits, trial: Trial, reference: MasterReference, before_m: float) -> MasterReference:
    """Return the reference, at rest at the end of the travel where no force of the hand keeps it within the limits.

    The search looks at one side alone: between two ends that are close together it may pass the other one.
    """
    if trial.side == _WITHIN:
        return reference
    position = min(max(reference.position_m, min(limits.low_m, before_m)), max(limits.high_m, before_m))
    if abs(position - reference.position_m) <= (0.0 if trial.over_m > _NEAR_M else _NEAR_M):
        return reference
    return MasterReference(position, 0.0, reference.force_n, reference.active)


_FREE = free()


def _is_clear(
    limits: HandLimits,
    reference: MasterReference,
    hand: HandSample,
    before_m: float,
    tip_reference_m: float,
    signal: PortSignal,
) -> bool:
    """Return whether a reference is so far within all limits that `begun` need not look: in nearly every tick."""
    x, v = reference.position_m, abs(reference.velocity_m_per_s)
    reach = v * limits.ahead_s
    if not (v <= limits.speed_m_per_s and limits.low_m <= x - reach and x + reach <= limits.high_m):
        return False
    if not abs(x - hand.position_m) + reach <= LONGEST_LEAD_M:
        return False
    if not (limits.position_scale > 0.0 and signal.active):
        return True
    lead = x - before_m + (tip_reference_m - signal.position_m) / limits.position_scale
    return abs(lead) + reach <= limits.tip_lead_m


def received_within(
    limits: HandLimits,
    receive: Callable[..., Any],
    params: Any,
    state: Any,
    hand: HandSample,
    signal: PortSignal,
    dt: float,
    before: MasterReference,
    tip_reference_m: float,
) -> tuple[Any, MasterReference, Trial]:
    """Take the step `receive` of a master half with the force that the limits let through.

    Args:
        limits: The limits.
        receive: The step `master_receive` of a law.
        params: Its parameters.
        state: Its state.
        hand: The sample of the hand.
        signal: The newest signal of the other half.
        dt: The time of the step [s].
        before: The newest reference of the hand.
        tip_reference_m: The reference of the tip that belongs to it [m].

    Returns:
        The state of the law, the reference of the hand, and the search that found the force.
    """
    before_m = before.position_m if before.active else hand.position_m
    after, reference = receive(params, state, hand, signal, dt)
    if _is_clear(limits, reference, hand, before_m, tip_reference_m, signal):
        return after, reference, _FREE
    within = ends(limits, hand, before_m, tip_reference_m, signal)
    trial = begun(limits, within, reference, hand)
    while not trial.done:
        after, reference = receive(params, state, with_force(hand, trial.next_n), signal, dt)
        trial = tried(limits, within, trial, reference)
    return after, cut(limits, trial, reference, before_m), trial
