"""Wave variables: the channel as a transmission line of impedance b that can only store energy, never make it.

At either port with the power F v, at the hand's scale,

    u = (b v + F) / sqrt(2 b)   towards the slave,     w = (b v - F) / sqrt(2 b)   towards the master,
    F v = u^2 / 2 - w^2 / 2.

The master's mass feels F_e = b v - sqrt(2 b) w, and the wave that leaves it is u = sqrt(2 b) v - w. At the slave the
base is a position source and F_s is measured: v = (sqrt(2 b) u - F_s) / b, and the returned wave is
w = (b v - F_s) / sqrt(2 b). B_v = b terminates the line at the master in its own impedance, so that this wave is not
reflected.
Sources: G. Niemeyer and J.-J. E. Slotine, "Stable adaptive teleoperation", IEEE J. Oceanic Eng. 16 (1991), and
"Telemanipulation with time delays", Int. J. Robotics Research 23 (2004), for waves, matching and filter; the same,
"Towards force-reflecting teleoperation over the Internet", ICRA 1998, for the integrals of wave and wave energy.

A hand whose device is off for a moment, because its guard misses a command, stands still, because its drive is a screw
that the hand cannot turn back. For the line this is the port v = 0, F_e = -sqrt(2 b) w, which reflects all waves,
u = -w, and needs no power. So the line continues through such gaps, of up to the silence limit, and waves in transit
are not lost.

If a line begins for the first time while the tip presses, it begins with the present force F_0: both halves use
F - F_0 for F, and F_0 fades with the time constant tau_0 as the waves replace it. So the tip is not released when the
law comes into force. The line is granted the energy of F_0 (its work at the two ports), which is zero if the tip starts
free; after a silence of the link no energy is granted again. A half that restarts alone uses no F_0, because the other
half has none; it recognises this case by the energy that the other half has sent.

The link carries cumulative counters, not samples: X = sqrt(2/b) int u dt = x + int F dt / b as `position_m`, and
E = int u^2/2 dt as `energy_j` (and w likewise). The receiver rebuilds its wave from the part that is still due,

    |u| = min( U / tau_f, 2 D / U ),   U = sqrt(b/2) |X received - X taken|,   D = E received - E taken.

The first term is the wave filter, a first-order low-pass of time constant tau_f, and also prevents drift, because every
metre that was sent is applied. The second spreads the due wave so that motion and energy run out together. Then
u^2/2 Ts <= D always, and each half is passive on samples up to the stiffness limit of its line:

- constant delay T each way: lossless except for the filter. At rest F_m = alpha_f F_s and x - x_s/alpha_p is about
  F (T + tau_f) / b: the line is a spring of stiffness b / (T + tau_f).
- varying delay, loss, reordering, repetition: without new signals the wave decays with tau_f, and a part that arrives
  later is spread as its energy allows. The wave that leaves the other end is then uneven, and so is its energy: jitter
  acts as dissipation, with a force below the hand's while the hand moves on.

The half at the slave also pays the energy K Ts d^2 / 2 that holding F_s over a period generates: the returned wave is
limited to the energy that is left, measured with the mean force over the motion. So for each half, at any time,

    energy sent + energy given out at the port <= energy received,

which the tests check. For the port of the slave this holds up to one period's work of the environment, repaid from the
waves that follow.
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
    port_signal,
    tip_signal,
)
from telenano.extend.virtual_mass import (
    NOTHING_HEARD,
    OVERDRAWN_J,
    HandPort,
    Mass,
    MassParams,
    at_hand,
    at_rest,
    at_tip,
    begun_again,
    followed,
    kept_near,
    let_go,
    moved,
    periods_in,
    put_in,
    rescaled,
    resumed,
    tip_reference,
    worked,
)
from telenano.numerics.compiler import compiled


class WaveParams(NamedTuple):
    """Constants of the law; `mass` includes the line's own damper b."""

    mass: MassParams
    impedance_n_s_per_m: float
    share: float
    fade: float
    bridge_s: float
    clamped: bool
    margin_n: float


class Inbox(NamedTuple):
    """Counters of the incoming wave at the hand's scale, received and applied: sqrt(2/b) int u dt [m], energy [J]."""

    received_m: float
    taken_m: float
    received_j: float
    taken_j: float


class MasterState(NamedTuple):
    """Mass, incoming wave, counters of the outgoing one (int F_e dt / b [m], energy [J]), F_0 [N], its work [J].

    `begun`: the line has run before; `up`: the line runs; `stood_s`: time for which the hand's device has been off [s].
    """

    mass: Mass
    inbox: Inbox
    impulse_m: float
    sent_j: float
    wave_sqrt_w: float
    bias_n: float
    granted_j: float
    begun: bool
    up: bool
    stood_s: float
    port: HandPort


class SlaveState(NamedTuple):
    """Base reference [m], incoming wave, counters of the outgoing wave, energy left, and the last measurement.

    `anchor_m`: base reference at the start of the line [m]; `sent_m`: sqrt(2/b) int w dt [m]; `sent_j`: its energy [J];
    `reserve_j`: energy received and neither given to the environment nor sent back [J]; `last_m`, `last_n`: base
    position [m] at the tip's scale and force [N] at the hand's; `bias_n`, `granted_j`: F_0 [N] and its work [J].
    """

    position_m: float
    inbox: Inbox
    anchor_m: float
    sent_m: float
    sent_j: float
    wave_sqrt_w: float
    reserve_j: float
    last_m: float
    last_n: float
    bias_n: float
    granted_j: float
    coupled: bool
    begun: bool


@compiled
def received(inbox: Inbox, position_m: float, energy_j: float) -> Inbox:
    """Update the counters of the received wave [m, J]; a signal with less energy than before is old, so ignore it."""
    if energy_j < inbox.received_j:
        return inbox
    return Inbox(position_m, inbox.taken_m, energy_j, inbox.taken_j)


@compiled
def drawn(inbox: Inbox, share: float, impedance_n_s_per_m: float, period_s: float) -> tuple[Inbox, float]:
    """Return the inbox after a period [s] and its wave [sqrt(W)]: a share of the due wave, within its energy."""
    root = math.sqrt(0.5 * impedance_n_s_per_m)
    due = root * (inbox.received_m - inbox.taken_m)
    if due == 0.0:
        return inbox, 0.0
    size = min(share * abs(due) / period_s, 2.0 * max(inbox.received_j - inbox.taken_j, 0.0) / abs(due))
    wave = math.copysign(size, due)
    taken_j = min(inbox.taken_j + 0.5 * wave * wave * period_s, inbox.received_j)
    return Inbox(inbox.received_m, inbox.taken_m + wave * period_s / root, inbox.received_j, taken_j), wave


@compiled
def emptied(position_m: float, energy_j: float) -> Inbox:
    """Return an inbox that starts at the counters of a signal [m, J]: all of it counts as applied."""
    return Inbox(position_m, position_m, energy_j, energy_j)


@compiled
def _begun(mass: Mass) -> MasterState:
    return MasterState(
        mass, emptied(0.0, 0.0), 0.0, 0.0, 0.0, 0.0, 0.0, False, False, 0.0, HandPort(mass.position_m, 0.0, 0.0, 0.0)
    )


@compiled
def master_start(params: WaveParams, hand: HandSample) -> MasterState:
    """Return the virtual mass at rest at the hand's position, without a line."""
    return _begun(at_rest(hand.position_m))


@compiled
def master_resume(params: WaveParams, hand: HandSample, tip_reference_m: float) -> MasterState:
    """Return the virtual mass with the hand's motion, such that the tip's reference stays, without a line."""
    return _begun(resumed(params.mass, hand, tip_reference_m))


@compiled
def master_send(params: WaveParams, state: MasterState, hand: HandSample, dt: float) -> tuple[MasterState, PortSignal]:
    """Return the counters of the outgoing wave and its energy; without a line, the position is the tip's reference."""
    p, mass = params.mass, state.mass
    position = tip_reference(p, mass) + p.position_scale * state.impulse_m
    return state, port_signal(
        position_m=position,
        velocity_m_per_s=p.position_scale * mass.velocity_m_per_s,
        force_n=hand.force_n / p.force_scale,
        wave_sqrt_w=state.wave_sqrt_w,
        energy_j=state.port.sent_j,
        active=state.up,
    )


@compiled
def master_receive(
    params: WaveParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Move the virtual mass over dt [s] at the end of the line; it stands still while the device is briefly off."""
    p, b = params.mass, params.impedance_n_s_per_m
    position = signal.position_m / p.position_scale
    may = at_hand(p, hand, signal, state.up, state.stood_s, dt, True)
    port = worked(state.port, hand, may.counts)
    if not (may.acts or may.stands):
        state = MasterState(
            mass=let_go(p, state.mass, hand, signal),
            inbox=emptied(position, signal.energy_j),
            impulse_m=0.0,
            sent_j=port.sent_j,
            wave_sqrt_w=0.0,
            bias_n=0.0,
            granted_j=state.granted_j,
            begun=state.begun,
            up=False,
            stood_s=may.stood_s,
            port=begun_again(port, state.sent_j, may.renews),
        )
        return state, MasterReference(hand.position_m, 0.0, 0.0, may.coupled)
    # Signals that were sent before the line began are no waves, so start counting at this one.
    inbox = state.inbox if state.up else emptied(position, signal.energy_j)
    inbox = received(inbox, position, signal.energy_j)
    # If the tip's half has sent energy, its line already runs and this half restarts alone, so it uses no F_0.
    again = state.begun or signal.energy_j > 0.0
    bias = state.bias_n if state.up else (0.0 if again else p.force_scale * signal.force_n)
    mass, impulse, sent, force, out = state.mass, state.impulse_m, state.sent_j, 0.0, 0.0
    if may.stands:
        mass = let_go(p, mass, hand, signal)
    granted = state.granted_j
    root, period = math.sqrt(2.0 * b), p.period_s
    for _ in range(periods_in(dt, period)):
        inbox, wave = drawn(inbox, params.share, b, period)
        before = mass.position_m
        if may.acts:
            mass = kept_near(mass, moved(p, mass, hand.force_n - bias + root * wave), hand.position_m)
        # The mean velocity gives the mean force of the damper b exactly, and never more energy than the damper took.
        velocity = (mass.position_m - before) / period
        force = b * velocity - root * wave
        out = root * velocity - wave
        impulse += force * period / b
        sent += 0.5 * out * out * period
        granted += abs(bias * velocity) * period
        force += bias
        port = put_in(port, force * velocity * period, sent)
        bias *= params.fade
    state = MasterState(
        mass=mass,
        inbox=inbox,
        impulse_m=impulse,
        sent_j=sent,
        wave_sqrt_w=out,
        bias_n=bias,
        granted_j=granted,
        begun=True,
        up=True,
        stood_s=may.stood_s,
        port=port,
    )
    return state, MasterReference(mass.position_m, mass.velocity_m_per_s, force, True)


@compiled
def slave_start(params: WaveParams, tip: TipMeasurement) -> SlaveState:
    """Return the state at the position of the base, without a line."""
    base, force = tip.base_position_m, params.mass.force_scale * tip.force_n
    inbox = emptied(0.0, NOTHING_HEARD)
    return SlaveState(base, inbox, 0.0, 0.0, 0.0, 0.0, 0.0, base, force, 0.0, 0.0, False, False)


@compiled
def slave_receive(
    params: WaveParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Move the base for dt [s], whole periods, with the incoming waves against the force measured last.

    While the tip does not follow, the base's reference is the master's; while the master does not follow, it stays.
    """
    p, b = params.mass, params.impedance_n_s_per_m
    position = signal.position_m / p.position_scale
    may = at_tip(p, signal, tip, state.position_m, state.coupled)
    if not may.leads:
        state = SlaveState(
            position_m=may.base_m,
            inbox=emptied(position, signal.energy_j if may.heard else state.inbox.received_j),
            anchor_m=may.base_m,
            sent_m=0.0,
            sent_j=state.sent_j,
            wave_sqrt_w=0.0,
            reserve_j=0.0,
            last_m=state.last_m,
            last_n=state.last_n,
            bias_n=0.0,
            granted_j=state.granted_j,
            coupled=False,
            begun=state.begun,
        )
        return state, SlaveReference(may.base_m, True)
    # An earlier position of the master is a reference and no wave, so start counting at this signal.
    inbox = state.inbox if state.coupled else emptied(position, signal.energy_j)
    inbox = received(inbox, position, signal.energy_j)
    anchor = state.anchor_m if state.coupled else state.position_m
    last_n = state.last_n if state.coupled else p.force_scale * tip.force_n
    # If the first signal received from the hand's half has no energy, both halves begin; else this one restarts alone.
    heard_j = signal.energy_j if state.inbox.received_j == NOTHING_HEARD else state.inbox.received_j
    again = state.begun or heard_j > 0.0
    bias = state.bias_n if state.coupled else (0.0 if again else last_n)
    # Consume exactly one period of waves for each sample of the hand; a surplus would let the hand run ahead.
    periods = round(dt / p.period_s)
    total, came_j = 0.0, 0.0
    for _ in range(periods):
        inbox, wave = drawn(inbox, params.share, b, p.period_s)
        total += wave
        came_j += 0.5 * wave * wave * p.period_s
    way = (math.sqrt(2.0 * b) * (total / max(periods, 1)) - (last_n - bias)) / b * dt
    if signal.silence_s > params.bridge_s:
        # All waves have decayed; giving way to the force would release the tip, so the base stands still.
        way = 0.0
    elif params.clamped:
        # The returned wave is computed from the actual motion, so the part that the clamp refuses is reflected.
        allowed = max(p.force_scale * signal.force_n, 0.0) + params.margin_n - last_n
        way = min(way, allowed / b * dt)
    reserve = state.reserve_j + came_j
    if reserve < -OVERDRAWN_J and way * last_n > 0.0:
        # A base that moves further than its reference, for example in coarse steps, has used more energy than it has
        # received: it presses no further until the next waves have paid.
        way = 0.0
    base = followed(p, state.position_m, tip) + p.position_scale * way
    state = SlaveState(
        position_m=base,
        inbox=inbox,
        anchor_m=anchor,
        sent_m=state.sent_m,
        sent_j=state.sent_j,
        wave_sqrt_w=state.wave_sqrt_w,
        reserve_j=reserve,
        last_m=state.last_m,
        last_n=last_n,
        bias_n=bias,
        granted_j=state.granted_j,
        coupled=True,
        begun=True,
    )
    return state, SlaveReference(base, True)


@compiled
def slave_send(params: WaveParams, state: SlaveState, tip: TipMeasurement, dt: float) -> tuple[SlaveState, PortSignal]:
    """Book the work on the environment over dt [s], and return the wave that the remaining energy allows."""
    p, b = params.mass, params.impedance_n_s_per_m
    force = p.force_scale * tip.force_n
    sent_m, sent_j, reserve, wave = state.sent_m, state.sent_j, state.reserve_j, 0.0
    bias, granted = state.bias_n, state.granted_j
    if state.coupled and dt > 0.0:
        moved_m = (tip.base_position_m - state.last_m) / p.position_scale
        mean = 0.5 * (force + state.last_n) - bias
        granted += abs(bias * moved_m)
        bias *= params.fade
        reserve -= mean * moved_m
        wave = (b * moved_m / dt - mean) / math.sqrt(2.0 * b)
        most = math.sqrt(2.0 * max(reserve, 0.0) / dt)
        wave = min(max(wave, -most), most)
        reserve -= 0.5 * wave * wave * dt
        sent_m += math.sqrt(2.0 / b) * wave * dt
        sent_j += 0.5 * wave * wave * dt
    state = SlaveState(
        position_m=state.position_m,
        inbox=state.inbox,
        anchor_m=state.anchor_m,
        sent_m=sent_m,
        sent_j=sent_j,
        wave_sqrt_w=wave,
        reserve_j=reserve,
        last_m=tip.base_position_m,
        last_n=force,
        bias_n=bias,
        granted_j=granted,
        coupled=state.coupled,
        begun=state.begun,
    )
    position = state.anchor_m + p.position_scale * sent_m if state.coupled else state.position_m
    return state, tip_signal(tip, position, tip.force_n, wave, sent_j)


@compiled
def _retuned_inbox(old: WaveParams, new: WaveParams, inbox: Inbox) -> tuple[Inbox, float]:
    """Return the counters for other parameters, such that the next wave stays, and the energy granted for it [J].

    Each period a share of the due wave is applied, so for a steady wave the part that remains due is 1 / share - 1 of
    it. Another share needs correspondingly more or less of the due wave and of its energy.
    """
    longer, more = old.mass.position_scale / new.mass.position_scale, 1.0
    if old.share < 1.0:
        more = old.share * (1.0 - new.share) / (new.share * (1.0 - old.share))
    due_m, due_j = inbox.received_m - inbox.taken_m, max(inbox.received_j - inbox.taken_j, 0.0)
    received_m = longer * inbox.received_m
    retuned = Inbox(received_m, received_m - more * due_m, inbox.received_j, inbox.received_j - more * due_j)
    return retuned, max(more - 1.0, 0.0) * due_j


@compiled
def retune(old: WaveParams, new: WaveParams, state: MasterState) -> MasterState:
    """Keep the tip's reference if alpha_p changes, force and energy of the line if b does, the wave if tau_f does."""
    ratio = old.impedance_n_s_per_m / new.impedance_n_s_per_m * (old.mass.position_scale / new.mass.position_scale)
    mass = rescaled(old.mass, new.mass, state.mass)
    inbox, granted_j = _retuned_inbox(old, new, state.inbox)
    return MasterState(
        mass=mass,
        inbox=inbox,
        impulse_m=state.impulse_m * ratio,
        sent_j=state.sent_j,
        wave_sqrt_w=state.wave_sqrt_w,
        bias_n=state.bias_n,
        granted_j=state.granted_j + granted_j,
        begun=state.begun,
        up=state.up,
        stood_s=state.stood_s,
        port=state.port,
    )


@compiled
def slave_retune(old: WaveParams, new: WaveParams, state: SlaveState) -> SlaveState:
    """Keep the sent wave, the measurement and the next incoming wave if the scales or tau_f change."""
    stronger = new.mass.force_scale / old.mass.force_scale
    inbox, granted_j = _retuned_inbox(old, new, state.inbox)
    return SlaveState(
        position_m=state.position_m,
        inbox=inbox,
        anchor_m=state.anchor_m,
        sent_m=state.sent_m * (old.mass.position_scale / new.mass.position_scale),
        sent_j=state.sent_j,
        wave_sqrt_w=state.wave_sqrt_w,
        reserve_j=state.reserve_j,
        last_m=state.last_m,
        last_n=stronger * state.last_n,
        bias_n=stronger * state.bias_n,
        granted_j=state.granted_j + granted_j,
        coupled=state.coupled,
        begun=state.begun,
    )


@compiled
def master_energy_account(params: WaveParams, state: MasterState) -> EnergyAccount:
    """Return the wave energy received and not yet applied, and the greatest energy that F_0 may have put in."""
    return EnergyAccount(
        state.inbox.received_j - state.inbox.taken_j, 0.0, 2.0 * state.granted_j + state.port.granted_j
    )


@compiled
def slave_energy_account(params: WaveParams, state: SlaveState) -> EnergyAccount:
    """Return the energy received and neither given to the environment nor sent back, and the work of F_0."""
    return EnergyAccount(state.inbox.received_j - state.inbox.taken_j + state.reserve_j, 0.0, state.granted_j)
