"""A recorder's listener while a publisher goes from single messages to batches and back: each message once."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from recorder_samples import MILLISECOND_NS, haptic_state
from test_recorder_batches import HAND, Rig

from proto import accept, encode
from proto.batch import BATCH_FRAME, SentCopy, pack_batch
from recording.reader import Recording
from recording.records import REJECTED_TOPIC
from services.recorder.listener import HOLD_NS, Listener


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path)
    yield rig
    rig.close()


def arrives_as_well(rig: Rig, *frames: list[bytes]) -> None:
    """Let frames arrive behind whatever the hand's publisher sends next, as on a network that had them under way."""
    subscriber: Any = rig.listeners[HAND].subscriber
    receive_raw = subscriber.receive_raw

    def both() -> Iterator[Any]:
        yield from receive_raw()
        for late in frames:
            yield late, rig.clock.now_ns()
        subscriber.receive_raw = receive_raw

    subscriber.receive_raw = both


def test_a_single_message_that_arrives_after_the_change_to_batches_is_not_recorded_again(rig: Rig) -> None:
    master = rig.node(HAND)
    rig.begin(master)
    assert rig.listeners[HAND].batched
    for seq in range(3):
        rig.advance(1.0)
        master.send("haptic/state", haptic_state(seq))
    master.flush()
    arrives_as_well(rig, [b"haptic/state", encode(haptic_state(1))], [b"haptic/state", encode(haptic_state(2))])
    recorded = rig.recorded()
    assert [(topic, seq) for topic, seq, _ in recorded] == [("haptic/state", seq) for seq in range(3)]


def test_a_publisher_is_left_at_its_batches_for_as_long_as_one_may_take_and_no_longer(rig: Rig) -> None:
    master = rig.node(HAND)
    rig.begin(master)
    listener = rig.listeners[HAND]
    last_ns = listener._last_batch_ns
    listener.check(last_ns + 1_200 * MILLISECOND_NS)
    assert listener.batched
    listener.check(last_ns + 1_200 * MILLISECOND_NS + 1)
    assert not listener.batched
    # two health reports come in that time
    assert 2 * 500 < 1_200


def test_frames_that_are_no_batch_are_kept_as_what_is_no_message_and_change_nothing(rig: Rig) -> None:
    master = rig.node(HAND)
    rig.begin(master)
    arrives_as_well(rig, [BATCH_FRAME], [BATCH_FRAME, b"\xc1"])
    rig.advance(1.0)
    master.send("haptic/state", haptic_state(0))
    master.flush()
    rig.take()
    assert rig.listeners[HAND].batched
    rig.advance(100.0)
    rig.take()
    rig.intake.finish()
    found = [message.topic for message in Recording(rig.path).select()]
    assert found.count(REJECTED_TOPIC) == 2
    assert found.count("haptic/state") == 1


@pytest.mark.parametrize(("longer_ms", "is_believed"), [(0.0, True), (1.0, False)])
def test_a_stamp_that_is_an_hour_old_is_the_time_of_a_process_that_stood_still(
    rig: Rig, longer_ms: float, is_believed: bool
) -> None:
    master = rig.node(HAND)
    rig.begin(master)
    rig.advance(1.0)
    master.send("haptic/state", haptic_state(0))
    sent_ms = (rig.clock.now_ns() - rig.begin_ns) / MILLISECOND_NS
    master.flush()
    # the recorder takes what has come 21 ms after this
    rig.advance(3_600_000.0 + longer_ms - 21.0)
    rig.take()
    # what is older was stamped by another clock, and has the time at which it was received
    received_ms = sent_ms + 3_600_000.0 + longer_ms
    assert [time_ms for _, _, time_ms in rig.recorded()] == [sent_ms if is_believed else received_ms]


class Arrivals:
    """What a subscriber has received, each with its time [ms]; it notes to which topics it is subscribed."""

    topics = ("haptic/state",)

    def __init__(self) -> None:
        self.socket = self
        self.arrived: list[tuple[list[bytes], int]] = []
        self.subscribed = {"haptic/state"}
        self.listener = Listener(HAND, cast(Any, self))
        self.listener.accept_batches()

    def subscribe(self, topic: bytes) -> None:
        self.subscribed.add(topic.decode())

    def unsubscribe(self, topic: bytes) -> None:
        self.subscribed.discard(topic.decode())

    def receive_raw(self) -> list[tuple[list[bytes], int]]:
        arrived, self.arrived = self.arrived, []
        return arrived

    def single(self, seq: int, time_ms: int) -> None:
        self.arrived.append(([b"haptic/state", encode(haptic_state(seq))], time_ms * MILLISECOND_NS))

    def batch(self, time_ms: int, *copies: tuple[int, int], last: bool = False) -> None:
        """Let a batch arrive: number and time of sending [ms] of each message in it."""
        sent = [SentCopy(at_ms * MILLISECOND_NS, b"haptic/state", encode(haptic_state(seq))) for seq, at_ms in copies]
        self.arrived.append(([BATCH_FRAME, pack_batch(sent, last=last)], time_ms * MILLISECOND_NS))

    def take(self, now_ms: int) -> list[tuple[int, float]]:
        """Return number and time [ms] of each message that the listener yields."""
        found = self.listener.receive(0, now_ms * MILLISECOND_NS)
        return [(accept("haptic/state", frames[1]).seq, time_ns / MILLISECOND_NS) for time_ns, frames in found]


HOLD_MS = HOLD_NS // MILLISECOND_NS


def test_what_is_not_in_the_first_batch_was_sent_before_it() -> None:
    arrivals = Arrivals()
    # the second of them is late, and the batch begins before it
    arrivals.single(0, 10)
    arrivals.single(1, 13)
    assert arrivals.take(13) == []
    arrivals.batch(15, (2, 12), (3, 14))
    assert arrivals.take(15) == [(0, 10.0), (1, 12.0), (2, 12.0), (3, 14.0)]
    assert arrivals.subscribed == {"node/batch"}


def test_a_first_batch_with_nothing_in_it_leaves_the_messages_before_it_their_times() -> None:
    arrivals = Arrivals()
    arrivals.single(0, 10)
    arrivals.batch(15)
    assert arrivals.take(15) == [(0, 10.0)]


def test_the_first_batch_is_compared_with_as_much_as_comes_while_a_node_may_be_silent() -> None:
    arrivals = Arrivals()
    for seq, time_ms in ((0, 0), (1, 1200)):
        arrivals.single(seq, time_ms)
    assert arrivals.take(1200 + HOLD_MS) == [(0, 0.0), (1, 1200.0)]
    arrivals.batch(1300, (0, 0), (1, 1200), (2, 1299))
    assert arrivals.take(1300) == [(2, 1299.0)]


def test_what_was_compared_with_a_first_batch_is_not_compared_with_the_next_one() -> None:
    arrivals = Arrivals()
    arrivals.single(0, 10)
    assert arrivals.take(10 + HOLD_MS) == [(0, 10.0)]
    arrivals.batch(100, (0, 10), (1, 99), last=True)
    assert arrivals.take(100) == [(1, 99.0)]
    assert arrivals.subscribed == {"haptic/state", "node/batch"}
    # the same message from whoever comes after the publisher has been sent again, and is recorded again
    arrivals.batch(200, (0, 199))
    assert arrivals.take(200) == [(0, 199.0)]
