"""Model-mediated: the hand touches a model of the surface, fitted to the tip's answers, at its own site without delay.

    M_v x'' + B_v x' = F_m - alpha_f F(x_ref; x_c, kappa, F_a),   x_ref = alpha_p x + offset

F is the compact Maugis-Dugdale surface of `surface`, whose parameters follow from the returned pairs (x_s, F_s) in
contact. Force and position close no loop through the link: delayed answers change only the model. Sources:
B. Hannaford, "A design framework for teleoperators with kinesthetic feedback", IEEE Trans. Robotics and Automation 5
(1989), for the idea; P. Mitra, G. Niemeyer, "Model-mediated telemanipulation", Int. J. Robotics Research 27 (2008), for
the way a model is changed under a hand; the fit is that of Levenberg and Marquardt.

Safe updates. A new model changes the potential V of the surface at the hand, and so may push energy into it. In each
period the rendered model moves towards the estimate by a share such that (a) the force at the hand changes no faster
than a limit and (b) the rise of V is paid from a store, which collects the energy that the virtual damper dissipates:

    sum of (V(x; new) - V(x; old))+ <= int B_v v^2 dt.

A surface met for the first time is placed under the hand, without force, and then moves to its estimated place. If hand
and tip are at the same place (no delay, or a law started in contact), it begins at that place, with the tip's force. So
the master with its model is passive at all times and under any delay, jitter and loss, which affect only the age of the
model.

The slave follows the received reference, but presses no harder than the hand does: its speed towards the sample is at
most (F_g - F_s) / B_g with F_g = max(F_m, 0) + F_0, at the hand's scale, so a wrong model, or a surface that has
moved, costs accuracy and not the tip. The guard is a damper to the environment; it is passive.

The guard does not limit the pull of the tip, so the work of the tip must be paid for as well. The hand sends its work
at the device, A = sum F_m dx_m, and the tip takes no more energy than E_0 and the last received A:

    sum F_s dx_s <= E_0 + max A,   where a step d costs F d + K d^2 / 2, with K the stiffest sample of the guard.

The hand takes back from A no more than the master stores. By this account hand and tip together get at most E_0 plus
that energy, however the hand pulls and whatever holds the tip. docs/passivity.md states the cases that exceed it.

Not guaranteed: F_m = alpha_f F_s while the model is being learnt, or on a surface that changes faster than a round
trip.
"""

from typing import NamedTuple

from telenano.extend.laws import (
    EnergyAccount,
    HandSample,
    Law,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
)
from telenano.extend.ranges import parameter
from telenano.extend.virtual_mass import (
    HandPort,
    Mass,
    MassConfig,
    MassParams,
    at_hand,
    at_rest,
    at_tip,
    followed,
    has_arrived,
    kept_near,
    let_go,
    mass_signal,
    moved,
    paid_stretch,
    periods_in,
    rescaled,
    resumed,
    tip_reference,
    worked,
)
from telenano.numerics import compiled
from telenano_laws.drift import Drift, drifted, error_of, no_drift
from telenano_laws.ports import slid_work
from telenano_laws.surface import (
    KAPPA_UNIT,
    NANO,
    Fit,
    FitParams,
    Surface,
    fitted,
    force_and_potential,
    gradient,
    met,
    over,
    root_of,
    unknown,
)

# The force at the tip counts as constant if it changes by less than this [nN/s].
_STANDS_NN_PER_S = 2.0
# Greatest possible drift of a sample, at the tip [nm/s].
_FASTEST_NM_PER_S = 0.5
# Least contact stiffness used for the drift: it is 0 at the end of the contact, where drift cannot be estimated [N/m].
_LEAST_SLOPE = 1e-3


class ModelMediatedParams(NamedTuple):
    """Constants of the law; force_step_n: greatest change of the hand's force by an update in a period [N]."""

    mass: MassParams
    fit: FitParams
    damping_n_s_per_m: float
    follow: float
    force_step_n: float
    cap_j: float
    guard_n_s_per_m: float
    margin_n: float
    stiffest_n_per_m: float
    start_j: float
    tip_cap_j: float


class ModelMediatedConfig(MassConfig):
    """Section `controller.model_mediated`."""

    cantilever_stiffness_n_per_m: float = parameter(40.0, "N/m", "Spring constant k of the cantilever [N/m]")
    contact_stiffness_n_per_m1_5: float = parameter(
        5.75e5, "N/m^1.5", "First estimate of kappa = 4/3 E* sqrt(R) [N/m^1.5]; Table 2 has 5.75e5"
    )
    adhesion_range_m: float = parameter(2e-9, "m", "Range l over which the pull fades outside [m]")
    fit_resolution_m: float = parameter(1e-10, "m", "Width of the 32 bins of position that the fit remembers [m]")
    update_s: float = parameter(0.05, "s", "Time constant with which the model follows the fit [s]")
    update_force_n_per_s: float = parameter(10.0, "N/s", "Fastest change of the force at the hand by an update [N/s]")
    energy_cap_j: float = parameter(
        5e-3, "J", "Most energy kept from the damper for updates, at the hand's scale [J]", zero=True
    )
    start_energy_j: float = parameter(
        2e-4, "J", "Energy that the tip may take at each arming before the hand has worked E_0 [J]"
    )
    tip_energy_cap_j: float = parameter(
        5e-2, "J", "Most energy kept of the hand's work for the tip, at the hand's scale [J]"
    )
    guard_damping_n_s_per_m: float = parameter(
        30.0, "N s/m", "Damper B_g of the slave's force guard, at the hand's scale [N s/m]"
    )
    force_margin_n: float = parameter(
        0.0, "N", "Force by which the slave may press harder than the hand, at the hand's scale F_0 [N]"
    )

    def to_params(self, period_s: float) -> ModelMediatedParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        kappa = self.contact_stiffness_n_per_m1_5 * KAPPA_UNIT
        fit = FitParams(
            cantilever=self.cantilever_stiffness_n_per_m,
            range_nm=self.adhesion_range_m / NANO,
            kappa=kappa,
            bin_nm=self.fit_resolution_m / NANO,
        )
        return ModelMediatedParams(
            mass=self.mass_params(period_s),
            fit=fit,
            damping_n_s_per_m=self.damping_n_s_per_m,
            follow=min(period_s / self.update_s, 1.0),
            force_step_n=self.update_force_n_per_s * period_s,
            cap_j=self.energy_cap_j,
            guard_n_s_per_m=self.guard_damping_n_s_per_m,
            margin_n=self.force_margin_n,
            stiffest_n_per_m=2.0 * self.guard_damping_n_s_per_m / period_s,
            start_j=min(self.start_energy_j, self.tip_energy_cap_j),
            tip_cap_j=self.tip_energy_cap_j,
        )

    def stiffness_limit_n_per_m(self, period_s: float) -> float:
        """Return the stiffest sample [N/m] that the guard of the slave tolerates."""
        return self.limit_of_damper(self.guard_damping_n_s_per_m, period_s)


class MasterState(NamedTuple):
    """The mass, the fit, the rendered model and whether there is one, and the energy kept for updates [J].

    The positions in the fit exclude the drift of the sample since it was met; `drift` is in nm and nN; since_s: time
    since the newest answer [s].
    `injected_j`, `dissipated_j`: total energy that updates have put in at the hand, and that the damper has dissipated.
    """

    mass: Mass
    fit: Fit
    model: Surface
    rendered: bool
    store_j: float
    injected_j: float
    dissipated_j: float
    drift: Drift
    since_s: float
    port: HandPort


class TipPort(NamedTuple):
    """Position [m] and force [N] of the tip, at the hand's scale, and the energy that it may still take [J]."""

    position_m: float
    force_n: float
    energy_j: float


class SlaveState(NamedTuple):
    """State of the slave half.

    position_m: reference of the base [m]; received_j: last received work of the hand [J]; granted_j: energy granted to
    the tip by all armings [J]; coupled: whether the hand led the base.
    """

    position_m: float
    port: TipPort
    received_j: float
    granted_j: float
    coupled: bool


@compiled
def _begun(params: ModelMediatedParams, mass: Mass) -> MasterState:
    return MasterState(
        mass=mass,
        fit=unknown(params.fit),
        model=Surface(0.0, params.fit.kappa, 0.0),
        rendered=False,
        store_j=0.0,
        injected_j=0.0,
        dissipated_j=0.0,
        drift=no_drift(0.0, 0.0, _FASTEST_NM_PER_S),
        since_s=0.0,
        port=HandPort(mass.position_m, 0.0, 0.0, 0.0),
    )


@compiled
def master_start(params: ModelMediatedParams, hand: HandSample) -> MasterState:
    """Start with the virtual mass at rest at the hand's position, and no known surface."""
    return _begun(params, at_rest(hand.position_m))


@compiled
def master_resume(params: ModelMediatedParams, hand: HandSample, tip_reference_m: float) -> MasterState:
    """Continue with the hand's motion and the tip's reference; the surface must be learnt anew."""
    return _begun(params, resumed(params.mass, hand, tip_reference_m))


@compiled
def master_send(
    params: ModelMediatedParams, state: MasterState, hand: HandSample, dt: float
) -> tuple[MasterState, PortSignal]:
    """Return the slave's reference, the hand's force, which limits that of the slave, and the work of the hand."""
    return state, mass_signal(params.mass, state.mass, hand, state.port.credit_j, hand.following and state.mass.coupled)


@compiled
def learnt(
    params: ModelMediatedParams, fit: Fit, drift: Drift, signal: PortSignal, elapsed_s: float
) -> tuple[Fit, Drift]:
    """Update fit and drift with a sample of the tip; a sample out of contact can only move the surface further away."""
    place, force = signal.position_m / NANO, signal.force_n / NANO
    if signal.in_contact:
        if not fit.known:
            return met(params.fit, place, force), no_drift(place, force, _FASTEST_NM_PER_S)
        r = root_of(place - drift.gone - fit.surface.contact_nm, fit.surface.kappa / params.fit.cantilever)
        slope = max(-gradient(fit.surface, params.fit.cantilever, r)[0], _LEAST_SLOPE)
        learnt_nn = fit.surface.kappa * r * r * r - fit.surface.adhesion_nn
        drift = drifted(drift, place, force, learnt_nn, slope, elapsed_s, _STANDS_NN_PER_S, _FASTEST_NM_PER_S)
        return fitted(params.fit, fit, place - drift.gone, force), drift
    position = place - drift.gone
    if fit.known and position > fit.surface.contact_nm + params.fit.range_nm:
        surface = Surface(position - params.fit.range_nm, fit.surface.kappa, fit.surface.adhesion_nn)
        return over(params.fit, fit, surface), drift
    return fit, drift


@compiled
def _now(fit: Fit, drift: Drift) -> Surface:
    """Return the fitted surface, moved by the drift."""
    return Surface(fit.surface.contact_nm + drift.gone, fit.surface.kappa, fit.surface.adhesion_nn)


@compiled
def between(start: Surface, end: Surface, share: float) -> Surface:
    """Return the surface interpolated linearly from `start` (share 0) to `end` (share 1)."""
    return Surface(
        start.contact_nm + share * (end.contact_nm - start.contact_nm),
        start.kappa + share * (end.kappa - start.kappa),
        start.adhesion_nn + share * (end.adhesion_nn - start.adhesion_nn),
    )


@compiled
def updated(
    params: ModelMediatedParams, model: Surface, goal: Surface, share: float, reference_m: float, store_j: float
) -> tuple[Surface, float, float]:
    """Move the model towards the goal by at most `share`, as far as force and energy at the hand allow.

    The share is halved until both limits hold, so they hold exactly for any shape of the surface; after 12 trials the
    model is kept. Return the model, the energy used [J] and the force of the model [nN].
    """
    p, k, span, x = params.mass, params.fit.cantilever, params.fit.range_nm, reference_m / NANO
    # Factor that converts nN nm at the tip to J at the hand.
    joules = NANO * NANO * p.force_scale / p.position_scale
    force, stored = force_and_potential(model, k, span, x)
    for _ in range(12):
        tried = between(model, goal, share)
        tried_nn, potential = force_and_potential(tried, k, span, x)
        change = abs(tried_nn - force) * NANO * p.force_scale
        rise = (potential - stored) * joules
        if change <= params.force_step_n and rise <= store_j:
            return tried, max(rise, 0.0), tried_nn
        share *= 0.5
    return model, 0.0, force


@compiled
def master_receive(
    params: ModelMediatedParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Learn from the answer, update the model safely, and move the virtual mass against it for dt [s]."""
    p, q = params.mass, params.fit
    may = at_hand(p, hand, signal, state.mass.coupled, 0.0, dt, False)
    mass, fit, model, rendered = state.mass, state.fit, state.model, state.rendered
    drift, since_s = state.drift, state.since_s + dt
    port = worked(state.port, hand, may.counts)
    if may.coupled and signal.silence_s < 0.5 * p.period_s:
        fit, drift = learnt(params, fit, drift, signal, since_s)
        since_s = 0.0
    if not may.acts:
        mass = let_go(p, mass, hand, signal)
        if fit.known and may.renews:
            # The tip may meet another surface after it is armed again.
            fit, drift = unknown(params.fit), no_drift(0.0, 0.0, _FASTEST_NM_PER_S)
        state = MasterState(
            mass=mass,
            fit=fit,
            model=_now(fit, drift),
            rendered=False,
            store_j=0.0,
            injected_j=state.injected_j,
            dissipated_j=state.dissipated_j,
            drift=drift,
            since_s=since_s,
            port=port,
        )
        return state, MasterReference(hand.position_m, 0.0, 0.0, may.coupled)
    goal = _now(fit, drift)
    if fit.known and not rendered:
        here = tip_reference(p, mass) / NANO
        # If the hand is already beyond the surface, the model begins under the hand, without force.
        out = max(goal.contact_nm, here + q.range_nm)
        if abs(here - signal.position_m / NANO) <= q.bin_nm:
            # Hand and tip are at the same place, so the model begins with the force of the tip.
            out = goal.contact_nm
        model, rendered = Surface(out, fit.surface.kappa, fit.surface.adhesion_nn), True
    store, injected, dissipated, force = state.store_j, state.injected_j, state.dissipated_j, 0.0
    if rendered:
        # Drift moves the model unchanged; energy is needed only if it comes nearer.
        gone = Surface(model.contact_nm + drift.gone - state.drift.gone, model.kappa, model.adhesion_nn)
        model, used, _ = updated(params, model, gone, 1.0, tip_reference(p, mass), store)
        store -= used
        injected += used
    for _ in range(periods_in(dt, p.period_s)):
        if rendered:
            model, used, model_nn = updated(params, model, goal, params.follow, tip_reference(p, mass), store)
            store -= used
            injected += used
            force = model_nn * NANO * p.force_scale
        before = mass.position_m
        mass = kept_near(mass, moved(p, mass, hand.force_n - force), hand.position_m)
        # The mean velocity never overstates the energy that the damper dissipated.
        moved_m = mass.position_m - before
        taken = params.damping_n_s_per_m * moved_m * moved_m / p.period_s
        store = min(store + taken, params.cap_j)
        dissipated += taken
    state = MasterState(
        mass=mass,
        fit=fit,
        model=model,
        rendered=rendered,
        store_j=store,
        injected_j=injected,
        dissipated_j=dissipated,
        drift=drift,
        since_s=since_s,
        port=port,
    )
    return state, MasterReference(mass.position_m, mass.velocity_m_per_s, force, True)


@compiled
def slave_start(params: ModelMediatedParams, tip: TipMeasurement) -> SlaveState:
    """Start at the position of the base; no energy is granted until a signal of the hand arrives."""
    return SlaveState(tip.base_position_m, TipPort(0.0, 0.0, 0.0), 0.0, 0.0, False)


@compiled
def _left(params: ModelMediatedParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement) -> SlaveState:
    """Update the energy that the tip may take: subtract the work on the sample, and add the new work of the hand.

    The energy starts at E_0 at the first signal, and again while the tip has to be armed.
    """
    p = params.mass
    here, force = tip.base_position_m / p.position_scale, p.force_scale * tip.force_n
    left, granted, received = state.port.energy_j, state.granted_j, state.received_j
    may = at_tip(p, signal, tip, state.position_m, state.coupled)
    if may.counts:
        left -= slid_work(state.port.position_m, state.port.force_n, here, force)
    if may.heard:
        left = min(left + signal.energy_j - received, params.tip_cap_j) if granted > 0.0 else 0.0
        received = signal.energy_j
        if granted == 0.0 or may.renews:
            left, granted = params.start_j, granted + max(params.start_j - left, 0.0)
    return SlaveState(state.position_m, TipPort(here, force, left), received, granted, state.coupled)


@compiled
def slave_receive(
    params: ModelMediatedParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Follow the reference no faster towards the sample than the guard allows, and no further than the hand paid for.

    While the tip does not follow, the reference is the master's; while the master does not, the base stays.
    """
    p, state = params.mass, _left(params, state, signal, tip)
    may = at_tip(p, signal, tip, state.position_m, state.coupled)
    base = may.base_m
    if may.leads:
        force, k = state.port.force_n, params.stiffest_n_per_m
        allowed = max(p.force_scale * signal.force_n, 0.0) + params.margin_n - force
        reach = allowed / params.guard_n_s_per_m * p.period_s
        start = followed(p, state.position_m, tip)
        base = start + min(signal.position_m - start, p.position_scale * reach)
        way = (base - tip.base_position_m) / p.position_scale
        paid, _ = paid_stretch(force / k, way, k, max(state.port.energy_j, 0.0))
        # Retraction through the air is free, and the law does not pay for the motion to the place of an arming.
        if paid != way and (tip.in_contact or way > 0.0) and has_arrived(p, state.position_m, tip):
            base = tip.base_position_m + p.position_scale * paid
    return SlaveState(base, state.port, state.received_j, state.granted_j, may.leads), SlaveReference(base, True)


@compiled
def retune(old: ModelMediatedParams, new: ModelMediatedParams, state: MasterState) -> MasterState:
    """Keep the tip's reference constant when alpha_p changes."""
    return MasterState(
        mass=rescaled(old.mass, new.mass, state.mass),
        fit=state.fit,
        model=state.model,
        rendered=state.rendered,
        store_j=min(state.store_j, new.cap_j),
        injected_j=state.injected_j,
        dissipated_j=state.dissipated_j,
        drift=state.drift,
        since_s=state.since_s,
        port=state.port,
    )


@compiled
def slave_retune(old: ModelMediatedParams, new: ModelMediatedParams, state: SlaveState) -> SlaveState:
    """Convert the tip's port, which is at the hand's scale, and limit its energy to the new cap."""
    place = state.port.position_m * old.mass.position_scale / new.mass.position_scale
    force = state.port.force_n * new.mass.force_scale / old.mass.force_scale
    port = TipPort(place, force, min(state.port.energy_j, new.tip_cap_j))
    return SlaveState(state.position_m, port, state.received_j, state.granted_j, state.coupled)


@compiled
def slave_energy_account(params: ModelMediatedParams, state: SlaveState) -> EnergyAccount:
    """Return the energy that the tip may still take, and the energy granted to it."""
    return EnergyAccount(max(state.port.energy_j, 0.0), 0.0, state.granted_j)


@compiled
def master_energy_account(params: ModelMediatedParams, state: MasterState) -> EnergyAccount:
    """Return the energy kept for updates, and the energy that the damper dissipated minus that of the updates."""
    return EnergyAccount(state.store_j, state.dissipated_j - state.injected_j, 0.0)


@compiled
def sample_drift(params: ModelMediatedParams, state: MasterState) -> tuple[float, float]:
    """Return the speed at which the sample recedes, and its standard error [m/s]."""
    return state.drift.speed * NANO, error_of(state.drift) * NANO


MODEL_MEDIATED = Law.of(
    __name__,
    ModelMediatedConfig,
    uses_energy=True,
    local_loop=True,
    link_loop=False,
    must_know=("cantilever_stiffness_n_per_m",),
    fixed_in_contact=("adhesion_range_m", "cantilever_stiffness_n_per_m"),
)
