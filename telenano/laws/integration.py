"""Timing of both halves of a law: when each steps, by how many periods, and when it answers, as pure state machines.

Both halves of `services/controller` ask it with each message. On the way of a sample its decision comes before the step
of the law, such as `telenano/laws/virtual_impedance.py`.

The controller nodes (`services.controller`) and the lockstep simulation (`telenano.lockstep.lockstep`) feed them the
same events and carry out their decisions, so that both have the same timing. The laws take the steps; the machines know
no force and no position.

The master half works in ticks of the hand. It sends at each sample, and receives once for each time that it has sent:

    state      event                            decision                                          next
    idle       sample, n >= 1 periods           send by n                                         due
    idle       sample that begins again         send by 1, and count energy from there            due
    idle       sample of 0 periods, or repeated command the last reference again                  idle
    idle       answer                           none: it is kept for the next tick                idle
    due        answer                           receive by the n that was sent, command           idle
    due        sample                           receive by n with the silence so far, command;    idle, and on
                                                then as in idle, without a second command
    any        stall of the process             the due command is dropped                        idle

The slave half works in commands to the instrument, which states with each of its states the last command carried out:

    state      event                            decision                                          next
    any        signal, n periods of the hand    receive by the lag of the half, command           waiting
    waiting    signal less than a period after  none, if the half has a local loop: the answer    waiting
               the last step                    to the last command also answers this signal
    any        signal that begins again         start, or start again, then as n = 1              waiting
    waiting    signal                           first answer with the newest measurement          settled, and on
    waiting    state with the newest command    account for all commands; answer if to a signal;  settled, or
                                                if late and without a signal, then as in settled  waiting
    waiting    state with an older command      account for the commands up to it                 waiting
    settled    state with the newest command    the instrument stepped by itself: receive by the  waiting, or
                                                lag of the half and command, if the last signal   settled
                                                still counts; else none
    any        stall of the process             no answer is owed any more                        settled

A local loop of the half against the sample uses the force measured last, and the signals of a burst arrive faster than
measurements. So it takes one step for each step that the instrument has carried out or, if the instrument answers late,
one for each period. Signals that it skips add to its lag.

If a signal comes before the instrument has answered, a half with a local loop answers without accounting. Otherwise the
tip would seem to stand in this step and to move twice as fast in the next, which takes twice the energy for the same
motion. Every other half accounts as if the commands had been carried out.
"""

from typing import NamedTuple

from telenano.extend.laws import paced
from telenano.laws.hand_periods import RESTARTED, HandClock, no_sample, periods_to
from telenano.numerics.compiler import inlined

_NEVER_NS = -1
# Index in the steps of commands that has the sum of all older steps.
_LAST = 7
# Periods of silence if no signal was ever received; more than any law waits.
_ENDLESS = 2**40


class TimingParams(NamedTuple):
    """Constants of the timing of a half.

    period_ns: period of the hand [ns]; longest_periods: longest pause of its samples that is bridged [periods];
    local_ns: time for which the last signal counts for a half that continues with the instrument's own steps [ns], 0
    for a half that does not.
    """

    period_ns: int
    longest_periods: int
    local_ns: int


class NewestSignal(NamedTuple):
    """Arrival of the newest signal of the other half, and stamp of the hand's sample behind it [ns]; -1 for none."""

    received_ns: int
    hand_ns: int


@inlined
def nothing_heard() -> NewestSignal:
    """Return the value before the first signal, and after a pause that makes the half wait for the next one."""
    return NewestSignal(_NEVER_NS, _NEVER_NS)


class MasterTiming(NamedTuple):
    """Clock of the hand, newest signal of the other half, and periods of the command that is due, 0 for none."""

    hand: HandClock
    heard: NewestSignal
    due: int


class HandDecision(NamedTuple):
    """Decision on a sample: whether the samples begin again, periods to send by, whether to repeat the last command."""

    begins: bool
    periods: int
    repeats: bool


@inlined
def master_begin() -> MasterTiming:
    """Return the timing of a master half before the first sample."""
    return MasterTiming(no_sample(), nothing_heard(), 0)


@inlined
def master_heard(timing: MasterTiming, received_ns: int, hand_ns: int) -> MasterTiming:
    """Return the timing after a signal received at received_ns that answers the hand's sample of hand_ns [ns]."""
    return MasterTiming(timing.hand, NewestSignal(received_ns, hand_ns), timing.due)


@inlined
def master_settled(timing: MasterTiming) -> MasterTiming:
    """Return the timing after the due command, a step of `timing.due` periods, was sent at an answer or a tick."""
    return MasterTiming(timing.hand, timing.heard, 0)


@inlined
def master_silenced(timing: MasterTiming) -> MasterTiming:
    """Return the timing of a half that waits for the next signal of the other half; a due command stays due."""
    return MasterTiming(timing.hand, nothing_heard(), timing.due)


@inlined
def master_stalled(timing: MasterTiming) -> MasterTiming:
    """Return the timing after a stall of the process: no command is due, and the half waits for the next signal."""
    return MasterTiming(timing.hand, nothing_heard(), 0)


@inlined
def master_sampled(
    timing: MasterTiming, params: TimingParams, sampled_ns: int, repeated: bool, commanded: bool
) -> tuple[MasterTiming, HandDecision]:
    """Return the timing after a sample of the hand, and the decision on it.

    A repeated sample counts as none: the law does not step, and the next sample bridges the gap. Beginning again from
    the old position would separate tip and hand by the motion in between, for the rest of the session.

    Args:
        timing: The timing before the sample.
        params: The constants of the timing.
        sampled_ns: The stamp of the sample [ns].
        repeated: Whether the device repeats an earlier sample because it has no newer one.
        commanded: Whether the command that was due has been sent at this sample.
    """
    if repeated:
        return timing, HandDecision(False, 0, not commanded and timing.hand.sampled_ns >= 0)
    hand, periods = periods_to(timing.hand, sampled_ns, params.period_ns, params.longest_periods)
    begins = periods == RESTARTED
    if periods == 0:
        # The previous sample was late, and its step included the period of this one: another step would be too many.
        return MasterTiming(hand, timing.heard, timing.due), HandDecision(False, 0, not commanded)
    # After a pause the law continues from its own state. A restarted hand is off, and a law follows a hand that is off;
    # a hand that was only delayed continues at its earlier reference.
    periods = 1 if begins else periods
    return MasterTiming(hand, timing.heard, periods), HandDecision(begins, periods, False)


@inlined
def silence_ns(heard: NewestSignal, now_ns: int) -> int:
    """Return the time since the arrival of the newest signal [ns]; `heard` must have one."""
    return max(0, now_ns - heard.received_ns)


@inlined
def round_trip_periods(timing: MasterTiming, params: TimingParams) -> int:
    """Return the round trip: the periods from the hand's sample that the newest signal answers to its newest sample."""
    since_ns = timing.hand.sampled_ns - timing.heard.hand_ns
    return max(0, (since_ns + params.period_ns // 2) // params.period_ns)


class Pacing(NamedTuple):
    """Periods of the hand that the newest signal brought, lag of the half behind the hand, length of its last step."""

    elapsed: int
    behind: int
    step: int


class Commands(NamedTuple):
    """Commands to the instrument: numbers of the newest one sent and of the newest one carried out, -1 for none.

    steps: periods of the newest commands, the newest first, with the sum of all older ones in the last place; waiting:
    whether the half waits for the newest one; answers: whether that belongs to a signal; lasts_ns: time at which the
    commanded steps end if each takes one period [ns].
    """

    newest: int
    carried_out: int
    steps: tuple[int, int, int, int, int, int, int, int]
    waiting: bool
    answers: bool
    lasts_ns: int


class SlaveTiming(NamedTuple):
    """Clock of the hand's samples behind the signals, newest signal, steps of the half, and its commands."""

    hand: HandClock
    heard: NewestSignal
    pacing: Pacing
    commands: Commands


class SlaveDecision(NamedTuple):
    """Decision of the slave half at a state of the instrument, or at a signal before one has arrived.

    periods: time for which the law accounts [periods].
    sends: whether the law computes the signal of its half.
    accounts: whether the law keeps the account of that, as it does if the tip was measured.
    answers: whether the signal is sent to the other half.
    continues: whether the half then steps without a signal, and commands the instrument.
    """

    periods: int
    sends: bool
    accounts: bool
    answers: bool
    continues: bool


class Tick(NamedTuple):
    """Decision of the slave half at a signal: whether it begins again, and whether it steps now.

    Without a step, the answer to the pending command answers this signal as well.
    """

    begins: bool
    steps: bool


@inlined
def slave_begin() -> SlaveTiming:
    """Return the timing of a slave half before the first signal."""
    commands = Commands(-1, -1, (0, 0, 0, 0, 0, 0, 0, 0), False, True, 0)
    return SlaveTiming(no_sample(), nothing_heard(), Pacing(1, 0, 1), commands)


@inlined
def slave_silenced(timing: SlaveTiming) -> SlaveTiming:
    """Return the timing of a half that waits for the next signal of the other half; its commands stay pending."""
    return SlaveTiming(timing.hand, nothing_heard(), timing.pacing, timing.commands)


@inlined
def slave_stalled(timing: SlaveTiming) -> SlaveTiming:
    """Return the timing after a stall of the process: no answer is owed, and the half waits for the next signal."""
    return SlaveTiming(timing.hand, nothing_heard(), timing.pacing, _carried_out(timing.commands, 0)[0])


@inlined
def slave_tick(
    timing: SlaveTiming,
    params: TimingParams,
    received_ns: int,
    now_ns: int,
    hand_ns: int,
    understood: bool,
    may_wait: bool,
) -> tuple[SlaveTiming, Tick]:
    """Return the timing at a signal, and the decision on it.

    Args:
        timing: The timing before the signal.
        params: The constants of the timing.
        received_ns: The arrival of the signal [ns].
        now_ns: The present time [ns].
        hand_ns: The stamp of the hand's sample that the signal follows from [ns].
        understood: Whether the signal belongs to the law in force; any other counts as silence.
        may_wait: Whether the half may defer its step to the next state of the instrument; false if the instrument is
            lost or the law changes.
    """
    hand, periods = periods_to(timing.hand, hand_ns, params.period_ns, params.longest_periods)
    heard = NewestSignal(received_ns, hand_ns) if understood else timing.heard
    if periods == RESTARTED:
        return SlaveTiming(hand, heard, Pacing(1, 0, timing.pacing.step), timing.commands), Tick(True, True)
    pacing = Pacing(periods, timing.pacing.behind, timing.pacing.step)
    after = SlaveTiming(hand, heard, pacing, timing.commands)
    if may_wait and _passes_over(after, params, now_ns):
        return _passed_over(after), Tick(False, False)
    return after, Tick(False, True)


@inlined
def _passes_over(timing: SlaveTiming, params: TimingParams, now_ns: int) -> bool:
    """Return whether the half takes no step at a signal: the instrument has a pending command whose time is not over.

    The time ends half a period early, because a signal may come early.
    """
    outstanding = timing.commands.newest > timing.commands.carried_out
    return params.local_ns > 0 and outstanding and now_ns < timing.commands.lasts_ns - params.period_ns // 2


@inlined
def _passed_over(timing: SlaveTiming) -> SlaveTiming:
    """Return the timing after a signal without a step; the answer to the pending command answers it as well."""
    c, pacing = timing.commands, timing.pacing
    commands = Commands(c.newest, c.carried_out, c.steps, c.waiting, True, c.lasts_ns)
    behind = Pacing(pacing.elapsed, pacing.behind + pacing.elapsed, pacing.step)
    return SlaveTiming(timing.hand, timing.heard, behind, commands)


@inlined
def slave_stepped(timing: SlaveTiming, params: TimingParams, now_ns: int, elapsed: int) -> SlaveTiming:
    """Return the timing with the step that the half takes now; elapsed: periods brought by a signal, 0 without one."""
    heard = timing.heard
    silent = silence_ns(heard, now_ns) // params.period_ns
    behind, step = paced(timing.pacing.behind, elapsed, _ENDLESS if heard.received_ns < 0 else silent)
    c = timing.commands
    begins_ns = max(c.lasts_ns, now_ns) if c.newest > c.carried_out else now_ns
    commands = Commands(c.newest, c.carried_out, c.steps, c.waiting, c.answers, begins_ns + params.period_ns)
    return SlaveTiming(timing.hand, heard, Pacing(timing.pacing.elapsed, behind, step), commands)


@inlined
def slave_commanded(timing: SlaveTiming, number: int, answers: bool) -> SlaveTiming:
    """Return the timing after the command of a step was sent; the numbers of commands are consecutive.

    answers: whether the command belongs to a signal.
    """
    c = timing.commands
    first, second, third, fourth, fifth, sixth, _, _ = c.steps
    steps = (timing.pacing.step, first, second, third, fourth, fifth, sixth, _owed(c, _LAST - 1))
    carried_out = number - 1 if c.newest < 0 else c.carried_out
    commands = Commands(number, carried_out, steps, True, answers, c.lasts_ns)
    return SlaveTiming(timing.hand, timing.heard, timing.pacing, commands)


@inlined
def slave_unanswered(timing: SlaveTiming, early: bool) -> tuple[SlaveTiming, SlaveDecision]:
    """Return the timing and the decision at a signal if the instrument has not answered the newest command.

    Otherwise there is nothing to do. early: answer without accounting for the pending commands, which stay pending.
    """
    if not timing.commands.waiting:
        return timing, _nothing()
    if early:
        return timing, SlaveDecision(0, True, False, timing.commands.answers, False)
    return _settled(timing, 0, False)


@inlined
def slave_measured(
    timing: SlaveTiming, params: TimingParams, now_ns: int, number: int, held: bool, follows: bool
) -> tuple[SlaveTiming, SlaveDecision]:
    """Return the timing and the decision at a state of the instrument that states the last command carried out.

    Args:
        timing: The timing before the state of the instrument.
        params: The constants of the timing.
        now_ns: The present time [ns].
        number: The number of the command that was carried out.
        held: Whether the half stands still because the law changes.
        follows: Whether the newest signal and the instrument are active, so that a half with a local loop continues.
    """
    c, heard = timing.commands, timing.heard
    later = c.newest - number
    if later == 0:
        silent_ns = silence_ns(heard, now_ns)
        counts = heard.received_ns >= 0 and params.local_ns > 0 and silent_ns <= params.local_ns
        continues = counts and follows and not held
        if c.waiting:
            # In a silence, waiting for an instrument that answers late would slow the local loop down, so continue.
            late = now_ns >= c.lasts_ns - params.period_ns // 2 and 2 * silent_ns >= 3 * params.period_ns
            return _settled(timing, 0, continues and late)
        return timing, SlaveDecision(0, False, False, False, continues)
    if held or number <= c.carried_out or not 0 < later < _LAST:
        return timing, _nothing()
    return _settled(timing, later, False)


@inlined
def _nothing() -> SlaveDecision:
    """Return the decision to do nothing."""
    return SlaveDecision(0, False, False, False, False)


@inlined
def _settled(timing: SlaveTiming, later: int, continues: bool) -> tuple[SlaveTiming, SlaveDecision]:
    """Return the timing without the commands carried out, and the decision: all but the last `later` are settled.

    The signal of the newest command is answered if that was carried out too.
    """
    commands, periods = _carried_out(timing.commands, later)
    after = SlaveTiming(timing.hand, timing.heard, timing.pacing, commands)
    return after, SlaveDecision(periods, True, True, later == 0 and timing.commands.answers, continues)


@inlined
def _carried_out(c: Commands, later: int) -> tuple[Commands, int]:
    """Return the commands after all except the last `later` were carried out, and the periods of those newly done."""
    waiting = c.waiting and later > 0
    return Commands(c.newest, c.newest - later, c.steps, waiting, c.answers, c.lasts_ns), _owed(c, later)


@inlined
def _owed(c: Commands, first: int) -> int:
    """Return the sum of the pending steps, from the index `first` on, where 0 is the newest [periods]."""
    periods = 0
    for place in range(first, min(c.newest - c.carried_out, _LAST + 1)):
        periods += c.steps[place]
    return periods
