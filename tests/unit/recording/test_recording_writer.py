import errno
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import msgpack
import pytest
from mcap.reader import make_reader
from recorder_samples import EPOCH_NS, NODE, haptic_state, sample, teleop_forward

from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import GAP_TOPIC, GapRecord
from telenano.recording.writer import RecordingWriter
from telenano.wire import encode
from telenano.wire.codec import fields_of
from telenano.wire.errors import RecordingError
from telenano.wire.messages import HapticState
from telenano.wire.schema import json_schema


class TinyDisk(io.BytesIO):
    """A file on a disk with room for some bytes only."""

    def __init__(self, room_bytes: int) -> None:
        super().__init__()
        self.room_bytes = room_bytes

    def write(self, data: bytes) -> int:
        if self.tell() + len(data) > self.room_bytes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(data)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_the_reference_reader_alone_understands_a_recording(make_file: Callable[..., Path], compression: str) -> None:
    path = make_file(40, compression=compression)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        header, summary = reader.get_header(), reader.get_summary()
        found = list(reader.iter_messages())
        attachments = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert header.profile == "telenano"
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == len(found) == 80
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"" if compression == "none" else compression}
    assert attachments == {"site.yaml": b"nodes: {}\n"}
    assert metadata == {"versions": {"python": "3"}}
    channels = {channel.topic: channel for channel in summary.channels.values()}
    assert channels["haptic/state"].message_encoding == "msgpack"
    assert channels["haptic/state"].metadata == {
        "topic": "haptic/state",
        "site": "master",
        "via": "direct",
        "src": "haptic_node@master",
        "rate_hz": "1000.0",
        "delivery": "latest",
    }
    assert channels["teleop/forward@slave"].metadata["via"] == "link"
    assert channels["teleop/forward@slave"].metadata["site"] == "slave"
    schema, _, message = found[0]
    assert schema is not None and schema.encoding == "jsonschema"
    assert json.loads(schema.data) == json_schema(HapticState)
    assert (message.log_time, message.publish_time, message.sequence) == (EPOCH_NS + 100, EPOCH_NS, 0)
    assert message.data == encode(haptic_state(0))


def test_a_recording_is_never_overwritten(config: RecorderConfig) -> None:
    paths = []
    for _ in range(3):
        writer = RecordingWriter.create(NODE, config)
        writer.finish()
        paths.append(writer.path)
    assert [path.name for path in paths] == ["session.mcap", "session_1.mcap", "session_2.mcap"]
    assert all(path.is_absolute() for path in paths)


def test_a_missing_folder_is_made(tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path / "a" / "b"))
    writer.finish()
    assert writer.path == tmp_path / "a" / "b" / "session.mcap"


def test_a_folder_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="file: is not a folder"):
        RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path / "file"))
    with pytest.raises(RecordingError, match=r"below/session\.mcap: cannot be created: Not a directory"):
        RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path / "file" / "below"))


def test_a_flush_hands_everything_to_the_file(config: RecorderConfig) -> None:
    stream = io.BytesIO()
    writer = RecordingWriter(stream, Path("x.mcap"), NODE, config)
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    writer.write(channel, EPOCH_NS, EPOCH_NS, 0, encode(haptic_state(0)))
    before = len(stream.getvalue())
    writer.flush()
    assert len(stream.getvalue()) == writer.size_bytes > before


def test_flushing_to_the_disk_reaches_the_same_bytes(tmp_path: Path) -> None:
    sizes = []
    for name, sync in (("a.mcap", False), ("b.mcap", True)):
        writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path, file_name=name, sync_to_disk=sync))
        channel = writer.channel("haptic/state", "haptic_node@master", "master")
        writer.write(channel, EPOCH_NS, EPOCH_NS, 0, encode(haptic_state(0)))
        writer.finish()
        sizes.append(writer.path.read_bytes())
    assert sizes[0] == sizes[1]


def test_a_long_sequence_number_is_cut_to_32_bits_beside_the_payload(config: RecorderConfig) -> None:
    writer = RecordingWriter.create(NODE, config)
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    state = sample("haptic/state", 2**32 + 7, src="haptic_node@master")
    writer.write(channel, EPOCH_NS, EPOCH_NS, 2**32 + 7, encode(state))
    writer.finish()
    with writer.path.open("rb") as file:
        (_, _, message) = next(iter(make_reader(file).iter_messages()))
    assert message.sequence == 7
    assert msgpack.unpackb(message.data)["seq"] == 2**32 + 7


def test_gaps_have_a_channel_and_a_schema_of_their_own(config: RecorderConfig) -> None:
    writer = RecordingWriter.create(NODE, config)
    gap = GapRecord(channel_topic="afm/state", src="afm_node@slave", first_missing=3, last_missing=5, count=3)
    writer.write_gap(EPOCH_NS, gap)
    writer.finish()
    with writer.path.open("rb") as file:
        ((schema, channel, message),) = make_reader(file).iter_messages()
    assert channel.topic == GAP_TOPIC
    assert schema is not None and json.loads(schema.data)["properties"]["first_missing"]["minimum"] == 0
    assert msgpack.unpackb(message.data) == fields_of(gap)


@pytest.mark.parametrize("room_bytes", [0, 8, 100, 3000, 6000])
def test_a_full_disk_is_a_recording_error_that_names_file_and_reason(config: RecorderConfig, room_bytes: int) -> None:
    disk = TinyDisk(room_bytes)
    with pytest.raises(RecordingError, match=r"x\.mcap: cannot be written: No space left on device"):
        writer = RecordingWriter(disk, Path("x.mcap"), NODE, config)
        writer.attach("site.yaml", "application/yaml", b"nodes: {}\n" * 20, EPOCH_NS)
        channel = writer.channel("teleop/forward", "controller@master", "master")
        for seq in range(10_000):
            writer.write(channel, EPOCH_NS, EPOCH_NS, seq, encode(teleop_forward(seq)))
            if seq % 10 == 9:
                writer.flush()
    assert disk.closed


_FILL = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.wire.errors import RecordingError
writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=Path(sys.argv[1]), compression="none"))
channel = writer.channel("haptic/state", "haptic_node@master", "master")
try:
    for seq in range(1000):
        writer.write(channel, seq, seq, seq, bytes(200))
        if seq % 10 == 9:
            writer.flush()
            sys.stdout.write(f"{seq + 1}\\n")
except RecordingError as error:
    sys.stdout.write(f"{error}\\n")
"""


def test_a_real_file_that_may_not_grow_keeps_what_was_flushed(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _FILL, str(tmp_path)], capture_output=True, text=True, check=True, timeout=60
    )
    *flushed, error = done.stdout.splitlines()
    assert error == f"{tmp_path}/session.mcap: cannot be written: File too large"
    recording = Recording(tmp_path / "session.mcap")
    assert [message.seq for message in recording.messages()][: int(flushed[-1])] == list(range(int(flushed[-1])))
    assert not recording.closed
