"""Time-domain passivity control of the channel: observe the energy at both ports, dissipate what it would make up.

The channel carries velocity forward and the computed force of the slave's controller backward (the position-computed
force architecture). The slave's controller is a spring K_c that draws the base after the reference x_d, and the base
moves as if through a damper B_c: F_c = K_c (x_d - x_s), B_c x_s' = F_c - F_s. The master's mass feels F_c, delayed.

At each port the energy is counted by direction, E_in >= 0 into the channel and E_out >= 0 out of it, and E_in is sent
across (`energy_j`). With E_0 for what each side holds at the start, the channel is passive if

    E_out,s(t) <= E_in,m(t - T_f) + E_0,    E_out,m(t) <= E_in,s(t - T_b) + E_0,

for then E_in,m + E_in,s - E_out,m - E_out,s >= -2 E_0 at all times. Each side knows both terms of its own inequality.
Sources: J.-H. Ryu, J. Artigas, C. Preusche, "A passive bilateral control scheme for a teleoperator with time-varying
communication delay", Mechatronics 20 (2010); J. Artigas, J.-H. Ryu, C. Preusche, "Time domain passivity control for
position-position teleoperation architectures", Presence 19 (2010).

Both devices are position sources, so both controllers act on motion and not on force (admittance type). The port gives
energy out in a period when F d < 0 at the master (the force drives the hand back) and F d > 0 at the slave. A series
conductance alpha would move the port by alpha F Ts less; the alpha that makes the inequality an equality is

    alpha = (F d + E_left) / (F^2 Ts),   that is   d -> d' with |F d'| = E_left,

which is how it is applied: the motion itself is cut to what the energy pays for. It needs no division by a small
velocity, so there is nothing to cap and no force spike; the strongest it can do is to stand still.

- At the slave the motion that was cut remains due, x_ref - x_d, and is made up when energy arrives, no faster than a
  speed limit: so positions do not drift apart, and the make-up is itself inside the inequality.
- At the master a cut would also hold an operator who pulls back by himself. Motion that the mass makes without
  the force costs the channel nothing; it is always allowed, and the force counts as zero over it.
- The slave never presses harder than the hand does, by the last signal, and a margin: F_c <= max(F_m, 0) + F_0 (the
  force clamp, which can be switched off). Without that, a channel that has run out of energy would hold hand and tip
  where they are, pressed together, after the hand has let go. Giving way is motion at the port like any other: it is
  counted, and returns the contact's energy. The limit follows a falling F_m with a time constant tau_c only, while the
  hand presses at all. At once, the hand would feel exactly its own force whenever it presses less than before, nothing
  would bring it back, and with each swing it would walk on; it returns if tau_c is longer than B_v over the stiffness
  it feels, and the round trip.
- A half that is taken up while the tip presses begins with the coupling stretched by that force, F_c = F_s, and keeps
  the stretch as an offset between x_d and x_ref: so the tip is not let off when the law or a hand comes back.
- E_0 is granted at the start, and anew to a tip that has to be armed: a channel that the last contact has emptied could
  not begin to press. While the tip is retracted each side has E_0, no more and no less, so that what follows an arming
  does not depend on what was before.
- E_left is capped (the rest is dissipated): a great store, gathered long ago, would let an instability grow first.

The inequalities use counters that only grow, so they hold under constant and varying delay, loss, reordering and
repetition alike: what has not arrived cannot be spent. Loss and jitter cost motion, not stability: while nothing
arrives the reference stands, and the coupling goes on against the force that the instrument measures.
"""

import math
from typing import NamedTuple

from pydantic import Field

from services.controller.discretisation import approach
from services.controller.law import (
    EnergyAccount,
    HandSample,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
    law_of,
    port_signal,
)
from services.controller.laws.shared.virtual_mass import (
    Mass,
    MassParams,
    SteeredConfig,
    at_rest,
    is_coupled,
    is_retracted,
    let_go,
    moved,
    periods_in,
    placed,
    rescaled,
    resumed,
    tip_reference,
)
from services.controller.ranges import (
    DampingNSPerM,
    EnergyJ,
    EnergyOrNoneJ,
    ForceOrNoneN,
    SpeedMPerS,
    StiffnessNPerM,
    TimeS,
)
from services.numerics.compiled import compiled


class PassivityParams(NamedTuple):
    """Constants of the law; `relaxed` is the share of the way to its rest that the base goes in a period."""

    mass: MassParams
    coupling_n_per_m: float
    relaxed: float
    step_m: float
    margin_n: float
    release: float
    start_j: float
    cap_j: float


class PassivityConfig(SteeredConfig):
    """Section `controller.passivity`; energies, stiffness and damping at the hand's scale."""

    coupling_stiffness_n_per_m: StiffnessNPerM = Field(default=1500.0, description="Spring of the coupling K_c [N/m]")
    coupling_damping_n_s_per_m: DampingNSPerM = Field(default=30.0, description="Damper of the base B_c [N s/m]")
    speed_limit_m_per_s: SpeedMPerS = Field(
        default=0.05, description="Fastest motion of the slave's reference, at the hand's scale [m/s]"
    )
    force_margin_n: ForceOrNoneN = Field(
        default=0.0, description="Force by which the slave may press harder than the hand, at the hand's scale F_0 [N]"
    )
    clamp_release_s: TimeS = Field(
        default=4.0, description="Time constant with which the clamp follows a hand that presses less tau_c [s]"
    )
    start_energy_j: EnergyOrNoneJ = Field(
        default=1e-3, description="Energy that each side may spend at the start E_0 [J]"
    )
    energy_cap_j: EnergyJ = Field(default=5e-3, description="Most energy that a side keeps to spend [J]")

    def to_params(self, period_s: float) -> PassivityParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        rate = self.coupling_stiffness_n_per_m / self.coupling_damping_n_s_per_m
        return PassivityParams(
            mass=self.mass_params(period_s),
            coupling_n_per_m=self.coupling_stiffness_n_per_m,
            relaxed=approach(rate * period_s),
            step_m=self.speed_limit_m_per_s * period_s,
            margin_n=self.force_margin_n,
            release=approach(period_s / self.clamp_release_s),
            start_j=min(self.start_energy_j, self.energy_cap_j),
            cap_j=self.energy_cap_j,
        )


class Account(NamedTuple):
    """Energy of one port [J]: put into the channel, put in by the other side, left to spend, dissipated, granted."""

    in_j: float
    received_j: float
    remaining_j: float
    lost_j: float
    granted_j: float


class MasterState(NamedTuple):
    """The mass and the account of its port."""

    mass: Mass
    account: Account


class SlaveState(NamedTuple):
    """The base reference [m], the coupling's stretch x_d - x_s and offset x_d - x_ref [m, hand's scale], and more.

    limit_n: the clamp's limit without its margin [N].
    """

    position_m: float
    stretch_m: float
    lead_m: float
    limit_n: float
    account: Account
    coupled: bool


@compiled
def credited(account: Account, energy_j: float, cap_j: float) -> Account:
    """Add what the other side has put in since its last signal; what goes beyond the cap is dissipated."""
    added_j = max(energy_j - account.received_j, 0.0)
    left = min(account.remaining_j + added_j, cap_j)
    lost = account.lost_j + (account.remaining_j + added_j - left)
    return Account(account.in_j, account.received_j + added_j, left, lost, account.granted_j)


@compiled
def charged(account: Account, work_j: float, lost_j: float) -> Account:
    """Charge the work done on the channel (positive) or by it (negative), and what the controller dissipated."""
    put_in, spent = max(work_j, 0.0), max(-work_j, 0.0)
    left = account.remaining_j - spent
    return Account(account.in_j + put_in, account.received_j, left, account.lost_j + lost_j, account.granted_j)


@compiled
def received_anew(account: Account, energy_j: float, received: bool) -> Account:
    """Start counting the other side's energy at a signal; what is left to spend stays.

    Where none is received nothing changes: to begin at zero would credit all that was received once more.
    """
    received_j = energy_j if received else account.received_j
    return Account(account.in_j, received_j, account.remaining_j, account.lost_j, account.granted_j)


@compiled
def opened(start_j: float) -> Account:
    """Start to count, with the energy E_0 [J] to spend."""
    return Account(0.0, 0.0, start_j, 0.0, start_j)


@compiled
def opened_anew(account: Account, start_j: float) -> Account:
    """Let the port begin with E_0 [J] once more; what is left beyond it is dissipated, what is missing granted."""
    missing = start_j - account.remaining_j
    lost, granted = account.lost_j + max(-missing, 0.0), account.granted_j + max(missing, 0.0)
    return Account(account.in_j, account.received_j, start_j, lost, granted)


@compiled
def master_start(params: PassivityParams, hand: HandSample) -> MasterState:
    """Start with the virtual mass at rest at the hand's position."""
    return MasterState(at_rest(hand.position_m), opened(params.start_j))


@compiled
def master_resume(params: PassivityParams, hand: HandSample, tip_reference_m: float) -> MasterState:
    """Continue with the hand's motion and the tip's reference."""
    return MasterState(resumed(params.mass, hand, tip_reference_m), opened(params.start_j))


@compiled
def master_send(
    params: PassivityParams, state: MasterState, hand: HandSample, dt: float
) -> tuple[MasterState, PortSignal]:
    """Return the slave's reference and the energy that has gone into the channel."""
    p, mass = params.mass, state.mass
    velocity = p.position_scale * mass.velocity_m_per_s
    force = hand.force_n / p.force_scale
    active = hand.following and mass.coupled
    return state, port_signal(
        position_m=tip_reference(p, mass),
        velocity_m_per_s=velocity,
        force_n=force,
        energy_j=state.account.in_j,
        active=active,
    )


@compiled
def paid_motion(motion_m: float, own_m: float, force_n: float, remaining_j: float) -> tuple[float, float]:
    """Limit a motion [m] of the hand to the energy left; return it with the work [J] done on the channel.

    motion_m: what the mass would do under hand and channel, own_m: without the channel's force F [N]. Into the channel
    (F d >= 0) nothing is cut.
    """
    if force_n * motion_m >= -remaining_j:
        return motion_m, force_n * motion_m
    back = math.copysign(1.0, motion_m)
    paid = remaining_j / abs(force_n)
    if own_m * back > paid:
        return back * min(own_m * back, motion_m * back), 0.0
    return back * paid, -remaining_j


@compiled
def master_receive(
    params: PassivityParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Move the virtual mass over dt [s] under the force received last, within the energy that the channel has."""
    p = params.mass
    force = p.force_scale * signal.force_n
    coupled = is_coupled(p, signal)
    if not (coupled and hand.following):
        account = received_anew(state.account, signal.energy_j, signal.silence_s <= p.silence_limit_s)
        if is_retracted(p, signal):
            account = opened_anew(account, params.start_j)
        state = MasterState(let_go(p, state.mass, hand, signal), account)
        return state, MasterReference(hand.position_m, 0.0, force if coupled else 0.0, coupled)
    mass, account = state.mass, credited(state.account, signal.energy_j, params.cap_j)
    for _ in range(periods_in(dt, p.period_s)):
        free = moved(p, mass, hand.force_n - force)
        wanted = free.position_m - mass.position_m
        own = moved(p, mass, hand.force_n).position_m - mass.position_m
        motion, work = paid_motion(wanted, own, force, account.remaining_j)
        if motion != wanted:
            mean = motion / p.period_s
            speed = min(abs(free.velocity_m_per_s), abs(mean))
            free = placed(free, mass.position_m + motion, math.copysign(speed, mean))
        account = charged(account, work, work - force * wanted)
        mass = free
    return MasterState(mass, account), MasterReference(mass.position_m, mass.velocity_m_per_s, force, True)


@compiled
def slave_start(params: PassivityParams, tip: TipMeasurement) -> SlaveState:
    """Start at the position of the base."""
    stretch = params.mass.force_scale * tip.force_n / params.coupling_n_per_m
    return SlaveState(
        position_m=tip.base_position_m,
        stretch_m=stretch,
        lead_m=stretch,
        limit_n=0.0,
        account=opened(params.start_j),
        coupled=False,
    )


@compiled
def paid_stretch(
    stretch_m: float, motion_m: float, stiffness_n_per_m: float, remaining_j: float
) -> tuple[float, float]:
    """Limit a motion [m] of the coupling's end to the energy left; return it with the work [J] done on the channel.

    The channel gives out F d + K d^2 / 2 with F = K stretch, exactly.
    """
    force, k = stiffness_n_per_m * stretch_m, stiffness_n_per_m
    out = force * motion_m + 0.5 * k * motion_m * motion_m
    if out <= remaining_j:
        return motion_m, -out
    root = math.sqrt(force * force + 2.0 * k * max(remaining_j, 0.0))
    return (math.copysign(root, motion_m) - force) / k, -remaining_j


@compiled
def slave_receive(
    params: PassivityParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Make the base follow the reference for a period, within the energy that the channel has.

    While the tip does not follow, the reference is the master's; while the master does not, the base stays.
    """
    p, k = params.mass, params.coupling_n_per_m
    coupled = is_coupled(p, signal) and tip.following
    if not coupled:
        base = state.position_m if tip.following else signal.position_m
        account = received_anew(state.account, signal.energy_j, signal.silence_s <= p.silence_limit_s)
        if not tip.following and not tip.in_contact:
            account = opened_anew(account, params.start_j)
        stretch = p.force_scale * tip.force_n / k if tip.following else 0.0
        state = SlaveState(
            position_m=base, stretch_m=stretch, lead_m=stretch, limit_n=0.0, account=account, coupled=False
        )
        return state, SlaveReference(base, True)
    account = credited(state.account, signal.energy_j, params.cap_j)
    base, stretch = state.position_m, state.stretch_m
    pressed = max(p.force_scale * signal.force_n, 0.0)
    limit = max(pressed, state.limit_n + params.release * (pressed - state.limit_n)) if pressed > 0.0 else 0.0
    most = (limit + params.margin_n) / k
    due = (signal.position_m - base) / p.position_scale + state.lead_m - stretch
    wanted = min(max(min(due, most - stretch), -params.step_m), params.step_m)
    motion, work = paid_stretch(stretch, wanted, k, account.remaining_j)
    refused = k * wanted * (stretch + 0.5 * wanted) + work
    account = charged(account, work, refused if motion != wanted else 0.0)
    stretch += motion
    # the base goes to where the coupling balances the force that was measured
    slid = params.relaxed * (k * stretch - p.force_scale * tip.force_n) / k
    stretch -= slid
    base += p.position_scale * slid
    state = SlaveState(
        position_m=base, stretch_m=stretch, lead_m=state.lead_m, limit_n=limit, account=account, coupled=True
    )
    return state, SlaveReference(base, True)


@compiled
def slave_send(
    params: PassivityParams, state: SlaveState, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, PortSignal]:
    """Send the force of the coupling back, and the energy that has gone into the channel here."""
    return state, port_signal(
        position_m=tip.base_position_m,
        force_n=params.coupling_n_per_m * state.stretch_m / params.mass.force_scale,
        energy_j=state.account.in_j,
        separation_m=tip.separation_m,
        separation_valid=tip.separation_valid,
        in_contact=tip.in_contact,
        active=tip.following,
    )


@compiled
def retune(old: PassivityParams, new: PassivityParams, state: MasterState) -> MasterState:
    """Keep the tip's reference constant when alpha_p changes; the energy left stays below the new cap."""
    a = state.account
    account = Account(a.in_j, a.received_j, min(a.remaining_j, new.cap_j), a.lost_j, a.granted_j)
    return MasterState(rescaled(old.mass, new.mass, state.mass), account)


@compiled
def master_energy_account(params: PassivityParams, state: MasterState) -> EnergyAccount:
    """Return what this port may still give out, what its controller dissipated, and what both ports were granted."""
    return EnergyAccount(state.account.remaining_j, state.account.lost_j, 2.0 * state.account.granted_j)


@compiled
def slave_energy_account(params: PassivityParams, state: SlaveState) -> EnergyAccount:
    """Return what this port may still give out, what its controller dissipated, and what both ports were granted."""
    return EnergyAccount(state.account.remaining_j, state.account.lost_j, 2.0 * state.account.granted_j)


PASSIVITY = law_of(__name__, PassivityConfig, uses_energy=True, local_loop=True)
