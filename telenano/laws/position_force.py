"""Position forward, force backward, reflected directly: the two-channel law that the others are measured against.

    M_v x'' + B_v x' = F_m - alpha_f F_s(t - T_b),   x_sr(t) = alpha_p x(t - T_f)

Source: the position-force architecture of Sheridan's and Lawrence's surveys (D. A. Lawrence, IEEE Trans. Robotics and
Automation 9, 1993: the four-channel scheme with C2 = C1 = 1 and the other two channels off), here with an admittance
as master. At rest F_m = alpha_f F_s.

Loop gain on a spring K: L(s) = alpha_f alpha_p K e^(-sT) / (M_v s^2 + B_v s). The law is not passive: with delay the
channel gives out energy, and beyond the phase margin of L the loop oscillates. Under varying delay and loss the last
force and position are held, so the present delay is decisive.
"""

from typing import NamedTuple

from telenano.extend.laws import HandSample, MasterReference, PortSignal, port_signal
from telenano.extend.virtual_mass import (
    Mass,
    MassParams,
    at_hand,
    at_rest,
    let_go,
    moved,
    periods_in,
    rescaled,
    resumed,
    tip_reference,
)
from telenano.numerics.compiler import compiled


class PositionForceParams(NamedTuple):
    """Constants of the law."""

    mass: MassParams


@compiled
def master_start(params: PositionForceParams, hand: HandSample) -> Mass:
    """Return the virtual mass at rest at the hand's position."""
    return at_rest(hand.position_m)


@compiled
def master_resume(params: PositionForceParams, hand: HandSample, tip_reference_m: float) -> Mass:
    """Return the virtual mass with the hand's motion, such that the tip's reference stays."""
    return resumed(params.mass, hand, tip_reference_m)


@compiled
def master_send(params: PositionForceParams, state: Mass, hand: HandSample, dt: float) -> tuple[Mass, PortSignal]:
    """Return the tip's reference, and the hand's force, which only the recording uses."""
    p = params.mass
    position, velocity = tip_reference(p, state), p.position_scale * state.velocity_m_per_s
    force = hand.force_n / p.force_scale
    active = hand.following and state.coupled
    return state, port_signal(position_m=position, velocity_m_per_s=velocity, force_n=force, active=active)


@compiled
def master_receive(
    params: PositionForceParams, state: Mass, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[Mass, MasterReference]:
    """Move the virtual mass over dt [s] against the force received last; it is released unless tip and hand follow."""
    p = params.mass
    force = p.force_scale * signal.force_n
    may = at_hand(p, hand, signal, state.coupled, 0.0, dt, False)
    if not may.acts:
        shown_n = force if may.coupled else 0.0
        return let_go(p, state, hand, signal), MasterReference(hand.position_m, 0.0, shown_n, may.coupled)
    for _ in range(periods_in(dt, p.period_s)):
        state = moved(p, state, hand.force_n - force)
    return state, MasterReference(state.position_m, state.velocity_m_per_s, force, True)


@compiled
def retune(old: PositionForceParams, new: PositionForceParams, state: Mass) -> Mass:
    """Keep the tip's reference constant when alpha_p changes."""
    return rescaled(old.mass, new.mass, state)
