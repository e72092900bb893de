import errno
import io
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import pytest
import zmq
from recorder_samples import EPOCH_NS, NODE, haptic_state, sample, session_control, teleop_forward

from services.recorder.intake import Intake, Listener
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import GAP_TOPIC, REJECTED_TOPIC, GapRecord, RejectedRecord
from telenano.recording.verify import verify
from telenano.recording.writer import RecordingWriter
from telenano.runtime.bus.bus import Subscriber
from telenano.runtime.security.peer_connections import MessagePermissions
from telenano.testing import VirtualClock
from telenano.wire import Message, encode
from telenano.wire.codec import MAX_MESSAGE_BYTES, fields_of
from telenano.wire.ends import end_data
from telenano.wire.messages import SessionControl

MakeListener = Callable[[str], Listener]
ANSWERS = pytest.mark.unchecked("its events answer a command that nobody gave")


def frames(topic: str, message: Message) -> list[bytes]:
    return [topic.encode(), encode(message)]


@pytest.fixture
def listen() -> Iterator[MakeListener]:
    """Yield a factory of listeners whose connection is never used: the frames come from the test."""
    made: list[Listener] = []
    with zmq.Context() as context:

        def make(publisher: str) -> Listener:
            made.append(
                Listener(publisher, Subscriber(context, VirtualClock(), {"inproc://nowhere": ["haptic/state"]}))
            )
            return made[-1]

        yield make
        for listener in made:
            listener.subscriber.close()


@pytest.fixture
def intake(config: RecorderConfig) -> Iterator[Intake]:
    intake = Intake(RecordingWriter.create(NODE, config))
    yield intake
    intake.finish()


def recorded(intake: Intake) -> Recording:
    assert intake.writer is not None
    intake.flush()
    return Recording(intake.writer.path)


def test_the_place_where_a_message_was_received_names_the_channel(intake: Intake, listen: MakeListener) -> None:
    near, far = listen("controller@master"), listen("delay_node@slave")
    for listener in (near, far):
        intake.record(listener, frames("teleop/forward", teleop_forward(0)), EPOCH_NS)
    link = sample("link/status", 0, src="delay_node@slave")
    intake.record(far, frames("link/status", link), EPOCH_NS)
    found = [(m.channel_topic, m.site, m.via, m.src) for m in recorded(intake).messages()]
    assert found == [
        ("teleop/forward", "master", "direct", "controller@master"),
        ("teleop/forward@slave", "slave", "link", "controller@master"),
        ("link/status", "slave", "direct", "delay_node@slave"),
    ]


@ANSWERS
def test_what_comes_back_to_the_master_is_marked_so(intake: Intake, listen: MakeListener) -> None:
    event = sample("session/event", 0, src="afm_node@slave")
    intake.record(listen("delay_node@master"), frames("session/event", event), EPOCH_NS)
    assert [m.channel_topic for m in recorded(intake).messages()] == ["session/event@master"]


@ANSWERS
def test_sources_on_one_topic_are_counted_apart(intake: Intake, listen: MakeListener) -> None:
    for source in ("haptic_node@master", "controller@master"):
        listener = listen(source)
        for seq in range(3):
            intake.record(listener, frames("session/event", sample("session/event", seq, src=source)), EPOCH_NS)
    info = recorded(intake).info()
    assert [(c.channel_topic, c.src, c.messages, c.gaps) for c in info.channels] == [
        ("session/event", "haptic_node@master", 3, 0),
        ("session/event", "controller@master", 3, 0),
    ]
    assert intake.gaps == 0


def test_a_gap_is_recorded_a_moment_after_it_was_noticed(intake: Intake, listen: MakeListener) -> None:
    listener = listen("haptic_node@master")
    for seq in (0, 1, 5, 6):
        intake.record(listener, frames("haptic/state", haptic_state(seq)), EPOCH_NS + seq)
    assert GAP_TOPIC not in {message.topic for message in recorded(intake).messages()}
    path = recorded(intake).path
    intake.finish()
    found = list(Recording(path).messages())
    assert [(m.topic, m.log_ns - EPOCH_NS) for m in found] == [
        ("haptic/state", 0),
        ("haptic/state", 1),
        ("haptic/state", 5),
        ("haptic/state", 6),
        (GAP_TOPIC, 6),
    ]
    assert found[4].decode() == GapRecord(
        channel_topic="haptic/state", src="haptic_node@master", first_missing=2, last_missing=4, count=3
    )
    assert (intake.gaps, intake.lost, intake.lossless_lost) == (1, 3, 0)


@pytest.mark.parametrize("stamp_ms", [1, 3000])
def test_what_comes_late_is_not_recorded_as_missing(intake: Intake, listen: MakeListener, stamp_ms: int) -> None:
    """As from a link that lets messages overtake one another and repeats one; they are read as they were received."""
    listener = listen("haptic_node@master")
    for place, seq in enumerate((0, 1, 8, 9, 2, 3, 3, 5, 4, 10, 11)):
        t_ns = EPOCH_NS + (seq + stamp_ms * (seq > 7)) * 1_000_000
        intake.record(listener, frames("haptic/state", haptic_state(seq, t_ns=t_ns)), EPOCH_NS + place * 1_000_000)
    path = recorded(intake).path
    intake.finish()
    found = Recording(path)
    gaps = [message.decode() for message in found.messages([GAP_TOPIC])]
    assert gaps == [
        GapRecord(channel_topic="haptic/state", src="haptic_node@master", first_missing=6, last_missing=7, count=2)
    ]
    assert (intake.gaps, intake.lost, intake.missing) == (1, 2, 2)
    assert [message.seq for message in found.messages(["haptic/state"])] == [0, 1, 8, 9, 2, 3, 3, 5, 4, 10, 11]
    assert found.info().missing == ("2 messages of haptic_node@master on haptic/state are missing",)


def test_a_gap_of_a_console_that_has_ended_is_recorded_before_what_the_next_console_sends(
    intake: Intake, listen: MakeListener
) -> None:
    """Of three consoles the second loses a number on the link, and the third ends with the number before it."""
    listener = listen("delay_node@slave")
    for place, seq in enumerate((0, 2, 0)):
        control = sample("session/control", seq, src="console@master", t_ns=EPOCH_NS + place)
        intake.record(listener, frames("session/control", control), EPOCH_NS + place)
    path = recorded(intake).path
    intake.finish()
    assert Recording(path).info().missing == ()
    topics = [message.topic for message in Recording(path).messages()]
    assert topics == ["session/control", "session/control", GAP_TOPIC, "session/control"]
    assert intake.missing == 0
    assert verify([path]).sound


def ended(src: str, seq: int, sent: dict[str, int], **forwarded: int) -> list[bytes]:
    """Return the last message of a publisher; `forwarded` of the link, by topic with _ in place of /."""
    others = {(topic.replace("_", "/"), "controller@master"): count for topic, count in forwarded.items()}
    event = sample("session/event", seq, src=src, kind="node", data=end_data(sent, others))
    return frames("session/event", event)


def test_what_is_missing_at_the_end_of_a_topic_is_lost(intake: Intake, listen: MakeListener) -> None:
    listener = listen("haptic_node@master")
    for seq in range(3):
        intake.record(listener, frames("haptic/state", haptic_state(seq)), EPOCH_NS)
    intake.record(listener, ended("haptic_node@master", 0, {"haptic/state": 7, "session/event": 1}), EPOCH_NS + 9)
    assert (intake.gaps, intake.lost, intake.missing) == (1, 4, 4)
    assert next(iter(listener.subscriber.trackers.values())).lost == 4
    (gap,) = recorded(intake).messages([GAP_TOPIC])
    assert gap.decode() == GapRecord(
        channel_topic="haptic/state", src="haptic_node@master", first_missing=3, last_missing=6, count=4
    )


def test_what_the_link_sent_on_at_last_is_missing_and_what_it_dropped_is_not(
    intake: Intake, listen: MakeListener
) -> None:
    far = listen("delay_node@slave")
    for seq in (0, 1, 4):
        intake.record(far, frames("teleop/forward", teleop_forward(seq)), EPOCH_NS)
    assert (intake.lost, intake.missing) == (2, 0)
    intake.record(far, ended("delay_node@slave", 0, {"session/event": 1}, teleop_forward=8), EPOCH_NS)
    assert (intake.lost, intake.missing) == (5, 3)
    # the same event as it came through the link from elsewhere counts nothing
    intake.record(far, ended("controller@master", 0, {"teleop/forward": 99}), EPOCH_NS)
    assert intake.missing == 3


def test_a_second_console_has_lost_nothing(intake: Intake, listen: MakeListener) -> None:
    listener = listen("console@master")
    command = sample("session/control", 0, src="console@master")
    intake.record(listener, frames("session/control", command), EPOCH_NS)
    intake.record(listener, ended("console@master", 0, {"session/control": 1, "session/event": 1}), EPOCH_NS)
    # its first two repetitions came before the recorder had connected
    again = sample("session/control", 2, src="console@master")
    assert intake.record(listener, frames("session/control", again), EPOCH_NS) is not None
    intake.record(listener, ended("console@master", 0, {"session/control": 3}), EPOCH_NS)
    assert (intake.gaps, intake.lost, intake.missing) == (0, 0, 0)


def test_nodes_that_fell_silent_without_a_last_message_are_named(intake: Intake, listen: MakeListener) -> None:
    last_ns = haptic_state(0).t_ns
    sites = ("master", "slave")
    for node in ("haptic_node@master", "controller@master"):
        topic = "haptic/state" if node.startswith("haptic") else "haptic/command"
        intake.record(listen(node), frames(topic, sample(topic, 0, src=node)), EPOCH_NS)
    # as long as they send, it is the recorder that ends
    assert intake.silent_at_the_end(sites, last_ns + 100_000_000) == ()
    later_ns = last_ns + 1_000_000_000
    assert intake.silent_at_the_end(sites, later_ns) == ("controller@master", "haptic_node@master")
    assert intake.silent_at_the_end(("slave",), later_ns) == ()
    listener = listen("haptic_node@master")
    intake.record(listener, ended("haptic_node@master", 0, {}), EPOCH_NS)
    assert intake.silent_at_the_end(sites, later_ns) == ("controller@master",)
    # one that was started again has to end again
    intake.record(listener, frames("haptic/state", haptic_state(1)), EPOCH_NS)
    assert intake.silent_at_the_end(sites, later_ns) == ("controller@master", "haptic_node@master")


@ANSWERS
def test_lost_events_count_as_a_fault_only_where_they_were_sent(intake: Intake, listen: MakeListener) -> None:
    near, far = listen("afm_node@slave"), listen("delay_node@master")
    for seq in (0, 3):
        intake.record(far, frames("session/event", sample("session/event", seq, src="afm_node@slave")), EPOCH_NS)
    assert (intake.lost, intake.lossless_lost) == (2, 0)
    for seq in (0, 3):
        intake.record(near, frames("session/event", sample("session/event", seq, src="afm_node@slave")), EPOCH_NS)
    assert (intake.lost, intake.lossless_lost) == (4, 2)


def test_only_a_command_received_from_its_publisher_is_given_back(intake: Intake, listen: MakeListener) -> None:
    command = session_control(0)
    near = intake.record(listen("launcher@master"), frames("session/control", command), EPOCH_NS)
    far = intake.record(listen("delay_node@slave"), frames("session/control", command), EPOCH_NS)
    assert near is not None and near.message == command
    assert far is None
    assert intake.record(listen("haptic_node@master"), frames("haptic/state", haptic_state(0)), EPOCH_NS) is None


def test_an_emergency_stop_at_the_inlet_is_recorded_at_the_site_of_its_sender(
    intake: Intake, listen: MakeListener
) -> None:
    inlet = listen("estop")
    for site in ("master", "slave"):
        fields = {**fields_of(session_control(0)), "src": f"estop@{site}", "command": "estop"}
        stop = msgspec.convert(fields, SessionControl)
        assert intake.record(inlet, frames("session/control", stop), EPOCH_NS) is not None
    channels = recorded(intake).channels
    assert [(c.channel_topic, c.src, c.site, c.via) for c in channels] == [
        ("session/control", "estop@master", "master", "direct"),
        ("session/control", "estop@slave", "slave", "direct"),
    ]


@pytest.mark.parametrize("topic", ["node/health", "session/event", "session/control"])
def test_what_was_damaged_behind_its_header_is_recorded_once_and_means_nothing(
    intake: Intake, listen: MakeListener, topic: str
) -> None:
    payload = msgpack.packb({"seq": 0, "t_ns": EPOCH_NS, "src": "launcher@master", "v": 1, "id": 7, "state": b"\xff"})
    assert intake.record(listen("launcher@master"), [topic.encode(), payload], EPOCH_NS) is None
    found = list(recorded(intake).raw())
    assert [(message.channel.topic, message.payload) for message in found] == [(topic, payload)]
    assert intake.rejected == 0


def header(**changes: Any) -> bytes:
    fields = {"seq": 1, "t_ns": 2, "src": "haptic_node@master", "v": 1} | changes
    return msgpack.packb({key: value for key, value in fields.items() if value is not None})


@pytest.mark.parametrize(
    ("sent", "reason"),
    [
        ([b"haptic/state"], "frames"),
        ([b"haptic/state", b"", b""], "frames"),
        ([b"\xff", b""], "topic"),
        ([b"haptic/stateful", header()], "topic"),
        ([b"haptic/state", b""], "malformed"),
        ([b"haptic/state", b"\xc1"], "malformed"),
        ([b"haptic/state", b"\x81\x01"], "malformed"),
        ([b"haptic/state", b"\x93\x01\x02\x03"], "malformed"),
        ([b"haptic/state", b"\x91" * 2000], "malformed"),
        ([b"haptic/state", bytes(MAX_MESSAGE_BYTES + 1)], "oversized"),
        ([b"haptic/state", header(v=5)], "newer_version"),
        ([b"haptic/state", header(v=0)], "schema"),
        ([b"haptic/state", header(seq=-1)], "schema"),
        ([b"haptic/state", header(seq=True)], "schema"),
        ([b"haptic/state", header(t_ns=2**63)], "schema"),
        ([b"haptic/state", header(src=None)], "schema"),
        ([b"haptic/state", header(src="somewhere")], "schema"),
        ([b"haptic/state", header(src="a@b" * 30)], "schema"),
    ],
)
def test_frames_that_are_no_message_are_counted_and_kept(
    intake: Intake, listen: MakeListener, sent: list[bytes], reason: str
) -> None:
    listener = listen("haptic_node@master")
    assert intake.record(listener, sent, EPOCH_NS + 9) is None
    assert listener.subscriber.rejected == {reason: 1}
    assert listener.subscriber.last_error
    (message,) = recorded(intake).messages()
    kept = message.decode()
    assert isinstance(kept, RejectedRecord)
    assert (message.channel_topic, message.log_ns) == (REJECTED_TOPIC, EPOCH_NS + 9)
    assert (kept.reason, kept.publisher) == (reason, "haptic_node@master")
    assert kept.frames == tuple(frame[:MAX_MESSAGE_BYTES] for frame in sent)
    assert kept.size_bytes == sum(map(len, sent))


def test_a_flood_of_made_up_sources_ends_in_rejections(intake: Intake, listen: MakeListener) -> None:
    listener = listen("haptic_node@master")
    for number in range(1100):
        intake.record(listener, [b"link/status", header(src=f"n{number}@master")], EPOCH_NS)
    assert listener.subscriber.rejected == {"source": 1100 - 1024}
    assert len(listener.streams) == 1024


def test_what_a_machine_may_not_send_is_kept_apart_and_not_acted_on(intake: Intake, listen: MakeListener) -> None:
    listener = listen("afm_node@slave")
    permissions = listener.subscriber.permit = MessagePermissions("slave", ["afm_node@slave"], ["observe"])
    command = frames("session/control", sample("session/control", 0, src="afm_node@slave"))
    assert intake.record(listener, command, EPOCH_NS) is None
    assert intake.record(listener, frames("afm/state", sample("afm/state", 0, src="afm_node@slave")), EPOCH_NS) is None
    assert listener.subscriber.rejected == {"role": 2}
    assert listener.subscriber.last_error == (
        "afm/state of afm_node@slave: the machine slave lacks the role data, it has observe"
    )
    permissions.change(["data", "control"])
    assert (
        intake.record(listener, frames("afm/state", sample("afm/state", 0, src="controller@slave")), EPOCH_NS) is None
    )
    assert listener.subscriber.rejected == {"role": 2, "source": 1}
    intake.record(listener, frames("afm/state", sample("afm/state", 1, src="afm_node@slave")), EPOCH_NS)
    received = intake.record(listener, command, EPOCH_NS)
    assert received is not None
    assert received.topic == "session/control"
    assert [(m.channel_topic, m.src, m.seq) for m in recorded(intake).messages(["afm/state", "session/control"])] == [
        ("afm/state", "afm_node@slave", 1),
        ("session/control", "afm_node@slave", 0),
    ]
    assert intake.rejected == 3


class BreakingFile(io.BytesIO):
    """A file that cannot be written any more once that is set."""

    broken = False

    def write(self, data: bytes) -> int:
        if self.broken:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return super().write(data)


@pytest.mark.parametrize("moment", ["message", "channel", "gap", "rejected", "flush", "finish"])
def test_a_write_error_ends_the_recording_and_nothing_else(listen: MakeListener, moment: str) -> None:
    file = BreakingFile()
    # A small chunk is written with the message that fills it, a large one when it is flushed.
    config = RecorderConfig(chunk_size_bytes=1 << 20 if moment == "flush" else 4096, compression="none")
    intake = Intake(RecordingWriter(file, Path("x.mcap"), NODE, config))
    listener = listen("haptic_node@master")
    intake.record(listener, frames("haptic/state", haptic_state(0)), EPOCH_NS)
    file.broken = True
    if moment == "message":
        for seq in range(1, 20):
            intake.record(listener, frames("haptic/state", haptic_state(seq)), EPOCH_NS)
    elif moment == "channel":
        for source in range(20):
            intake.record(listener, frames("node/health", sample("node/health", 0, src=f"n{source}@master")), EPOCH_NS)
    elif moment == "gap":
        for seq in range(2, 80, 2):
            intake.record(listener, frames("haptic/state", haptic_state(seq)), EPOCH_NS)
    elif moment == "rejected":
        intake.record(listener, [b"haptic/state", bytes(8192)], EPOCH_NS)
    elif moment == "flush":
        intake.flush()
    else:
        intake.finish()
    assert intake.writer is None
    assert intake.fault == "x.mcap: cannot be written: Input/output error"
    # whatever comes now is received, counted and answered all the same
    lost = intake.lost
    intake.record(listener, frames("haptic/state", haptic_state(100)), EPOCH_NS)
    intake.record(listener, [b"haptic/state"], EPOCH_NS)
    command = intake.record(listen("launcher@master"), frames("session/control", session_control(0)), EPOCH_NS)
    assert command is not None
    assert intake.lost > lost
    intake.flush()
    intake.finish()
