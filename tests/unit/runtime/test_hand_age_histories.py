"""The histories behind the age of the hand's sample: how much is kept, what is forgotten, and who counts which way."""

import pytest

from proto.messages import LinkDelay
from services.runtime.clock import NEVER_NS
from services.runtime.loop.freshness import _MOST_CHANGES, LOOP_DEADLINE_NS, DelayHistory, Freshness

MS = 1_000_000
START_NS = 1_750_000_000 * 10**9
LATER_NS = START_NS + 60 * 10**9


def told(direction: str, hand_t_ns: int, delay_ms: float, **changes: int) -> LinkDelay:
    header = {"seq": 0, "t_ns": hand_t_ns, "src": "delay_node@master", "v": 1}
    fields = {"direction": direction, "hand_t_ns": hand_t_ns, "delay_ns": round(delay_ms * MS)}
    return LinkDelay.model_validate({**header, **fields, "transit_ns": 0, "clock_ahead_ns": 0, **changes})


def test_a_history_keeps_four_thousand_changes_and_then_drops_the_older_half() -> None:
    history = DelayHistory()
    for n in range(1, 4096):
        history.record(n, 10 * n)
    # with the one that it began with
    assert len(history.from_ns) == len(history.delay_ns) == 4096 == _MOST_CHANGES
    history.record(4096, 40_960)
    assert len(history.from_ns) == len(history.delay_ns) == 2049
    assert history.of(2048) == 20_480
    assert history.of(2047) == 0
    assert history.of(4096) == 40_960


def test_a_second_word_for_the_same_sample_replaces_the_first() -> None:
    history = DelayHistory()
    history.record(5, 10)
    history.record(5, 20)
    assert (history.from_ns, history.delay_ns) == ([0, 5], [0, 20])
    assert (history.of(4), history.of(5), history.of(6)) == (0, 20, 20)


def test_what_older_samples_had_is_forgotten_and_no_more() -> None:
    history = DelayHistory()
    for n in (10, 20, 30):
        history.record(n, n)
    history.forget_before(25)
    assert (history.from_ns, history.delay_ns) == ([20, 30], [20, 30])
    history.forget_before(20)
    assert history.from_ns == [20, 30]
    assert history.of(19) == 0


def test_the_way_back_does_not_count_at_the_slave() -> None:
    there = Freshness("controller@slave", START_NS)
    there.record(told("forward", START_NS, 100.0))
    there.record(told("backward", START_NS, 30.0))
    assert there.lag_ns(LATER_NS) == 100 * MS
    assert there.age_s(LATER_NS, LATER_NS - 110 * MS) == pytest.approx(10e-3, rel=1e-6, abs=0.0)
    # at the master both do, and the network both ways
    back = Freshness("controller@master", START_NS)
    back.record(told("forward", START_NS, 100.0))
    back.record(told("backward", START_NS, 30.0, transit_ns=5 * MS, clock_ahead_ns=7 * MS))
    assert back.lag_ns(LATER_NS) == 140 * MS
    assert Freshness("controller@slave", START_NS).lag_ns(LATER_NS) == 0


def test_an_older_sample_has_its_own_delay_after_the_newest_has_been_told() -> None:
    hand = Freshness("controller@master", START_NS)
    hand.record(told("forward", START_NS, 10.0))
    hand.record(told("backward", START_NS + 50 * MS, 20.0))
    hand.record(told("forward", START_NS + 100 * MS, 80.0))
    now_ns = START_NS + 500 * MS
    for sampled_ms, lag_ms in ((0, 10), (49, 10), (50, 30), (99, 30), (100, 100), (101, 100)):
        expected_s = (500 - sampled_ms - lag_ms) * 1e-3
        assert hand.age_s(now_ns, START_NS + sampled_ms * MS) == pytest.approx(expected_s, rel=1e-9, abs=0.0)
    # the first sample can still be asked for when the link has reported again without one being judged since
    hand.age_s(now_ns, START_NS + 60 * MS)
    hand.record(told("forward", START_NS + 200 * MS, 5.0))
    assert hand.lag_ns(START_NS + 60 * MS) == 30 * MS


def test_what_is_a_second_older_than_the_node_is_from_a_recording() -> None:
    hand = Freshness("afm_node@slave", START_NS)
    assert hand.stamp_ns(START_NS - 1000 * MS, LATER_NS) == START_NS - 1000 * MS
    assert hand.stamp_ns(START_NS - 1000 * MS - 1, LATER_NS) == LATER_NS
    assert hand.age_s(LATER_NS, START_NS - 1000 * MS) == pytest.approx(61.0, rel=1e-9, abs=0.0)
    assert hand.age_s(LATER_NS, START_NS - 1000 * MS - 1, 0.25) == 0.25
    received_ns = LATER_NS - 3 * MS
    old_ns = START_NS - 2000 * MS
    assert hand.stamp_ns(old_ns, received_ns) == received_ns
    assert hand.stamp_ns(LATER_NS - MS, received_ns) == LATER_NS - MS
    hand.allow_replay = False
    assert hand.stamp_ns(old_ns, received_ns) == old_ns


def test_a_stall_is_longer_than_the_deadline_of_the_loop_and_has_a_turn_before_it() -> None:
    detector = Freshness("controller@slave", START_NS)
    assert detector.deadline_ns() == NEVER_NS
    # what came before the first turn is no stall, however long it took
    assert detector.stalled_s(LATER_NS) == 0.0
    assert detector.deadline_ns() == LATER_NS + LOOP_DEADLINE_NS // 2
    assert detector.stalled_s(LATER_NS + LOOP_DEADLINE_NS) == 0.0
    late_ns = LATER_NS + 2 * LOOP_DEADLINE_NS + 1
    assert detector.stalled_s(late_ns) == pytest.approx((LOOP_DEADLINE_NS + 1) * 1e-9, rel=1e-12, abs=0.0)
    assert detector.stalled_s(late_ns) == 0.0
