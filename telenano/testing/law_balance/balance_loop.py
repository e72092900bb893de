"""The loop over the periods between two events of an order: both halves, the line, the two devices, and the books.

`stretch` is a marked step: `balance` calls it as plain Python or compiled, with the same bits. The type of the
parameters selects the law, which `known_as` has registered.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from telenano.extend.laws import (
    EnergyAccount,
    HandSample,
    Law,
    MasterReference,
    PortSignal,
    TipMeasurement,
    paced,
)
from telenano.numerics import chosen_step, compiled
from telenano.testing.law_balance.balance_world import (
    Arm,
    Contact,
    Hand,
    Line,
    Sample,
    pressed,
    pushed,
    quantised,
    within,
)

RETRACTED_M = -2e-7
UNHEARD = -(10**9)
# Time for which the master half waits for a lost device before it continues with an inactive one [s].
_LOST_S = 1.0
_LONGEST_BRIDGED_PERIODS = 50
# Speed below which the kinetic energy of a law's virtual mass is negligible [m/s].
_AT_REST_M_PER_S = 1e-3
# Time at which the hand grips the device [s].
_GRIPS_S = 0.5

_LAW_OF: dict[type, Law] = {}


def known_as(kind: type, law: Law) -> None:
    """Register the law whose steps are used for parameters of a class."""
    _LAW_OF[kind] = law


def _chosen(name: str) -> Callable[[type], Callable[..., Any]]:
    def choose(kind: type) -> Callable[..., Any]:
        step: Callable[..., Any] = getattr(_LAW_OF[kind], name)
        return step

    return choose


_master_resume = chosen_step(_chosen("master_resume"))
_master_send = chosen_step(_chosen("master_send"))
_master_receive = chosen_step(_chosen("master_receive"))
_master_energy_account = chosen_step(_chosen("master_energy_account"))
_slave_start = chosen_step(_chosen("slave_start"))
_slave_receive = chosen_step(_chosen("slave_receive"))
_slave_send = chosen_step(_chosen("slave_send"))
_slave_energy_account = chosen_step(_chosen("slave_energy_account"))


class World(NamedTuple):
    """The constants of an order: ends of travel and sensors of the devices, hand, sample and line.

    carried: share of the remaining distance that the instrument's servo moves in a period.
    """

    period_s: float
    hand: Hand
    sample: Sample
    forward: Line
    backward: Line
    hand_least_m: float
    hand_most_m: float
    base_least_m: float
    base_most_m: float
    hand_quantum_n: float
    hand_quantum_m: float
    tip_quantum_n: float
    base_quantum_m: float
    carried: float


class LoopConditions(NamedTuple):
    """The conditions that are constant between two events.

    off: the device obeys no commands; away: another law is in force; lost: the instrument is lost; stalls: the
    instrument does nothing and sends nothing; hand_lost_since: period of the loss, -1 if the hand's device is not lost;
    off_until: period until which the device stays off; let_go_s, slow_s: start and duration of letting go [s], -1 if
    the hand holds; reign: number of times that the law was put in force; longest: pause of signals after which the
    slave half restarts [periods].
    """

    off: bool
    away: bool
    retracted: bool
    lost: bool
    stalls: bool
    silent_forward: bool
    silent_backward: bool
    hand_lost_since: int
    off_until: int
    let_go_s: float
    slow_s: float
    reign: int
    local_loop: bool
    longest: int
    silence_limit_s: float
    position_scale: float
    force_scale: float


class Books(NamedTuple):
    """The energy sums of an order [J], as in `Balance`; *_before_j: those of earlier reigns of a half.

    sent_*, heard_*: energy counters of the forward and backward signals; touched: number of periods in contact.
    """

    hand_j: float
    tip_j: float
    reference_j: float
    master_before_j: float
    slave_before_j: float
    dissipated_before_j: float
    master_now: EnergyAccount
    slave_now: EnergyAccount
    granted_j: float
    least: float
    at_s: float
    begun_s: float
    books_j: float
    least_reference_j: float
    unstated_j: float
    least_stored: float
    sent_forward_j: float
    sent_backward_j: float
    heard_forward_j: float
    heard_backward_j: float
    touched: int


class Now(NamedTuple):
    """The state of an order: the devices, the newest signals of the halves, and the positions in the line."""

    x_m: float
    velocity: float
    force_n: float
    base_m: float
    asked_m: float
    arm: Arm
    contact: Contact
    hand: HandSample
    tip: TipMeasurement
    reference: MasterReference
    master_switching: bool
    slave_switching: bool
    heard_tick: int
    heard_hand_tick: int
    heard: PortSignal
    slave_tick: int
    hand_tick: int
    slave_heard: PortSignal
    behind: int
    last_sample_tick: int
    forward_at: int
    forward_newest: int
    backward_at: int
    backward_newest: int


def empty_books() -> Books:
    """Return the books before the first period."""
    none = EnergyAccount(0.0, 0.0, 0.0)
    return Books(
        hand_j=0.0,
        tip_j=0.0,
        reference_j=0.0,
        master_before_j=0.0,
        slave_before_j=0.0,
        dissipated_before_j=0.0,
        master_now=none,
        slave_now=none,
        granted_j=0.0,
        least=0.0,
        at_s=0.0,
        begun_s=-1.0,
        books_j=0.0,
        least_reference_j=0.0,
        unstated_j=0.0,
        least_stored=math.inf,
        sent_forward_j=0.0,
        sent_backward_j=0.0,
        heard_forward_j=0.0,
        heard_backward_j=0.0,
        touched=0,
    )


@compiled
def no_signal() -> PortSignal:
    """Return the signal that stands for none so far."""
    return PortSignal(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False, False, False, 1e9, 0.0)


@compiled
def _heard_now(signal: PortSignal, silence_s: float, round_trip_s: float) -> PortSignal:
    return PortSignal(
        signal.position_m,
        signal.velocity_m_per_s,
        signal.force_n,
        signal.wave_sqrt_w,
        signal.energy_j,
        signal.separation_m,
        signal.separation_valid,
        signal.in_contact,
        signal.active,
        silence_s,
        round_trip_s,
    )


@compiled
def _put(line: Line, tick: int, reign: int, signal: PortSignal, hand_tick: int, silent: bool) -> None:
    """Store a message that descends from the hand's sample of `hand_tick`, unless the line is silent."""
    if silent:
        return
    line.reign[tick], line.hand_tick[tick] = reign, hand_tick
    line.sent[tick, 0] = signal.position_m
    line.sent[tick, 1] = signal.velocity_m_per_s
    line.sent[tick, 2] = signal.force_n
    line.sent[tick, 3] = signal.wave_sqrt_w
    line.sent[tick, 4] = signal.energy_j
    line.sent[tick, 5] = signal.separation_m
    line.sent[tick, 6] = 1.0 if signal.separation_valid else 0.0
    line.sent[tick, 7] = 1.0 if signal.in_contact else 0.0
    line.sent[tick, 8] = 1.0 if signal.active else 0.0


@compiled
def _message(line: Line, number: int) -> PortSignal:
    return PortSignal(
        float(line.sent[number, 0]),
        float(line.sent[number, 1]),
        float(line.sent[number, 2]),
        float(line.sent[number, 3]),
        float(line.sent[number, 4]),
        float(line.sent[number, 5]),
        bool(line.sent[number, 6] != 0.0),
        bool(line.sent[number, 7] != 0.0),
        bool(line.sent[number, 8] != 0.0),
        0.0,
        0.0,
    )


@compiled
def _taken(line: Line, at: int, newest: int, tick: int, reign: int) -> tuple[int, int]:
    """Return the index after the last arrival up to a period, and the number of the newest new message, or -1.

    Overtaken messages, and those sent in another reign, are dropped, as by a node that reads only the newest one.
    """
    found = -1
    while at < len(line.when) and line.when[at] <= tick:
        number = int(line.number[at])
        if line.reign[number] == reign and number > newest:
            newest, found = number, number
        at += 1
    return at, found


@compiled
def stretch(
    master_params: Any,
    slave_params: Any,
    master: Any,
    slave: Any,
    world: World,
    held: LoopConditions,
    now: Now,
    books: Books,
    first: int,
    last: int,
    tolerance_j: float,
) -> tuple[Any, Any, Now, Books]:
    """Run the periods from `first` to before `last`; return the states of both halves and the order, and the books."""
    period_s, w, reign = world.period_s, world, held.reign
    x_m, velocity, force_n, base_m, asked_m = now.x_m, now.velocity, now.force_n, now.base_m, now.asked_m
    arm, contact, hand, tip, reference = now.arm, now.contact, now.hand, now.tip, now.reference
    master_switching, slave_switching = now.master_switching, now.slave_switching
    heard_tick, heard_hand_tick, heard = now.heard_tick, now.heard_hand_tick, now.heard
    slave_tick, hand_tick, slave_heard, behind = now.slave_tick, now.hand_tick, now.slave_heard, now.behind
    last_sample_tick = now.last_sample_tick
    forward_at, forward_newest = now.forward_at, now.forward_newest
    backward_at, backward_newest = now.backward_at, now.backward_newest
    hand_j, tip_j, reference_j = books.hand_j, books.tip_j, books.reference_j
    master_now, slave_now = books.master_now, books.slave_now
    granted_j, least, at_s, begun_s = books.granted_j, books.least, books.at_s, books.begun_s
    books_j, least_reference_j = books.books_j, books.least_reference_j
    unstated_j, least_stored = books.unstated_j, books.least_stored
    sent_forward_j, sent_backward_j = books.sent_forward_j, books.sent_backward_j
    heard_forward_j, heard_backward_j, touched = books.heard_forward_j, books.heard_backward_j, books.touched
    for tick in range(first, last):
        now_s = tick * period_s
        # The device moves to its reference, under the force that the hand has held since the last period. A device
        # that is off stands still; a displacement by an event has happened already.
        was_following, start_m = hand.following, x_m
        following = (not held.off) and tick >= held.off_until and reference.active
        if following:
            x_m = within(quantised(reference.position_m, w.hand_quantum_m), w.hand_least_m, w.hand_most_m)
        velocity = (x_m - start_m) / period_s
        measured_n = quantised(force_n, w.hand_quantum_n)
        before_m = hand.position_m
        hand = HandSample(x_m, velocity, measured_n, following)
        if following and was_following and not master_switching:
            hand_j += measured_n * (x_m - before_m)
        grip = 1.0
        if held.let_go_s >= 0.0:
            since_s = now_s - held.let_go_s
            grip = 0.0 if since_s >= held.slow_s else 1.0 - since_s / held.slow_s
        if now_s < _GRIPS_S:
            grip = 0.0
        arm, force_n = pushed(w.hand, arm, tick, grip, x_m, velocity, period_s)

        steps_slave, idles, periods = False, False, 0
        master_runs = not held.away
        if held.hand_lost_since >= 0 and (tick - held.hand_lost_since) * period_s < _LOST_S:
            master_runs = False
        dt = period_s
        signal = no_signal()
        if master_runs:
            pause = tick - last_sample_tick
            dt = period_s * (1 if pause > _LONGEST_BRIDGED_PERIODS else pause)
            last_sample_tick = tick
            shown = HandSample(hand.position_m, hand.velocity_m_per_s, hand.force_n, following and not master_switching)
            master, sent = _master_send(master_params, master, shown, dt)
            sent_forward_j = sent.energy_j
            _put(w.forward, tick, reign, sent, tick, held.silent_forward)
        found, answers = -1, False
        if held.away:
            idles = True
        elif not held.stalls:
            forward_at, found = _taken(w.forward, forward_at, forward_newest, tick, reign)
            if found >= 0:
                forward_newest = found
                slave_heard = _message(w.forward, found)
                heard_forward_j = slave_heard.energy_j
                slave_switching = slave_switching and not slave_heard.active
                elapsed = found - hand_tick
                hand_tick, slave_tick = found, tick
                if elapsed > held.longest:
                    elapsed, behind = 1, 0
                    if not slave_switching:
                        slave, _ = _slave_receive(slave_params, slave, no_signal(), tip, period_s)
                answers = True
                if held.lost:
                    # The instrument is silent, so the half answers with its last measurement, as not following.
                    slave, answer = _slave_send(slave_params, slave, tip, period_s)
                    sent_backward_j = answer.energy_j
                    _put(w.backward, tick, reign, answer, hand_tick, held.silent_backward)
                else:
                    steps_slave = True
                    behind, periods = paced(behind, elapsed, 0)
                    signal = _heard_now(slave_heard, 0.0, 0.0)
            else:
                # Without a signal, a half with a local loop steps with the instrument; other halves stand.
                silent = tick - slave_tick
                counts = silent * period_s <= held.silence_limit_s
                follows = slave_heard.active and tip.following and not slave_switching and not held.lost
                if held.local_loop and counts and follows:
                    steps_slave = True
                    behind, periods = paced(behind, 0, silent)
                    signal = _heard_now(slave_heard, silent * period_s, 0.0)
                else:
                    idles = True
        if steps_slave:
            if slave_switching:
                slave = _slave_start(slave_params, tip)
            else:
                slave, wanted = _slave_receive(slave_params, slave, signal, tip, periods * period_s)
                if wanted.active:
                    asked_m = wanted.position_m
        if (steps_slave or idles) and not held.lost:
            if held.retracted:
                base_m = RETRACTED_M
            else:
                goal_m = asked_m
                if idles and (held.away or w.carried >= 1.0):
                    goal_m = base_m
                goal_m = within(quantised(goal_m, w.base_quantum_m), w.base_least_m, w.base_most_m)
                base_m = goal_m if w.carried >= 1.0 else base_m + w.carried * (goal_m - base_m)
            contact, tip_n = pressed(w.sample, contact, base_m, tick, period_s)
            tip_n = quantised(tip_n, w.tip_quantum_n)
            was = tip
            touches = contact.depth_m >= 0.0 or tip_n != 0.0
            tip = TipMeasurement(base_m, tip_n, -contact.depth_m, True, touches, not held.retracted, 0.0)
            if was.following and tip.following and not held.away:
                way_m = (tip.base_position_m - was.base_position_m) / held.position_scale
                tip_j -= held.force_scale * 0.5 * (tip.force_n + was.force_n) * way_m
            touched += 1 if touches else 0
        elif idles:
            contact, tip_n = pressed(w.sample, contact, base_m, tick, period_s)
        if steps_slave:
            slave, answer = _slave_send(slave_params, slave, tip, periods * period_s)
            if answers:
                sent_backward_j = answer.energy_j
                _put(w.backward, tick, reign, answer, hand_tick, held.silent_backward)
        if not held.away:
            backward_at, found = _taken(w.backward, backward_at, backward_newest, tick, reign)
            if found >= 0:
                backward_newest = found
                heard, heard_tick, heard_hand_tick = _message(w.backward, found), tick, int(w.backward.hand_tick[found])
                heard_backward_j = heard.energy_j
                if master_switching:
                    master_switching = False
                    taken_up = HandSample(reference.position_m, 0.0, hand.force_n, hand.following)
                    master = _master_resume(master_params, taken_up, heard.position_m if heard.active else base_m)
            if master_runs and not master_switching:
                silent = 0 if heard_tick == tick else tick + 1 - heard_tick
                signal = no_signal()
                if heard_tick != UNHEARD:
                    trip_s = max(0, tick - heard_hand_tick) * period_s
                    signal = _heard_now(heard, silent * period_s, trip_s)
                was_active, was_m = reference.active, reference.position_m
                master, reference = _master_receive(master_params, master, hand, signal, dt)
                if was_active and reference.active:
                    reference_j += hand.force_n * (reference.position_m - was_m)

        # Update the books.
        if not held.away:
            master_now = _master_energy_account(master_params, master)
            slave_now = _slave_energy_account(slave_params, slave)
        granted_j = max(
            books.master_before_j + master_now.granted_j,
            books.slave_before_j + slave_now.granted_j,
        )
        margin = hand_j + tip_j + granted_j
        stated = master_now.remaining_j + slave_now.remaining_j + master_now.dissipated_j + slave_now.dissipated_j
        books_j = min(books_j, margin - stated - books.dissipated_before_j)
        least_reference_j = min(least_reference_j, reference_j + tip_j + granted_j)
        if not math.isfinite(margin):
            margin = -math.inf
        if held.away:
            least_stored = math.inf
            sent_forward_j, sent_backward_j, heard_forward_j, heard_backward_j = 0.0, 0.0, 0.0, 0.0
        else:
            if abs(velocity) < _AT_REST_M_PER_S:
                stored = max(master_now.remaining_j, 0.0) + max(slave_now.remaining_j, 0.0)
                stored += max(sent_forward_j - heard_forward_j, 0.0) + max(sent_backward_j - heard_backward_j, 0.0)
                least_stored = min(least_stored, stored - margin)
            unstated_j = min(unstated_j, margin + least_stored)
        if margin < least:
            least, at_s = margin, now_s
            if margin < -tolerance_j and begun_s < 0.0:
                begun_s = now_s
    now = Now(
        x_m,
        velocity,
        force_n,
        base_m,
        asked_m,
        arm,
        contact,
        hand,
        tip,
        reference,
        master_switching,
        slave_switching,
        heard_tick,
        heard_hand_tick,
        heard,
        slave_tick,
        hand_tick,
        slave_heard,
        behind,
        last_sample_tick,
        forward_at,
        forward_newest,
        backward_at,
        backward_newest,
    )
    books = Books(
        hand_j,
        tip_j,
        reference_j,
        books.master_before_j,
        books.slave_before_j,
        books.dissipated_before_j,
        master_now,
        slave_now,
        granted_j,
        least,
        at_s,
        begun_s,
        books_j,
        least_reference_j,
        unstated_j,
        least_stored,
        sent_forward_j,
        sent_backward_j,
        heard_forward_j,
        heard_backward_j,
        touched,
    )
    return master, slave, now, books
