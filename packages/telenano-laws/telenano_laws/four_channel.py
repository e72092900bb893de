"""Four channels with local force loops: positions, velocities and forces of both sides go to both sides.

    M_v x_m'' + B_v x_m' = F_m - F_e
    F_e = B_c (v_m - v_s) + K_c (x_m - x_s) + (1 + C_mf) F_s - C_mf F_m
    M_s v_s' = (1 + C_sf) (F_m - F_s) + B_c (v_m - v_s) + K_c (x_m - x_s)

with the quantities of the other side delayed. A force loop C > 0 divides the apparent mass of its side by 1 + C.
Without delay, masses and gains as in Lawrence's conditions make hand and tip one rigid body. Over a line, stability is
not guaranteed: the conditions leave no margin (Llewellyn's three terms are zero), and any delay generates energy at
some frequency.

Sources: D. A. Lawrence, IEEE Trans. Robotics and Automation 9 (1993); K. Hashtrudi-Zaad, S. E. Salcudean, Int. J.
Robotics Research 20 (2001); equations as in public reports of them (F. Grotto, phri; K. Kim, smart-pinyin), sampled
here without the channels of acceleration.

At the nanoscale, the tip has no mass of its own, so M_s is a filter of its force error and not an inertia; and the
stiffness felt, 3000 N/m for 20 N/m, needs more damping between the sides than the arm of a robot does.
"""

from typing import NamedTuple

from telenano.extend.laws import (
    HandSample,
    Law,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
    port_signal,
)
from telenano.extend.ranges import parameter
from telenano.extend.virtual_mass import (
    FASTEST_M_PER_S,
    Mass,
    MassConfig,
    MassParams,
    at_hand,
    at_rest,
    at_tip,
    let_go,
    mass_signal,
    moved,
    periods_in,
    rescaled,
    resumed,
    tip_reference,
)
from telenano.numerics import compiled
from telenano_laws.ports import bounded, followed


class FourChannelParams(NamedTuple):
    """Constants of the law."""

    mass: MassParams
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    hand_loop: float
    tip_loop: float
    tip_mass_kg: float


class FourChannelConfig(MassConfig):
    """Section `controller.four_channel`; all at the hand's scale."""

    coupling_stiffness_n_per_m: float = parameter(100.0, "N/m", "Spring between the sides K_c [N/m]", zero=True)
    coupling_damping_n_s_per_m: float = parameter(100.0, "N s/m", "Damper between the sides B_c [N s/m]", zero=True)
    hand_force_loop: float = parameter(0.5, "1", "Gain of the force loop at the hand C_mf")
    tip_force_loop: float = parameter(0.5, "1", "Gain of the force loop at the tip C_sf")
    tip_mass_kg: float = parameter(0.5, "kg", "Virtual mass of the tip M_s [kg]")

    def to_params(self, period_s: float) -> FourChannelParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        return FourChannelParams(
            self.mass_params(period_s),
            self.coupling_stiffness_n_per_m,
            self.coupling_damping_n_s_per_m,
            self.hand_force_loop,
            self.tip_force_loop,
            self.tip_mass_kg,
        )


class MasterState(NamedTuple):
    """The mass."""

    mass: Mass


class SlaveState(NamedTuple):
    """The base reference [m], and the velocity of the tip's virtual mass at the hand's scale [m/s]."""

    position_m: float
    velocity_m_per_s: float


@compiled
def hand_force(params: FourChannelParams, apart_m: float, apart_m_per_s: float, tip_n: float, hand_n: float) -> float:
    """Return the force against the hand F_e [N]; apart: hand minus tip, as a distance [m] and a velocity [m/s]."""
    coupling = params.damping_n_s_per_m * apart_m_per_s + params.stiffness_n_per_m * apart_m
    return coupling + (1.0 + params.hand_loop) * tip_n - params.hand_loop * hand_n


@compiled
def tip_acceleration(
    params: FourChannelParams, apart_m: float, apart_m_per_s: float, tip_n: float, hand_n: float
) -> float:
    """Return the acceleration of the tip's mass [m/s^2]; apart: hand minus tip, distance [m] and velocity [m/s]."""
    coupling = params.damping_n_s_per_m * apart_m_per_s + params.stiffness_n_per_m * apart_m
    return ((1.0 + params.tip_loop) * (hand_n - tip_n) + coupling) / params.tip_mass_kg


@compiled
def master_start(params: FourChannelParams, hand: HandSample) -> MasterState:
    """Start with the virtual mass at rest at the hand's position."""
    return MasterState(at_rest(hand.position_m))


@compiled
def master_resume(params: FourChannelParams, hand: HandSample, tip_reference_m: float) -> MasterState:
    """Continue with the hand's motion and the tip's reference."""
    return MasterState(resumed(params.mass, hand, tip_reference_m))


@compiled
def master_send(
    params: FourChannelParams, state: MasterState, hand: HandSample, dt: float
) -> tuple[MasterState, PortSignal]:
    """Return position, velocity and force of the hand at the tip's scale."""
    return state, mass_signal(params.mass, state.mass, hand, 0.0, hand.following and state.mass.coupled)


@compiled
def master_receive(
    params: FourChannelParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Move the mass for dt [s] under the force of the hand, against the coupling and the force of the tip."""
    p, mass = params.mass, state.mass
    may = at_hand(p, hand, signal, mass.coupled, 0.0, dt, False)
    if not may.acts:
        return MasterState(let_go(p, mass, hand, signal)), MasterReference(hand.position_m, 0.0, 0.0, may.coupled)
    speed, tip_n = signal.velocity_m_per_s / p.position_scale, p.force_scale * signal.force_n
    force = 0.0
    for _ in range(periods_in(dt, p.period_s)):
        apart = (tip_reference(p, mass) - signal.position_m) / p.position_scale
        force = hand_force(params, apart, mass.velocity_m_per_s - speed, tip_n, hand.force_n)
        mass = moved(p, mass, hand.force_n - force)
    return MasterState(mass), MasterReference(mass.position_m, mass.velocity_m_per_s, force, True)


@compiled
def slave_start(params: FourChannelParams, tip: TipMeasurement) -> SlaveState:
    """Start at the position of the base, at rest."""
    return SlaveState(tip.base_position_m, 0.0)


@compiled
def slave_receive(
    params: FourChannelParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Move the tip's mass for a period under the coupling and the difference between the forces of hand and tip.

    While the tip does not follow, the reference is the master's; while the master does not, the base stays.
    """
    p = params.mass
    may = at_tip(p, signal, tip, state.position_m, False)
    if not may.leads:
        return SlaveState(may.base_m, 0.0), SlaveReference(may.base_m, True)
    start = followed(p, state.position_m, tip)
    apart = (signal.position_m - start) / p.position_scale
    faster = signal.velocity_m_per_s / p.position_scale - state.velocity_m_per_s
    pressed, force = p.force_scale * signal.force_n, p.force_scale * tip.force_n
    speed = state.velocity_m_per_s + p.period_s * tip_acceleration(params, apart, faster, force, pressed)
    speed = bounded(speed, FASTEST_M_PER_S)
    base = start + p.position_scale * p.period_s * speed
    return SlaveState(base, speed), SlaveReference(base, True)


@compiled
def slave_send(
    params: FourChannelParams, state: SlaveState, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, PortSignal]:
    """Return position, velocity and force of the tip."""
    return state, port_signal(
        position_m=tip.base_position_m,
        velocity_m_per_s=params.mass.position_scale * state.velocity_m_per_s,
        force_n=tip.force_n,
        separation_m=tip.separation_m,
        separation_valid=tip.separation_valid,
        in_contact=tip.in_contact,
        active=tip.following,
    )


@compiled
def retune(old: FourChannelParams, new: FourChannelParams, state: MasterState) -> MasterState:
    """Keep the tip's reference constant when alpha_p changes."""
    return MasterState(rescaled(old.mass, new.mass, state.mass))


FOUR_CHANNEL = Law.of(__name__, FourChannelConfig, local_loop=True)
