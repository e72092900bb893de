"""A contact that is rendered at the hand from a bounded model, and pressed at the tip with the hand's own force.

In free motion the base follows the hand's position. In contact it is a servo of the hand's force, independent of the
hand's position, and the hand touches a model of the contact at its own site: no loop is closed through the link.

    hand   (M_v + M_e) x'' + (B_v + B_e) x' = F_m - F(y),   F(y) = K (y - y_0) down to -F_a, and 0 outside of that
    base   B_g x_s' = F_m(t - T) - F_s in contact,          B_a x_s' <= max(F_m(t - T), 0) + F_0 - F_s outside

y is the tip's reference. The model's line goes through the newest returned pair (x_s, F_s), with the slope of the pairs
over about the last `memory_m` of motion. The idea is that of model-mediated teleoperation (B. Hannaford 1989; P. Mitra,
G. Niemeyer 2008, as in telenano's model_mediated). The following additions are derived here:

1. One energy account covers both ports. The model's potential V may rise only by the energy that the dampers at the
   hand have dissipated (Z), and the tip may get only E_0 and the energy that the hand has sent from Z; the work of the
   tip is measured. So a wrong or late model costs force or motion, and generates no energy (docs/bounded-model.md, "Why
   it is passive").
2. Hand and tip move together. The tip responds at t to the hand's force at t - T, so a hand that responds at once is
   ahead of it. M_e = c_2 K tau^2 and B_e = c_1 K tau - B_v, with tau = T + B_g / K, hold the hand back by about tau:
   K exp(s tau) = K (1 + s tau + s^2 tau^2 / 2 ...) is the impedance of a contact K that is tau late, and these two
   terms of it are passive. They fade in while the model agrees with the tip's answers.
3. A surface is met late. The hand is then beyond it, so the model begins under the hand without force, and moves to its
   place only as fast as the dampers pay for, with a force of at most `update_margin_n` more than that of the tip.
"""

import math
from typing import NamedTuple

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
    FARTHEST_M,
    FASTEST_M_PER_S,
    AtHand,
    Mass,
    MassConfig,
    MassParams,
    at_hand,
    at_rest,
    at_tip,
    let_go,
    mass_signal,
    periods_in,
    rescaled,
    resumed,
    tip_reference,
)
from telenano.numerics import compiled
from telenano_laws.drift import Drift, drifted, error_of, no_drift
from telenano_laws.ports import (
    PortEnergy,
    account_of,
    bounded,
    credited,
    followed,
    kept_below,
    of_scales,
    opened,
    paid_way,
    recount_received,
    reopen,
    sent_on,
    slid_work,
    tank,
)

# Greatest lag that holds the hand back [s].
_LONGEST_LAG_S = 1.0
# Time constant of the mean lag [s].
_LAG_S = 1.0
# Time constant with which the terms of the lag fade in and out [s].
_FADE_S = 0.1
# The model agrees with the answers if their forces at the hand differ by less than this [N].
_AGREES_N = 0.5
# A device that follows lags behind its reference by less than this [m].
_LONGEST_LEAD_M = 2e-3
# The force counts as constant if it changes by less than this [N/s].
_STANDS_N_PER_S = 0.2
# Greatest possible drift of a sample, at the tip [m/s].
_FASTEST_DRIFT_M_PER_S = 5e-10
# Share of `memory_m` with which the first slope is weighted, so that it holds until the tip has moved that far.
_UNKNOWN_SHARE = 0.1
# The tip requests energy if less than this share of E_0 is left.
_LEAST_SHARE = 0.25


class BoundedModelParams(NamedTuple):
    """Constants of the law; lengths are at the hand's scale, and shares are those of a period."""

    mass: MassParams
    mass_kg: float
    damping_n_s_per_m: float
    first_n_per_m: float
    memory_m: float
    follow: float
    force_step_n: float
    update_margin_n: float
    lag_damping: float
    lag_inertia: float
    lag_share: float
    fade_share: float
    servo_n_s_per_m: float
    approach_n_s_per_m: float
    margin_n: float
    start_j: float
    cap_j: float
    well_j: float
    send_share: float


class BoundedModelConfig(MassConfig):
    """Section `controller.bounded_model`; energies and stiffness at the hand's scale."""

    silence_limit_s: float = parameter(
        0.5, "s", "Time without a signal from the other half after which the hand is let go [s]"
    )
    first_stiffness_n_per_m: float = parameter(
        1000.0, "N/m", "Stiffness of the contact before its slope is known, at the hand's scale K_0 [N/m]"
    )
    memory_m: float = parameter(1e-10, "m", "Way of the tip over which the slope of the contact is taken [m]")
    update_s: float = parameter(0.05, "s", "Time constant with which the model follows [s]")
    update_force_n_per_s: float = parameter(10.0, "N/s", "Fastest change of the force at the hand by an update [N/s]")
    update_margin_n: float = parameter(
        0.5, "N", "Force above the tip's up to which an update may raise the force at the hand [N]"
    )
    lag_damping: float = parameter(0.85, "1", "Share c_1 of K tau that the hand feels as a damper in contact; 0 = none")
    lag_inertia: float = parameter(0.22, "1", "Share c_2 of K tau^2 that the hand feels as a mass in contact; 0 = none")
    servo_damping_n_s_per_m: float = parameter(
        150.0, "N s/m", "Damper B_g of the tip's force servo in contact, at the hand's scale [N s/m]"
    )
    approach_damping_n_s_per_m: float = parameter(
        30.0, "N s/m", "Damper B_a against which the hand's force drives the tip on outside [N s/m]"
    )
    force_margin_n: float = parameter(
        0.0, "N", "Force by which the tip may meet the sample harder than the hand presses F_0 [N]"
    )
    start_energy_j: float = parameter(
        7.5e-4, "J", "Energy that each side has at the start, before it has taken or received any E_0 [J]", zero=True
    )
    energy_cap_j: float = parameter(1e-2, "J", "Most energy that a side keeps [J]")
    well_energy_j: float = parameter(
        5e-4, "J", "Deepest well of an attraction that the model may have E_a [J]", zero=True
    )
    exchange_s: float = parameter(
        0.05, "s", "Time constant with which a tip's store that is nearly empty is filled [s]"
    )

    def to_params(self, period_s: float) -> BoundedModelParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        return BoundedModelParams(
            mass=self.mass_params(period_s),
            mass_kg=self.mass_kg,
            damping_n_s_per_m=self.damping_n_s_per_m,
            first_n_per_m=self.first_stiffness_n_per_m,
            memory_m=self.memory_m / self.position_scale,
            follow=min(period_s / self.update_s, 1.0),
            force_step_n=self.update_force_n_per_s * period_s,
            update_margin_n=self.update_margin_n,
            lag_damping=self.lag_damping,
            lag_inertia=self.lag_inertia,
            lag_share=min(period_s / _LAG_S, 1.0),
            fade_share=min(period_s / _FADE_S, 1.0),
            servo_n_s_per_m=max(self.servo_damping_n_s_per_m, self.approach_damping_n_s_per_m),
            approach_n_s_per_m=self.approach_damping_n_s_per_m,
            margin_n=self.force_margin_n,
            start_j=min(self.start_energy_j, self.energy_cap_j),
            cap_j=self.energy_cap_j,
            well_j=self.well_energy_j,
            send_share=min(period_s / self.exchange_s, 1.0),
        )

    def stiffness_limit_n_per_m(self, period_s: float) -> float:
        """Return the stiffest sample [N/m] that the tip may meet, which it approaches through the damper B_a."""
        return self.limit_of_damper(self.approach_damping_n_s_per_m, period_s)


class Contact(NamedTuple):
    """The line F = K (y - y_0) [N, m at the hand's scale] down to minus the adhesion F_a [N], and 0 outside."""

    stiffness_n_per_m: float
    zero_m: float
    pull_n: float


class ContactMoments(NamedTuple):
    """Statistics of the contact: newest pair, means and mean products with fading weights, and greatest adhesion [N].

    Positions exclude the drift of the sample while the tip was in contact.
    """

    known: bool
    last_m: float
    last_n: float
    mean_m: float
    mean_n: float
    square_m2: float
    product_n_m: float
    pull_n: float
    drift: Drift


class MasterState(NamedTuple):
    """Mass, statistics, the model and whether there is one, lag [s], share of the lag's terms, M [kg], and the store.

    stood_s: time for which the device has been off [s]; device_m: its last position [m]; ahead_j: work of the hand at
    the reference minus that at the device [J]; since_s: time since the newest answer [s].
    """

    mass: Mass
    seen: ContactMoments
    contact: Contact
    rendered: bool
    lag_s: float
    held_back: float
    mass_kg: float
    store: PortEnergy
    stood_s: float
    device_m: float
    ahead_j: float
    since_s: float


class SlaveState(NamedTuple):
    """Base reference [m], last measurement at the hand's scale [m, N], and store; coupled: the hand led the base."""

    position_m: float
    last_m: float
    last_n: float
    store: PortEnergy
    coupled: bool


@compiled
def restarted(drift: Drift, place: float, force: float) -> Drift:
    """Return the estimate of the drift for a next contact that begins at this position and force."""
    d = drift
    return Drift(place, force, d.speed, d.square, d.recent, d.slow_square, d.known_s, d.gone)


@compiled
def rescaled_drift(drift: Drift, longer: float, stronger: float) -> Drift:
    """Return the drift in other units: positions are multiplied by `longer`, and forces by `stronger`."""
    d, square = drift, longer * longer
    place, force, gone = longer * d.slow_place, stronger * d.slow_force, longer * d.gone
    speed, recent = longer * d.speed, longer * d.recent
    return Drift(place, force, speed, square * d.square, recent, square * d.slow_square, d.known_s, gone)


@compiled
def nothing_seen() -> ContactMoments:
    """Return the statistics before the first contact."""
    return ContactMoments(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, no_drift(0.0, 0.0, 0.0))


@compiled
def contact_force(contact: Contact, y_m: float) -> float:
    """Return the force of the model [N] at a reference of the tip [m]."""
    force = contact.stiffness_n_per_m * (y_m - contact.zero_m)
    return force if force > -contact.pull_n else 0.0


@compiled
def potential(contact: Contact, y_m: float) -> float:
    """Return the work that brings the hand to a reference y [m] from outside [J], at least -F_a^2 / 2 K."""
    force, pull = contact.stiffness_n_per_m * (y_m - contact.zero_m), contact.pull_n
    return 0.5 * (force * force - pull * pull) / contact.stiffness_n_per_m if force > -pull else 0.0


@compiled
def taught(
    params: BoundedModelParams, seen: ContactMoments, measured_m: float, force_n: float, touches: bool, elapsed_s: float
) -> ContactMoments:
    """Update the statistics with a pair of the tip; out of contact it can only move the surface further away.

    The weight of a pair grows with the motion since the previous one, without the drift, so nothing is forgotten while
    the tip is at rest or moves with the sample.
    """
    drift = seen.drift
    if touches and seen.known:
        most = _FASTEST_DRIFT_M_PER_S / params.mass.position_scale
        slope = slope_of(params, seen)
        drift = drifted(drift, measured_m, force_n, force_n, slope, elapsed_s, _STANDS_N_PER_S, most)
    position_m = measured_m - drift.gone
    if not touches:
        slope = slope_of(params, seen)
        beyond = seen.known and position_m > seen.last_m - (seen.last_n + seen.pull_n) / slope
        if not beyond:
            return seen
        return ContactMoments(
            seen.known,
            position_m,
            -seen.pull_n,
            seen.mean_m,
            seen.mean_n,
            seen.square_m2,
            seen.product_n_m,
            seen.pull_n,
            restarted(drift, measured_m, -seen.pull_n),
        )
    if not seen.known:
        pull_n = max(-force_n, 0.0)
        here = no_drift(measured_m, force_n, _FASTEST_DRIFT_M_PER_S / params.mass.position_scale)
        return ContactMoments(True, measured_m, force_n, measured_m, force_n, 0.0, 0.0, pull_n, here)
    way = abs(position_m - seen.last_m) / params.memory_m
    gain = way / (1.0 + way)
    by_m, by_n, kept = position_m - seen.mean_m, force_n - seen.mean_n, 1.0 - gain
    return ContactMoments(
        known=True,
        last_m=position_m,
        last_n=force_n,
        mean_m=seen.mean_m + gain * by_m,
        mean_n=seen.mean_n + gain * by_n,
        square_m2=kept * (seen.square_m2 + gain * by_m * by_m),
        product_n_m=kept * (seen.product_n_m + gain * by_m * by_n),
        pull_n=max(seen.pull_n, -force_n),
        drift=drift,
    )


@compiled
def slope_of(params: BoundedModelParams, seen: ContactMoments) -> float:
    """Return the slope of the observed contact [N/m]; it is the configured first slope until the tip has moved."""
    first, unknown = params.first_n_per_m, _UNKNOWN_SHARE * params.memory_m
    slope = (seen.product_n_m + first * unknown * unknown) / (seen.square_m2 + unknown * unknown)
    return min(max(slope, 1e-3 * first), 1e3 * first)


@compiled
def goal_of(params: BoundedModelParams, seen: ContactMoments) -> Contact:
    """Return the model that fits the statistics, with a potential well no deeper than allowed."""
    slope = slope_of(params, seen)
    pull = min(seen.pull_n, math.sqrt(2.0 * slope * params.well_j))
    return Contact(slope, seen.last_m + seen.drift.gone - seen.last_n / slope, pull)


@compiled
def between(start: Contact, end: Contact, share: float) -> Contact:
    """Return the model interpolated linearly from `start` (share 0) to `end` (share 1)."""
    return Contact(
        start.stiffness_n_per_m + share * (end.stiffness_n_per_m - start.stiffness_n_per_m),
        start.zero_m + share * (end.zero_m - start.zero_m),
        start.pull_n + share * (end.pull_n - start.pull_n),
    )


@compiled
def updated(
    params: BoundedModelParams, contact: Contact, goal: Contact, y_m: float, tip_n: float, left_j: float
) -> tuple[Contact, float]:
    """Move the model towards the goal as far as force and energy allow; return it with the rise of its energy [J].

    The share is halved until the limits hold; after 12 trials the model is kept.
    """
    force, stored = contact_force(contact, y_m), potential(contact, y_m)
    most = max(force, tip_n + params.update_margin_n)
    share = params.follow
    for _ in range(12):
        tried = between(contact, goal, share)
        force_then, rise = contact_force(tried, y_m), potential(tried, y_m) - stored
        if abs(force_then - force) <= params.force_step_n and force_then <= most and rise <= max(left_j, 0.0):
            return tried, rise
        share *= 0.5
    return contact, 0.0


@compiled
def _begun(params: BoundedModelParams, mass: Mass) -> MasterState:
    contact, store = Contact(params.first_n_per_m, 0.0, 0.0), opened(params.start_j)
    return MasterState(
        mass, nothing_seen(), contact, False, 0.0, 0.0, params.mass_kg, store, 0.0, mass.position_m, 0.0, 0.0
    )


@compiled
def master_start(params: BoundedModelParams, hand: HandSample) -> MasterState:
    """Start with the virtual mass at rest at the hand's position, and no known surface."""
    return _begun(params, at_rest(hand.position_m))


@compiled
def master_resume(params: BoundedModelParams, hand: HandSample, tip_reference_m: float) -> MasterState:
    """Continue with the hand's motion and the tip's reference; the contact must be learnt anew."""
    return _begun(params, resumed(params.mass, hand, tip_reference_m))


@compiled
def master_send(
    params: BoundedModelParams, state: MasterState, hand: HandSample, dt: float
) -> tuple[MasterState, PortSignal]:
    """Return the slave's reference, the hand's force, and the total energy sent to the tip."""
    return state, mass_signal(params.mass, state.mass, hand, state.store.sent_j, state.mass.coupled)


@compiled
def _let_go(
    params: BoundedModelParams, state: MasterState, hand: HandSample, signal: PortSignal, may: AtHand, worked_j: float
) -> MasterState:
    """Release the hand, and return the energy of the model to the store; while the tip must be armed, restart all."""
    p, store = params.mass, state.store
    if state.rendered:
        y = tip_reference(p, state.mass) / p.position_scale
        store = tank(store, potential(state.contact, y), params.cap_j)
    ahead = state.ahead_j
    if state.mass.coupled:
        # The reference moves back to the device; Z pays for that motion against the hand's force.
        undone_j = hand.force_n * (hand.position_m - state.mass.position_m)
        store = tank(store, min(undone_j, 0.0), params.cap_j)
        ahead += undone_j - worked_j
    seen, lag = state.seen, state.lag_s
    if may.renews:
        seen, lag, store, ahead = nothing_seen(), 0.0, reopen(store, 0.0, False, params.start_j), 0.0
    mass = let_go(p, state.mass, hand, signal)
    return MasterState(
        mass, seen, state.contact, False, lag, 0.0, params.mass_kg, store, may.stood_s, hand.position_m, ahead, 0.0
    )


@compiled
def _at_device(state: MasterState, hand: HandSample, may: AtHand) -> float:
    """Return the work [J] of the hand at its device since the last sample; 0 if the law did not move the device."""
    return hand.force_n * (hand.position_m - state.device_m) if may.counts else 0.0


@compiled
def _first_contact(params: BoundedModelParams, goal: Contact, y_m: float, tip_m: float, left_j: float) -> Contact:
    """Return the first model: under the hand without force, or at its place if hand and tip are at the same place.

    The second case needs the energy of the force with which the hand then begins.
    """
    if abs(y_m - tip_m) <= params.memory_m and potential(goal, y_m) <= max(left_j, 0.0):
        return goal
    return Contact(goal.stiffness_n_per_m, max(goal.zero_m, y_m), 0.0)


@compiled
def lag_terms(params: BoundedModelParams, stiffness_n_per_m: float, delay_s: float) -> tuple[float, float]:
    """Return the mass M_e [kg] and the damper B_e [N s/m], including B_v, that delay the hand as much as the tip.

    The tip is late by the delay T of its line, K e^(sT) = K (1 + s T + s^2 T^2 / 2 ...), and by its servo, K + s B_g.
    """
    late = stiffness_n_per_m * delay_s
    mass = (params.lag_inertia * late + params.lag_damping * params.servo_n_s_per_m) * delay_s
    return mass, params.lag_damping * late + params.servo_n_s_per_m


@compiled
def master_receive(
    params: BoundedModelParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Learn from the answer, update the model within the energy in the store, and move the mass against it for dt [s].

    The step is Euler's with the new velocity, for which the energy balance of a period is exact: F_m dx is the change
    of M v^2 / 2 and V plus the energy dissipated by mass, damper and the step of the model.
    """
    p, scale = params.mass, params.mass.position_scale
    may = at_hand(p, hand, signal, state.mass.coupled, state.stood_s, dt, True)
    worked_j = _at_device(state, hand, may)
    if not (may.acts or may.stands):
        state = _let_go(params, state, hand, signal, may, worked_j)
        return state, MasterReference(hand.position_m, 0.0, 0.0, may.coupled)
    mass, seen, contact, rendered, store = state.mass, state.seen, state.contact, state.rendered, state.store
    tip_m, tip_n = signal.position_m / scale, p.force_scale * signal.force_n
    lag, heavy = state.lag_s, state.mass_kg
    since = state.since_s + dt
    if signal.silence_s < 0.5 * p.period_s:
        seen = taught(params, seen, tip_m, tip_n, signal.in_contact, since)
        since = 0.0
        lag += params.lag_share * (min(0.5 * signal.round_trip_s, _LONGEST_LAG_S) - lag)
    offset = mass.tip_offset_m / scale
    goal, held_back, force = goal_of(params, seen), state.held_back, 0.0
    before, ahead = mass.position_m, state.ahead_j - worked_j
    lead = mass.position_m - hand.position_m
    # Two energies must not be spent: that needed to set back the reference of a stuck device, and the work that the
    # hand has done at the reference only.
    owed = max(hand.force_n * bounded(lead, _LONGEST_LEAD_M), ahead, 0.0)
    if seen.known and not rendered:
        y = mass.position_m + offset
        contact, rendered = _first_contact(params, goal, y, tip_m, store.left_j - owed), True
        store = tank(store, -potential(contact, y), params.cap_j)
    if may.stands or abs(lead) > _LONGEST_LEAD_M:
        # A device that is off for a moment, or at the end of its travel, stands: set its reference back, and book that
        # like a motion.
        y, kept = mass.position_m + offset, bounded(lead, _LONGEST_LEAD_M) if may.acts else 0.0
        back, tip_offset = kept - lead, mass.tip_offset_m
        if rendered:
            rise = potential(contact, y + back) - potential(contact, y)
            if rise > max(store.left_j - owed, 0.0):
                # There is no energy for pressing deeper into the model, so the offset moves the model along.
                tip_offset, rise = tip_offset - scale * back, 0.0
                offset = tip_offset / scale
            store = tank(store, -rise, params.cap_j)
            force = contact_force(contact, hand.position_m + kept + offset)
        mass = Mass(hand.position_m + kept, 0.0, tip_offset, True)
        store = tank(store, hand.force_n * back, params.cap_j)
    if may.stands:
        ahead += hand.force_n * (mass.position_m - before)
        heavy = params.mass_kg
        state = MasterState(
            mass, seen, contact, rendered, lag, held_back, heavy, store, may.stood_s, hand.position_m, ahead, since
        )
        return state, MasterReference(hand.position_m, 0.0, force, True)
    for _ in range(periods_in(dt, p.period_s)):
        y = mass.position_m + offset
        agrees = 0.0
        if rendered:
            contact, used = updated(params, contact, goal, y, tip_n, store.left_j - owed)
            store = tank(store, -max(used, 0.0), params.cap_j)
            force = contact_force(contact, y)
            if force > 0.0:
                agrees = max(1.0 - abs(contact_force(goal, y) - force) / _AGREES_N, 0.0)
        held_back += params.fade_share * (agrees - held_back)
        stiffness = contact.stiffness_n_per_m
        more_mass, more_damper = lag_terms(params, stiffness, lag)
        wanted = params.mass_kg + held_back * more_mass
        velocity = mass.velocity_m_per_s
        if wanted > heavy:
            # The momentum is kept while the mass grows, so that the kinetic energy falls.
            velocity *= heavy / wanted
        heavy = wanted
        b = params.damping_n_s_per_m
        damper = b + held_back * max(more_damper - b, 0.0)
        after = (heavy * velocity + p.period_s * (hand.force_n - force)) / (heavy + damper * p.period_s)
        after = bounded(after, FASTEST_M_PER_S)
        way, change = after * p.period_s, after - velocity
        stored = (potential(contact, y + way) - potential(contact, y)) if rendered else 0.0
        taken = 0.5 * heavy * change * change + damper * after * way + force * way - stored
        store = tank(store, taken, params.cap_j)
        mass = Mass(bounded(mass.position_m + way, FARTHEST_M), after, mass.tip_offset_m, True)
    missing = max(signal.energy_j - store.sent_j, 0.0)
    store = sent_on(store, min(max(store.left_j - owed, 0.0), params.send_share * missing))
    ahead += hand.force_n * (mass.position_m - before)
    state = MasterState(mass, seen, contact, rendered, lag, held_back, heavy, store, 0.0, hand.position_m, ahead, since)
    return state, MasterReference(mass.position_m, mass.velocity_m_per_s, force, True)


@compiled
def slave_start(params: BoundedModelParams, tip: TipMeasurement) -> SlaveState:
    """Start at the position of the base."""
    return _standing(params, tip.base_position_m, tip, opened(params.start_j))


@compiled
def _standing(params: BoundedModelParams, position_m: float, tip: TipMeasurement, store: PortEnergy) -> SlaveState:
    p = params.mass
    return SlaveState(position_m, tip.base_position_m / p.position_scale, p.force_scale * tip.force_n, store, False)


@compiled
def slave_receive(
    params: BoundedModelParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Press with the hand's force in contact and follow its position outside, within the energy that has arrived.

    While the tip does not follow, the reference is the master's; while the master does not, the base stays.
    """
    p, store = params.mass, state.store
    here, force = tip.base_position_m / p.position_scale, p.force_scale * tip.force_n
    may = at_tip(p, signal, tip, state.position_m, state.coupled)
    if may.counts:
        store = tank(store, -slid_work(state.last_m, state.last_n, here, force), params.cap_j)
    if not may.leads:
        store = recount_received(store, signal.energy_j, may.heard)
        if may.renews:
            store = reopen(store, signal.energy_j, may.heard, params.start_j)
        return _standing(params, may.base_m, tip, store), SlaveReference(may.base_m, True)
    store = credited(store, signal.energy_j, params.cap_j)
    pressed, start = p.force_scale * signal.force_n, followed(p, state.position_m, tip)
    due = (signal.position_m - start) / p.position_scale
    if tip.in_contact:
        way = p.period_s / params.servo_n_s_per_m * (pressed - force)
        if pressed <= 0.0:
            # A hand that no longer presses pulls the tip back with it.
            way = min(way, due)
    else:
        allowed = max(pressed, 0.0) + params.margin_n - force
        way = min(due, p.period_s / params.approach_n_s_per_m * allowed)
    way = paid_way(way, force, 2.0 * params.servo_n_s_per_m / p.period_s, store.left_j)
    base = start + p.position_scale * way
    return SlaveState(base, here, force, store, True), SlaveReference(base, True)


@compiled
def slave_send(
    params: BoundedModelParams, state: SlaveState, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, PortSignal]:
    """Return the tip's measurement, and the total energy requested from the hand: that used, plus a reserve."""
    asked = max(state.store.received_j - state.store.left_j + _LEAST_SHARE * params.start_j, 0.0)
    return state, tip_signal(tip, tip.base_position_m, tip.force_n, energy_j=asked)


@compiled
def retune(old: BoundedModelParams, new: BoundedModelParams, state: MasterState) -> MasterState:
    """Keep the tip's reference, the force of the model and the mass when parameters change; Z pays for a rise of V.

    Statistics and model are lengths and forces of the tip, so they are converted to new scales. The mass changes in the
    next period, in which it keeps momentum if it grows and speed if it falls.
    """
    longer, stronger = of_scales(old.mass, new.mass)
    seen, contact, store = state.seen, state.contact, kept_below(state.store, new.cap_j)
    seen = ContactMoments(
        known=seen.known,
        last_m=longer * seen.last_m,
        last_n=stronger * seen.last_n,
        mean_m=longer * seen.mean_m,
        mean_n=stronger * seen.mean_n,
        square_m2=longer * longer * seen.square_m2,
        product_n_m=longer * stronger * seen.product_n_m,
        pull_n=stronger * seen.pull_n,
        drift=rescaled_drift(seen.drift, longer, stronger),
    )
    mass = rescaled(old.mass, new.mass, state.mass)
    scaled = Contact(contact.stiffness_n_per_m * stronger / longer, longer * contact.zero_m, stronger * contact.pull_n)
    if state.rendered:
        before = potential(contact, tip_reference(old.mass, state.mass) / old.mass.position_scale)
        rise = potential(scaled, tip_reference(new.mass, mass) / new.mass.position_scale) - before
        store = tank(store, -max(rise, 0.0), new.cap_j)
    return MasterState(
        mass,
        seen,
        scaled,
        state.rendered,
        state.lag_s,
        state.held_back,
        state.mass_kg,
        store,
        state.stood_s,
        state.device_m,
        state.ahead_j,
        state.since_s,
    )


@compiled
def slave_retune(old: BoundedModelParams, new: BoundedModelParams, state: SlaveState) -> SlaveState:
    """Convert the last measurement, which is at the hand's scale, and limit the store to the new cap."""
    longer, stronger = of_scales(old.mass, new.mass)
    store = kept_below(state.store, new.cap_j)
    return SlaveState(state.position_m, longer * state.last_m, stronger * state.last_n, store, state.coupled)


@compiled
def master_energy_account(params: BoundedModelParams, state: MasterState) -> EnergyAccount:
    """Return the dissipated energy that neither updates nor the tip have used, and the energy granted to both ports."""
    return EnergyAccount(state.store.left_j, 0.0, params.well_j + 2.0 * state.store.granted_j)


@compiled
def slave_energy_account(params: BoundedModelParams, state: SlaveState) -> EnergyAccount:
    """Return the energy that the tip may still get, and the energy granted to both ports."""
    return account_of(state.store)


@compiled
def sample_drift(params: BoundedModelParams, state: MasterState) -> tuple[float, float]:
    """Return the speed at which the sample recedes, and its standard error [m/s]."""
    scale = params.mass.position_scale
    return scale * state.seen.drift.speed, scale * error_of(state.seen.drift)


BOUNDED_MODEL = Law.of(
    __name__,
    BoundedModelConfig,
    uses_energy=True,
    local_loop=True,
    link_loop=False,
    passive=True,
)
