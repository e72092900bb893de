"""Tactile feedback (Fig. 9-10): the hand is moved like the surface under the tip, and does not move the tip.

    x_m = x_m0 + (x_tip - x_tip0) / alpha_p,   x_tip = x_s - zeta,   zeta = F_s / k,

both along the paper's axis: if the surface rises, tip and hand rise with it. With a base at rest this is the paper's
x_m = alpha_p zeta (its alpha_p is the inverse of ours); if a feedback moves the base, the hand still follows the
surface. x_tip0 is the position at the first contact, so the approach does not move the hand.

A device that renders forces also gets the contact force, scaled linearly (Eq. 12) or by impedance (Eq. 13),

    F* = alpha^4 m zeta'' + alpha^2 b zeta' + alpha^2 k zeta,

with mass, damping and stiffness of the cantilever, and alpha the scale of lengths from nano to macro. No motion of the
operator reaches the instrument, so there is no loop that a delay could make unstable.
"""

from typing import NamedTuple

from telenano.extend.laws import (
    HandSample,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
    port_signal,
    tip_signal,
)
from telenano.extend.pass_through import SlaveState
from telenano.extend.pass_through import slave_start as slave_start
from telenano.extend.virtual_mass import (
    FARTHEST_M,
    at_hand,
    bounded,
)
from telenano.numerics.compiler import compiled

# Greatest force that a message can carry [N].
_MOST_N = 1e6


def impedance_scaled(
    alpha: float, mass_kg: float, damping_n_s_per_m: float, stiffness_n_per_m: float
) -> tuple[float, float, float]:
    """Return the factors of x'', x' and x in Eq. 13: alpha^4 m [kg], alpha^2 b [N s/m], alpha^2 k [N/m].

    >>> impedance_scaled(10.0, 2.0, 3.0, 4.0)
    (20000.0, 300.0, 400.0)
    """
    return alpha**4 * mass_kg, alpha**2 * damping_n_s_per_m, alpha**2 * stiffness_n_per_m


class TactileParams(NamedTuple):
    """Scales and limits; stiffness of the cantilever [N/m]; factors of zeta'', zeta' and zeta in Eq. 13 (SI units)."""

    position_scale: float
    force_scale: float
    silence_limit_s: float
    period_s: float
    stiffness_n_per_m: float
    by_impedance: bool
    inertia_kg: float
    damping_n_s_per_m: float
    spring_n_per_m: float


class MasterState(NamedTuple):
    """Origins of hand and tip [m], whether the tip has touched, zeta [m] and its rate [m/s], displayed force [N]."""

    hand_m: float
    tip_m: float
    touched: bool
    zeta_m: float
    speed_m_per_s: float
    force_n: float


@compiled
def _untouched(hand: HandSample) -> MasterState:
    return MasterState(hand_m=hand.position_m, tip_m=0.0, touched=False, zeta_m=0.0, speed_m_per_s=0.0, force_n=0.0)


@compiled
def master_start(params: TactileParams, hand: HandSample) -> MasterState:
    """Return the state before the first contact, with the hand at its position."""
    return _untouched(hand)


@compiled
def master_resume(params: TactileParams, hand: HandSample, tip_reference_m: float) -> MasterState:
    """Return the state before the first contact, with the hand at its position."""
    return _untouched(hand)


@compiled
def master_send(
    params: TactileParams, state: MasterState, hand: HandSample, dt: float
) -> tuple[MasterState, PortSignal]:
    """Return a signal without motion, which only states whether the hand follows."""
    return state, port_signal(position_m=0.0, active=hand.following)


@compiled
def master_receive(
    params: TactileParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Return the hand's reference, which follows the surface; the hand is released unless it and the tip follow."""
    may = at_hand(params, hand, signal, False, 0.0, dt, False)
    if not may.acts:
        return _untouched(hand), MasterReference(hand.position_m, 0.0, 0.0, may.coupled)
    zeta = signal.force_n / params.stiffness_n_per_m
    if params.by_impedance:
        # The newest signal may still be that of the previous tick; the rate is then zero.
        speed = (zeta - state.zeta_m) / dt
        shown = params.inertia_kg * (speed - state.speed_m_per_s) / dt
        shown += params.damping_n_s_per_m * speed + params.spring_n_per_m * zeta
    else:
        speed = 0.0
        shown = params.force_scale * signal.force_n
    shown = bounded(shown, _MOST_N)
    if not (state.touched or signal.in_contact):
        state = MasterState(
            hand_m=state.hand_m, tip_m=0.0, touched=False, zeta_m=zeta, speed_m_per_s=speed, force_n=shown
        )
        return state, MasterReference(state.hand_m, 0.0, shown, True)
    tip = state.tip_m if state.touched else signal.position_m
    reference = bounded(state.hand_m + (signal.position_m - tip) / params.position_scale, FARTHEST_M)
    state = MasterState(hand_m=state.hand_m, tip_m=tip, touched=True, zeta_m=zeta, speed_m_per_s=speed, force_n=shown)
    return state, MasterReference(reference, 0.0, shown, True)


@compiled
def slave_receive(
    params: TactileParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Keep the base's reference; a program of the instrument moves the base."""
    return state, SlaveReference(state.position_m, True)


@compiled
def slave_send(
    params: TactileParams, state: SlaveState, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, PortSignal]:
    """Return the position of the tip, x_s - zeta, and the force on it."""
    place = tip.base_position_m - tip.force_n / params.stiffness_n_per_m
    return state, tip_signal(tip, place, tip.force_n)


@compiled
def retune(old: TactileParams, new: TactileParams, state: MasterState) -> MasterState:
    """Return the state unchanged: a changed scale applies to the distance from the point of first contact."""
    return state
