"""The age of the hand's sample, less what link and clocks account for; its histories, and a hold-up."""

import math

import msgspec
import pytest

from telenano.timing.clock import NEVER_NS
from telenano.timing.freshness import _MOST_CHANGES, LOOP_DEADLINE_NS, DelayHistory, Freshness, age_s
from telenano.wire.messages import LinkDelay
from telenano.wire.topics import LOOP_DEADLINE_S, deadline_of
from telenano.wire.topics import OWN_TOPICS as TOPICS

MS = 1_000_000
START_NS = 1_750_000_000 * 10**9
LATER_NS = START_NS + 60 * 10**9


def told(direction: str, hand_t_ns: int, delay_ms: float, **changes: int) -> LinkDelay:
    header = {"seq": 0, "t_ns": hand_t_ns, "src": "delay_node@master", "v": 1}
    fields = {"direction": direction, "hand_t_ns": hand_t_ns, "delay_ns": round(delay_ms * MS)}
    return msgspec.convert({**header, **fields, "transit_ns": 0, "clock_ahead_ns": 0, **changes}, LinkDelay)


def age_ms(hand: Freshness, now_ns: int, hand_t_ns: int, message_age_s: float = 0.0) -> float:
    return hand.age_s(now_ns, hand_t_ns, message_age_s) * 1e3


def test_every_topic_of_the_loop_has_one_deadline_from_the_table() -> None:
    loop = [row for row in TOPICS.values() if row.rate_hz == 1000.0]
    assert len(loop) == 6
    assert {deadline_of(row.name) for row in loop} == {LOOP_DEADLINE_S} == {LOOP_DEADLINE_NS * 1e-9}
    with pytest.raises(ValueError, match="session/control has no deadline"):
        deadline_of("session/control")


def test_without_a_word_of_the_link_an_age_is_the_plain_one() -> None:
    hand = Freshness("afm_node@slave", START_NS)
    assert age_ms(hand, LATER_NS, LATER_NS - 70 * MS) == pytest.approx(70.0, rel=1e-9, abs=0.0)
    # the greater of the two counts
    assert age_ms(hand, LATER_NS, LATER_NS - 70 * MS, 0.2) == pytest.approx(200.0, rel=1e-9, abs=0.0)


def test_only_the_link_says_what_its_delay_is() -> None:
    hand = Freshness("afm_node@slave", START_NS)
    hand.record(msgspec.structs.replace(told("forward", START_NS, 150.0), src="console@master"))
    assert age_ms(hand, LATER_NS, LATER_NS - 160 * MS) == pytest.approx(160.0, rel=1e-9, abs=0.0)


def test_network_and_clock_of_another_machine_are_taken_off() -> None:
    """Behind a network of 40 ms, and a clock that is 5 s ahead, a sample is as old as it is; half an hour off too."""
    for ahead_s in (5, -1800):
        there = Freshness("afm_node@slave", START_NS + ahead_s * 10**9)
        there.record(told("forward", START_NS, 10.0, transit_ns=40 * MS, clock_ahead_ns=ahead_s * 10**9))
        now_ns = LATER_NS + ahead_s * 10**9
        assert age_ms(there, now_ns, LATER_NS - 57 * MS) == pytest.approx(7.0, rel=1e-6, abs=0.0)
        assert age_ms(there, now_ns, LATER_NS - 1057 * MS) == pytest.approx(1007.0, rel=1e-6, abs=0.0)
    back = Freshness("controller@master", START_NS)
    back.record(told("backward", START_NS, 10.0, transit_ns=40 * MS, clock_ahead_ns=5 * 10**9))
    assert age_ms(back, LATER_NS, LATER_NS - 97 * MS) == pytest.approx(7.0, rel=1e-6, abs=0.0)


@pytest.mark.check("takes 0.9 s")
def test_a_delay_that_changes_with_every_sample_is_forgotten_as_it_is_used() -> None:
    hand = Freshness("haptic_node@master", START_NS)
    for n in range(20_000):
        hand.record(told("forward", LATER_NS + n * MS, 100.0 + n % 40))
        # the answers come 300 samples later
        if n >= 300:
            at_ns = LATER_NS + (n - 300) * MS
            assert age_ms(hand, at_ns + 200 * MS, at_ns) == pytest.approx(100.0 - (n - 300) % 40, rel=1e-9, abs=0.0)
    # and those of a deadline before the last that was judged, which the hand may still have got
    assert len(hand._forward.from_ns) <= 302 + LOOP_DEADLINE_NS // MS
    # the answers stay away: the memory is bounded all the same
    for n in range(20_000, 40_000):
        hand.record(told("forward", LATER_NS + n * MS, 100.0 + n % 40))
    assert len(hand._forward.from_ns) <= 4096


def test_a_recording_that_is_played_from_an_earlier_place_is_followed() -> None:
    hand = Freshness("afm_node@slave", START_NS)
    for n in (0, 1, 2):
        hand.record(told("forward", LATER_NS + n * 1000 * MS, 10.0 * n))
    hand.record(told("forward", LATER_NS, 50.0))
    assert age_ms(hand, LATER_NS + 2060 * MS, LATER_NS + 2000 * MS) == pytest.approx(10.0, rel=1e-9, abs=0.0)


def test_a_stamp_from_the_future_is_as_far_off_as_one_from_the_past() -> None:
    assert age_s(LATER_NS, LATER_NS + LOOP_DEADLINE_NS) == -LOOP_DEADLINE_S
    assert age_s(LATER_NS, LATER_NS + LOOP_DEADLINE_NS + 1) > LOOP_DEADLINE_S
    assert Freshness("afm_node@slave", START_NS).age_s(LATER_NS, LATER_NS + 3600 * 10**9) == pytest.approx(3600.0)


# --- the histories: how much is kept, what is forgotten, and who counts which way


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
    history.record(9, 30)
    history.record(9, 40)
    assert (history.from_ns, history.delay_ns) == ([0, 5, 9], [0, 20, 40])


def test_delays_of_samples_older_than_the_judged_one_are_not_kept() -> None:
    hand = Freshness("controller@master", START_NS)
    for n in range(100):
        stamp_ns = LATER_NS + 100 * n * MS
        hand.record(told("forward", stamp_ns, 10.0 + n))
        hand.record(told("backward", stamp_ns, 20.0 + n))
        # A deadline before the judged sample is still known, and after it the newest report counts.
        assert age_ms(hand, stamp_ns + 300 * MS, stamp_ns) == pytest.approx(270.0 - 2.0 * n, rel=1e-6, abs=0.0)
    kept = hand.capture()
    assert max(len(kept.forward.from_ns), len(kept.backward.from_ns)) <= 3


def test_what_older_samples_had_is_forgotten_and_no_more() -> None:
    history = DelayHistory()
    for n in (10, 20, 30):
        history.record(n, n)
    history.forget_before(9)
    assert history.from_ns == [0, 10, 20, 30]
    # the delay before the first change is the only one that no later sample has
    history.forget_before(10)
    assert (history.from_ns, history.delay_ns) == ([10, 20, 30], [10, 20, 30])
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


@pytest.mark.parametrize("behind", [0, 1, 20, 45])
def test_the_answer_that_a_hand_has_is_as_old_as_beyond_the_delay_of_its_own_sample(behind: int) -> None:
    """Change the delay with every sample, while the half judges newer answers than the hand has."""
    freshness = Freshness("controller@master", START_NS)
    for number in range(200):
        hand_ns = START_NS + number * MS
        for direction, delay_ms in (("forward", 100 + number % 7), ("backward", 100 + number % 11)):
            freshness.record(told(direction, hand_ns, delay_ms))
        freshness.age_s(hand_ns, hand_ns)
        answered = number - behind
        if answered < 0:
            continue
        trip_ms = 200 + answered % 7 + answered % 11
        for late_ms in (0, 3, 60):
            sampled_ns = START_NS + (answered + trip_ms + late_ms) * MS
            age_s = freshness.answer_age_s(sampled_ns, START_NS + answered * MS)
            assert age_s == pytest.approx(1e-3 * late_ms, abs=1e-9)


def test_a_hand_without_an_answer_has_felt_nothing_and_a_played_one_all_that_it_did() -> None:
    freshness = Freshness("controller@master", START_NS)
    assert freshness.answer_age_s(START_NS, 0) == math.inf
    assert freshness.answer_age_s(START_NS - 2_000 * MS, 0) == 0.0
    # a live hand whose last answer is from long before this half began
    assert freshness.answer_age_s(START_NS, START_NS - 5_000 * MS) == pytest.approx(5.0)
