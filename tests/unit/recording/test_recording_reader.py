import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, teleop_forward

from telenano.recording.mcap_scan import MAGIC, scan
from telenano.recording.messages import RecordedMessage
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import GAP_TOPIC, REJECTED_TOPIC, GapRecord, RejectedRecord
from telenano.recording.writer import RecordingWriter
from telenano.wire import encode
from telenano.wire.errors import RecordingError

MakeFile = Callable[..., Path]


def messages_in(recording: Recording) -> list[tuple[int, bytes]]:
    return [(message.log_ns, message.payload) for message in recording.messages()]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("finish", [True, False])
def test_what_was_written_is_read(make_file: MakeFile, compression: str, finish: bool) -> None:
    recording = Recording(make_file(40, finish=finish, compression=compression))
    found = list(recording.messages())
    assert recording.closed is finish
    assert len(found) == 80
    assert [message.log_ns for message in found] == sorted(message.log_ns for message in found)
    first, second = found[0], found[1]
    assert (first.channel_topic, first.topic, first.site, first.via) == (
        "haptic/state",
        "haptic/state",
        "master",
        "direct",
    )
    assert (second.channel_topic, second.topic, second.site, second.via) == (
        "teleop/forward@slave",
        "teleop/forward",
        "slave",
        "link",
    )
    assert (first.log_ns, first.publish_ns, first.seq, first.src) == (EPOCH_NS + 100, EPOCH_NS, 0, "haptic_node@master")
    assert first.payload == encode(haptic_state(0))
    assert first.decode() == haptic_state(0)
    assert found[-1].decode() == teleop_forward(39)
    assert [channel.channel_topic for channel in recording.channels] == ["haptic/state", "teleop/forward@slave"]
    assert recording.channels[0].rate_hz == 1000.0
    assert recording.attachments == {"site.yaml": b"nodes: {}\n"}
    assert recording.metadata == {"versions": {"python": "3"}}


def test_topics_and_times_select(make_file: MakeFile) -> None:
    recording = Recording(make_file(40))
    start, end = EPOCH_NS + 5 * MILLISECOND_NS + 200, EPOCH_NS + 9 * MILLISECOND_NS + 200
    found = list(recording.messages(["teleop/forward@slave"], start, end))
    assert [message.seq for message in found] == [5, 6, 7, 8]
    assert list(recording.messages(["teleop/forward"])) == []
    assert list(recording.messages([])) == []
    # one name is not the letters of it
    assert list(recording.messages("teleop/forward@slave", start, end)) == found


def test_the_account_of_a_recording(config: RecorderConfig) -> None:
    writer = RecordingWriter.create(NODE, config)
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    for seq in (0, 1, 2, 6, 7, 7):
        log_ns = EPOCH_NS + seq * MILLISECOND_NS
        writer.write(hand, log_ns, log_ns, seq, encode(haptic_state(seq)))
    gap = GapRecord(channel_topic="haptic/state", src="haptic_node@master", first_missing=3, last_missing=5, count=3)
    writer.write_gap(EPOCH_NS, gap)
    writer.finish()
    recording = Recording(writer.path)
    info = recording.info()
    hand_info, gap_info = info.channels
    assert (hand_info.messages, hand_info.gaps, hand_info.lost, hand_info.repeated) == (6, 1, 3, 1)
    assert hand_info.rate_hz == pytest.approx(5 / 7e-3, rel=1e-9, abs=0)
    assert (hand_info.first_ns, hand_info.last_ns) == (EPOCH_NS, EPOCH_NS + 7 * MILLISECOND_NS)
    assert hand_info.declared_rate_hz == 1000.0
    assert (gap_info.channel_topic, gap_info.declared_rate_hz) == (GAP_TOPIC, None)
    assert (info.closed, info.skipped_bytes, info.damage, info.messages) == (True, 0, (), 7)
    assert (info.complete, info.lost) == (False, 3)
    assert info.missing == ("3 messages of haptic_node@master on haptic/state are missing",)
    assert info.size_bytes == writer.path.stat().st_size == writer.size_bytes
    assert info.duration_s == pytest.approx(7e-3, rel=1e-9, abs=0)
    assert info.model_validate_json(info.model_dump_json()) == info
    assert next(recording.messages([GAP_TOPIC])).decode() == gap


def test_rejected_frames_are_read_back(config: RecorderConfig) -> None:
    writer = RecordingWriter.create(NODE, config)
    rejected = RejectedRecord(
        reason="malformed", text="no map", publisher="afm_node@slave", size_bytes=11, frames=(b"afm/state", b"\xc1\xff")
    )
    writer.write_rejected(EPOCH_NS, rejected)
    writer.finish()
    (message,) = Recording(writer.path).messages()
    assert message.channel_topic == REJECTED_TOPIC
    assert message.decode() == rejected


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"\x01", b"\x80"])
def test_a_payload_that_is_no_message_names_channel_and_number(make_file: MakeFile, payload: bytes) -> None:
    channel = Recording(make_file(1)).channels[0]
    message = RecordedMessage(channel, 1, 1, 17, payload)
    with pytest.raises(RecordingError, match="haptic/state, seq 17"):
        message.decode()


@pytest.mark.parametrize(
    ("content", "text"),
    [(b"", "is empty"), (b"\x89MCAP", "ends before its first record"), (b"hdf5 or so", "is not an MCAP file")],
)
def test_a_file_of_another_kind_is_a_clear_error(tmp_path: Path, content: bytes, text: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=rf"x\.mcap: {text}"):
        Recording(path)


def test_a_missing_file_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"x\.mcap: cannot be read: No such file"):
        Recording(tmp_path / "x.mcap")
    with pytest.raises(RecordingError, match="cannot be read: Is a directory"):
        Recording(tmp_path)


def test_a_file_that_is_cut_off_meanwhile_is_a_clear_error(make_file: MakeFile) -> None:
    recording = Recording(make_file(1))
    with recording.path.open("r+b") as file:
        file.truncate(100)
    with pytest.raises(RecordingError, match="cannot be read any more"):
        list(recording.messages())


def test_a_file_that_is_taken_away_meanwhile_is_read_on(make_file: MakeFile) -> None:
    recording = Recording(make_file(1))
    before = list(recording.messages())
    recording.path.unlink()
    assert list(recording.messages()) == before != []


def test_a_recording_that_grows_is_read_as_far_as_it_was_when_opened(config: RecorderConfig) -> None:
    writer = RecordingWriter.create(NODE, config)
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    writer.write(channel, 1, 1, 0, encode(haptic_state(0)))
    writer.flush()
    early = Recording(writer.path)
    writer.write(channel, 2, 2, 1, encode(haptic_state(1)))
    writer.finish()
    assert len(messages_in(early)) == 1
    assert len(messages_in(Recording(writer.path))) == 2


@pytest.mark.parametrize("use_chunking", [True, False])
def test_a_plain_mcap_file_without_our_facts_is_read(tmp_path: Path, use_chunking: bool) -> None:
    path = tmp_path / "plain.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=use_chunking)
        writer.start()
        channel = writer.register_channel("imu", "json", writer.register_schema("Imu", "jsonschema", b"{}"))
        writer.add_message(channel, 5, b"{}", 4, 3)
        writer.finish()
    recording = Recording(path)
    (message,) = recording.messages()
    assert recording.closed
    assert (message.channel_topic, message.topic, message.site, message.log_ns) == ("imu", "imu", "", 5)
    assert recording.channels == (message.channel,)


# the step between cuts [bytes]: the records are the same in all three, and only the inside of a chunk differs
@pytest.mark.check("reads a file cut off at many places")
@pytest.mark.grid(compression="zstd")
@pytest.mark.parametrize(
    ("compression", "step"),
    [("zstd", 5), ("lz4", 11), ("none", 13), pytest.param("zstd", 1, marks=pytest.mark.endurance)],
)
def test_a_file_cut_off_anywhere_gives_a_beginning_that_grows_with_it(
    make_file: MakeFile, compression: str, step: int
) -> None:
    path = make_file(20, compression=compression)
    whole = messages_in(Recording(path))
    fewest = len(whole)
    last_error = -1
    sizes = sorted({*range(0, path.stat().st_size, step), *range(100)}, reverse=True)
    for size in sizes:
        os.truncate(path, size)
        try:
            recording = Recording(path)
        except RecordingError:
            last_error = max(last_error, size)
            continue
        found = messages_in(recording)
        assert not recording.closed
        assert found == whole[: len(found)]
        assert len(found) <= fewest
        fewest = len(found)
    assert fewest == 0
    # only a file without the whole of its first eight bytes is beyond reading
    assert last_error == len(MAGIC) - 1


def test_the_end_that_is_cut_off_is_accounted_for(make_file: MakeFile) -> None:
    path = make_file(40, finish=False, compression="none")
    last = scan(path.read_bytes()).blocks[-1]
    os.truncate(path, last.data_end - 30)
    info = Recording(path).info()
    assert not info.complete
    # all but the very last message, of which only a part is there
    assert info.messages == 79
    assert info.damage == (
        f"byte {last.offset}, {last.data_end - 30 - last.offset} bytes: the file ends within a chunk, "
        "whose beginning was read",
    )
    assert info.skipped_bytes == last.data_end - 30 - last.offset


@pytest.mark.check("takes 1.2 s")
@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_one_wrong_byte_costs_one_chunk_at_most(make_file: MakeFile, tmp_path: Path, compression: str) -> None:
    path = make_file(40, compression=compression)
    content = path.read_bytes()
    whole = messages_in(Recording(path))
    damaged = tmp_path / "damaged.mcap"
    random_source = random.Random(20)
    for _ in range(400):
        position = random_source.randrange(len(MAGIC), len(content))
        wrong = content[position] ^ random_source.randrange(1, 256)
        damaged.write_bytes(content[:position] + bytes([wrong]) + content[position + 1 :])
        recording = Recording(damaged)
        found = messages_in(recording)
        info = recording.info()
        assert set(found) <= set(whole), position
        assert len(found) >= len(whole) - 20, position
        assert info.messages == len(found)
        if len(found) < len(whole):
            assert info.skipped_bytes > 0, position


def test_a_damaged_chunk_is_named(make_file: MakeFile, tmp_path: Path) -> None:
    path = make_file(40, compression="none")
    content = bytearray(path.read_bytes())
    block = scan(bytes(content)).blocks[1]
    content[block.data_start + 100] ^= 1
    path.write_bytes(content)
    info = Recording(path).info()
    assert info.messages == 60
    assert (info.closed, info.complete) == (True, False)
    assert info.missing[0] == f"{info.skipped_bytes} bytes of session.mcap cannot be read"
    assert len(info.damage) == 1
    assert info.damage[0].startswith(f"byte {block.offset}, ")
    assert info.damage[0].endswith("the checksum of the chunk is wrong")
    assert {channel.lost for channel in info.channels} == {10}


def test_reading_goes_on_after_foreign_bytes(make_file: MakeFile) -> None:
    path = make_file(40, finish=False)
    content = path.read_bytes()
    block = scan(content).blocks[2]
    path.write_bytes(content[: block.offset] + b"\x00" * 500 + content[block.offset :])
    info = Recording(path).info()
    assert info.messages == 80
    assert info.skipped_bytes == 500
    assert info.damage == (f"byte {block.offset}, 500 bytes: bytes that are not a record",)


def test_bytes_after_the_end_are_reported(make_file: MakeFile) -> None:
    path = make_file(10)
    with path.open("ab") as file:
        file.write(b"more")
    info = Recording(path).info()
    assert (info.closed, info.complete) == (True, False)
    assert info.skipped_bytes == 4


@given(tail=st.binary(max_size=300), cut=st.integers(0, 4000))
def test_any_bytes_are_read_without_another_error(
    tmp_path_factory: pytest.TempPathFactory, tail: bytes, cut: int
) -> None:
    folder = tmp_path_factory.mktemp("fuzz")
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=folder))
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    writer.write(channel, 1, 1, 0, encode(haptic_state(0)))
    writer.finish()
    writer.path.write_bytes(writer.path.read_bytes()[: max(cut, len(MAGIC))] + tail)
    recording = Recording(writer.path)
    assert recording.info().messages == len(list(recording.messages())) <= 1 + len(tail) // 31
    shutil.rmtree(folder)
