"""A recorder takes batches where it gets them: each message once, in order, with its time, and none is lost."""

from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import pytest
import zmq
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, sample

from proto import Message, encode
from proto.batch import BATCH_FRAME, SentCopy
from recording.reader import Recording
from recording.verify import verify
from recording.writer import RecordingWriter
from services.recorder.config import RecorderConfig
from services.recorder.intake import Intake
from services.recorder.listener import Listener
from services.recorder.live import accept_batches
from services.recorder.node import HELD_S, RecorderBus
from services.runtime.bus.bus import Subscriber, ZmqBus
from services.runtime.bus.outgoing_batch import DUE_NS, LATEST_NS, OutgoingBatch
from services.runtime.bus.publisher import NullPublisher, ZmqPublisher
from services.runtime.loop.main import load_site
from services.runtime.loop.participant import OBSERVER, open_participant
from telenano.extend.testing import VirtualClock

HAND, AFM = "haptic_node@master", "afm_node@slave"
TOPICS_OF = {HAND: ["haptic/state", "node/health", "session/control"], AFM: ["afm/state", "node/health"]}
PATIENCE_MS = 20_000


class Node:
    """A node with copies of what it sends, or a foreign one without."""

    def __init__(self, rig: "Rig", key: str, *, batches: bool = True) -> None:
        self.rig, self.seq = rig, 0
        self.publisher = ZmqPublisher(rig.context, rig.clock, key, f"inproc://{key}", kind=zmq.XPUB)
        self.batch: OutgoingBatch | None = self.publisher.keep_batch() if batches else None

    def send(self, topic: str, message: Message) -> None:
        self.publisher.send(topic, encode(message))

    def flush(self) -> None:
        assert self.batch is not None
        self.batch.flush()

    def subscriptions(self, count: int) -> list[bytes]:
        """Return the next subscriptions and their ends."""
        found = []
        for _ in range(count):
            assert self.publisher.socket.poll(PATIENCE_MS)
            found.append(self.publisher.socket.recv())
        return found


class Rig:
    """A recorder and its publishers in virtual time."""

    def __init__(self, folder: Path) -> None:
        self.context = zmq.Context[zmq.Socket[bytes]]()
        self.clock = VirtualClock(start_ns=10**13, epoch_offset_ns=EPOCH_NS - 10**13)
        self.path = folder / "session.mcap"
        self.intake = Intake(RecordingWriter.create(NODE, RecorderConfig(directory=folder)))
        self.listeners = {
            key: Listener(key, Subscriber(self.context, self.clock, {f"inproc://{key}": topics}))
            for key, topics in TOPICS_OF.items()
        }
        for listener in self.listeners.values():
            listener.accept_batches()
        publisher = NullPublisher(self.clock, NODE)
        self.bus = RecorderBus(publisher, list(self.listeners.values()), self.intake, self.clock, self.wake())
        self.nodes: list[Node] = []
        self.begin_ns = EPOCH_NS

    def wake(self) -> int:
        self.waker = self.context.socket(zmq.PAIR)
        self.waker.bind("inproc://wake")
        return self.waker.fileno()

    def node(self, key: str, *, batches: bool = True) -> Node:
        node = Node(self, key, batches=batches)
        self.nodes.append(node)
        node.subscriptions(len(TOPICS_OF[key]) + 1)
        return node

    def advance(self, ms: float) -> None:
        self.clock.advance_ns(round(ms * MILLISECOND_NS))

    def begin(self, *nodes: Node) -> None:
        """Have the recorder take batches of these nodes; from then on the time of a recording begins."""
        for node in nodes:
            node.send("node/health", sample("node/health", 0, **{"src": node.publisher.node}))
            node.flush()
        self.take()
        self.begin_ns = self.clock.now_ns()

    def take(self) -> list[str]:
        """Let the recorder take what has come; return the commands that it is given."""
        self.advance(21.0)
        return [received.topic for received in self.bus.receive()]

    def drop_commands(self) -> None:
        """Let the recorder receive now."""
        for _ in self.bus.receive():
            pass

    def recorded(self) -> list[tuple[str, int, float]]:
        """End the recording; return topic, number and time of reception since the start [ms] of each message."""
        self.take()
        self.advance(100.0)
        self.take()
        self.intake.finish()
        assert verify([self.path]).sound
        messages = [message for message in Recording(self.path).select() if message.topic != "node/health"]
        return [(m.topic, m.seq, round((m.log_ns - self.begin_ns) / MILLISECOND_NS, 6)) for m in messages]

    def close(self) -> None:
        self.intake.finish()
        for node in self.nodes:
            node.publisher.close()
        self.context.destroy(linger=0)


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path)
    yield rig
    rig.close()


def hand(seq: int) -> Message:
    return haptic_state(seq)


def afm(seq: int) -> Message:
    return sample("afm/state", seq, src=AFM)


def test_two_publishers_are_recorded_in_the_order_of_sending(rig: Rig) -> None:
    master, slave = rig.node(HAND), rig.node(AFM)
    rig.begin(master, slave)
    rig.advance(17.0)
    for seq in range(4):
        master.send("haptic/state", hand(seq))
        rig.advance(0.5)
        slave.send("afm/state", afm(seq))
        rig.advance(0.5)
    # what was sent later comes first, and is taken alone
    slave.flush()
    assert list(rig.bus.receive()) == []
    assert rig.intake.received == 2
    master.flush()
    found = rig.recorded()
    assert [(topic, seq) for topic, seq, _ in found] == [
        ("haptic/state", 0), ("afm/state", 0), ("haptic/state", 1), ("afm/state", 1),
        ("haptic/state", 2), ("afm/state", 2), ("haptic/state", 3), ("afm/state", 3),
    ]  # fmt: skip
    assert [time_ms for _, _, time_ms in found] == [17.0, 17.5, 18.0, 18.5, 19.0, 19.5, 20.0, 20.5]


def test_what_came_before_the_first_batch_is_recorded_once(rig: Rig) -> None:
    node = rig.node(HAND)
    for seq in range(3):
        node.send("haptic/state", hand(seq))
    rig.take()
    rig.take()
    assert rig.intake.received == 3
    node.send("haptic/state", hand(3))
    node.flush()
    rig.take()
    # nothing else is subscribed to any more, and what was on its way is in the next batch
    assert node.subscriptions(3) == [b"\x00" + topic.encode() for topic in sorted(TOPICS_OF[HAND])]
    node.send("haptic/state", hand(4))
    node.flush()
    assert [seq for _, seq, _ in rig.recorded()] == [0, 1, 2, 3, 4]
    assert rig.intake.received == 5


def test_a_foreign_publisher_is_recorded_message_by_message(rig: Rig) -> None:
    foreign, ours = rig.node(HAND, batches=False), rig.node(AFM)
    ours.send("afm/state", afm(0))
    ours.flush()
    rig.take()
    for seq in range(5):
        foreign.send("haptic/state", hand(seq))
        ours.send("afm/state", afm(seq + 1))
        rig.advance(1.0)
    ours.flush()
    found = rig.recorded()
    assert [seq for topic, seq, _ in found if topic == "haptic/state"] == [0, 1, 2, 3, 4]
    assert [seq for topic, seq, _ in found if topic == "afm/state"] == [0, 1, 2, 3, 4, 5]
    assert not rig.listeners[HAND].batched
    assert rig.listeners[AFM].batched


@pytest.mark.parametrize("late_ms", [0.0, 90.0])
def test_a_first_batch_that_begins_before_the_single_messages_is_recorded_in_order(rig: Rig, late_ms: float) -> None:
    node = rig.node(HAND)
    assert node.batch is not None
    # sent before anybody had subscribed, so that only the batch has it
    with mock.patch.object(node.publisher, "send_frame"):
        node.send("haptic/state", hand(4453))
    for seq in range(4454, 4460):
        rig.advance(1.0)
        node.send("haptic/state", hand(seq))
    for _ in range(2):
        # of a publisher that stands still meanwhile the single messages are written first
        rig.advance(late_ms / 2.0)
        rig.drop_commands()
    for seq in (4460, 4461):
        node.batch._copies.append(SentCopy(rig.clock.monotonic_ns(), b"haptic/state", encode(hand(seq))))
    node.flush()
    found = [seq for _, seq, _ in rig.recorded()]
    assert found == list(range(4453, 4462))
    if not late_ms:
        assert [message.seq for message in Recording(rig.path).raw()] == found
    assert (rig.intake.gaps, rig.intake.lost, rig.intake.missing) == (0, 0, 0)
    channel = next(channel for channel in Recording(rig.path).info().channels if channel.topic == "haptic/state")
    assert (channel.gaps, channel.lost, channel.repeated, channel.restarts) == (0, 0, 0, 0)


def test_a_publisher_that_stood_still_is_recorded_in_order_and_without_a_gap(rig: Rig) -> None:
    node = rig.node(HAND)
    rig.begin(node)
    node.subscriptions(3)
    for seq in range(10):
        node.send("haptic/state", hand(seq))
        rig.advance(0.5)
    # two seconds: the recorder goes back to single messages
    for _ in range(100):
        rig.take()
    assert not rig.listeners[HAND].batched
    node.subscriptions(3)
    for seq in range(10, 30):
        node.send("haptic/state", hand(seq))
        rig.drop_commands()
        rig.advance(0.5)
    node.flush()
    assert [seq for _, seq, _ in rig.recorded()] == list(range(30))
    assert [message.seq for message in Recording(rig.path).raw() if message.channel.topic == "haptic/state"] == list(
        range(30)
    )
    assert (rig.intake.gaps, rig.intake.lost) == (0, 0)


@pytest.mark.parametrize("killed", [False, True])
def test_whoever_comes_after_a_node_is_recorded_as_well(rig: Rig, killed: bool) -> None:
    node = rig.node(HAND)
    node.send("haptic/state", hand(0))
    node.flush()
    rig.take()
    node.subscriptions(3)
    if killed:
        rig.advance(1200.0)
    else:
        assert node.batch is not None
        node.batch.flush(last=True)
    rig.take()
    assert node.subscriptions(3) == [b"\x01" + topic.encode() for topic in sorted(TOPICS_OF[HAND])]
    # the same socket stands for a player or a program in another language
    node.publisher._batch = None
    node.send("haptic/state", hand(1))
    assert [seq for _, seq, _ in rig.recorded()] == [0, 1]


def test_a_broken_batch_is_kept_as_what_is_no_message(rig: Rig) -> None:
    node = rig.node(HAND)
    node.send("haptic/state", hand(0))
    node.flush()
    rig.take()
    for frames in ((BATCH_FRAME, b"\xc1"), (BATCH_FRAME,), (BATCH_FRAME, b"", b"")):
        node.publisher.socket.send_multipart(frames)
    node.send("haptic/state", hand(1))
    node.flush()
    rig.take()
    rig.advance(100.0)
    rig.take()
    assert rig.listeners[HAND].subscriber.rejected == {"malformed": 1, "frames": 2}
    assert rig.intake.written == 5


def test_a_command_is_answered_in_its_place_among_the_messages(rig: Rig) -> None:
    node = rig.node(HAND)
    node.send("session/control", sample("session/control", 0, src=HAND))
    node.flush()
    assert [*rig.take(), *rig.take()] == ["session/control"]


def test_a_stamp_of_another_clock_is_no_time_of_reception(rig: Rig) -> None:
    node = rig.node(HAND)
    assert node.batch is not None
    rig.begin(node)
    now_ns = rig.clock.monotonic_ns()
    for seq, sent_ns in enumerate((now_ns, 5, now_ns + 10**12)):
        node.batch._monotonic_ns = lambda sent_ns=sent_ns: sent_ns
        node.send("haptic/state", hand(seq))
        node.flush()
    assert [time_ms for _, _, time_ms in rig.recorded()] == [0.0, 21.0, 21.0]


def test_of_a_publisher_without_batches_no_more_is_kept_than_a_first_batch_may_have(rig: Rig) -> None:
    node = rig.node(HAND, batches=False)
    listener = rig.listeners[HAND]
    for number in range(10):
        node.send("haptic/state", hand(number))
        rig.advance(500.0)
        rig.take()
    # of the last 1.2 s
    assert len(listener._recent) == 3


def test_a_batch_is_due_in_a_pause_and_goes_without_one_when_the_bus_waits(rig: Rig) -> None:
    node = rig.node(HAND)
    assert node.batch is not None
    listener = rig.listeners[HAND]
    bus = ZmqBus(node.publisher, [listener.subscriber], rig.clock, rig.waker.fileno(), None, [node.batch])
    node.send("haptic/state", hand(0))
    rig.advance(DUE_NS / MILLISECOND_NS - 0.1)
    assert not bus.is_batch_due(rig.clock.monotonic_ns())
    rig.advance(0.2)
    assert bus.is_batch_due(rig.clock.monotonic_ns())
    bus.send_batches()
    assert node.batch.due_ns == 2**62
    node.send("haptic/state", hand(1))
    rig.advance(LATEST_NS / MILLISECOND_NS - 0.1)
    # virtual time: the wait is over at once
    bus.wait(rig.clock.monotonic_ns())
    assert node.batch.due_ns < 2**62
    rig.advance(0.2)
    bus.wait(rig.clock.monotonic_ns())
    assert node.batch.due_ns == 2**62


@pytest.mark.parametrize(
    ("changes", "held_s", "batched"),
    [
        ({}, HELD_S, True),
        ({"exclude": ("law/status", "law/status@*")}, HELD_S, False),
        ({"flush_interval_s": 0.05}, 0.0, False),
    ],
)
def test_batches_are_for_who_records_everything(
    tmp_path: Path, changes: dict[str, object], held_s: float, batched: bool
) -> None:
    config = RecorderConfig(directory=tmp_path, **changes)
    with open_participant(OBSERVER, load_site(Path("presets/sites/local.yaml")), publisher=False) as participant:
        subscribed: list[str] = []

        def listener(key: str) -> Listener:
            found = Listener(key, participant.subscribers({key: ["law/status"]}, apart=True)[0])
            found.accept_batches = lambda: subscribed.append(key)  # type: ignore[method-assign]
            return found

        keys = ("controller@master", "haptic_node@master", "estop")
        listeners = [listener(key) if key != "estop" else Listener(key, None) for key in keys]  # type: ignore[arg-type]
        assert accept_batches(listeners, participant, config) == held_s
    assert ("controller@master" in subscribed) == batched
    assert "haptic_node@master" in subscribed or not held_s


def test_a_message_of_a_kill_is_not_held_for_longer_than_is_promised(rig: Rig) -> None:
    node = rig.node(HAND)
    node.flush()
    node.send("haptic/state", hand(0))
    rig.advance(DUE_NS / MILLISECOND_NS)
    node.flush()
    waited_ms = DUE_NS / MILLISECOND_NS
    while not rig.intake.written:
        rig.advance(1.0)
        waited_ms += 1.0
        for _ in rig.bus.receive():
            pass
    assert waited_ms <= HELD_S * 1e3
