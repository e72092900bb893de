"""The age of the hand's sample, less what link and clocks account for; and a process that notices its own hold-up."""

import pytest

from proto import TOPICS
from proto.messages import LinkDelay
from proto.topics import LOOP_DEADLINE_S, deadline_of
from services.runtime.loop.freshness import LOOP_DEADLINE_NS, Freshness, age_s

MS = 1_000_000
START_NS = 1_750_000_000 * 10**9
LATER_NS = START_NS + 60 * 10**9


def told(direction: str, hand_t_ns: int, delay_ms: float, **changes: int) -> LinkDelay:
    header = {"seq": 0, "t_ns": hand_t_ns, "src": "delay_node@master", "v": 1}
    fields = {"direction": direction, "hand_t_ns": hand_t_ns, "delay_ns": round(delay_ms * MS)}
    return LinkDelay.model_validate({**header, **fields, "transit_ns": 0, "clock_ahead_ns": 0, **changes})


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
    hand.record(told("forward", START_NS, 150.0).model_copy(update={"src": "console@master"}))
    assert age_ms(hand, LATER_NS, LATER_NS - 160 * MS) == pytest.approx(160.0, rel=1e-9, abs=0.0)


def test_the_slave_takes_off_the_way_there_and_the_master_both() -> None:
    there, both = Freshness("controller@slave", START_NS), Freshness("haptic_node@master", START_NS)
    for hand in (there, both):
        hand.record(told("forward", START_NS, 150.0))
    both.record(told("backward", START_NS, 30.0))
    assert age_ms(there, LATER_NS, LATER_NS - 160 * MS) == pytest.approx(10.0, rel=1e-9, abs=0.0)
    assert age_ms(both, LATER_NS, LATER_NS - 190 * MS) == pytest.approx(10.0, rel=1e-9, abs=0.0)


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


def test_each_sample_has_the_delay_that_was_told_before_it() -> None:
    hand = Freshness("afm_node@slave", START_NS)
    for n, delay_ms in enumerate((10.0, 80.0, 20.0)):
        hand.record(told("forward", LATER_NS + 100 * n * MS, delay_ms))
    ages = [age_ms(hand, LATER_NS + 300 * MS, LATER_NS + (100 * n + 50) * MS) for n in range(3)]
    assert ages == pytest.approx([240.0, 70.0, 30.0], rel=1e-9, abs=0.0)
    # told again with every link/status, which changes nothing
    hand.record(told("forward", LATER_NS + 200 * MS, 20.0))
    assert age_ms(hand, LATER_NS + 300 * MS, LATER_NS + 250 * MS) == pytest.approx(30.0, rel=1e-9, abs=0.0)


def test_a_delay_that_changes_with_every_sample_is_forgotten_as_it_is_used() -> None:
    hand = Freshness("haptic_node@master", START_NS)
    for n in range(20_000):
        hand.record(told("forward", LATER_NS + n * MS, 100.0 + n % 40))
        # the answers come 300 samples later
        if n >= 300:
            at_ns = LATER_NS + (n - 300) * MS
            assert age_ms(hand, at_ns + 200 * MS, at_ns) == pytest.approx(100.0 - (n - 300) % 40, rel=1e-9, abs=0.0)
    assert len(hand._forward.from_ns) <= 302
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


def test_a_sample_from_before_the_node_began_is_of_a_recording() -> None:
    hand = Freshness("afm_node@slave", START_NS)
    assert age_ms(hand, LATER_NS, START_NS - 10**15, 0.012) == 12.0
    assert hand.stamp_ns(START_NS - 10**15, LATER_NS) == LATER_NS
    # of one that the node might have been sent while it began the age is plain
    assert age_ms(hand, START_NS + 100 * MS, START_NS - 100 * MS) == pytest.approx(200.0, rel=1e-9, abs=0.0)


def test_a_stamp_from_the_future_is_as_far_off_as_one_from_the_past() -> None:
    assert age_s(LATER_NS, LATER_NS + LOOP_DEADLINE_NS) == -LOOP_DEADLINE_S
    assert age_s(LATER_NS, LATER_NS + LOOP_DEADLINE_NS + 1) > LOOP_DEADLINE_S
    assert Freshness("afm_node@slave", START_NS).age_s(LATER_NS, LATER_NS + 3600 * 10**9) == pytest.approx(3600.0)


def test_a_process_notices_that_it_stood_still_and_only_then() -> None:
    stalls = Freshness("controller@slave", START_NS)
    assert stalls.stalled_s(10**9) == 0.0
    now = 10**9
    for gap_ns in (MS, LOOP_DEADLINE_NS // 2, LOOP_DEADLINE_NS, 1):
        now += gap_ns
        assert stalls.stalled_s(now) == 0.0
        assert stalls.deadline_ns() == now + LOOP_DEADLINE_NS // 2
    now += LOOP_DEADLINE_NS + 1
    assert stalls.stalled_s(now) == pytest.approx(LOOP_DEADLINE_S, rel=1e-6, abs=0.0)
    assert stalls.stalled_s(now + 1) == 0.0
    assert stalls.stalled_s(now + 3 * 10**9) == pytest.approx(3.0, rel=1e-6, abs=0.0)
