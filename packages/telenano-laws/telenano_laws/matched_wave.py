"""Wave variables with both ends matched: no wave is reflected, and motion that the energy guard cut is restored.

    u = (b v + F) / sqrt(2 b)   towards the tip,   w = (b v - F) / sqrt(2 b)   back,   F v = u^2 / 2 - w^2 / 2

The hand feels F_e = b v - sqrt(2 b) w and sends u = sqrt(2 b) v - w. At the tip a damper b ends the line, so that

    x_s' = u / sqrt(2 b) - F_s / (2 b),   w = -F_s / sqrt(2 b):

no part of u is in w. Hence F_e = b v + F_s (late), and x_s' = v (late) + (F_s of a round trip before - F_s) / 2 b.

The signals carry the wave itself and two counters, sqrt(2/b) int u dt as `position_m` and int u^2 / 2 dt as
`energy_j`. The receiver uses u + kappa (the received but unused part of int u dt, minus u Ts), limited by the energy
that has arrived, and so slowly that both run out together, like telenano's own wave law. A late, lost or repeated
message thus generates no energy, and hand and tip do not drift apart.

Sources: R. J. Anderson, M. W. Spong 1989 and G. Niemeyer, J.-J. E. Slotine, IEEE J. Oceanic Eng. 16 (1991) and Int. J.
Robotics Research 23 (2004), for waves and matching; equations of the unmatched line as in public code. The matched end,
the guard and this form of the correction are derived here. The impedance b is constant: adapting it at both ends, as in
the literature, moves hand and tip apart while the ends differ.

At the nanoscale, the tip's end is a position source, so its damper b subtracts a share of the measured force from the
base's speed, which tolerates samples up to 4 b / (alpha_f alpha_p n Ts); and the hand feels b in addition to B_v.
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
    port_signal,
    tip_signal,
)
from telenano.extend.ranges import parameter
from telenano.extend.virtual_mass import (
    OVERDRAWN_J,
    Mass,
    MassConfig,
    MassParams,
    at_hand,
    at_rest,
    at_tip,
    let_go,
    moved,
    periods_in,
    rescaled,
    resumed,
    tip_reference,
    worked,
)
from telenano.numerics import compiled
from telenano_laws.ports import (
    HandPort,
    begun_again,
    followed,
    kept_near,
    of_scales,
    put_in,
    slid_work,
)

# Silence after which no wave is in transit any more and the base stops [s].
_STANDS_S = 0.02
# Longest step of a slave half after late signals [periods].
_LONGEST_STEP = 3


class MatchedWaveParams(NamedTuple):
    """Constants of the law; `mass` includes the damper b of the line."""

    mass: MassParams
    impedance_n_s_per_m: float
    made_up_per_s: float
    cap_j: float


class MatchedWaveConfig(MassConfig):
    """Section `controller.matched_wave`; all at the hand's scale."""

    silence_limit_s: float = parameter(
        0.5, "s", "Time without a signal from the other half after which the hand is let go [s]"
    )
    impedance_n_s_per_m: float = parameter(100.0, "N s/m", "Impedance of the line b [N s/m]")
    drift_rate_per_s: float = parameter(
        10.0, "1", "Rate at which waves that are due are made up for kappa [1/s]; 0 = never"
    )
    energy_cap_j: float = parameter(
        5e-3, "J", "Most energy of the tip's damper that is kept to pay for the wave back [J]"
    )

    def to_params(self, period_s: float) -> MatchedWaveParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        b = self.impedance_n_s_per_m
        rate = min(self.drift_rate_per_s, 1.0 / period_s)
        return MatchedWaveParams(self.mass_params(period_s, b), b, rate, self.energy_cap_j)

    def stiffness_limit_n_per_m(self, period_s: float) -> float:
        """Return the stiffest sample [N/m] that the base tolerates with its damper 2 b, in the longest step."""
        return self.limit_of_damper(2.0 * self.impedance_n_s_per_m, period_s, _LONGEST_STEP)


class Inbox(NamedTuple):
    """Counters of the incoming wave: sqrt(2/b) int u dt received and used [m], and its energy received and used [J]."""

    received_m: float
    taken_m: float
    received_j: float
    taken_j: float


class MasterState(NamedTuple):
    """State of the master half.

    impulse_m: int F_e dt / b [m]; sent_j: wave energy sent [J]; wave_sqrt_w: the newest outgoing wave [sqrt(W)];
    stood_s: time for which the device has been off [s].
    """

    mass: Mass
    inbox: Inbox
    impulse_m: float
    sent_j: float
    wave_sqrt_w: float
    stood_s: float
    port: HandPort


class SlaveState(NamedTuple):
    """State of the slave half.

    position_m: reference of the base [m]; anchor_m: start of the outgoing position counter [m]; sent_m, sent_j: the
    outgoing counters [m, J]; wave_sqrt_w: the newest outgoing wave [sqrt(W)]; reserve_j: energy left to pay for work
    and waves [J]; last_m, last_n: the last measurement at the hand's scale [m, N].
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
    coupled: bool


@compiled
def hand_end(impedance_n_s_per_m: float, velocity_m_per_s: float, wave_sqrt_w: float) -> tuple[float, float]:
    """Return the force against the hand [N] and the outgoing wave [sqrt(W)]."""
    root = math.sqrt(2.0 * impedance_n_s_per_m)
    force = impedance_n_s_per_m * velocity_m_per_s - root * wave_sqrt_w
    return force, root * velocity_m_per_s - wave_sqrt_w


@compiled
def tip_end(impedance_n_s_per_m: float, wave_sqrt_w: float, force_n: float) -> tuple[float, float]:
    """Return the velocity of a matched base [m/s] and the outgoing wave [sqrt(W)]."""
    root = math.sqrt(2.0 * impedance_n_s_per_m)
    return wave_sqrt_w / root - force_n / (2.0 * impedance_n_s_per_m), -force_n / root


@compiled
def guarded_wave(wave_sqrt_w: float, left_j: float, period_s: float) -> float:
    """Return a wave [sqrt(W)] limited so that a period [s] of it spends no more than `left_j` [J]."""
    most = math.sqrt(2.0 * max(left_j, 0.0) / period_s)
    return min(max(wave_sqrt_w, -most), most)


@compiled
def received(inbox: Inbox, position_m: float, energy_j: float) -> Inbox:
    """Update the counters from a signal; a signal with less energy than already received is old and is ignored."""
    if energy_j < inbox.received_j:
        return inbox
    return Inbox(position_m, inbox.taken_m, energy_j, inbox.taken_j)


@compiled
def emptied(position_m: float, energy_j: float) -> Inbox:
    """Start counting at a signal: everything up to it counts as used."""
    return Inbox(position_m, position_m, energy_j, energy_j)


@compiled
def drawn(params: MatchedWaveParams, inbox: Inbox, wave_sqrt_w: float) -> tuple[Inbox, float]:
    """Return counters and wave of the next period [sqrt(W)]: the newest wave plus a share of the paid arrears."""
    b, period = params.impedance_n_s_per_m, params.mass.period_s
    root = math.sqrt(0.5 * b)
    due = root * (inbox.received_m - inbox.taken_m)
    wanted = wave_sqrt_w + params.made_up_per_s * (due - wave_sqrt_w * period)
    left = max(inbox.received_j - inbox.taken_j, 0.0)
    # A wave of 2 D / U spends the energy left, D, in the same time as the arrears, U, so that neither lasts longer.
    most = 2.0 * left / abs(due) if due != 0.0 else 0.0
    wave = guarded_wave(min(max(wanted, -most), most), left, period)
    taken_j = min(inbox.taken_j + 0.5 * wave * wave * period, inbox.received_j)
    return Inbox(inbox.received_m, inbox.taken_m + wave * period / root, inbox.received_j, taken_j), wave


@compiled
def _begun(mass: Mass) -> MasterState:
    return MasterState(mass, emptied(0.0, 0.0), 0.0, 0.0, 0.0, 0.0, HandPort(mass.position_m, 0.0, 0.0, 0.0))


@compiled
def master_start(params: MatchedWaveParams, hand: HandSample) -> MasterState:
    """Start with the virtual mass at rest at the hand's position."""
    return _begun(at_rest(hand.position_m))


@compiled
def master_resume(params: MatchedWaveParams, hand: HandSample, tip_reference_m: float) -> MasterState:
    """Continue with the hand's motion and the tip's reference."""
    return _begun(resumed(params.mass, hand, tip_reference_m))


@compiled
def master_send(
    params: MatchedWaveParams, state: MasterState, hand: HandSample, dt: float
) -> tuple[MasterState, PortSignal]:
    """Return wave and counters; while the hand is released, the position counter is the tip's reference."""
    p, mass = params.mass, state.mass
    return state, port_signal(
        position_m=tip_reference(p, mass) + p.position_scale * state.impulse_m,
        velocity_m_per_s=p.position_scale * mass.velocity_m_per_s,
        force_n=hand.force_n / p.force_scale,
        wave_sqrt_w=state.wave_sqrt_w,
        energy_j=state.port.sent_j,
        active=mass.coupled,
    )


@compiled
def master_receive(
    params: MatchedWaveParams, state: MasterState, hand: HandSample, signal: PortSignal, dt: float
) -> tuple[MasterState, MasterReference]:
    """Move the virtual mass at the end of the line for dt [s]; while its device is off for a moment, it rests."""
    p, b = params.mass, params.impedance_n_s_per_m
    position = signal.position_m / p.position_scale
    may = at_hand(p, hand, signal, state.mass.coupled, state.stood_s, dt, True)
    port = worked(state.port, hand, may.counts)
    if not (may.acts or may.stands):
        mass = let_go(p, state.mass, hand, signal)
        state = MasterState(
            mass,
            emptied(position, signal.energy_j),
            0.0,
            port.sent_j,
            0.0,
            may.stood_s,
            begun_again(port, state.sent_j, may.renews),
        )
        return state, MasterReference(hand.position_m, 0.0, 0.0, may.coupled)
    # Signals sent before the halves were coupled carry no waves, so counting starts here.
    inbox = received(state.inbox, position, signal.energy_j)
    if not state.mass.coupled:
        inbox = emptied(position, signal.energy_j)
    mass, impulse, sent, force, out = state.mass, state.impulse_m, state.sent_j, 0.0, 0.0
    if may.stands:
        mass = let_go(p, mass, hand, signal)
    for _ in range(periods_in(dt, p.period_s)):
        inbox, wave = drawn(params, inbox, signal.wave_sqrt_w)
        before = mass.position_m
        if may.acts:
            mass = kept_near(mass, moved(p, mass, hand.force_n + math.sqrt(2.0 * b) * wave), hand.position_m)
        # The mean velocity gives the mean force of the damper b exactly.
        force, out = hand_end(b, (mass.position_m - before) / p.period_s, wave)
        impulse += force * p.period_s / b
        sent += 0.5 * out * out * p.period_s
        port = put_in(port, force * (mass.position_m - before), sent)
    mass = Mass(mass.position_m, mass.velocity_m_per_s, mass.tip_offset_m, True)
    state = MasterState(mass, inbox, impulse, sent, out, may.stood_s, port)
    return state, MasterReference(mass.position_m, mass.velocity_m_per_s, force, True)


@compiled
def slave_start(params: MatchedWaveParams, tip: TipMeasurement) -> SlaveState:
    """Start at the position of the base."""
    return _standing(params, tip.base_position_m, tip, emptied(0.0, 0.0), 0.0)


@compiled
def _standing(
    params: MatchedWaveParams, position_m: float, tip: TipMeasurement, inbox: Inbox, sent_j: float
) -> SlaveState:
    p = params.mass
    here, force = tip.base_position_m / p.position_scale, p.force_scale * tip.force_n
    return SlaveState(position_m, inbox, position_m, 0.0, sent_j, 0.0, 0.0, here, force, False)


@compiled
def slave_receive(
    params: MatchedWaveParams, state: SlaveState, signal: PortSignal, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, SlaveReference]:
    """Move the base for dt [s], a whole number of periods, by the incoming waves and against the last measured force.

    While the tip does not follow, the reference is the master's; while the master does not, the base stays.
    """
    p = params.mass
    position = signal.position_m / p.position_scale
    may = at_tip(p, signal, tip, state.position_m, state.coupled)
    if not may.leads:
        state = _standing(params, may.base_m, tip, emptied(position, signal.energy_j), state.sent_j)
        return state, SlaveReference(may.base_m, True)
    inbox = received(state.inbox, position, signal.energy_j) if state.coupled else emptied(position, signal.energy_j)
    here, force = tip.base_position_m / p.position_scale, p.force_scale * tip.force_n
    reserve, way = state.reserve_j, 0.0
    for _ in range(round(dt / p.period_s)):
        inbox, wave = drawn(params, inbox, signal.wave_sqrt_w)
        reserve += 0.5 * wave * wave * p.period_s
        speed, _ = tip_end(params.impedance_n_s_per_m, wave, force)
        way += speed * p.period_s
    if signal.silence_s > _STANDS_S or (reserve < -OVERDRAWN_J and way * force > 0.0):
        # A port that has given more energy than it received presses no further until new waves have paid for it.
        way = 0.0
    base = followed(p, state.position_m, tip) + p.position_scale * way
    # If no step came since, the work is still counted from the last measurement.
    last_m, last_n = (state.last_m, state.last_n) if state.coupled else (here, force)
    state = SlaveState(
        position_m=base,
        inbox=inbox,
        anchor_m=state.anchor_m,
        sent_m=state.sent_m,
        sent_j=state.sent_j,
        wave_sqrt_w=state.wave_sqrt_w,
        reserve_j=reserve,
        last_m=last_m,
        last_n=last_n,
        coupled=True,
    )
    return state, SlaveReference(base, True)


@compiled
def slave_send(
    params: MatchedWaveParams, state: SlaveState, tip: TipMeasurement, dt: float
) -> tuple[SlaveState, PortSignal]:
    """Account for the work on the sample, and return the wave of the force, limited to the energy that is left."""
    p, b = params.mass, params.impedance_n_s_per_m
    here, force = tip.base_position_m / p.position_scale, p.force_scale * tip.force_n
    sent_m, sent_j, reserve, wave = state.sent_m, state.sent_j, state.reserve_j, 0.0
    if state.coupled and dt > 0.0:
        reserve -= slid_work(state.last_m, state.last_n, here, force)
        _, wave = tip_end(b, 0.0, 0.5 * (force + state.last_n))
        wave = guarded_wave(wave, reserve, dt)
        reserve = min(reserve - 0.5 * wave * wave * dt, params.cap_j)
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
        last_m=here,
        last_n=force,
        coupled=state.coupled,
    )
    position = state.anchor_m + p.position_scale * sent_m if state.coupled else state.position_m
    return state, tip_signal(tip, position, tip.force_n, wave, sent_j)


@compiled
def _rescaled_inbox(inbox: Inbox, longer: float) -> Inbox:
    """Return the counters with lengths multiplied by `longer`; the part that is still to be used is not changed."""
    received_m = longer * inbox.received_m
    return Inbox(received_m, received_m - (inbox.received_m - inbox.taken_m), inbox.received_j, inbox.taken_j)


@compiled
def retune(old: MatchedWaveParams, new: MatchedWaveParams, state: MasterState) -> MasterState:
    """Keep the tip's reference constant when alpha_p changes, and the force and energy of the line when b changes."""
    longer, _ = of_scales(old.mass, new.mass)
    impulse = state.impulse_m * (old.impedance_n_s_per_m / new.impedance_n_s_per_m) * longer
    mass, inbox = rescaled(old.mass, new.mass, state.mass), _rescaled_inbox(state.inbox, longer)
    return MasterState(mass, inbox, impulse, state.sent_j, state.wave_sqrt_w, state.stood_s, state.port)


@compiled
def slave_retune(old: MatchedWaveParams, new: MatchedWaveParams, state: SlaveState) -> SlaveState:
    """Convert the counters and the measurement, which are at the hand's scale, to the new scales."""
    longer, stronger = of_scales(old.mass, new.mass)
    return SlaveState(
        position_m=state.position_m,
        inbox=_rescaled_inbox(state.inbox, longer),
        anchor_m=state.anchor_m,
        sent_m=longer * state.sent_m,
        sent_j=state.sent_j,
        wave_sqrt_w=state.wave_sqrt_w,
        reserve_j=min(state.reserve_j, new.cap_j),
        last_m=longer * state.last_m,
        last_n=stronger * state.last_n,
        coupled=state.coupled,
    )


@compiled
def master_energy_account(params: MatchedWaveParams, state: MasterState) -> EnergyAccount:
    """Return the wave energy that has arrived and is not used yet, and the energy granted to the hand's port."""
    return EnergyAccount(state.inbox.received_j - state.inbox.taken_j, 0.0, state.port.granted_j)


@compiled
def slave_energy_account(params: MatchedWaveParams, state: SlaveState) -> EnergyAccount:
    """Return the energy that has arrived and was neither given to the sample nor sent back."""
    return EnergyAccount(state.inbox.received_j - state.inbox.taken_j + state.reserve_j, 0.0, 0.0)


MATCHED_WAVE = Law.of(
    __name__,
    MatchedWaveConfig,
    uses_waves=True,
    uses_energy=True,
    local_loop=True,
    passive=True,
    fixed_in_contact=("impedance_n_s_per_m",),
)
