"""The recorder's bus takes each message once, in the order of its publisher, however many wait."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, sample

from services.recorder.intake import Intake
from services.recorder.node import RecorderBus
from telenano.console.listener import Listener
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.verify import verify
from telenano.recording.writer import RecordingWriter
from telenano.runtime.bus.bus import Subscriber
from telenano.runtime.bus.publisher import NullPublisher, ZmqPublisher
from telenano.testing import VirtualClock
from telenano.wire import Message, encode

HAND, AFM = "haptic_node@master", "afm_node@slave"
TOPICS_OF = {HAND: ["haptic/state", "session/control"], AFM: ["afm/state"]}
PATIENCE_MS = 20_000


class Rig:
    """A recorder and two publishers in virtual time."""

    def __init__(self, folder: Path) -> None:
        self.context = zmq.Context[zmq.Socket[bytes]]()
        self.clock = VirtualClock(start_ns=10**13, epoch_offset_ns=EPOCH_NS - 10**13)
        self.publishers = {
            key: ZmqPublisher(self.context, self.clock, key, f"inproc://{key}", kind=zmq.XPUB) for key in TOPICS_OF
        }
        listeners = [
            Listener(key, Subscriber(self.context, self.clock, {f"inproc://{key}": topics}))
            for key, topics in TOPICS_OF.items()
        ]
        for key, topics in TOPICS_OF.items():
            for _ in topics:
                assert self.publishers[key].socket.poll(PATIENCE_MS)
                self.publishers[key].socket.recv()
        self.waker = self.context.socket(zmq.PAIR)
        self.waker.bind("inproc://wake")
        self.path = folder / "session.mcap"
        self.intake = Intake(RecordingWriter.create(NODE, RecorderConfig(directory=folder)))
        publisher = NullPublisher(self.clock, NODE)
        self.bus = RecorderBus(publisher, listeners, self.intake, self.clock, self.waker.fileno())

    def send(self, key: str, topic: str, message: Message) -> None:
        self.publishers[key].send(topic, encode(message))

    def take(self) -> list[str]:
        """Record what has come until there is no more; return the commands."""
        found, before = [], -1
        while self.intake.received > before:
            before = self.intake.received
            found += [received.topic for received in self.bus.receive()]
        return found

    def close(self) -> None:
        self.intake.finish()
        for publisher in self.publishers.values():
            publisher.close()
        self.context.destroy(linger=0)


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path)
    yield rig
    rig.close()


@pytest.mark.check("takes 0.9 s")
def test_all_that_waits_for_a_recorder_that_stood_still_is_recorded_in_order(rig: Rig) -> None:
    # more than one call takes, and eight seconds of a publisher of one message a millisecond
    count = 8000
    for seq in range(count):
        rig.send(HAND, "haptic/state", haptic_state(seq))
        rig.send(AFM, "afm/state", sample("afm/state", seq, src=AFM))
        rig.clock.advance_ns(MILLISECOND_NS)
    assert rig.take() == []
    rig.intake.finish()
    assert (rig.intake.gaps, rig.intake.lost, rig.intake.missing) == (0, 0, 0)
    for topic in ("haptic/state", "afm/state"):
        found = [message.seq for message in Recording(rig.path).raw() if message.channel.topic == topic]
        assert found == list(range(count))
    assert verify([rig.path]).sound


def test_a_command_is_recorded_and_given_to_the_node(rig: Rig) -> None:
    rig.send(HAND, "haptic/state", haptic_state(0))
    rig.send(HAND, "session/control", sample("session/control", 0, src=HAND))
    assert rig.take() == ["session/control"]
    rig.intake.finish()
    assert [message.topic for message in Recording(rig.path).messages()] == ["haptic/state", "session/control"]


def test_what_comes_within_a_millisecond_is_received_together(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.recorder.node.time.sleep", lambda pause_s: rig.clock.advance_ns(round(pause_s * 1e9)))
    begin_ns = rig.clock.monotonic_ns()
    for seq in range(3):
        rig.send(HAND, "haptic/state", haptic_state(seq))
        rig.bus.wait(begin_ns + 10**9)
        # the first is taken at once, each later one a millisecond after the one before
        assert rig.clock.monotonic_ns() == begin_ns + seq * MILLISECOND_NS
        rig.take()
