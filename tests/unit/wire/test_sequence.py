"""The account of a sequence against one that remembers everything."""

import random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from telenano.wire.sequence import Arrival, SequenceTracker


class Reference:
    """Every life of the publisher as the whole set of numbers received in it; lost is what is missing in between."""

    def __init__(self) -> None:
        self.lives: list[list[int]] = []
        self.newest_t_ns = 0

    def accept(self, seq: int, t_ns: int) -> Arrival:
        arrival = self._classify(seq, t_ns)
        if arrival is Arrival.RESTART or not self.lives:
            self.lives.append([])
        if arrival is not Arrival.DUPLICATE:
            self.lives[-1].append(seq)
        if arrival not in (Arrival.DUPLICATE, Arrival.LATE):
            self.newest_t_ns = t_ns
        return arrival

    def _classify(self, seq: int, t_ns: int) -> Arrival:
        if not self.lives or seq == max(self.lives[-1]) + 1:
            return Arrival.NEXT
        life = self.lives[-1]
        if seq > max(life):
            return Arrival.AFTER_GAP
        if t_ns > self.newest_t_ns:
            return Arrival.RESTART
        return Arrival.LATE if min(life) < seq and seq not in life else Arrival.DUPLICATE

    @property
    def lost(self) -> int:
        return sum(len(set(range(min(life), max(life))) - set(life)) for life in self.lives)

    @property
    def received(self) -> int:
        return sum(map(len, self.lives))


def agree(messages: list[tuple[int, int]]) -> SequenceTracker:
    tracker, reference = SequenceTracker(), Reference()
    seen: list[Arrival] = []
    for seq, t_ns in messages:
        seen.append(tracker.accept(seq, t_ns))
        assert seen[-1] is reference.accept(seq, t_ns)
        assert (tracker.received, tracker.lost) == (reference.received, reference.lost)
    assert tracker.gaps == seen.count(Arrival.AFTER_GAP)
    assert tracker.late == seen.count(Arrival.LATE)
    assert tracker.duplicates == seen.count(Arrival.DUPLICATE)
    assert tracker.restarts == seen.count(Arrival.RESTART)
    assert tracker.received + tracker.duplicates == len(messages)
    return tracker


@pytest.mark.check("takes 0.9 s")
@settings(max_examples=500)
@given(st.lists(st.tuples(st.integers(0, 20), st.integers(0, 10)), max_size=60))
@example([(5, 1), (3, 1), (4, 1)])
@example([(0, 0), (0, 0)])
def test_any_messages_give_the_account_of_the_reference(messages: list[tuple[int, int]]) -> None:
    agree(messages)


@settings(max_examples=200)
@given(st.integers(0, 2**32), st.integers(1, 4))
def test_a_bad_link_and_restarts(seed: int, lives: int) -> None:
    """Numbers from 0 with rising stamps, each life dropped, doubled and shuffled within a window, lives in order."""
    rng = random.Random(seed)
    received: list[tuple[int, int]] = []
    for life in range(lives):
        sent = [(seq, 1000 * life + seq) for seq in range(rng.randint(5, 80))]
        kept = [m for m in sent for _ in range(rng.choice((0, 1, 1, 1, 2)))]
        received += sorted(kept, key=lambda m: m[1] + rng.randint(0, 5))
    tracker = agree(received)
    assert 0 <= tracker.restarts < lives


def test_a_healthy_stream_loses_nothing_wherever_the_reader_comes_in() -> None:
    tracker = SequenceTracker()
    assert {tracker.accept(seq, seq) for seq in range(777, 1777)} == {Arrival.NEXT}
    assert (tracker.received, tracker.lost, tracker.gaps) == (1000, 0, 0)
    assert (tracker.last_seq, tracker.last_t_ns) == (1776, 1776)


def test_an_overtaken_message_fills_its_gap_once() -> None:
    tracker = SequenceTracker()
    for seq in (0, 1, 5):
        tracker.accept(seq, seq)
    assert (tracker.lost, tracker.last_gap) == (3, (2, 4))
    assert tracker.accept(3, 3) is Arrival.LATE
    assert tracker.accept(3, 3) is Arrival.DUPLICATE
    assert (tracker.lost, tracker.late, tracker.duplicates, tracker.last_seq) == (2, 1, 1, 5)


def test_a_restart_starts_anew_but_what_was_lost_stays_lost() -> None:
    tracker = SequenceTracker()
    tracker.accept(0, 10)
    tracker.accept(9, 20)
    assert tracker.accept(0, 30) is Arrival.RESTART
    assert tracker.accept(1, 31) is Arrival.NEXT
    # number 5 of the life before is not missing any more
    assert tracker.accept(0, 15) is Arrival.DUPLICATE
    assert (tracker.lost, tracker.restarts) == (8, 1)


@pytest.mark.parametrize("gap", [4096, 4097, 10_000, 2**62])
def test_a_huge_gap_is_counted_whole_and_costs_little(gap: int) -> None:
    tracker = SequenceTracker()
    tracker.accept(0, 1)
    assert tracker.accept(gap + 1, 2) is Arrival.AFTER_GAP
    assert tracker.lost == gap
    assert tracker.accept(gap, 1) is Arrival.LATE
    # the oldest part of it is recognised only while it is remembered
    assert tracker.accept(1, 1) is (Arrival.LATE if gap == 4096 else Arrival.DUPLICATE)


def test_many_gaps_are_remembered_to_a_bound_the_newest_first() -> None:
    tracker = SequenceTracker()
    for seq in range(0, 40_000, 4):
        tracker.accept(seq, seq)
    newest = 40_000 - 4
    assert tracker.lost == 3 * (newest // 4)
    assert tracker.accept(newest - 1, 0) is Arrival.LATE
    assert tracker.accept(1, 0) is Arrival.DUPLICATE


def test_what_is_missing_at_the_end_is_lost() -> None:
    tracker = SequenceTracker()
    for seq in range(5):
        tracker.accept(seq, 10 + seq)
    assert tracker.finish(8) == 3
    assert (tracker.lost, tracker.gaps, tracker.last_gap) == (3, 1, (5, 7))


def test_a_whole_topic_and_one_that_was_never_received_lack_nothing_at_the_end() -> None:
    tracker = SequenceTracker()
    assert tracker.finish(8) == 0
    tracker.accept(7, 10)
    assert (tracker.finish(8), tracker.finish(3)) == (0, 0)
    assert tracker.lost == 0


@pytest.mark.parametrize("seq", [0, 1, 2, 40])
def test_after_the_end_any_number_is_that_of_the_next_process(seq: int) -> None:
    tracker = SequenceTracker()
    tracker.accept(1, 10)
    tracker.finish(2)
    # of the process that has ended, come late
    assert tracker.accept(1, 10) is Arrival.DUPLICATE
    assert tracker.accept(seq, 20) is Arrival.RESTART
    assert (tracker.lost, tracker.restarts) == (0, 1)
    # and its own gaps count again
    assert tracker.accept(seq + 3, 21) is Arrival.AFTER_GAP
    assert tracker.lost == 2


def test_a_number_far_ahead_in_the_name_of_a_publisher_does_not_make_the_rest_late() -> None:
    tracker, second_ns = SequenceTracker(), 10**9
    tracker.accept(100, second_ns)
    # by a clock that is four seconds ahead
    assert tracker.accept(3000, 5 * second_ns) is Arrival.AFTER_GAP
    seen = [tracker.accept(seq, second_ns + seq * 10**6) for seq in range(101, 200)]
    assert seen[:7] == [Arrival.LATE] * 7
    assert seen[7] is Arrival.RESTART
    assert set(seen[8:]) == {Arrival.NEXT}


def test_what_was_held_back_for_less_than_a_second_is_late_however_long_it_is() -> None:
    tracker = SequenceTracker()
    tracker.accept(0, 0)
    tracker.accept(900, 900 * 10**6)
    assert {tracker.accept(seq, seq * 10**6) for seq in range(1, 900)} == {Arrival.LATE}


class Truth:
    """A publisher's processes as they are: whatever a reader gets of them, its account is that of the sets of numbers.

    A process is told by its run alone: their stamps may overlap, go back, or be equal.
    """

    def __init__(self, rng: random.Random, processes: int) -> None:
        self.received: list[tuple[int, int, int]] = []
        self.lost = 0
        for run in range(processes):
            sent = rng.randint(1, 60)
            # A process may be met late, and a carrier may be away in the middle of its numbers.
            first, gone = rng.randint(0, sent - 1), range(*sorted(rng.choices(range(sent + 1), k=2)))
            kept = [seq for seq in range(first, sent) if seq not in gone and rng.random() < 0.9]
            if not kept:
                continue
            began_ns = rng.choice((0, 10**9, 10**10, -(3 * 10**10)))
            messages = [(seq, 10**12 + began_ns + seq * 1000, run) for seq in kept]
            self.lost += max(kept) + 1 - len(kept) - (min(kept) if not self.received else 0)
            doubled = [one for one in messages for _ in range(rng.choice((1, 1, 2)))]
            # What overtakes the first one that is received of all is a repetition to a reader.
            shuffled = sorted(doubled[1:], key=lambda one: one[0] + rng.randint(0, 4))
            self.received += [doubled[0], *shuffled]


@pytest.mark.check("takes 0.6 s")
@settings(max_examples=500)
@given(st.integers(0, 2**32), st.integers(1, 5))
def test_with_its_run_every_process_is_counted_from_0_whatever_its_clock(seed: int, processes: int) -> None:
    truth = Truth(random.Random(seed), processes)
    tracker = SequenceTracker(counts_heads=True)
    seen = [tracker.accept(*one) for one in truth.received]
    runs = list(dict.fromkeys(run for *_, run in truth.received))
    assert tracker.lost == truth.lost
    assert (tracker.restarts, seen.count(Arrival.RESTART)) == (max(0, len(runs) - 1),) * 2
    assert tracker.received == len({one[::2] for one in truth.received})


def test_a_node_that_meets_a_process_anew_has_lost_nothing_of_it() -> None:
    """A console that is started again has sent three copies before the node is connected."""
    tracker = SequenceTracker()
    tracker.accept(0, 10, 7)
    tracker.accept(1, 11, 7)
    assert tracker.accept(3, 20, 8) is Arrival.RESTART
    assert (tracker.lost, tracker.gaps) == (0, 0)


def test_a_process_whose_clock_was_set_back_is_heard_from_its_first_message_on() -> None:
    tracker, minute_ns = SequenceTracker(), 60 * 10**9
    assert {tracker.accept(seq, minute_ns + seq, 7) for seq in range(100)} == {Arrival.NEXT}
    assert [tracker.accept(seq, seq, 8) for seq in range(3)] == [Arrival.RESTART, Arrival.NEXT, Arrival.NEXT]
    # and what a slow way delivers of the process before is late, not a restart
    assert tracker.accept(100, minute_ns + 100, 7) is Arrival.LATE
    assert tracker.accept(3, 3, 8) is Arrival.NEXT
    assert (tracker.restarts, tracker.lost) == (1, 0)


def test_the_end_of_a_link_ends_no_numbers_but_shows_what_did_not_arrive() -> None:
    tracker = SequenceTracker(counts_heads=True)
    for seq in range(5):
        tracker.accept(seq, 10 + seq, 7)
    assert tracker.finish(7, ended=False) == 2
    # The messages that the link did not carry are a gap, and no publisher was restarted.
    assert tracker.accept(20, 40, 7) is Arrival.AFTER_GAP
    assert (tracker.lost, tracker.gaps, tracker.restarts, tracker.last_gap) == (15, 2, 0, (7, 19))


def test_the_end_of_a_process_of_which_nothing_was_received_counts_all_of_it() -> None:
    tracker = SequenceTracker(counts_heads=True)
    tracker.accept(0, 10, 7)
    assert (tracker.finish(1, 7), tracker.finish(4, 8)) == (0, 4)
    assert (tracker.lost, tracker.restarts) == (4, 1)
    # the end of an earlier process is known already
    assert tracker.finish(9, 7) == 0
    assert tracker.accept(0, 5, 9) is Arrival.RESTART
