"""The state machines of the halves: each row of the tables in `integration`, and what holds for any order of events."""

import random
from typing import Any

import pytest

from services.controller.integration import (
    ACCOUNT,
    ANSWER,
    ANSWER_EARLY,
    GO_ON,
    NOTHING,
    MasterTiming,
    Sampled,
    Settled,
    SlaveTiming,
    TimingParams,
    master_begin,
    master_heard,
    master_sampled,
    master_settled,
    master_stalled,
    round_trip_periods,
    slave_begin,
    slave_commanded,
    slave_measured,
    slave_signalled,
    slave_stalled,
    slave_stepped,
    slave_unanswered,
)

MS = 1_000_000
MASTER, SLAVE = TimingParams(MS, 50, 0), TimingParams(MS, 50, 50 * MS)
BEGIN_NS = 10**18
SEND, REPEAT, REST = Sampled(False, 1, False), Sampled(False, 0, True), Sampled(False, 0, False)
NOT_SETTLED = Settled(NOTHING, 0, False)


def sampled(timing: MasterTiming, ms: float, *, repeated: bool = False, commanded: bool = False) -> Any:
    return master_sampled(timing, MASTER, BEGIN_NS + round(ms * MS), repeated, commanded)


@pytest.fixture
def due() -> MasterTiming:
    """A master half that has sent at its first sample."""
    timing, found = sampled(master_begin(), 0)
    assert found == Sampled(True, 1, False)
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


def test_the_master_begins_anew_after_a_pause_and_waits_after_a_stall(due: MasterTiming) -> None:
    assert sampled(due, 50)[1] == Sampled(False, 50, False)
    assert sampled(due, 51)[1] == Sampled(True, 1, False)
    heard = master_heard(due, BEGIN_NS, BEGIN_NS)
    assert master_stalled(heard)._replace(hand=due.hand) == master_begin()._replace(hand=due.hand)


def test_the_round_trip_is_the_age_of_the_answered_sample_in_periods(due: MasterTiming) -> None:
    timing = due
    for ms in range(1, 6):
        timing, _ = sampled(timing, ms + 0.2)
    assert round_trip_periods(master_heard(timing, BEGIN_NS + 5 * MS, BEGIN_NS + 2 * MS), MASTER) == 3
    assert round_trip_periods(master_heard(timing, BEGIN_NS + 5 * MS, BEGIN_NS + 9 * MS), MASTER) == 0


def signalled(timing: SlaveTiming, ms: int, number: int) -> SlaveTiming:
    """Return the timing after a signal of a sample that was taken at ms, and its command."""
    now_ns = BEGIN_NS + ms * MS
    timing, _ = slave_signalled(timing, SLAVE, now_ns, now_ns, True)
    timing = slave_stepped(timing, SLAVE, now_ns, timing.pacing.elapsed)
    return slave_commanded(timing, number, True)


def measured(timing: SlaveTiming, ms: float, number: int, *, held: bool = False, follows: bool = True) -> Any:
    return slave_measured(timing, SLAVE, BEGIN_NS + round(ms * MS), number, held, follows)


def test_the_slave_answers_when_the_instrument_has_carried_out_its_newest_command() -> None:
    timing = signalled(slave_begin(), 0, 7)
    settled_timing, settled = measured(timing, 0, 7)
    assert settled == Settled(ANSWER, 1, True)
    assert not settled_timing.commands.waiting
    # of a command that is not its own it knows nothing
    for number in (5, 6, 8):
        assert measured(timing, 0, number) == (timing, NOT_SETTLED)


def test_an_instrument_that_steps_by_itself_takes_the_slave_along_while_the_signal_counts() -> None:
    timing, _ = measured(signalled(slave_begin(), 0, 7), 0, 7)
    assert measured(timing, 50, 7)[1].what == GO_ON
    assert measured(timing, 50.1, 7)[1].what == NOTHING
    assert measured(timing, 1.5, 7, follows=False)[1].what == NOTHING
    assert measured(timing, 1.5, 7, held=True)[1].what == NOTHING
    # what its own command did is accounted for, and not sent
    own = slave_commanded(slave_stepped(timing, SLAVE, BEGIN_NS + 3 * MS // 2, 0), 8, False)
    assert measured(own, 1.5, 8)[1] == Settled(ANSWER, 1, False)
    without = TimingParams(MS, 50, 0)
    assert slave_measured(timing, without, BEGIN_NS + MS, 7, False, True)[1].what == NOTHING


def test_a_signal_before_the_instrument_has_answered_is_answered_and_accounted_for_once() -> None:
    timing = signalled(slave_begin(), 0, 7)
    assert slave_unanswered(timing, True) == (timing, Settled(ANSWER_EARLY, 0, True))
    assert slave_unanswered(timing, False)[1] == Settled(ANSWER, 1, True)
    two = signalled(signalled(timing, 1, 8), 3, 9)
    first, settled = measured(two, 3, 8)
    assert settled == Settled(ACCOUNT, 2, False)
    assert measured(first, 3, 8)[1] == measured(first, 3, 7)[1] == NOT_SETTLED
    assert measured(first, 3, 9)[1] == Settled(ANSWER, 2, True)


def test_nothing_is_owed_after_a_stall() -> None:
    timing = slave_stalled(signalled(slave_begin(), 0, 7))
    assert slave_unanswered(timing, False)[1] == NOT_SETTLED
    assert measured(timing, 1, 7)[1] == NOT_SETTLED
    again, begins = slave_signalled(timing, SLAVE, BEGIN_NS + MS, BEGIN_NS + MS, True)
    assert not begins
    assert again.heard.received_ns == BEGIN_NS + MS


def test_a_signal_of_another_law_counts_as_silence() -> None:
    timing, _ = slave_signalled(slave_begin(), SLAVE, BEGIN_NS, BEGIN_NS, False)
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
