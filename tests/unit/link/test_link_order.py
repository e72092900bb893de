"""Order, queues, slots and limits of the link's engine, message by message, with the counts beside them."""

from pathlib import Path

import pytest
from link_bench import MS, START, TOPIC, engine, finish, stream

from telenano.link.direction import DirectionEngine
from telenano.link.engine import LinkEngine
from telenano.link.fate import Release
from telenano.settings.link_settings import LinkSettings


@pytest.mark.parametrize("order", ["topic", "link"])
def test_where_order_is_asked_for_a_message_that_passes_untouched_stays_in_the_queue(order: str) -> None:
    # 5 ms on the line for each, one a millisecond
    fates = stream(40, order=order, rate={"rate_bytes_per_s": 20_000.0}, apply_probability=0.5)
    assert [fate.release_ns for fate in fates] == [START + 5 * (n + 1) * MS for n in range(40)]
    assert not any(fate.reordered for fate in fates)
    # without it those messages go past the line, and past the messages in it
    free = stream(40, rate={"rate_bytes_per_s": 20_000.0}, apply_probability=0.5)
    assert 10 < sum(fate.delay_ns == 0 for fate in free) < 30
    assert sum(fate.reordered for fate in free) > 5


def test_slots_hold_only_what_the_settings_apply_to() -> None:
    fates = stream(200, slots={"min_interval_s": 0.01}, apply_probability=0.5)
    in_slots = [fate for fate in fates if fate.release_ns is not None and (fate.release_ns - START) % (10 * MS) == 0]
    at_once = [fate for fate in fates if fate.delay_ns == 0]
    assert len(in_slots) + len(at_once) >= 200
    assert 60 < sum((fate.arrived_ns - START) % (10 * MS) != 0 for fate in at_once) < 120


@pytest.mark.parametrize("late_ns", [0, 1, 50 * MS])
def test_of_two_queues_that_are_ready_together_the_one_of_the_direction_goes_first(late_ns: int) -> None:
    line = {"rate": {"rate_bytes_per_s": 1e5}}
    link = engine(**line, topics={"own/*": line})
    for seq in range(3):
        link.submit(START, "own/a", bytes(100), seq)
        link.submit(START, "a", bytes(100), seq)
    link.due(START + 3 * MS + late_ns)
    # the first one of each was on its line at once, in the order in which they came
    assert [(fate.topic, fate.seq) for fate in link.take_fates()] == [
        ("own/a", 0), ("a", 0), ("a", 1), ("own/a", 1), ("a", 2), ("own/a", 2)
    ]  # fmt: skip


def test_a_copy_that_comes_before_its_original_has_overtaken_nothing() -> None:
    settings = {"delay_s": 0.0002, "jitter": {"scale_s": 0.0002, "distribution": "uniform"}}
    link = engine(**settings, duplication={"probability": 1.0})
    for seq in range(200):
        link.submit(START + seq * MS, TOPIC, b"", seq)
    finish(link)
    fates = link.take_fates()
    release_ns = {(fate.seq, fate.copy): fate.release_ns or 0 for fate in fates}
    assert sum(release_ns[seq, 1] < release_ns[seq, 0] for seq in range(200)) > 50
    assert not any(fate.reordered for fate in fates)
    # the original carries the mark, and its copy is told by its number
    assert {(fate.copy, fate.duplicated) for fate in fates} == {(0, True), (1, False)}
    stats = link.stats()
    assert (stats.reordered, stats.duplicated, stats.messages_out) == (0, 200, 400)


def test_no_draw_delays_a_message_for_more_than_a_day(tmp_path: Path) -> None:
    (tmp_path / "table.txt").write_text("1000000\n")
    heavy = {"scale_s": 1.0, "distribution": "table", "table_file": "table.txt"}
    assert {fate.delay_ns for fate in stream(5, tmp_path, jitter=heavy)} == {86_400_000 * MS}
    (tmp_path / "table.txt").write_text("3600\n")
    assert {fate.delay_ns for fate in stream(5, tmp_path, jitter=heavy)} == {3_600_000 * MS}
    # and none before it came
    (tmp_path / "table.txt").write_text("-1\n")
    assert {fate.delay_ns for fate in stream(5, tmp_path, jitter=heavy, delay_s=0.5)} == {0}


def test_a_shorter_constant_delay_lets_new_messages_overtake_and_counts_them() -> None:
    link = LinkEngine(LinkSettings.of({"forward": {"delay_s": 0.05}}), START)
    for seq in range(3):
        link.forward.submit(START + seq * MS, TOPIC, b"ab", seq)
    link.reconfigure(link.settings.changed({"forward.delay_s": 0.01}), START + 3 * MS)
    for seq in range(3, 6):
        link.forward.submit(START + seq * MS, TOPIC, b"ab", seq)
    assert [fate.reordered for fate in link.take_fates()] == [False, False, False, True, True, True]
    released = link.forward.due(START + 100 * MS)
    assert [release.fate.seq for release in released] == [3, 4, 5, 0, 1, 2]
    # once the former ones have gone nothing is overtaken any more
    link.forward.submit(START + 90 * MS, TOPIC, b"ab", 6)
    assert [fate.reordered for fate in link.take_fates()] == [False]
    stats = link.forward.stats()
    assert (stats.messages_in, stats.bytes_in, stats.messages_out, stats.bytes_out) == (7, 14, 6, 12)
    assert (stats.reordered, stats.queued, stats.in_flight) == (3, 0, 1)
    assert (stats.delay_count, stats.delay_min_s, stats.delay_max_s) == (6, 0.01, 0.05)


def test_messages_without_a_delay_wait_for_those_that_are_due_before_them() -> None:
    link = engine(topics={"slow": {"delay_s": 0.001}})
    assert link.submit(START, "slow", b"1", 0) == ()
    assert [r.payload for r in link.submit(START + MS - 1, "fast", b"2", 0)] == [b"2"]
    assert [r.payload for r in link.submit(START + MS, "fast", b"3", 1)] == [b"1", b"3"]
    assert [r.payload for r in link.submit(START + MS, "fast", b"4", 2)] == [b"4"]
    assert link.next_release_ns() is None
    assert [fate.delay_ns for fate in link.take_fates()] == [MS, 0, 0, 0]


def test_what_waits_in_a_queue_is_counted_and_due_when_it_has_left() -> None:
    link = engine(rate={"rate_bytes_per_s": 1e5}, delay_s=0.002)
    for seq in range(3):
        assert link.submit(START, TOPIC, bytes(100), seq) == ()
    assert link.next_release_ns() == START + MS
    # the first one is on the line, and its release is decided
    assert (link.stats().queued, link.stats().in_flight) == (2, 3)
    assert link.due(START + MS) == []
    assert (link.stats().queued, link.stats().in_flight) == (1, 3)
    # on its way already while the next one is on the line
    assert link.next_release_ns() == START + 2 * MS
    assert [release.fate.seq for release in finish(link)] == [0, 1, 2]
    fates = link.take_fates()
    assert [(fate.queue_ns, fate.delay_ns, fate.held_ns) for fate in fates] == [
        (n * MS, (n + 2) * MS, 0) for n in (1, 2, 3)
    ]


def test_an_outage_that_holds_delays_by_what_it_has_left_and_one_that_drops_spares_what_is_not_applied() -> None:
    outage = {"schedule": ((0.010, 0.020),)}
    held = stream(50, delay_s=0.001, outage={**outage, "mode": "hold"}, rate={"rate_bytes_per_s": 1e6})
    assert [(fate.held_ns, fate.queue_ns) for fate in held[9:13]] == [
        (0, MS // 10), (20 * MS, MS // 10), (19 * MS, 2 * MS // 10), (18 * MS, 3 * MS // 10)
    ]  # fmt: skip
    dropped = stream(50, outage=outage, apply_probability=0.5)
    lost = [fate.seq for fate in dropped if fate.dropped == "outage"]
    assert 4 < len(lost) < 16
    assert set(lost) <= set(range(10, 30))
    assert all((fate.release_ns, fate.delay_ns) == (None, 0) for fate in dropped if fate.dropped)


def test_a_line_that_new_settings_replace_is_emptied_and_stays_busy_for_what_it_sent() -> None:
    link = LinkEngine(LinkSettings.of({"forward": {"rate": {"rate_bytes_per_s": 1e5}}}), START)
    for seq in range(3):
        link.forward.submit(START, TOPIC, bytes(100), seq)
    link.reconfigure(link.settings.changed({"forward.rate.rate_bytes_per_s": 1e6}), START + MS // 2)
    assert link.forward.stats().queued == 0
    released = list(link.forward.submit(START + MS, TOPIC, bytes(100), 3))
    assert [fate.release_ns for fate in link.take_fates()] == [START + n * MS for n in (1, 2, 3)]
    released += finish(link.forward)
    assert [release.fate.seq for release in released] == [0, 1, 2, 3]
    assert released[3].fate.release_ns == START + 3 * MS + MS // 10
    # times do not go back, and the line is free when it has sent what it has
    assert link.forward.submit(START, TOPIC, b"", 4) == ()
    assert (link.take_fates()[-1].arrived_ns, link.next_release_ns()) == (START + MS, START + 3 * MS + MS // 10)


def test_the_next_release_of_a_link_is_the_earlier_one_of_its_directions() -> None:
    link = LinkEngine(LinkSettings.of({"forward": {"delay_s": 0.02}, "backward": {"delay_s": 0.01}}), START)
    assert link.next_release_ns() is None
    link.forward.submit(START, TOPIC, b"", 0)
    assert link.next_release_ns() == START + 20 * MS
    link.backward.submit(START, "teleop/backward", b"", 0)
    assert link.next_release_ns() == START + 10 * MS
    assert [fate.direction for fate in link.take_fates()] == ["forward", "backward"]
    assert link.backward.due(START + 10 * MS)[0].fate.direction == "backward"


def test_a_full_queue_drops_and_names_itself_as_the_cause() -> None:
    link = engine(rate={"rate_bytes_per_s": 1e5}, queue={"limit_messages": 2})
    for seq in range(6):
        link.submit(START, TOPIC, bytes(100), seq)
    finish(link)
    fates = sorted(link.take_fates())
    assert [fate.dropped for fate in fates].count("queue") == link.stats().dropped["queue"] == 3
    assert all(fate.release_ns is None for fate in fates if fate.dropped)


def test_a_plain_bridge_counts_what_it_passes_on_at_once() -> None:
    link = engine()
    link.submit(START, TOPIC, b"abc", 0)
    stats = link.stats()
    assert (stats.messages_out, stats.bytes_out, stats.delay_count, stats.delay_max_s) == (1, 3, 1, 0.0)
    assert DirectionEngine.fates(LinkSettings.of({}), "forward", TOPIC, [], 9) == []


def test_a_message_that_finds_the_line_free_is_on_it_at_once_and_one_that_has_left_makes_room() -> None:
    link = engine(rate={"rate_bytes_per_s": 1e5}, queue={"limit_messages": 1})
    link.submit(START, TOPIC, bytes(100), 0)
    assert (link.stats().queued, link.stats().in_flight) == (0, 1)
    link.submit(START, TOPIC, bytes(100), 1)
    assert link.stats().queued == 1
    link.submit(START + 5 * MS, TOPIC, bytes(100), 2)
    finish(link)
    assert [fate.dropped for fate in link.take_fates()] == ["", "", ""]


@pytest.mark.parametrize("order", ["any", "topic"])
def test_what_overtakes_is_marked_and_in_order_nothing_does(order: str) -> None:
    jitter = {"scale_s": 0.01, "distribution": "uniform"}
    fates = stream(300, delay_s=0.02, jitter=jitter, order=order)
    latest_ns, overtaking = 0, 0
    for fate in fates:
        release_ns = fate.release_ns or 0
        assert fate.reordered == (release_ns < latest_ns)
        overtaking += release_ns < latest_ns
        latest_ns = max(latest_ns, release_ns)
    assert (overtaking > 30) is (order == "any")
    assert (overtaking == 0) is (order == "topic")


def test_a_link_in_order_keeps_the_order_of_all_its_topics() -> None:
    link = engine(delay_s=0.02, jitter={"scale_s": 0.01, "distribution": "uniform"}, order="link")
    released: list[Release] = []
    for seq in range(300):
        released += link.submit(START + seq * MS, "ab"[seq % 2], b"", seq)
    assert [release.fate.seq for release in released + finish(link)] == list(range(300))
    release_ns = [fate.release_ns or 0 for fate in link.take_fates()]
    assert release_ns == sorted(release_ns)


def test_settings_of_a_pattern_may_go_while_messages_wait_under_them() -> None:
    line = {"rate": {"rate_bytes_per_s": 1e5}}
    link = LinkEngine(LinkSettings.of({"forward": {"topics": {"own/*": line}}}), START)
    for seq in range(3):
        link.forward.submit(START, "own/a", bytes(100), seq)
    link.reconfigure(LinkSettings.of({"forward": {}}), START + MS // 2)
    assert [release.fate.release_ns for release in finish(link.forward)] == [START + n * MS for n in (1, 2, 3)]


def test_corruption_flips_all_of_a_short_payload_and_leaves_an_empty_one() -> None:
    link = engine(corruption={"probability": 1.0, "bits": 100})
    sent = [link.submit(START, TOPIC, payload, seq)[0] for seq, payload in enumerate((b"\x0f", b"", b"\0"))]
    assert [(release.payload, release.fate.corrupted) for release in sent] == [
        (b"\xf0", True), (b"", False), (b"\xff", True)
    ]  # fmt: skip
    assert link.stats().corrupted == 2


def test_messages_of_one_slot_come_out_in_the_order_in_which_they_went_in() -> None:
    link = engine(slots={"min_interval_s": 0.01})
    for seq in range(4):
        link.submit(START + (seq + 1) * MS, TOPIC, bytes([9 - seq]), seq)
    released = finish(link)
    # in that of the time and not of the content
    assert [(release.fate.seq, release.fate.release_ns) for release in released] == [
        (seq, START + 10 * MS) for seq in range(4)
    ]
