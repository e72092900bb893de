"""Two layers: a transparent one, and below it energy tanks that must pay for every motion and force.

The upper layer is direct: the hand feels the force measured at the tip, and the tip follows the hand's position. In the
lower layer each side has a tank H that the work at its port fills or empties. In each period a share beta of H goes to
the other side, as a counter that never decreases. While the hand's tank is below its level H_d, the hand also feels a
damper

    d = alpha (H_d - H)

whose work fills the tank. At the hand the force is clipped so that its work in the coming period stays within H; at the
tip the motion is shortened to the part that H covers.

Source: M. Franken, S. Stramigioli, S. Misra, C. Secchi, A. Macchelli, IEEE Trans. Robotics 27 (2011). The paper's text
could not be read: tank, level control and limit are as in public code (F. Grotto, phri; creminem94, pHRI); the clip,
the one-sided limit and the counters are derived here.

At the nanoscale, the tip's tank must hold the energy that the sample stores, F^2 / 2 K at the hand's scale, which is
0.2 mJ for 1 N on 20 N/m and 30 mJ on 0.1 N/m; and the hand, which follows positions, feels the damper as slowness.
"""

from typing import NamedTuple

from telenano.extend.laws import (
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
    MassParams,
    at_tip,
    moved,
    periods_in,
)
from telenano.numerics import compiled
from telenano_laws.ports import (
    clipped_force,
    credited,
    followed,
    kept_near,
    paid_base,
    put_in,
    recount_received,
    reopen,
    sent_on,
    slid_work,
    tank,
    unpaid_j,
)
from telenano_laws.tdpa import MasterState, PaidConfig, SlaveState, at_sample, standing
from telenano_laws.tdpa import master_energy_account as master_energy_account
from telenano_laws.tdpa import master_resume as master_resume
from telenano_laws.tdpa import master_send as master_send
from telenano_laws.tdpa import master_start as master_start
from telenano_laws.tdpa import retune as retune
from telenano_laws.tdpa import slave_energy_account as slave_energy_account
from telenano_laws.tdpa import slave_retune as slave_retune
from telenano_laws.tdpa import slave_start as slave_start

# A damper that acts on the velocity of the previous period is stable below M / Ts; this share of it leaves a margin.
_STABLE_SHARE = 0.4


class TwoLayerParams(NamedTuple):
    """Constants of the law; shared: the share beta of a tank that is sent in a period."""

    mass: MassParams
    level_j: float
    damping_per_j: float
    most_damping_n_s_per_m: float
    shared: float
    start_j: float
    cap_j: float
    stiffest_n_per_m: float


class TwoLayerConfig(PaidConfig):
    """Section `controller.two_layer`; energies at the hand's scale."""

    silence_limit_s: float = parameter(
        0.5, "s", "Time without a signal from the other half after which the hand is let go [s]"
    )
    level_j: float = parameter(2e-3, "J", "Level of the hand's tank H_d [J]", zero=True)
    level_gain_n_s_per_m_j: float = parameter(
        1e5, "1", "Damper at the hand for each joule that is missing in its tank alpha [N s/m/J]"
    )
    exchange_s: float = parameter(0.1, "s", "Time in which a tank would send all it has to the other side Ts/beta [s]")
    start_energy_j: float = parameter(1e-3, "J", "Energy in each tank at the start H(0) [J]", zero=True)
    energy_cap_j: float = parameter(2e-2, "J", "Most energy that a tank keeps [J]")

    def to_params(self, period_s: float) -> TwoLayerParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        return TwoLayerParams(
            mass=self.mass_params(period_s),
            level_j=self.level_j,
            damping_per_j=self.level_gain_n_s_per_m_j,
            most_damping_n_s_per_m=_STABLE_SHARE * self.mass_kg / period_s,
            shared=min(period_s / self.exchange_s, 1.0),
            start_j=min(self.start_energy_j, self.energy_cap_j),
            cap_j=self.energy_cap_j,
            stiffest_n_per_m=self.stiffest_n_per_m,
        )


@compiled
def level_damper(params: TwoLayerParams, left_j: float) -> float:
    """Return the damper [N s/m] that the hand feels while its tank has left_j [J]."""
    return min(params.damping_per_j * max(params.level_j - left_j, 0.0), params.most_damping_n_s_per_m)


@compiled
def master_receive(
    params: TwoLayerParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Move the mass for dt [s] against the tip's force and the level damper, clipped to the energy in the tank."""
    p, received = params.mass, params.mass.force_scale * signal.force_n
    may, state = at_sample(params, state, hand, signal, dt)
    if not may.acts:
        return state, MasterReference(hand.position_m, 0.0, received if may.coupled else 0.0, may.coupled)
    mass, store, port = state.mass, state.store, state.port
    force = received
    for _ in range(periods_in(dt, p.period_s)):
        wanted = received + level_damper(params, store.left_j) * mass.velocity_m_per_s
        own = moved(p, mass, hand.force_n).position_m - mass.position_m
        force = clipped_force(wanted, own, p.gamma_x_m_per_n, store.left_j - unpaid_j(port))
        after = kept_near(mass, moved(p, mass, hand.force_n - force), hand.position_m)
        into_j = force * (after.position_m - mass.position_m)
        store = tank(store, into_j, params.cap_j)
        port = put_in(port, into_j, 0.0)
        store = sent_on(store, params.shared * max(store.left_j - unpaid_j(port), 0.0))
        mass = after
    port = put_in(port, 0.0, store.sent_j + unpaid_j(port))
    return MasterState(mass, store, 0.0, port), MasterReference(mass.position_m, mass.velocity_m_per_s, force, True)


@compiled
def slave_receive(
    params: TwoLayerParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Follow the hand's position, as far as the energy in the tank covers it.

    While the tip does not follow, the reference is the master's; while the master does not, the base stays.
    """
    p = params.mass
    here, force = tip.base_position_m / p.position_scale, p.force_scale * tip.force_n
    may, store = at_tip(p, signal, tip, state.position_m, state.coupled), state.store
    if may.counts:
        store = tank(store, -slid_work(state.last_m, state.last_n, here, force), params.cap_j)
    if not may.leads:
        store = recount_received(store, signal.energy_j, may.heard)
        if may.renews:
            store = reopen(state.store, signal.energy_j, may.heard, params.start_j)
        return standing(params, may.base_m, tip, store), SlaveReference(may.base_m, True)
    store = credited(store, signal.energy_j, params.cap_j)
    start, target = followed(p, state.position_m, tip), signal.position_m / p.position_scale
    # Energy that is sent on can no longer pay for the motion, so it is subtracted first.
    store = sent_on(store, params.shared * max(store.left_j, 0.0))
    way = target - start / p.position_scale
    base = paid_base(p, state.position_m, tip, way, params.stiffest_n_per_m, store.left_j, 0.0)
    return SlaveState(base, target, here, force, store, True), SlaveReference(base, True)


@compiled
def slave_send(
    params: TwoLayerParams, state: SlaveState, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, PortSignal]:
    """Return the tip's measurement and the energy sent from its tank; book the work with the force after the step."""
    p = params.mass
    here, force = tip.base_position_m / p.position_scale, p.force_scale * tip.force_n
    if state.coupled and tip.following:
        store = tank(state.store, -slid_work(state.last_m, state.last_n, here, force), params.cap_j)
        state = SlaveState(state.position_m, state.heard_m, here, force, store, True)
    return state, tip_signal(tip, tip.base_position_m, tip.force_n, energy_j=state.store.sent_j)


TWO_LAYER = Law.of(__name__, TwoLayerConfig, uses_energy=True, passive=True)
