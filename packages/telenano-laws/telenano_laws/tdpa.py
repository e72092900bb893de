"""Time-domain passivity control with drift compensation: no port lets out more energy than the other has put in.

The hand feels the force that was measured at the tip, and the tip follows the hand's position. Each port counts its
work by direction,

    E_in += max(F d, 0),   E_out += max(-F d, 0)   (into the network, over a displacement d),

and sends E_in. The energy that may leave a port is w = E_0 + E_in of the other one, as far as received, - E_out. At the
hand the force is clipped so that its work in the coming period stays within w; at the tip the displacement is shortened
to the part that w covers. Before that, it is the hand's displacement plus a share of the distance between hand and tip,

    d = x_m[k] - x_m[k-1] + kappa Ts (x_m[k-1] - x_s[k]),

so motion that the controller has refused is made up for later, within the energy account.

Sources: J.-H. Ryu, J. Artigas, C. Preusche, Mechatronics 20 (2010), for the two accounts; J. Artigas and others for the
compensation. Their equations could not be read: observer and controller are as in public code (F. Jakob,
high-frequency-cloud-robotics, TDPA), the clip and the limit of the compensation are derived here.

At the nanoscale, the hand's device is no force source but follows a position, so the textbook's series damper becomes a
clip of the force that the virtual mass feels; and 1 N presses a base by 0.3 mm at the hand's scale, so the motion of
one period costs a large part of E_0.
"""

import math
from typing import Any, NamedTuple

from telenano.extend.laws import (
    EnergyAccount,
    HandSample,
    Law,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
    tip_signal,
)
from telenano.extend.ranges import parameter
from telenano.extend.virtual_mass import (
    AtHand,
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
    worked,
)
from telenano.numerics import compiled
from telenano_laws.ports import (
    HandPort,
    PortEnergy,
    account_of,
    clipped_force,
    credited,
    followed,
    kept_below,
    kept_near,
    of_scales,
    opened,
    paid_base,
    paid_or_granted,
    put_in,
    rearm,
    recount_received,
    reopen,
    slid_work,
    stood,
    two_counters,
    unpaid_j,
)

# Energy granted to a tip with an empty account [J]: it moves on through the air only so far in a step that meeting the
# sample costs no more than this. Otherwise it could never be brought back to the sample.
_TOUCH_J = 1e-6


class TdpaParams(NamedTuple):
    """Constants of the law; made_up is the share kappa Ts, unpaid_m the motion in air that needs no energy [m]."""

    mass: MassParams
    made_up: float
    start_j: float
    cap_j: float
    stiffest_n_per_m: float
    unpaid_m: float


class PaidConfig(MassConfig):
    """Parameters of laws whose tip moves no further than its energy account covers."""

    stiffest_n_per_m: float = parameter(
        6e4, "N/m", "Stiffest sample that a step of the tip is paid for, at the hand's scale K [N/m]"
    )

    def stiffness_limit_n_per_m(self, period_s: float) -> float:
        """Return the stiffest sample [N/m] for which a step of the tip is paid; the period [s] does not matter."""
        return self.stiffest_n_per_m / (self.force_scale * self.position_scale)


class TdpaConfig(PaidConfig):
    """Section `controller.tdpa`; energies at the hand's scale."""

    silence_limit_s: float = parameter(
        0.5, "s", "Time without a signal from the other half after which the hand is let go [s]"
    )
    drift_rate_per_s: float = parameter(
        20.0, "1", "Rate at which the tip makes up for its lag behind the hand kappa [1/s]; 0 = none"
    )
    start_energy_j: float = parameter(1e-3, "J", "Energy that may leave each port at the start E_0 [J]", zero=True)
    energy_cap_j: float = parameter(5e-3, "J", "Most energy that a port keeps [J]")

    def to_params(self, period_s: float) -> TdpaParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        start_j = min(self.start_energy_j, self.energy_cap_j)
        made_up = min(self.drift_rate_per_s * period_s, 1.0)
        unpaid_m = math.sqrt(2.0 * _TOUCH_J / self.stiffest_n_per_m)
        mass, stiffest = self.mass_params(period_s), self.stiffest_n_per_m
        return TdpaParams(mass, made_up, start_j, self.energy_cap_j, stiffest, unpaid_m)


class MasterState(NamedTuple):
    """The mass, the account of the hand's port, the time for which the device has been off [s], and the hand's work."""

    mass: Mass
    store: PortEnergy
    stood_s: float
    port: HandPort


class SlaveState(NamedTuple):
    """Base reference [m]; last received reference and last measurement, at the hand's scale [m, N]; energy account."""

    position_m: float
    heard_m: float
    last_m: float
    last_n: float
    store: PortEnergy
    coupled: bool


@compiled
def _begun(params: Any, mass: Mass) -> MasterState:
    return MasterState(mass, opened(params.start_j), 0.0, HandPort(mass.position_m, 0.0, 0.0, 0.0))


@compiled
def master_start(params: TdpaParams, hand: HandSample) -> MasterState:
    """Start with the virtual mass at rest at the hand's position."""
    return _begun(params, at_rest(hand.position_m))


@compiled
def master_resume(params: TdpaParams, hand: HandSample, tip_reference_m: float) -> MasterState:
    """Continue with the hand's motion and the tip's reference."""
    return _begun(params, resumed(params.mass, hand, tip_reference_m))


@compiled
def master_send(params: TdpaParams, state: MasterState, hand: HandSample, dt: float) -> tuple[MasterState, PortSignal]:
    """Return the slave's reference, the hand's force for the recording, and E_in of the hand's port."""
    return state, mass_signal(params.mass, state.mass, hand, state.port.sent_j, state.mass.coupled)


@compiled
def at_sample(
    params: Any, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[AtHand, MasterState]:
    """Return the decision on a sample, `dt` [s] after the previous one, and the state of the half after it.

    If the half acts, its store includes the energy that has arrived, and the caller must still move the mass. If it
    stands, the reference is set back to the device, and the energy of that is booked. Otherwise the hand is released.
    """
    p, mass = params.mass, state.mass
    may = at_hand(p, hand, signal, mass.coupled, state.stood_s, dt, True)
    port = worked(state.port, hand, may.counts)
    if not (may.acts or may.stands):
        heard = signal.silence_s <= p.silence_limit_s
        store = recount_received(state.store, signal.energy_j, heard)
        if may.renews:
            store, port = rearm(store, port, signal.energy_j, heard, params.start_j)
        return may, MasterState(let_go(p, mass, hand, signal), store, may.stood_s, port)
    store = credited(state.store, signal.energy_j, params.cap_j)
    if may.stands:
        back_j = p.force_scale * signal.force_n * (hand.position_m - mass.position_m)
        store = paid_or_granted(store, back_j)
        mass, port = stood(mass, hand), put_in(port, back_j, store.sent_j)
    return may, MasterState(mass, store, may.stood_s, port)


@compiled
def master_receive(
    params: TdpaParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Move the mass for dt [s] against the last received force, clipped to the energy that may leave."""
    p, force = params.mass, params.mass.force_scale * signal.force_n
    may, state = at_sample(params, state, hand, signal, dt)
    if not may.acts:
        return state, MasterReference(hand.position_m, 0.0, force if may.coupled else 0.0, may.coupled)
    mass, store, port = state.mass, state.store, state.port
    for _ in range(periods_in(dt, p.period_s)):
        own = moved(p, mass, hand.force_n).position_m - mass.position_m
        force = clipped_force(p.force_scale * signal.force_n, own, p.gamma_x_m_per_n, store.left_j - unpaid_j(port))
        after = kept_near(mass, moved(p, mass, hand.force_n - force), hand.position_m)
        into_j = force * (after.position_m - mass.position_m)
        store = two_counters(store, into_j)
        mass, port = after, put_in(port, into_j, store.sent_j)
    return MasterState(mass, store, 0.0, port), MasterReference(mass.position_m, mass.velocity_m_per_s, force, True)


@compiled
def slave_start(params: TdpaParams, tip: TipMeasurement) -> SlaveState:
    """Start at the position of the base."""
    return standing(params, tip.base_position_m, tip, opened(params.start_j))


@compiled
def standing(params: Any, position_m: float, tip: TipMeasurement, store: PortEnergy) -> SlaveState:
    """Return the state of a slave half that is not coupled, for laws whose parameters have a field `mass`."""
    p = params.mass
    here, force = tip.base_position_m / p.position_scale, p.force_scale * tip.force_n
    return SlaveState(position_m, here, here, force, store, False)


@compiled
def tip_worked(store: PortEnergy, last_m: float, last_n: float, here_m: float, force_n: float) -> PortEnergy:
    """Book the work at the tip's port by direction; grant up to `_TOUCH_J` that the store lacks to meet a sample."""
    out_j = slid_work(last_m, last_n, here_m, force_n)
    store = two_counters(store, -out_j)
    if last_n * (here_m - last_m) > 0.0:
        return store
    lacking_j = min(max(-store.left_j, 0.0), max(out_j, 0.0), _TOUCH_J)
    # Half of it, because `account_of` doubles the grant for both ports, but only this port gets it.
    return PortEnergy(store.sent_j, store.received_j, store.left_j + lacking_j, store.granted_j + 0.5 * lacking_j)


@compiled
def drift_free_way(heard_m: float, target_m: float, here_m: float, made_up: float) -> float:
    """Return the desired motion of a period [m]: that of the reference, plus a share of the previous position error."""
    return target_m - heard_m + made_up * (heard_m - here_m)


@compiled
def slave_receive(
    params: TdpaParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Follow the reference within the energy that may leave.

    While the tip does not follow, the reference is the master's; while the master does not, the base stays.
    """
    p = params.mass
    here, force = tip.base_position_m / p.position_scale, p.force_scale * tip.force_n
    may, store = at_tip(p, signal, tip, state.position_m, state.coupled), state.store
    if may.counts:
        store = tip_worked(store, state.last_m, state.last_n, here, force)
    if not may.leads:
        store = recount_received(store, signal.energy_j, may.heard)
        if may.renews:
            store = reopen(state.store, signal.energy_j, may.heard, params.start_j)
        return standing(params, may.base_m, tip, store), SlaveReference(may.base_m, True)
    store = credited(store, signal.energy_j, params.cap_j)
    start = followed(p, state.position_m, tip)
    target = signal.position_m / p.position_scale
    before = state.heard_m if state.coupled else target
    wanted = drift_free_way(before, target, start / p.position_scale, params.made_up)
    # An account overdrawn by more than `_TOUCH_J` means that a surface moved towards the tip; the tip then waits for
    # energy in the air too.
    unpaid_m = params.unpaid_m if store.left_j >= -_TOUCH_J else 0.0
    base = paid_base(p, state.position_m, tip, wanted, params.stiffest_n_per_m, store.left_j, unpaid_m)
    return SlaveState(base, target, here, force, store, True), SlaveReference(base, True)


@compiled
def slave_send(params: TdpaParams, state: SlaveState, tip: TipMeasurement, dt: float) -> tuple[SlaveState, PortSignal]:
    """Return the tip's measurement and E_in of its port, after the step of the base.

    The work is booked with the force right after the step, because the sample may move before the next signal.
    """
    p = params.mass
    here, force, store = tip.base_position_m / p.position_scale, p.force_scale * tip.force_n, state.store
    if state.coupled and tip.following:
        store = tip_worked(store, state.last_m, state.last_n, here, force)
        state = SlaveState(state.position_m, state.heard_m, here, force, store, True)
    return state, tip_signal(tip, tip.base_position_m, tip.force_n, energy_j=store.sent_j)


@compiled
def retune(old: Any, new: Any, state: MasterState) -> MasterState:
    """Keep the tip's reference constant when alpha_p changes; limit the energy that may leave to the new cap."""
    return MasterState(
        rescaled(old.mass, new.mass, state.mass), kept_below(state.store, new.cap_j), state.stood_s, state.port
    )


@compiled
def slave_retune(old: Any, new: Any, state: SlaveState) -> SlaveState:
    """Convert reference and measurement, which are at the hand's scale; limit the store to the new cap."""
    longer, stronger = of_scales(old.mass, new.mass)
    return SlaveState(
        position_m=state.position_m,
        heard_m=longer * state.heard_m,
        last_m=longer * state.last_m,
        last_n=stronger * state.last_n,
        store=kept_below(state.store, new.cap_j),
        coupled=state.coupled,
    )


@compiled
def master_energy_account(params: TdpaParams, state: MasterState) -> EnergyAccount:
    """Return the energy that may still leave this port, and the energy granted to both ports."""
    account = account_of(state.store)
    return EnergyAccount(account.remaining_j, account.dissipated_j, account.granted_j + state.port.granted_j)


@compiled
def slave_energy_account(params: TdpaParams, state: SlaveState) -> EnergyAccount:
    """Return the energy that may still leave this port, and the energy granted to both ports."""
    return account_of(state.store)


TDPA = Law.of(__name__, TdpaConfig, uses_energy=True, passive=True)
