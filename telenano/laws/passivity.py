"""Time-domain passivity control with a store of energy on each side that the hand's damper fills: it does not tire.

Limits. A round trip T over a sample that the hand feels as stiffness K acts like a damper of -K sin(w T) / w, and the
hand feels the damping that compensates it: up to 375 N s/m on a stiff sample at 300 ms and 0.5 Hz. From about
K T = 2 B_v on, the response to a swing is up to 1.5 times its size. A motion at v against F needs F v T in the stores,
each of which holds 5 mJ at most and 1 mJ as a rule: faster motions are followed late. A hand of constant force comes to
rest with the time constant B_v / (alpha_f alpha_p K), which is 6.7 s on 0.1 N/m. Samples stiffer than
`stiffness_limit_n_per_m`, 800 N/m, are too stiff for the loop of the base: the store pays the energy that the loop
generates, and the base jumps.

The channel carries velocity forward and the computed force of the slave's controller backward (the position-computed
force architecture). The slave's controller is a spring K_c that draws the base to the reference x_d, and the base
moves as if through a damper B_c: F_c = K_c (x_d - x_s), B_c x_s' = F_c - F_s. The master's mass feels F_c, delayed.

Each side has a store S >= 0 of energy that it may spend, and sends a counter that only grows (`energy_j`). In a period

    master:  S += received + damper,  F d > 0 is sent;   F d < 0 is paid from S, and motion that S cannot pay is cut
    slave:   S += received + damper,  work of K_c into x_d is sent;  work that K_c needs there is paid from S
    both:    a share Ts / tau_e of S is sent to the other side

Each side spends only energy that was granted, received or taken from a damper. So for the sum of both sides and of the
energy in transit, at all times, E_in - E_out + E_granted >= 0. Sources: J.-H. Ryu, J. Artigas, C. Preusche, "A passive
bilateral control scheme for a teleoperator with time-varying communication delay", Mechatronics 20 (2010), for the
accounts by port and direction; M. Franken, S. Stramigioli, S. Misra, C. Secchi, A. Macchelli, "Bilateral
telemanipulation with time delays: a two-layer approach combining passivity and transparency", IEEE Trans. Robotics 27
(2011), for a store that a damper at the hand keeps at its level.

Why stores: a force that arrives T late does work on a hand that swings. Each cycle takes that work from the account
without a return, so E_0 alone would be spent after seconds or minutes, and the channel would stand still. Here the
damper at the hand is B_t (1 - S / E_0) while S < E_0: it takes from the hand only the energy that the delay generates,
and the exchange moves half of it to the side that lacks it.

Both devices are position sources, so both controllers act on motion and not on force (admittance type). The port gives
energy out in a period when F d < 0 at the master (the force drives the hand back) and F d > 0 at the slave. The motion
is then cut to the part that the energy pays, |F d'| = S. This needs no division by a small velocity, so it cannot cause
a force spike; its strongest effect is that the device stands still.

- At the slave the motion that was cut remains due, x_ref - x_d, and is made up when energy arrives, within a speed
  limit. So the positions do not drift apart, and the account includes the make-up motion.
- At the master a cut would also hold back an operator who pulls away himself. Motion that the mass would make without
  the force costs the channel nothing; it is always allowed, and the force counts as zero over it.
- The dissipation of the base's damper is measured and not assumed: the energy that the spring lost over the base's
  motion and the sample did not get. It is negative if a sample is too stiff for the loop, and then the store pays; a
  base whose store is overdrawn presses no further. The base continues from its position: the messages of a burst that
  it has not followed yet move it no further than one of them.
- The slave presses at most as hard as the hand by the last signal, plus a margin: F_c <= max(F_m, 0) + F_0 (the force
  clamp, which can be switched off). Without it, a channel without energy would hold hand and tip pressed together after
  the hand has been released. Giving way is motion at the port like any other: it is counted, and returns the contact's
  energy. While the hand presses at all, the limit follows a falling F_m only with a time constant tau_c. If it followed
  at once, a hand that presses less than before would feel exactly its own force, nothing would bring it back, and it
  would advance with each swing. It returns if tau_c is longer than the round trip and than B_v over the stiffness that
  it feels. For a hand that no longer presses the time constant is 0.2 s.
- A half that begins while the tip presses begins with the coupling stretched by that force, F_c = F_s, and keeps the
  stretch as an offset between x_d and x_ref: so the tip is not released when the law or a hand comes back. That energy,
  F_s^2 / 2 K_c, is granted in the account.
- A device that is off for a moment, because its guard misses a command, stands still, and the coupling continues. A new
  coupling would leave hand and tip separated by their motion meanwhile, and jitter and loss often cause such moments.
- E_0 is granted at the start, and again to a tip that has to be armed. While the tip is retracted each side has exactly
  E_0, so that the behaviour after an arming does not depend on earlier events.
- S is capped (the rest is dissipated): a large store, gathered long ago, would let an instability grow first.

The counters only grow, so the bound holds under constant and varying delay, loss, reordering and repetition: energy
that has not arrived cannot be spent. Loss and jitter cost motion, not stability: while no signal arrives the reference
stands, and the coupling continues against the force that the instrument measures.
"""

import math
from typing import NamedTuple

from telenano.extend.laws import (
    EnergyAccount,
    HandSample,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
    tip_signal,
)
from telenano.extend.virtual_mass import (
    NOTHING_HEARD,
    HandPort,
    Mass,
    MassParams,
    at_hand,
    at_rest,
    at_tip,
    begun_again,
    followed,
    has_arrived,
    kept_near,
    let_go,
    mass_signal,
    moved,
    paid_stretch,
    periods_in,
    placed,
    put_in,
    rescaled,
    resumed,
    unpaid_j,
    worked,
)
from telenano.numerics.compiler import compiled


class PassivityParams(NamedTuple):
    """Constants of the law; `relaxed` is the share of its distance to equilibrium that the base moves in a period.

    Further shares of a period: `release` and `let_go`, with which the clamp's limit follows a hand that presses less,
    or no longer; `shared`, the part of the store that is sent to the other side.
    """

    mass: MassParams
    coupling_n_per_m: float
    relaxed: float
    step_m: float
    margin_n: float
    release: float
    let_go: float
    start_j: float
    cap_j: float
    level_j: float
    refill_n_s_per_m: float
    shared: float


class Account(NamedTuple):
    """Energy of one port [J]: put into the channel, received from the other side, left to spend, dissipated, granted.

    received_j is `NOTHING_HEARD` until the first signal, because energy that the other side sent before that does not
    count here.
    """

    in_j: float
    received_j: float
    remaining_j: float
    lost_j: float
    granted_j: float


class MasterState(NamedTuple):
    """The mass and the account of its port; stood_s: time for which the device of the hand has been off [s]."""

    mass: Mass
    account: Account
    stood_s: float
    port: HandPort


class SlaveState(NamedTuple):
    """State of the slave half: reference of the base [m], coupling, clamp, last measurement and account.

    stretch_m, lead_m: stretch x_d - x_s and offset x_d - x_ref of the coupling at the hand's scale [m]; limit_n: the
    clamp's limit without its margin [N]; last_m, last_n: last measured position of the base [m] and the force there at
    the hand's scale [N].
    """

    position_m: float
    stretch_m: float
    lead_m: float
    limit_n: float
    last_m: float
    last_n: float
    account: Account
    coupled: bool


@compiled
def credited(account: Account, energy_j: float, cap_j: float) -> Account:
    """Add the energy that the other side has sent since its last signal; the part above the cap is dissipated [J]."""
    if account.received_j < 0.0:
        return recount_received(account, energy_j, True)
    added_j = max(energy_j - account.received_j, 0.0)
    left = min(account.remaining_j + added_j, cap_j)
    lost = account.lost_j + (account.remaining_j + added_j - left)
    return Account(account.in_j, account.received_j + added_j, left, lost, account.granted_j)


@compiled
def charged(account: Account, work_j: float, lost_j: float) -> Account:
    """Book work done on the channel (positive) or by it (negative), and energy dissipated by the controller [J]."""
    put_in, spent = max(work_j, 0.0), max(-work_j, 0.0)
    left = account.remaining_j - spent
    return Account(account.in_j + put_in, account.received_j, left, account.lost_j + lost_j, account.granted_j)


@compiled
def taken(account: Account, energy_j: float, cap_j: float) -> Account:
    """Add the energy [J] that a damper of this side has taken to the store; the part above the cap stays dissipated.

    It is negative if the damper generated energy, as on a sample that is too stiff for the discrete loop; the store
    then pays it.
    """
    left = account.remaining_j + energy_j
    if energy_j > 0.0:
        left = max(min(left, cap_j), account.remaining_j)
    lost = account.lost_j + (account.remaining_j + energy_j - left)
    return Account(account.in_j, account.received_j, left, lost, account.granted_j)


@compiled
def shared_out(account: Account, share: float) -> Account:
    """Move a share of the store to the counter of energy sent to the other side."""
    out = share * max(account.remaining_j, 0.0)
    left = account.remaining_j - out
    return Account(account.in_j + out, account.received_j, left, account.lost_j, account.granted_j)


@compiled
def granted(account: Account, energy_j: float) -> Account:
    """Book granted energy [J], such as that of a coupling which begins stretched; the store does not change."""
    return Account(account.in_j, account.received_j, account.remaining_j, account.lost_j, account.granted_j + energy_j)


@compiled
def recount_received(account: Account, energy_j: float, received: bool) -> Account:
    """Restart the count of the other side's energy at the counter `energy_j` [J] of a signal; the store stays.

    Without a recent signal (`received` false) nothing changes: a restart at zero would credit all energy again.
    """
    received_j = energy_j if received else account.received_j
    return Account(account.in_j, received_j, account.remaining_j, account.lost_j, account.granted_j)


@compiled
def opened(start_j: float) -> Account:
    """Return a new account with the energy E_0 [J] in its store."""
    return Account(0.0, NOTHING_HEARD, start_j, 0.0, start_j)


@compiled
def reopen(account: Account, start_j: float, sent_j: float) -> Account:
    """Set the store to E_0 [J] again; an excess is dissipated, and a deficit granted.

    sent_j: counter of energy sent to the other side [J], which excludes the part that the hand has not paid.
    """
    missing = start_j - account.remaining_j
    lost, granted = account.lost_j + max(-missing, 0.0), account.granted_j + max(missing, 0.0)
    return Account(sent_j, account.received_j, start_j, lost, granted)


@compiled
def master_start(params: PassivityParams, hand: HandSample) -> MasterState:
    """Return the virtual mass at rest at the hand's position, with a new account."""
    port = HandPort(hand.position_m, 0.0, 0.0, 0.0)
    return MasterState(at_rest(hand.position_m), opened(params.start_j), 0.0, port)


@compiled
def master_resume(params: PassivityParams, hand: HandSample, tip_reference_m: float) -> MasterState:
    """Return the virtual mass with the hand's motion, such that the tip's reference stays, with a new account."""
    mass, port = resumed(params.mass, hand, tip_reference_m), HandPort(hand.position_m, 0.0, 0.0, 0.0)
    return MasterState(mass, opened(params.start_j), 0.0, port)


@compiled
def master_send(
    params: PassivityParams, state: MasterState, hand: HandSample, dt: float
) -> tuple[MasterState, PortSignal]:
    """Return the tip's reference and the counter of energy sent."""
    return state, mass_signal(params.mass, state.mass, hand, state.port.sent_j, state.mass.coupled)


@compiled
def paid_motion(motion_m: float, own_m: float, force_n: float, remaining_j: float) -> tuple[float, float]:
    """Limit a motion [m] of the hand to the energy left [J]; return it with the work [J] done on the channel.

    motion_m: motion of the mass under the forces of hand and channel; own_m: motion without the channel's force F [N].
    Motion into the channel (F d >= 0) is not cut.
    """
    if force_n * motion_m >= -remaining_j:
        return motion_m, force_n * motion_m
    back = math.copysign(1.0, motion_m)
    paid = remaining_j / abs(force_n)
    if own_m * back > paid:
        return back * min(own_m * back, motion_m * back), 0.0
    return back * paid, -remaining_j


@compiled
def charged_or_granted(account: Account, work_j: float) -> Account:
    """Book the work [J] of a motion that cannot be cut; the part that the store cannot pay is granted."""
    return granted(charged(account, max(work_j, -account.remaining_j), 0.0), max(-work_j - account.remaining_j, 0.0))


@compiled
def moved_by_what_is_paid(
    params: PassivityParams, mass: Mass, account: Account, hand: HandSample, force_n: float, port: HandPort
) -> tuple[Mass, Account, HandPort]:
    """Move the mass by a period under the hand's force and the channel's [N]; return it with the account and the port.

    The damper that fills the store acts on the mean velocity of the period, so the energy that it takes is exact.
    """
    p = params.mass
    damper = params.refill_n_s_per_m * min(max(1.0 - account.remaining_j / params.level_j, 0.0), 1.0)
    left, hand_n = account.remaining_j - unpaid_j(port), hand.force_n
    way = moved(p, mass, hand_n - force_n).position_m - mass.position_m
    taken_n = damper * way / (p.period_s + damper * p.gamma_x_m_per_n)
    after = kept_near(mass, moved(p, mass, hand_n - force_n - taken_n), hand.position_m)
    wanted = after.position_m - mass.position_m
    own = kept_near(mass, moved(p, mass, hand_n - taken_n), hand.position_m).position_m - mass.position_m
    motion, work = paid_motion(wanted, own, force_n, max(left, 0.0))
    account = charged(account, work, work - force_n * wanted)
    into_j = work
    if motion == wanted:
        into_j += damper * motion * motion / p.period_s
        account = taken(account, into_j - work, params.cap_j)
    else:
        mean = motion / p.period_s
        speed = min(abs(after.velocity_m_per_s), abs(mean))
        after = placed(after, mass.position_m + motion, math.copysign(speed, mean))
    port = put_in(port, into_j, 0.0)
    if unpaid_j(port) == 0.0:
        account = shared_out(account, params.shared)
    return after, account, put_in(port, 0.0, account.in_j)


@compiled
def master_receive(
    params: PassivityParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Move the virtual mass over dt [s] under the force received last, within the energy of the store."""
    p, mass = params.mass, state.mass
    force = p.force_scale * signal.force_n
    may = at_hand(p, hand, signal, mass.coupled, state.stood_s, dt, True)
    port = worked(state.port, hand, may.counts)
    if not (may.acts or may.stands):
        account = recount_received(state.account, signal.energy_j, signal.silence_s <= p.silence_limit_s)
        if may.renews:
            port = begun_again(port, account.in_j, True)
            account = reopen(account, params.start_j, port.sent_j)
        state = MasterState(let_go(p, mass, hand, signal), account, may.stood_s, port)
        return state, MasterReference(hand.position_m, 0.0, force if may.coupled else 0.0, may.coupled)
    account = credited(state.account, signal.energy_j, params.cap_j)
    if not mass.coupled:
        account = granted(account, 0.5 * force * force / params.coupling_n_per_m)
    if may.stands:
        # A device that is off for a moment stands still: set the reference back to it, and book that like a motion.
        back_j = force * (hand.position_m - mass.position_m)
        account = shared_out(charged_or_granted(account, back_j), params.shared)
        mass, port = placed(mass, hand.position_m, 0.0), put_in(port, back_j, account.in_j)
        return MasterState(mass, account, may.stood_s, port), MasterReference(hand.position_m, 0.0, force, True)
    for _ in range(periods_in(dt, p.period_s)):
        mass, account, port = moved_by_what_is_paid(params, mass, account, hand, force, port)
    return MasterState(mass, account, 0.0, port), MasterReference(mass.position_m, mass.velocity_m_per_s, force, True)


@compiled
def slave_start(params: PassivityParams, tip: TipMeasurement) -> SlaveState:
    """Return the state at the position of the base, with a new account."""
    return _standing(params, tip.base_position_m, tip, opened(params.start_j))


@compiled
def _standing(params: PassivityParams, position_m: float, tip: TipMeasurement, account: Account) -> SlaveState:
    """Return the state of an uncoupled half; if the tip follows, the coupling is stretched by its force."""
    force = params.mass.force_scale * tip.force_n
    stretch = force / params.coupling_n_per_m if tip.following else 0.0
    return SlaveState(
        position_m=position_m,
        stretch_m=stretch,
        lead_m=stretch,
        limit_n=0.0,
        last_m=tip.base_position_m,
        last_n=force,
        account=account,
        coupled=False,
    )


@compiled
def slave_receive(
    params: PassivityParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Move the base towards the reference for a period, within the energy of the store.

    While the tip does not follow, the base's reference is the master's; while the master does not follow, the base
    stays.
    """
    p, k = params.mass, params.coupling_n_per_m
    may = at_tip(p, signal, tip, state.position_m, state.coupled)
    if not (may.leads and has_arrived(p, state.position_m, tip)):
        account = recount_received(state.account, signal.energy_j, may.heard)
        if may.renews:
            account = reopen(account, params.start_j, account.in_j)
        return _standing(params, may.base_m, tip, account), SlaveReference(may.base_m, True)
    force = p.force_scale * tip.force_n
    account = credited(state.account, signal.energy_j, params.cap_j)
    if not state.coupled:
        # The base may have moved far since its last measurement, and the coupling caused none of that motion.
        state = _standing(params, state.position_m, tip, account)
        account = granted(account, 0.5 * k * state.stretch_m * state.stretch_m)
    # The damper of the base dissipated the work of the coupling over the motion of the base, minus the work on the
    # sample.
    slid = (tip.base_position_m - state.last_m) / p.position_scale
    stretch = state.stretch_m - slid
    spring_n, tip_n = 0.5 * k * (state.stretch_m + stretch), 0.5 * (force + state.last_n)
    account = taken(account, (spring_n - tip_n) * slid, params.cap_j)
    pressed = max(p.force_scale * signal.force_n, 0.0)
    limit = state.limit_n + (params.release if pressed > 0.0 else params.let_go) * (pressed - state.limit_n)
    limit = max(pressed, limit)
    most = (limit + params.margin_n) / k
    due = (signal.position_m - tip.base_position_m) / p.position_scale + state.lead_m - stretch
    wanted = min(max(min(due, most - stretch), -params.step_m), params.step_m)
    motion, work = paid_stretch(stretch, wanted, k, max(account.remaining_j, 0.0))
    refused = k * wanted * (stretch + 0.5 * wanted) + work
    account = shared_out(charged(account, work, refused if motion != wanted else 0.0), params.shared)
    stretch += motion
    # The base moves towards the position at which the coupling balances the measured force.
    way = params.relaxed * (k * stretch - force) / k
    if account.remaining_j < 0.0:
        # The store is overdrawn: the base presses no further, and gives way by a quarter of its step.
        way = 0.0 if way * force > 0.0 else 0.25 * way
    base = followed(p, state.position_m, tip) + p.position_scale * way
    state = SlaveState(
        position_m=base,
        stretch_m=stretch,
        lead_m=state.lead_m,
        limit_n=limit,
        last_m=tip.base_position_m,
        last_n=force,
        account=account,
        coupled=True,
    )
    return state, SlaveReference(base, True)


@compiled
def slave_send(
    params: PassivityParams, state: SlaveState, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, PortSignal]:
    """Return the force of the coupling, and the counter of energy sent by this side."""
    force = params.coupling_n_per_m * state.stretch_m / params.mass.force_scale
    return state, tip_signal(tip, tip.base_position_m, force, energy_j=state.account.in_j)


@compiled
def retune(old: PassivityParams, new: PassivityParams, state: MasterState) -> MasterState:
    """Keep the tip's reference constant when alpha_p changes, and limit the store to the new cap."""
    a = state.account
    account = Account(a.in_j, a.received_j, min(a.remaining_j, new.cap_j), a.lost_j, a.granted_j)
    return MasterState(rescaled(old.mass, new.mass, state.mass), account, state.stood_s, state.port)


@compiled
def slave_retune(old: PassivityParams, new: PassivityParams, state: SlaveState) -> SlaveState:
    """Keep the force of the coupling constant when K_c changes, and book the change of its stored energy.

    A rise is paid from the store or else granted; a fall counts as dissipated.
    """
    longer = old.mass.position_scale / new.mass.position_scale
    stronger = new.mass.force_scale / old.mass.force_scale
    stretch = state.stretch_m * (old.coupling_n_per_m / new.coupling_n_per_m) * stronger
    stored = 0.5 * old.coupling_n_per_m * state.stretch_m * state.stretch_m
    rise = 0.5 * new.coupling_n_per_m * stretch * stretch - stored
    paid = min(rise, max(state.account.remaining_j, 0.0))
    account = charged(state.account, 0.0, -rise)
    if rise > 0.0:
        account = granted(charged(state.account, -paid, 0.0), rise - paid)
    left = min(account.remaining_j, new.cap_j)
    return SlaveState(
        position_m=state.position_m,
        stretch_m=stretch,
        lead_m=longer * (state.lead_m - state.stretch_m) + stretch,
        limit_n=stronger * state.limit_n,
        last_m=state.last_m,
        last_n=stronger * state.last_n,
        account=Account(account.in_j, account.received_j, left, account.lost_j, account.granted_j),
        coupled=state.coupled,
    )


@compiled
def master_energy_account(params: PassivityParams, state: MasterState) -> EnergyAccount:
    """Return the store, the dissipated energy, and the energy granted to both ports."""
    granted_j = 2.0 * state.account.granted_j + state.port.granted_j
    return EnergyAccount(state.account.remaining_j, state.account.lost_j, granted_j)


@compiled
def slave_energy_account(params: PassivityParams, state: SlaveState) -> EnergyAccount:
    """Return the store, the dissipated energy, and the energy granted to both ports."""
    return EnergyAccount(state.account.remaining_j, state.account.lost_j, 2.0 * state.account.granted_j)
