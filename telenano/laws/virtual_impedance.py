"""The paper's law: a virtual impedance between hand and tip (Fig. 11, Eq. 15-17, erratum E8).

The master half steps it after the decision of `telenano/laws/integration.py`, and sends the reference that it gives to
`services/delay_node/node.py`.

    M_v x'' + B_v x' + K_v x = K_f (F_m - alpha_f F_s) - alpha_f F_s,   x_mr = x,   x_sr = alpha_p x

The master half holds the impedance; the slave half passes the reference on and sends the force back. With K_v = 0 the
loop rests where F_m = alpha_f F_s (1 + 1/K_f). It makes no promise about passivity: delay in the link takes phase from
the loop gain (K_f + 1) alpha_f alpha_p K e^(-sT) / (M_v s^2 + B_v s + K_v), and past its phase margin it oscillates.
"""

from typing import NamedTuple

from telenano.extend.laws import HandSample, MasterReference, PortSignal, port_signal
from telenano.extend.virtual_mass import FARTHEST_M, FASTEST_M_PER_S, at_hand, bounded
from telenano.numerics.compiler import compiled
from telenano.numerics.discretisation import Discretisation


class VirtualImpedanceParams(NamedTuple):
    """Constants of the law, with the exact discrete impedance over one period."""

    force_gain: float
    position_scale: float
    force_scale: float
    silence_limit_s: float
    period_s: float
    impedance: Discretisation


class ImpedanceState(NamedTuple):
    """The virtual mass: x [m], x' [m/s], and the offset [m] at the tip that a change of scale leaves behind."""

    position_m: float
    velocity_m_per_s: float
    tip_offset_m: float


@compiled
def master_start(params: VirtualImpedanceParams, hand: HandSample) -> ImpedanceState:
    """Start with the virtual mass at rest at the hand's position."""
    return ImpedanceState(hand.position_m, 0.0, 0.0)


@compiled
def master_resume(params: VirtualImpedanceParams, hand: HandSample, tip_reference_m: float) -> ImpedanceState:
    """Continue with the hand's motion; the offset keeps the tip's reference where it is."""
    offset = tip_reference_m - params.position_scale * hand.position_m
    return ImpedanceState(hand.position_m, hand.velocity_m_per_s, offset)


@compiled
def master_send(
    params: VirtualImpedanceParams, state: ImpedanceState, hand: HandSample, dt: float
) -> tuple[ImpedanceState, PortSignal]:
    """Return the slave's reference: x_sr = alpha_p x (Eq. 15)."""
    position = params.position_scale * state.position_m + state.tip_offset_m
    velocity = params.position_scale * state.velocity_m_per_s
    force = hand.force_n / params.force_scale
    return state, port_signal(position_m=position, velocity_m_per_s=velocity, force_n=force, active=hand.following)


@compiled
def master_receive(
    params: VirtualImpedanceParams, state: ImpedanceState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[ImpedanceState, MasterReference]:
    """Integrate the virtual impedance over dt [s], a whole number of periods (Eq. 16-17).

    While a device does not follow, or the other half is silent for longer than the limit, the virtual mass stays with
    the hand and no force acts: an unmeasured force must not move anything. Over a retracted tip the offset between hand
    and tip is zero again.
    """
    scaled_force = params.force_scale * signal.force_n
    may = at_hand(params, hand, signal, False, 0.0, dt, False)
    if not may.acts:
        offset = 0.0 if may.renews else _offset_that_keeps(params, state, hand.position_m)
        held = ImpedanceState(hand.position_m, 0.0, offset)
        return held, MasterReference(hand.position_m, 0.0, scaled_force if may.coupled else 0.0, may.coupled)
    drive = params.force_gain * (hand.force_n - scaled_force) - scaled_force
    step = params.impedance
    x, v = state.position_m, state.velocity_m_per_s
    for _ in range(max(1, round(dt / params.period_s))):
        x, v = (
            step.phi_xx * x + step.phi_xv * v + step.gamma_x * drive,
            step.phi_vx * x + step.phi_vv * v + step.gamma_v * drive,
        )
    x, v = bounded(x, FARTHEST_M), bounded(v, FASTEST_M_PER_S)
    return ImpedanceState(x, v, state.tip_offset_m), MasterReference(x, v, scaled_force, True)


@compiled
def _offset_that_keeps(params: VirtualImpedanceParams, state: ImpedanceState, position_m: float) -> float:
    """Return the offset that keeps the tip's reference constant while the virtual mass is moved to the hand [m]."""
    return state.tip_offset_m + params.position_scale * (state.position_m - position_m)


@compiled
def retune(old: VirtualImpedanceParams, new: VirtualImpedanceParams, state: ImpedanceState) -> ImpedanceState:
    """Keep the tip's reference constant when alpha_p changes; position and velocity of the hand continue."""
    offset = state.tip_offset_m + (old.position_scale - new.position_scale) * state.position_m
    return ImpedanceState(state.position_m, state.velocity_m_per_s, offset)


def rest_force(params: VirtualImpedanceParams, force_n: float) -> float:
    """Return alpha_f F_s = F_m / (1 + 1/K_f) [N]; NaN with a virtual spring, whose force depends on the position."""
    gain = params.force_gain
    return gain / (1.0 + gain) * force_n if abs(params.impedance.phi_xx - 1.0) < 1e-12 else float("nan")
