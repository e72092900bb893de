"""Splitting, quota and filters of a recorder whose frames come from the test."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zmq
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, sample, session_control, teleop_forward

from services.recorder.intake import Intake, Listener, begin_recording
from services.recorder.node import RecorderNode
from telenano.recording.multi_file import open_recordings
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.verify import verify
from telenano.runtime.bus.bus import Subscriber, ZmqBus
from telenano.runtime.bus.publisher import NullPublisher
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import NodeContext
from telenano.settings.config import validate
from telenano.testing import VirtualClock
from telenano.wire import Message, encode
from telenano.wire.errors import ConfigError, RecordingError, RefusedError
from telenano.wire.messages import SessionEvent

SECOND_NS = 1_000_000_000


class RecorderRig:
    """A recorder without a bus: frames and time come from the test."""

    def __init__(self, folder: Path, context: "zmq.Context[Any]", **settings: Any) -> None:
        self.folder = folder
        self.clock = VirtualClock(0, EPOCH_NS)
        self.config = RecorderConfig(directory=folder, **settings)
        site_file = folder.parent / "site.yaml"
        site_file.write_text("nodes: {}\n")
        self.intake = begin_recording(NODE, self.clock, self.config, site_file, None)
        subscriber = Subscriber(context, self.clock, {"inproc://nowhere": ["haptic/state"]})
        self.listener = Listener("haptic_node@master", subscriber)
        self.publisher = NullPublisher(self.clock, NODE)
        self.events: list[SessionEvent] = []
        bus = ZmqBus(self.publisher, [], self.clock, -1)
        bus.publish = self._publish
        self.node = RecorderNode(NodeContext(NODE, self.clock, bus, StructuredLog(NODE)), self.config, self.intake)

    def _publish(self, topic: str, **fields: Any) -> Message:
        message = self.publisher.publish(topic, **fields)
        if isinstance(message, SessionEvent):
            self.events.append(message)
        return message

    def receive(self, topic: str, message: Message) -> None:
        self.intake.record(self.listener, [topic.encode(), encode(message)], self.clock.now_ns())

    def receive_states(self, first: int, count: int) -> None:
        for seq in range(first, first + count):
            self.clock.advance_ns(MILLISECOND_NS)
            self.receive("haptic/state", haptic_state(seq))

    def flush(self) -> None:
        self.node.on_deadline(self.clock.monotonic_ns())

    def command(self, **parameters: Any) -> str:
        return self.node.on_control(
            msgspec.structs.replace(session_control(0), command="set", parameters=parameters, target="recorder")
        )

    def files(self) -> list[Path]:
        return sorted(self.folder.glob("*.mcap"), key=lambda path: (len(path.name), path.name))


@pytest.fixture
def make_rig(tmp_path: Path) -> Iterator[Callable[..., RecorderRig]]:
    made: list[RecorderRig] = []
    with zmq.Context() as context:

        def make(**settings: Any) -> RecorderRig:
            made.append(RecorderRig(tmp_path / "out", context, **settings))
            return made[-1]

        yield make
        for each in made:
            each.intake.finish()
            each.listener.subscriber.close()


def seqs(path: Path, topic: str = "haptic/state") -> list[int]:
    return [message.seq for message in Recording(path).messages([topic])]


def test_only_the_chosen_channels_are_written(make_rig: Callable[..., RecorderRig]) -> None:
    rig = make_rig(topics=("haptic/*",), exclude=("/command/",))
    rig.receive_states(0, 3)
    rig.receive("teleop/forward", teleop_forward(0))
    rig.receive("haptic/command", sample("haptic/command", 0, src="controller@master"))
    rig.intake.finish()
    assert {channel.channel_topic for channel in Recording(rig.files()[0]).channels} == {"haptic/state"}
    assert rig.intake.received == 5
    assert rig.intake.written == 3


def test_a_new_file_begins_after_the_time_and_nothing_is_lost_between(make_rig: Callable[..., RecorderRig]) -> None:
    rig = make_rig(split_interval_s=1.0)
    for second in range(3):
        rig.receive_states(second * 1000, 1000)
        rig.flush()
    rig.intake.finish()
    assert len(rig.files()) == 4
    assert [seq for path in rig.files() for seq in seqs(path)] == list(range(3000))
    assert all(Recording(path).closed for path in rig.files())
    assert all("site.yaml" in Recording(path).attachments for path in rig.files())
    assert [message.seq for message in open_recordings(rig.files()).select()] == list(range(3000))
    assert [event.data["path"] for event in rig.events] == [str(path) for path in rig.files()]


def test_a_new_file_begins_at_the_size(make_rig: Callable[..., RecorderRig]) -> None:
    rig = make_rig(split_size_bytes=65_536, compression="none")
    for turn in range(6):
        rig.receive_states(turn * 100, 100)
        rig.flush()
    assert len(rig.files()) > 1
    # kept to within one flush
    assert all(path.stat().st_size < 65_536 + 80_000 for path in rig.files())


def test_at_the_quota_recording_stops_with_a_file_that_is_not_whole(
    make_rig: Callable[..., RecorderRig],
) -> None:
    rig = make_rig(quota_bytes=65_536, compression="none")
    for turn in range(6):
        rig.receive_states(turn * 100, 100)
        rig.flush()
    (path,) = rig.files()
    info = Recording(path).info()
    assert (info.closed, info.complete) == (True, False)
    assert info.missing == ("the recording was stopped before its end: the quota of 65536 bytes is used up",)
    assert any(finding.text == info.missing[0] for finding in verify([path]).findings)
    assert "quota of 65536 bytes" in rig.intake.fault
    (failed,) = [event for event in rig.events if event.data.get("state") == "failed"]
    assert failed.level == "error"
    assert rig.node.state == "safe"
    # the rig goes on and is received
    rig.receive_states(600, 1)
    assert rig.intake.received == 601


def test_at_the_quota_the_oldest_file_goes(make_rig: Callable[..., RecorderRig]) -> None:
    rig = make_rig(quota_bytes=300_000, quota_policy="drop_oldest", split_size_bytes=65_536, compression="none")
    for turn in range(20):
        rig.receive_states(turn * 100, 100)
        rig.flush()
    rig.intake.finish()
    assert rig.intake.fault == ""
    assert rig.intake.rotation is not None
    assert rig.intake.rotation.dropped > 0
    kept = [seq for path in rig.files() for seq in seqs(path)]
    assert kept == list(range(kept[0], 2000))
    assert kept[0] > 0
    assert sum(path.stat().st_size for path in rig.files()) < 300_000 + 90_000
    assert any("removed to keep the quota" in event.text for event in rig.events)


def test_a_new_file_begins_on_demand_and_every_file_ends_with_the_reason(make_rig: Callable[..., RecorderRig]) -> None:
    rig = make_rig()
    rig.receive_states(0, 5)
    assert "session_1.mcap" in rig.command(**{"record.split": True})
    rig.receive_states(5, 5)
    rig.intake.finish()
    assert [seqs(path) for path in rig.files()] == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9]]
    assert [Recording(path).ending for path in rig.files()] == ["split", "stopped"]
    info = open_recordings(rig.files()).info()
    assert (info.complete, info.missing, info.messages, len(info.parts)) == (True, (), 10, 2)


@pytest.mark.parametrize("what", ["file", "folder", "replaced"])
def test_a_recording_that_is_removed_goes_on_in_another_file_and_says_so(
    make_rig: Callable[..., RecorderRig], what: str
) -> None:
    rig = make_rig()
    rig.receive_states(0, 50)
    rig.flush()
    first = rig.files()[0]
    if what == "folder":
        shutil.rmtree(rig.folder)
    else:
        first.unlink()
    if what == "replaced":
        first.write_bytes(b"something else")
    rig.receive_states(50, 10)
    rig.flush()
    # it is noted in the file before that is finished
    assert "was removed while it was written" in Recording(rig.folder / "session_1.mcap").info().missing[-1]
    rig.receive_states(60, 10)
    rig.intake.finish()
    (removed,) = [event for event in rig.events if event.data.get("state") == "removed"]
    assert (removed.kind, removed.level) == ("recording", "error")
    assert removed.text == f"{first} was removed while it was written, and 60 messages with it"
    assert rig.events[-1].data["path"] == str(rig.folder / "session_1.mcap")
    assert seqs(rig.folder / "session_1.mcap") == list(range(60, 70))
    info = Recording(rig.folder / "session_1.mcap").info()
    assert (info.complete, info.missing) == (False, (removed.text,))
    assert rig.intake.fault == ""
    # what stands there now is somebody else's
    assert first.exists() is (what == "replaced")


def test_the_recorder_says_how_it_does(make_rig: Callable[..., RecorderRig]) -> None:
    rig = make_rig()
    rig.receive_states(0, 1000)
    rig.flush()
    status = rig.command(**{"record.status": True})
    assert "1000 messages/s" in status
    assert "1000 written" in status
    assert "0 lost" in status
    rig.receive_states(1005, 1)
    assert "5 lost" in rig.node.status()


def test_orders_that_make_no_sense_are_refused(make_rig: Callable[..., RecorderRig]) -> None:
    rig = make_rig()
    with pytest.raises(RefusedError, match=r"settable are record\.split"):
        rig.command(**{"record.splt": True})
    with pytest.raises(RefusedError, match=r"record\.split must be true"):
        rig.command(**{"record.split": 3})
    rig.intake.finish()
    rig.intake.fault, rig.intake.writer = "the disk is full", None
    with pytest.raises(RecordingError, match="the disk is full"):
        rig.command(**{"record.split": True})


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"quota_bytes": 100_000, "quota_policy": "drop_oldest"}, "needs split_size_bytes"),
        ({"quota_bytes": 100_000, "split_size_bytes": 200_000}, "must not be above quota_bytes"),
        ({"topics": ["/[/"]}, "is not a regular expression"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        validate(RecorderConfig, settings, "test")


def test_an_intake_without_rotation_cannot_split(config: RecorderConfig) -> None:
    with pytest.raises(RecordingError, match="no folder"):
        Intake(None, "no folder").split(0)
