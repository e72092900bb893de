"""A recorder's listener while a publisher goes from single messages to batches and back: each message once."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from recorder_samples import MILLISECOND_NS, haptic_state
from test_recorder_batches import HAND, Rig

from proto import encode
from proto.batch import BATCH_FRAME
from recording.reader import Recording
from recording.records import REJECTED_TOPIC


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


def test_a_stamp_that_is_an_hour_old_is_the_time_of_a_process_that_stood_still(rig: Rig) -> None:
    master = rig.node(HAND)
    rig.begin(master)
    rig.advance(1.0)
    master.send("haptic/state", haptic_state(0))
    sent_ms = (rig.clock.now_ns() - rig.begin_ns) / MILLISECOND_NS
    master.flush()
    # the recorder takes what has come 21 ms after this
    rig.advance(3_600_000.0 - 21.0)
    rig.take()
    assert [time_ms for _, _, time_ms in rig.recorded()] == [sent_ms]
