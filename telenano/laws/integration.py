"""When each half of a law integrates, by how many periods, and what it owes the other side: pure state machines.

The nodes (`node`) and the loop of the studies (`telenano.lockstep.lockstep`) feed them the same events, carry out what
they decide, and decide nothing of the kind themselves. The laws take the steps; the machines know no force and no
position.

The master half works in ticks of the hand. It sends at each sample, and receives once for each time that it has sent:

    state      event                            decision                                          next
    idle       sample, n >= 1 periods           send by n                                         due
    idle       sample that begins again          send by 1, and count energy from there            due
    idle       sample of 0 periods, or repeated command the last reference again                  idle
    idle       answer                           none: it is kept for the next tick                idle
    due        answer                           receive by the n that was sent, command           idle
    due        sample                           receive by n with the silence so far, command;    idle, and on
                                                then as in idle, without a second command
    any        stall of the process             the command that is due is dropped                idle

The slave half works in commands to the instrument, which says of each state which command it has carried out:

    state      event                            decision                                          next
    any        signal, n periods of the hand    receive by what the half is behind, command       waiting
    waiting    signal less than a period after  none, where the half has a loop of its own: the   waiting
               the last step                    answer to the last command is that to this one
    any        signal that begins again          start, or start again, then as n = 1               waiting
    waiting    signal                           before that: answer with the newest sample        settled, and on
    waiting    state with the newest command    account for all commands; answer if to a signal;  settled, or
               if late and no signal comes: then as in settled                             waiting
    waiting    state with an older command      account for the commands up to it                 waiting
    settled    state with the newest command    the instrument stepped by itself: receive by      waiting, or
                                                what the half is behind, command; if the last     settled
                                                signal still counts, else none
    any        stall of the process             nothing is owed any more                          settled

A loop of the half against the sample has the force that was measured last, and signals of a burst come quicker than
that. So it takes one step for each that the instrument has carried out, and, where the instrument answers late, one for
each period. Signals that it passes over add to what it is behind.

Before the instrument has answered, a half that keeps account of its local steps answers without accounting: to
such a half the tip would have stood for this step and moved twice as fast in the next, which takes twice the energy
for the same way. Every other half accounts as if the commands had been carried out.
"""

from typing import NamedTuple

from telenano.extend.laws import paced
from telenano.laws.hand_periods import RESTARTED, HandClock, no_sample, periods_to
from telenano.numerics.compiler import inlined

_NEVER_NS = -1
# the place among the steps of commands where those that are no longer distinguished are added up
_LAST = 7
# whole periods of silence where no signal was ever received: more than any law waits
_ENDLESS = 2**40


class TimingParams(NamedTuple):
    """Constants of the timing of a half.

    period_ns, of the hand [ns]; longest_periods, the longest pause of its samples that is bridged; local_ns, how long
    the last signal counts for a half that continues with the instrument's own steps [ns], 0 for one that does not.
    """

    period_ns: int
    longest_periods: int
    local_ns: int


class NewestSignal(NamedTuple):
    """When the newest signal of the other half came [ns], -1 for none, and the stamp of the hand's sample behind it."""

    received_ns: int
    hand_ns: int


@inlined
def nothing_heard() -> NewestSignal:
    """Return what a half has heard before the first signal, and after a pause that makes it wait again."""
    return NewestSignal(_NEVER_NS, _NEVER_NS)


class MasterTiming(NamedTuple):
    """Samples of the hand, the signal of the other half, and the periods of the command that is due: 0 for none."""

    hand: HandClock
    heard: NewestSignal
    due: int


class HandDecision(NamedTuple):
    """What follows from a sample of the hand: whether it begins again, periods to send by, whether to command again."""

    begins: bool
    periods: int
    repeats: bool


@inlined
def master_begin() -> MasterTiming:
    """Return the timing of a master half before the first sample."""
    return MasterTiming(no_sample(), nothing_heard(), 0)


@inlined
def master_heard(timing: MasterTiming, received_ns: int, hand_ns: int) -> MasterTiming:
    """Return the timing after a signal of the other half, which answers a sample of the hand [ns]."""
    return MasterTiming(timing.hand, NewestSignal(received_ns, hand_ns), timing.due)


@inlined
def master_settled(timing: MasterTiming) -> MasterTiming:
    """Return the timing after the command that was due, `timing.due` periods of the law: an answer or a tick came."""
    return MasterTiming(timing.hand, timing.heard, 0)


@inlined
def master_silenced(timing: MasterTiming) -> MasterTiming:
    """Return the timing of a half that waits again for the other half."""
    return MasterTiming(timing.hand, nothing_heard(), timing.due)


@inlined
def master_stalled(timing: MasterTiming) -> MasterTiming:
    """Return the timing after a pause of the process: no command is due, and the other half is waited for again."""
    return MasterTiming(timing.hand, nothing_heard(), 0)


@inlined
def master_sampled(
    timing: MasterTiming, params: TimingParams, sampled_ns: int, repeated: bool, commanded: bool
) -> tuple[MasterTiming, HandDecision]:
    """Return what follows from a sample of the hand, stamped sampled_ns [ns].

    A sample that the device only repeats is none: the law does not step, and the next one bridges the gap. To join the
    old position again would leave tip and hand apart by the way in between, for the rest of the session.

    Args:
        timing: The timing before the sample.
        params: The parameters of timing.
        sampled_ns: The stamp of the sample [ns].
        repeated: Whether a device that has nothing newer repeats the sample.
        commanded: Whether the sample settled what was due.
    """
    if repeated:
        return timing, HandDecision(False, 0, not commanded and timing.hand.sampled_ns >= 0)
    hand, periods = periods_to(timing.hand, sampled_ns, params.period_ns, params.longest_periods)
    begins = periods == RESTARTED
    if periods == 0:
        # The sample before was late, and its step was that of both: another step would be a period too many.
        return MasterTiming(hand, timing.heard, timing.due), HandDecision(False, 0, not commanded)
    # After a pause the law continues from its own state: a hand that was restarted is off, and a law stays with an off
    # hand, while one that was only held up finds its reference where it was.
    periods = 1 if begins else periods
    return MasterTiming(hand, timing.heard, periods), HandDecision(begins, periods, False)


@inlined
def silence_ns(heard: NewestSignal, now_ns: int) -> int:
    """Return the time since the newest signal [ns]; there has to be one."""
    return max(0, now_ns - heard.received_ns)


@inlined
def round_trip_periods(timing: MasterTiming, params: TimingParams) -> int:
    """Return how many periods before the newest sample the one lies that the newest signal answers."""
    since_ns = timing.hand.sampled_ns - timing.heard.hand_ns
    return max(0, (since_ns + params.period_ns // 2) // params.period_ns)


class Pacing(NamedTuple):
    """Periods of the hand that the newest signal brought, that the half is behind the hand, and of its last step."""

    elapsed: int
    behind: int
    step: int


class Commands(NamedTuple):
    """What was asked of the instrument: the numbers of the newest command, and of the newest that it has carried out.

    -1 is none. steps: periods of the newest commands, the newest first, and in the last place the sum of all that are
    older; waiting: whether the newest is waited for; answers: whether it belongs to a signal; lasts_ns: until when the
    steps last that were commanded, one period each [ns].
    """

    newest: int
    carried_out: int
    steps: tuple[int, int, int, int, int, int, int, int]
    waiting: bool
    answers: bool
    lasts_ns: int


class SlaveTiming(NamedTuple):
    """The hand's samples behind the signals, the newest signal, the steps of the half, and its commands."""

    hand: HandClock
    heard: NewestSignal
    pacing: Pacing
    commands: Commands


class SlaveDecision(NamedTuple):
    """What the slave half does on a state of the instrument, or where a signal finds that none came.

    periods: for which the law accounts.
    sends: whether the law makes the signal of its half.
    accounts: whether the law keeps what it booked for that, which it does where the tip was measured.
    answers: whether the signal goes to the other half.
    continues: whether the half then steps by itself, and commands the instrument.
    """

    periods: int
    sends: bool
    accounts: bool
    answers: bool
    continues: bool


class Tick(NamedTuple):
    """What the slave half does at a signal: whether it begins again, and whether it steps now.

    Without a step the command that is waited for answers this signal as well.
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
    """Return the timing of a half that waits again for the other half."""
    return SlaveTiming(timing.hand, nothing_heard(), timing.pacing, timing.commands)


@inlined
def slave_stalled(timing: SlaveTiming) -> SlaveTiming:
    """Return the timing after a pause of the process: nothing is owed, and the other half is waited for again."""
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
    """Return the timing at a signal, and what the half does about it.

    Args:
        timing: The timing before the signal.
        params: The parameters of timing.
        received_ns: When the signal came [ns].
        now_ns: The time now [ns].
        hand_ns: The stamp of the hand's sample that the signal descends from [ns].
        understood: Whether the signal is of the law in force; any other counts as silence.
        may_wait: Whether the half may leave its step to the instrument's next state: not without one, nor while the
            law changes.
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
    """Return whether the half makes no step at a signal now: the instrument still has one, and its time is not over.

    Half a period is left to signals that come early.
    """
    outstanding = timing.commands.newest > timing.commands.carried_out
    return params.local_ns > 0 and outstanding and now_ns < timing.commands.lasts_ns - params.period_ns // 2


@inlined
def _passed_over(timing: SlaveTiming) -> SlaveTiming:
    """Return the timing after a signal without a step: the command that is waited for answers this one as well."""
    c, pacing = timing.commands, timing.pacing
    commands = Commands(c.newest, c.carried_out, c.steps, c.waiting, True, c.lasts_ns)
    behind = Pacing(pacing.elapsed, pacing.behind + pacing.elapsed, pacing.step)
    return SlaveTiming(timing.hand, timing.heard, behind, commands)


@inlined
def slave_stepped(timing: SlaveTiming, params: TimingParams, now_ns: int, elapsed: int) -> SlaveTiming:
    """Return the timing with the step that the half has to make now; elapsed: periods of a signal, 0 without one."""
    heard = timing.heard
    silent = silence_ns(heard, now_ns) // params.period_ns
    behind, step = paced(timing.pacing.behind, elapsed, _ENDLESS if heard.received_ns < 0 else silent)
    c = timing.commands
    begins_ns = max(c.lasts_ns, now_ns) if c.newest > c.carried_out else now_ns
    commands = Commands(c.newest, c.carried_out, c.steps, c.waiting, c.answers, begins_ns + params.period_ns)
    return SlaveTiming(timing.hand, heard, Pacing(timing.pacing.elapsed, behind, step), commands)


@inlined
def slave_commanded(timing: SlaveTiming, number: int, answers: bool) -> SlaveTiming:
    """Return the timing after the command of a step was sent; commands are numbered one after the other."""
    c = timing.commands
    first, second, third, fourth, fifth, sixth, _, _ = c.steps
    steps = (timing.pacing.step, first, second, third, fourth, fifth, sixth, _owed(c, _LAST - 1))
    carried_out = number - 1 if c.newest < 0 else c.carried_out
    commands = Commands(number, carried_out, steps, True, answers, c.lasts_ns)
    return SlaveTiming(timing.hand, timing.heard, timing.pacing, commands)


@inlined
def slave_unanswered(timing: SlaveTiming, early: bool) -> tuple[SlaveTiming, SlaveDecision]:
    """Return what a signal settles that comes while a command is waited for; early: without accounting for it."""
    if not timing.commands.waiting:
        return timing, _nothing()
    if early:
        return timing, SlaveDecision(0, True, False, timing.commands.answers, False)
    return _settled(timing, 0, False)


@inlined
def slave_measured(
    timing: SlaveTiming, params: TimingParams, now_ns: int, number: int, held: bool, follows: bool
) -> tuple[SlaveTiming, SlaveDecision]:
    """Return what follows from a state of the instrument in which it has carried out the command of a number.

    Args:
        timing: The timing before the state of the instrument.
        params: The parameters of timing.
        now_ns: The time now [ns].
        number: The number of the command that was carried out.
        held: Whether the half stands still while the law changes.
        follows: Whether the newest signal and the instrument are active, so that a half with a local loop continues.
    """
    c, heard = timing.commands, timing.heard
    later = c.newest - number
    if later == 0:
        silent_ns = silence_ns(heard, now_ns)
        counts = heard.received_ns >= 0 and params.local_ns > 0 and silent_ns <= params.local_ns
        continues = counts and follows and not held
        if c.waiting:
            # an instrument that answers late would make a loop in a silence as much slower
            late = now_ns >= c.lasts_ns - params.period_ns // 2 and 2 * silent_ns >= 3 * params.period_ns
            return _settled(timing, 0, continues and late)
        return timing, SlaveDecision(0, False, False, False, continues)
    if held or number <= c.carried_out or not 0 < later < _LAST:
        return timing, _nothing()
    return _settled(timing, later, False)


@inlined
def _nothing() -> SlaveDecision:
    """Return that a half does nothing."""
    return SlaveDecision(0, False, False, False, False)


@inlined
def _settled(timing: SlaveTiming, later: int, continues: bool) -> tuple[SlaveTiming, SlaveDecision]:
    """Settle all commands but those that were sent later than the one carried out; the newest of them is answered."""
    commands, periods = _carried_out(timing.commands, later)
    after = SlaveTiming(timing.hand, timing.heard, timing.pacing, commands)
    return after, SlaveDecision(periods, True, True, later == 0 and timing.commands.answers, continues)


@inlined
def _carried_out(c: Commands, later: int) -> tuple[Commands, int]:
    """Return the commands after all but the last `later` were carried out, and the periods of those that were."""
    waiting = c.waiting and later > 0
    return Commands(c.newest, c.newest - later, c.steps, waiting, c.answers, c.lasts_ns), _owed(c, later)


@inlined
def _owed(c: Commands, first: int) -> int:
    """Return the sum of the steps from a place on that the instrument has not carried out yet [periods]."""
    periods = 0
    for place in range(first, min(c.newest - c.carried_out, _LAST + 1)):
        periods += c.steps[place]
    return periods
