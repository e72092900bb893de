"""The state machines of the halves: each row of the tables in `integration`, and what holds for any order of events."""

import random
from typing import Any

import pytest

from telenano.extend.laws import MOST_PERIODS_A_STEP
from telenano.laws.integration import (
    HandDecision,
    MasterTiming,
    NewestSignal,
    SlaveDecision,
    SlaveTiming,
    Tick,
    TimingParams,
    master_begin,
    master_heard,
    master_sampled,
    master_settled,
    master_silenced,
    master_stalled,
    round_trip_periods,
    silence_ns,
    slave_begin,
    slave_commanded,
    slave_measured,
    slave_silenced,
    slave_stalled,
    slave_stepped,
    slave_tick,
    slave_unanswered,
)

MS = 1_000_000
MASTER, SLAVE = TimingParams(MS, 50, 0), TimingParams(MS, 50, 50 * MS)
BEGIN_NS = 10**18
SEND, REPEAT, REST = HandDecision(False, 1, False), HandDecision(False, 0, True), HandDecision(False, 0, False)
NOT_SETTLED = SlaveDecision(0, False, False, False, False)
CONTINUES = NOT_SETTLED._replace(continues=True)


def accounted(periods: int, *, answers: bool = False, continues: bool = False) -> SlaveDecision:
    return SlaveDecision(periods, True, True, answers, continues)


def sampled(timing: MasterTiming, ms: float, *, repeated: bool = False, commanded: bool = False) -> Any:
    return master_sampled(timing, MASTER, BEGIN_NS + round(ms * MS), repeated, commanded)


@pytest.fixture
def due() -> MasterTiming:
    """A master half that has sent at its first sample."""
    timing, found = sampled(master_begin(), 0)
    assert found == HandDecision(True, 1, False)
    assert timing.due == 1
    return timing


def test_the_master_sends_at_each_sample_by_the_periods_since(due: MasterTiming) -> None:
    timing, found = sampled(master_settled(due), 1)
    assert (found, timing.due) == (SEND, 1)
    timing, found = sampled(master_settled(timing), 4)
    assert (found.periods, timing.due) == (3, 3)


def test_a_sample_of_no_period_and_a_repeated_one_command_again_where_the_tick_had_its_command(
    due: MasterTiming,
) -> None:
    # the one before was late by more than half a period, and its step was that of both
    late, _ = sampled(master_settled(due), 1.6)
    for repeated, ms in ((False, 2.4), (True, 2.6)):
        assert sampled(master_settled(late), ms, repeated=repeated)[1] == REPEAT
        # it was what settled the tick before, and the command is out
        assert sampled(master_settled(late), ms, repeated=repeated, commanded=True)[1] == REST
        assert sampled(master_settled(late), ms, repeated=repeated)[0].due == 0
    # before the first sample there is nothing to repeat
    assert sampled(master_begin(), 0, repeated=True) == (master_begin(), REST)
    # the clock of a rig may have begun with the first sample
    at_once, _ = master_sampled(master_begin(), MASTER, 0, False, False)
    assert master_sampled(at_once, MASTER, 0, True, False)[1] == REPEAT


def test_the_master_begins_anew_after_a_pause_and_waits_after_a_stall(due: MasterTiming) -> None:
    assert sampled(due, 50)[1] == HandDecision(False, 50, False)
    assert sampled(due, 51)[1] == HandDecision(True, 1, False)
    heard = master_heard(due, BEGIN_NS, BEGIN_NS)
    assert master_stalled(heard)._replace(hand=due.hand) == master_begin()._replace(hand=due.hand)


def test_the_round_trip_is_the_age_of_the_answered_sample_in_periods(due: MasterTiming) -> None:
    timing = due
    for ms in range(1, 6):
        timing, _ = sampled(timing, ms + 0.2)
    assert round_trip_periods(master_heard(timing, BEGIN_NS + 5 * MS, BEGIN_NS + 2 * MS), MASTER) == 3
    assert round_trip_periods(master_heard(timing, BEGIN_NS + 5 * MS, BEGIN_NS + 9 * MS), MASTER) == 0


def test_the_round_trip_is_rounded_to_the_nearest_period(due: MasterTiming) -> None:
    for since_ns, periods in ((MS // 2 - 1, 0), (MS // 2, 1), (3 * MS // 2 - 1, 1), (3 * MS // 2, 2)):
        heard = master_heard(due, BEGIN_NS, due.hand.sampled_ns - since_ns)
        assert round_trip_periods(heard, MASTER) == periods


def test_there_is_no_silence_before_a_signal_and_none_of_less_than_nothing() -> None:
    assert silence_ns(NewestSignal(BEGIN_NS, BEGIN_NS), BEGIN_NS + 1) == 1
    # the reception is stamped after the time of the turn
    assert silence_ns(NewestSignal(BEGIN_NS + 1, BEGIN_NS), BEGIN_NS) == 0


def test_a_half_that_waits_anew_keeps_what_is_due(due: MasterTiming) -> None:
    heard = master_heard(due, BEGIN_NS, BEGIN_NS)
    assert master_silenced(heard) == due
    timing = signalled(slave_begin(), 0, 7)
    silenced = slave_silenced(timing)
    assert silenced.heard.received_ns < 0
    assert silenced._replace(heard=timing.heard) == timing
    # without a signal that counts it does not go on by itself
    settled_timing, _ = measured(timing, 0, 7)
    assert measured(settled_timing, 0, 7)[1] == CONTINUES
    assert measured(slave_silenced(settled_timing), 0, 7)[1] == NOT_SETTLED


def signalled(timing: SlaveTiming, ms: int, number: int) -> SlaveTiming:
    """Return the timing after a signal of a sample that was taken at ms, and its command."""
    now_ns = BEGIN_NS + ms * MS
    timing, _ = ticked(timing, now_ns, now_ns)
    timing = slave_stepped(timing, SLAVE, now_ns, timing.pacing.elapsed)
    return slave_commanded(timing, number, True)


def ticked(
    timing: SlaveTiming,
    now_ns: int,
    hand_ns: int,
    params: TimingParams = SLAVE,
    *,
    understood: bool = True,
    may_wait: bool = False,
) -> tuple[SlaveTiming, Tick]:
    return slave_tick(timing, params, now_ns, now_ns, hand_ns, understood, may_wait)


def measured(timing: SlaveTiming, ms: float, number: int, *, held: bool = False, follows: bool = True) -> Any:
    return slave_measured(timing, SLAVE, BEGIN_NS + round(ms * MS), number, held, follows)


def test_the_slave_answers_when_the_instrument_has_carried_out_its_newest_command() -> None:
    timing = signalled(slave_begin(), 0, 7)
    settled_timing, settled = measured(timing, 0, 7)
    assert settled == accounted(1, answers=True)
    assert not settled_timing.commands.waiting
    # of a command that is not its own it knows nothing
    for number in (5, 6, 8):
        assert measured(timing, 0, number) == (timing, NOT_SETTLED)


def test_an_instrument_that_steps_by_itself_takes_the_slave_along_while_the_signal_counts() -> None:
    timing, _ = measured(signalled(slave_begin(), 0, 7), 0, 7)
    assert measured(timing, 50, 7)[1] == CONTINUES
    assert measured(timing, 50.1, 7)[1] == NOT_SETTLED
    assert measured(timing, 1.5, 7, follows=False)[1] == NOT_SETTLED
    assert measured(timing, 1.5, 7, held=True)[1] == NOT_SETTLED
    # what its own command did is accounted for, and not sent
    own = slave_commanded(slave_stepped(timing, SLAVE, BEGIN_NS + 3 * MS // 2, 0), 8, False)
    assert measured(own, 1.5, 8)[1] == accounted(1)
    without = TimingParams(MS, 50, 0)
    for now_ns in (BEGIN_NS, BEGIN_NS + MS):
        assert slave_measured(timing, without, now_ns, 7, False, True)[1] == NOT_SETTLED


def test_a_slave_that_waits_for_its_command_neither_goes_on_nor_takes_one_back() -> None:
    timing = signalled(signalled(slave_begin(), 0, 7), 1, 8)
    # the instrument has carried out the one before, and stands still while the law changes
    assert measured(timing, 1, 7, held=True) == (timing, NOT_SETTLED)
    before, settled = measured(timing, 1, 7)
    assert settled == accounted(1)
    assert before.commands.waiting
    assert measured(before, 1, 8)[1] == accounted(1, answers=True)


@pytest.mark.parametrize("first", [0, 1, 7])
def test_the_first_command_is_accounted_for_whatever_its_number_is(first: int) -> None:
    timing = signalled(signalled(slave_begin(), 0, first), 1, first + 1)
    assert measured(timing, 1, first + 1)[1] == accounted(2, answers=True)
    assert measured(timing, 1, first)[1] == accounted(1)


def test_before_the_first_command_a_state_of_the_instrument_settles_nothing() -> None:
    for number in (-1, 0, 1):
        assert measured(slave_begin(), 0, number) == (slave_begin(), NOT_SETTLED)
    assert slave_unanswered(slave_begin(), False) == (slave_begin(), NOT_SETTLED)


def test_up_to_six_commands_back_are_told_apart_and_all_are_accounted_for_by_the_newest() -> None:
    timing, ms = slave_begin(), 0
    for number in range(20):
        timing = signalled(timing, ms := ms + number % 3 + 1, number)
    # the steps: 1, and then 2, 3, 1, 2, 3, ...
    assert measured(timing, ms, 12) == (timing, NOT_SETTLED)
    older, settled = measured(timing, ms, 13)
    assert settled == accounted(1 + sum(number % 3 + 1 for number in range(1, 14)))
    assert measured(older, ms, 19)[1].periods == sum(number % 3 + 1 for number in range(14, 20))
    assert measured(timing, ms, 19)[1].periods == 1 + sum(number % 3 + 1 for number in range(1, 20))


def test_a_slave_between_two_signals_makes_up_for_each_whole_period_of_silence_once() -> None:
    timing, _ = measured(signalled(slave_begin(), 0, 7), 0, 7)
    for since_ns, periods in ((MS - 1, 0), (MS, 1), (2 * MS - 1, 1), (2 * MS, 2)):
        assert slave_stepped(timing, SLAVE, BEGIN_NS + since_ns, 0).pacing.step == periods
    ahead = slave_stepped(timing, SLAVE, BEGIN_NS + 2 * MS, 0)
    assert slave_stepped(ahead, SLAVE, BEGIN_NS + 2 * MS, 0).pacing.step == 0
    # the two signals that come after all bring the two periods again, and each is a step of at least one
    late, tick = ticked(ahead, BEGIN_NS + 2 * MS, BEGIN_NS + 2 * MS)
    assert (tick.begins, late.pacing.elapsed, late.pacing.behind) == (False, 2, -2)
    assert slave_stepped(late, SLAVE, BEGIN_NS + 2 * MS, 2).pacing.step == 1


def test_a_slave_that_begins_anew_owes_no_period_of_the_pause() -> None:
    timing = slave_stepped(signalled(slave_begin(), 0, 7), SLAVE, BEGIN_NS + 5 * MS, 0)
    assert timing.pacing.behind == -3
    again, tick = ticked(timing, BEGIN_NS + 60 * MS, BEGIN_NS + 60 * MS)
    assert tick == Tick(True, True)
    assert (again.pacing.elapsed, again.pacing.behind) == (1, 0)
    assert slave_stepped(again, SLAVE, BEGIN_NS + 60 * MS, 1).pacing[1:] == (0, 1)


def test_a_slave_that_understands_no_signal_makes_the_longest_step() -> None:
    timing, _ = ticked(slave_begin(), BEGIN_NS, BEGIN_NS, understood=False)
    assert slave_stepped(timing, SLAVE, BEGIN_NS, 0).pacing.step == MOST_PERIODS_A_STEP
    # one that was understood before counts on, and the other is silence
    understood = signalled(slave_begin(), 0, 7)
    other, _ = ticked(understood, BEGIN_NS + MS, BEGIN_NS + MS, understood=False)
    assert other.heard == understood.heard
    assert (other.hand.sampled_ns, other.pacing.elapsed) == (BEGIN_NS + MS, 1)


def test_a_signal_counts_that_came_when_the_clock_began() -> None:
    timing, _ = ticked(slave_begin(), 0, 0)
    stepped = slave_stepped(timing, SLAVE, 0, 1)
    assert stepped.pacing.step == 1
    settled = slave_measured(slave_commanded(stepped, 7, True), SLAVE, 0, 7, False, True)[0]
    assert slave_measured(settled, SLAVE, 2 * MS, 7, False, True)[1] == CONTINUES
    # and one that is not understood counts for an endless silence then as well
    assert slave_stepped(ticked(slave_begin(), 0, 0, understood=False)[0], SLAVE, 0, 1).pacing.step == (
        MOST_PERIODS_A_STEP
    )


def test_the_last_signal_counts_for_a_nanosecond_where_that_is_the_setting() -> None:
    timing, _ = measured(signalled(slave_begin(), 0, 7), 0, 7)
    found = [slave_measured(timing, TimingParams(MS, 50, 1), BEGIN_NS + since, 7, False, True)[1] for since in (1, 2)]
    assert found == [CONTINUES, NOT_SETTLED]


def test_a_signal_before_the_instrument_has_answered_is_answered_and_accounted_for_once() -> None:
    timing = signalled(slave_begin(), 0, 7)
    assert slave_unanswered(timing, True) == (timing, SlaveDecision(0, True, False, True, False))
    assert slave_unanswered(timing, False)[1] == accounted(1, answers=True)
    two = signalled(signalled(timing, 1, 8), 3, 9)
    first, settled = measured(two, 3, 8)
    assert settled == accounted(2)
    assert measured(first, 3, 8)[1] == measured(first, 3, 7)[1] == NOT_SETTLED
    assert measured(first, 3, 9)[1] == accounted(2, answers=True)


def test_a_signal_of_a_burst_is_passed_over_until_the_instrument_or_half_a_period_has_gone_on() -> None:
    def steps(timing: SlaveTiming, now_ns: int, params: TimingParams = SLAVE) -> bool:
        return ticked(timing, now_ns, BEGIN_NS + MS, params, may_wait=True)[1].steps

    timing = signalled(slave_begin(), 0, 7)
    half_ns = BEGIN_NS + MS // 2
    assert [steps(timing, half_ns + ns) for ns in (-MS // 2, -1, 0)] == [False, False, True]
    # one period for each step while the instrument is late, however early the signals come
    two = slave_commanded(slave_stepped(timing, SLAVE, half_ns, 1), 8, True)
    assert [steps(two, half_ns + MS + ns) for ns in (-1, 0)] == [False, True]
    # a step of before counts no more when the instrument has carried out all, or a pause was longer
    prompt = measured(two, 0.5, 8)[0]
    assert steps(prompt, half_ns)
    assert slave_stepped(prompt, SLAVE, half_ns + MS // 10, 1).commands.lasts_ns == half_ns + MS // 10 + MS
    later = slave_commanded(slave_stepped(timing, SLAVE, BEGIN_NS + 9 * MS, 1), 8, True)
    assert later.commands.lasts_ns == BEGIN_NS + 10 * MS
    # a half that follows a reference has no force to wait for
    assert steps(timing, BEGIN_NS, TimingParams(MS, 50, 0))
    # nor is waited for an instrument that is lost
    assert ticked(timing, BEGIN_NS, BEGIN_NS + MS)[1].steps


def test_what_is_passed_over_adds_to_what_the_half_is_behind_and_is_answered_with_the_last_command() -> None:
    own = slave_commanded(slave_stepped(signalled(slave_begin(), 0, 7), SLAVE, BEGIN_NS, 0), 8, False)
    timing, _ = ticked(own, BEGIN_NS, BEGIN_NS + 2 * MS)
    over, tick = ticked(own, BEGIN_NS, BEGIN_NS + 2 * MS, may_wait=True)
    assert tick == Tick(False, False)
    assert over.pacing.behind == timing.pacing.behind + 2
    assert measured(over, 0, 8)[1].answers
    assert not measured(timing, 0, 8)[1].answers


def test_a_half_whose_instrument_is_late_goes_on_in_a_silence_without_a_step_of_the_instruments_own() -> None:
    timing = signalled(slave_begin(), 0, 7)
    for ms, follows, goes_on in ((1.4, True, False), (1.5, True, True), (1.5, False, False), (51, True, False)):
        assert measured(timing, ms, 7, follows=follows)[1] == accounted(1, answers=True, continues=goes_on)
    # one that has answered in time makes its own steps
    own = slave_commanded(slave_stepped(timing, SLAVE, BEGIN_NS + 3 * MS, 0), 8, False)
    assert [measured(own, ms, 8)[1].continues for ms in (3.4, 3.49, 3.5, 4.5)] == [False, False, True, True]


def test_nothing_is_owed_after_a_stall() -> None:
    timing = slave_stalled(signalled(slave_begin(), 0, 7))
    assert slave_unanswered(timing, False)[1] == NOT_SETTLED
    assert measured(timing, 1, 7)[1] == NOT_SETTLED
    again, tick = ticked(timing, BEGIN_NS + MS, BEGIN_NS + MS)
    assert not tick.begins
    assert again.heard.received_ns == BEGIN_NS + MS


def test_a_signal_of_another_law_counts_as_silence() -> None:
    timing, _ = ticked(slave_begin(), BEGIN_NS, BEGIN_NS, understood=False)
    assert timing.heard.received_ns < 0
    assert timing.hand.sampled_ns == BEGIN_NS


@pytest.mark.parametrize("seed", range(10))
def test_each_step_is_accounted_for_once_whatever_the_instrument_leaves_out(seed: int) -> None:
    """Signals that are late, lost or in bursts, and an instrument that carries out any of the newest commands."""
    source = random.Random(seed)
    timing, number, carried_out, ms = slave_begin(), 0, 0, 0
    steps: dict[int, int] = {}
    accounted = 0
    for _ in range(3000):
        if source.random() < 0.6:
            ms += source.choice((1, 1, 1, 2, 7))
            if source.random() < 0.1:
                timing, settled = slave_unanswered(timing, False)
                accounted += settled.periods
                carried_out = number
            timing = signalled(timing, ms, number := number + 1)
            steps[number] = timing.pacing.step
        elif number:
            # never further back than is told apart
            told = source.randint(max(carried_out, number - 6), number)
            timing, settled = measured(timing, ms, told, follows=False)
            accounted += settled.periods
            carried_out = max(carried_out, told)
        assert accounted == sum(step for seq, step in steps.items() if seq <= carried_out)
    assert accounted > 1000
