"""The order and the times of sending, of recordings whose recorder was late."""

import random
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, sample, teleop_forward

from services.player.playback import Playback, Span
from telenano.recording.channel_filter import ALL, Selection
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.sender_time import SenderClock, SenderOrder, SentMessage
from telenano.recording.writer import RecordingWriter
from telenano.wire import Message, encode
from telenano.wire.codec import fields_of
from telenano.wire.ends import end_data
from telenano.wire.messages import LinkClock

SECOND_NS = 1_000_000_000
HAND, TIP = "haptic_node@master", "afm_node@slave"
# topic, site of reception, message, time of reception [ns]
Row = tuple[str, str, Message, int]


@pytest.fixture
def record(tmp_path: Path) -> Callable[[list[Row]], Recording]:
    """Write messages in the order of their reception."""

    def write(rows: list[Row]) -> Recording:
        writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
        channels: dict[tuple[str, str, str], int] = {}
        for topic, site, message, log_ns in sorted(rows, key=lambda row: row[3]):
            key = (topic, message.src, site)
            if key not in channels:
                channels[key] = writer.channel(*key)
            writer.write(channels[key], log_ns, message.t_ns, message.seq, encode(message))
        writer.finish()
        return Recording(writer.path)

    return write


def hand(seq: int, log_ns: int) -> Row:
    return ("haptic/state", "master", haptic_state(seq), log_ns)


def tip(seq: int, log_ns: int, **changes: Any) -> Row:
    return ("afm/state", "slave", sample("afm/state", seq, src=TIP, **changes), log_ns)


def sent(seq: int) -> int:
    """Return when the sample of this number is sent [ns]."""
    return EPOCH_NS + seq * MILLISECOND_NS


def in_order(recording: Recording, first_ns: int | None = None) -> list[SentMessage]:
    order, found = SenderOrder(recording, ALL, SenderClock(recording), first_ns), []
    while (message := order.peek()) is not None:
        found.append(message)
        order.pop()
    return found


def late(seed: int) -> list[Row]:
    """Return two streams of a message a ms whose recorder stands still now and then, and then takes them in blocks."""
    dice = random.Random(seed)
    rows, log_ns = [], 0
    waiting: dict[Any, int] = {hand: 0, tip: 0}
    while min(waiting.values()) < 4000:
        # up to three seconds at once, then at most 256 of one publisher before the other has its turn
        log_ns = max(log_ns, sent(max(waiting.values()))) + dice.choice((1, 1, 50, 300, 3000)) * MILLISECOND_NS
        for make in waiting:
            while waiting[make] < 4000 and sent(waiting[make]) <= log_ns:
                for _ in range(256):
                    if waiting[make] < 4000 and sent(waiting[make]) <= log_ns:
                        log_ns += 1000
                        rows.append(make(waiting[make], log_ns))
                        waiting[make] += 1
    return rows


@pytest.mark.parametrize("seed", range(3))
def test_messages_come_in_the_order_and_at_the_times_of_their_sending(
    record: Callable[[list[Row]], Recording], seed: int
) -> None:
    recording = record(late(seed))
    lags = [message.log_ns - message.publish_ns for message in recording.messages()]
    assert max(lags) > SECOND_NS
    found = in_order(recording)
    assert len(found) == 8000
    assert [each.time_ns for each in found] == [each.message.publish_ns for each in found]
    assert all(before.time_ns <= after.time_ns for before, after in pairwise(found))


def test_what_is_read_ahead_comes_in_the_same_order_and_is_bounded(record: Callable[[list[Row]], Recording]) -> None:
    recording = record(late(0))
    order, found = SenderOrder(recording, ALL, SenderClock(recording)), []
    while (message := order.peek()) is not None:
        found.append(message)
        order.pop()
        # in the gaps between messages, of which there is not always one
        while len(found) % 3 == 0 and order.read_ahead(least=40):
            pass
    assert found == in_order(recording)
    assert not order.read_ahead(least=40)


def test_from_a_time_on_nothing_is_missing_and_the_state_before_is_known(
    record: Callable[[list[Row]], Recording],
) -> None:
    recording = record(late(1))
    order = SenderOrder(recording, ALL, SenderClock(recording), sent(2000))
    first = order.peek()
    assert first is not None and first.time_ns == sent(2000)
    assert {each.message.seq for each in order.before.values()} == {1999}
    assert [each.message.seq for each in in_order(recording, sent(2000))] == [
        seq for seq in range(2000, 4000) for _ in range(2)
    ]


def test_a_playback_is_due_when_the_messages_were_sent(record: Callable[[list[Row]], Recording]) -> None:
    playback = Playback(record(late(2)), Selection.of(["haptic/state"]), Span(start_s=1.0, end_s=1.5))
    times = []
    while playback.peek() is not None:
        times.append(playback.next_ns)
        playback.pop()
    assert times == [sent(seq) for seq in range(1000, 1500)]
    (state,) = playback.seek(playback.at(2.0))
    assert state.seq == 1999


def fates(seq: int, rows: list[tuple[int, int]], log_ns: int, topic: str = "teleop/forward") -> Row:
    """Return a report of the link: number and delay [ns] of messages of a topic that reached it when they were sent."""
    base = {"topic": topic, "is_duplicate": False, "queue_ns": 0, "held_ns": 0, "dropped": "", "duplicated": False}
    told = tuple(
        {
            **base,
            "seq": number,
            "arrived_ns": sent(number),
            "delay_ns": delay_ns,
            "reordered": False,
            "corrupted": False,
        }
        for number, delay_ns in rows
    )
    report = sample("link/fates", seq, src="delay_node@master", direction="forward")
    return ("link/fates", "master", msgspec.convert({**fields_of(report), "fates": told}, type(report)), log_ns)


def test_what_left_the_link_is_sent_when_the_link_sent_it(record: Callable[[list[Row]], Recording]) -> None:
    dice = random.Random(4)
    delays = {seq: 20 * MILLISECOND_NS + dice.randrange(15 * MILLISECOND_NS) for seq in range(400)}
    rows: list[Row] = []
    for seq, delay_ns in delays.items():
        # the recorder is late by half a second, and takes the report of the link after some of the messages
        log_ns = sent(seq) + delay_ns + 500 * MILLISECOND_NS
        rows.append(("teleop/forward", "slave", teleop_forward(seq), log_ns))
        if seq % 50 == 49:
            batch = [(number, delays[number]) for number in range(seq - 49, seq + 1)]
            rows.append(fates(seq // 50, batch, sent(seq) + 540 * MILLISECOND_NS))
    found = [each for each in in_order(record(rows)) if each.message.topic == "teleop/forward"]
    assert [(each.message.seq, each.time_ns) for each in found] == sorted(
        ((seq, sent(seq) + delay_ns) for seq, delay_ns in delays.items()), key=lambda row: row[1]
    )


def test_without_its_report_the_least_delay_stands_for_that_of_the_link(
    record: Callable[[list[Row]], Recording],
) -> None:
    lags = (40, 20, 300, 25, 20)
    rows: list[Row] = [
        ("teleop/forward", "slave", teleop_forward(seq), sent(seq) + lag * MILLISECOND_NS)
        for seq, lag in enumerate(lags)
    ]
    found = in_order(record(rows))
    assert [(each.message.seq, each.time_ns - sent(each.message.seq)) for each in found] == [
        (seq, 20 * MILLISECOND_NS) for seq in range(5)
    ]


def test_the_clock_of_the_other_site_is_set_right_by_the_offset_that_the_link_measured(
    record: Callable[[list[Row]], Recording],
) -> None:
    ahead_ns = 80 * MILLISECOND_NS
    rows: list[Row] = [status(uncertainty_s=1e-3)]
    for seq in range(50):
        rows += [hand(seq, sent(seq) + 5000), tip(seq, sent(seq) + 6000, t_ns=sent(seq) + ahead_ns)]
    found = in_order(record(rows))
    assert {each.time_ns - sent(each.message.seq) for each in found if each.message.topic == "afm/state"} == {0}


def test_stamps_of_one_clock_are_left_as_they_are(record: Callable[[list[Row]], Recording]) -> None:
    rows = [status(uncertainty_s=0.1), tip(0, sent(0) + 6000)]
    assert [each.time_ns - sent(0) for each in in_order(record(rows)) if each.message.topic == "afm/state"] == [0]


def status(uncertainty_s: float) -> Row:
    """Return a report of the link: the slave's clock is 80 ms ahead."""
    clock = LinkClock(valid=True, offset_s=0.08, uncertainty_s=uncertainty_s, round_trip_s=2e-3, exchanges=9)
    return ("link/status", "master", sample("link/status", 0, src="delay_node@master", clock=clock), sent(0))


def test_a_source_that_was_itself_a_replay_is_aligned_by_its_reception(
    record: Callable[[list[Row]], Recording],
) -> None:
    old_ns = 3600 * SECOND_NS
    rows = [
        row for seq in range(20) for row in (hand(seq, sent(seq)), tip(seq, sent(seq) + 900, t_ns=sent(seq) - old_ns))
    ]
    times = [each.time_ns - sent(each.message.seq) for each in in_order(record(rows)) if each.message.src == TIP]
    assert times == [900] * 20


def test_the_last_message_of_a_publisher_is_not_played(record: Callable[[list[Row]], Recording]) -> None:
    last = sample("session/event", 1, src=HAND, kind="node", data=end_data({"haptic/state": 1}))
    other = sample("session/event", 0, src=HAND, kind="mode")
    rows: list[Row] = [hand(0, sent(0)), *(("session/event", "master", each, each.t_ns) for each in (other, last))]
    assert [each.message.topic for each in in_order(record(rows))] == ["haptic/state", "session/event"]
