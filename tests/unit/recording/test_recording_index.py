"""Header, indexes and checksums of a file, against the reader of the format and against single flipped bits."""

import io
import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.writer import IndexType, Writer

from telenano.recording.mcap_index import index_faults
from telenano.recording.mcap_scan import MAGIC, RECORD_HEAD, scan
from telenano.recording.verify import verify

MakeFile = Callable[..., Path]
FOOTER = RECORD_HEAD.size + 20 + len(MAGIC)
# the fields that begin a summary record or an index, behind its head
FIRST = RECORD_HEAD.size


@pytest.fixture
def plain(tmp_path: Path) -> bytes:
    """Return a small file of another program: three chunks, an attachment, metadata, no checksum of the data."""
    out = io.BytesIO()
    writer = Writer(out, chunk_size=1 << 20)
    writer.start()
    schema = writer.register_schema("Odometry", "jsonschema", b"{}")
    channels = [writer.register_channel(f"/odom{place}", "json", schema, {"place": str(place)}) for place in range(2)]
    writer.add_attachment(1, 2, "map.txt", "text/plain", b"here be dragons")
    writer.add_metadata("robot", {"name": "r2", "kind": "droid"})
    for number in range(30):
        writer.add_message(channels[number % 2], 1000 + number, b"{}", number, number)
        if number % 10 == 9:
            writer.flush()
    writer.finish()
    return out.getvalue()


def records(data: bytes) -> list[tuple[int, int, int]]:
    """Return opcode, start and end of every record outside of the chunks."""
    found, position = [], len(MAGIC)
    while position < len(data) - len(MAGIC):
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        found.append((opcode, position, position + RECORD_HEAD.size + length))
        position += RECORD_HEAD.size + length
    return found


def start_of(data: bytes, opcode: int, number: int = 0) -> int:
    return [start for found, start, _ in records(data) if found == opcode][number]


def faults_of(data: bytes) -> list[str]:
    """Return the faults of a file with the messages that were written to `plain`."""
    return index_faults(data, scan(data), 30)


def checksummed(data: bytearray) -> bytes:
    """Return a file with the checksum of its summary made right, so that only its content can be wrong."""
    footer = len(data) - FOOTER
    (summary,) = struct.unpack_from("<Q", data, footer + FIRST)
    data[-len(MAGIC) - 4 : -len(MAGIC)] = zlib.crc32(data[summary : len(data) - len(MAGIC) - 4]).to_bytes(4, "little")
    return bytes(data)


def changed(data: bytes, place: int, form: str, value: int) -> bytes:
    content = bytearray(data)
    struct.pack_into(form, content, place, value)
    return checksummed(content)


def test_a_file_that_is_right_has_no_faults(plain: bytes, make_file: MakeFile) -> None:
    assert faults_of(plain) == []
    assert verify([make_file()]).sound


def test_what_a_writer_may_leave_out_is_not_asked_for() -> None:
    for options in (
        {"use_chunking": False},
        {"use_statistics": False, "use_summary_offsets": False},
        {"repeat_channels": False, "repeat_schemas": False, "enable_crcs": False},
        {"enable_data_crcs": True},
        {"use_statistics": False, "use_summary_offsets": False, "repeat_channels": False, "repeat_schemas": False,
         "index_types": IndexType.NONE},
    ):  # fmt: skip
        out = io.BytesIO()
        writer = Writer(out, **options)
        writer.start()
        channel = writer.register_channel("/odom", "json", 0)
        writer.add_message(channel, log_time=1, data=b"{}", publish_time=1)
        writer.finish()
        data = out.getvalue()
        assert index_faults(data, scan(data), 1) == [], options


def test_what_other_readers_go_by_is_compared_with_the_file(plain: bytes) -> None:
    statistics, chunk = start_of(plain, Opcode.STATISTICS), start_of(plain, Opcode.CHUNK_INDEX, 1)
    for place, form, value, fault in (
        (statistics + FIRST, "<Q", 31, "the summary states 31 messages, but the file has 30"),
        (statistics + FIRST + 48, "<Q", 3, "do not add up to the total that it states"),
        (chunk + FIRST, "<Q", 5, "the chunk indexes of the summary differ from the chunks in the file, first at byte"),
        (chunk + FIRST + 16, "<Q", 5, "the chunk indexes of the summary differ from the chunks in the file, first at"),
        (len(MAGIC) + FIRST, "<I", 1000, "header or summary cannot be read"),
        (len(plain) - FOOTER + FIRST, "<Q", chunk, "the end of the data section is not where the footer says"),
    ):
        faults = faults_of(changed(plain, place, form, value))
        assert any(fault in found for found in faults), (fault, faults)


def test_header_and_checksum_of_the_summary_are_read(plain: bytes) -> None:
    content = bytearray(plain)
    content[len(MAGIC)] = Opcode.METADATA
    assert faults_of(bytes(content))[0].startswith("header or summary cannot be read")
    content = bytearray(plain)
    content[-len(MAGIC) - 1] ^= 1
    assert faults_of(bytes(content)) == ["the checksum of the summary is wrong"]


def test_any_flipped_bit_of_a_recording_is_named(make_file: MakeFile) -> None:
    path = make_file(20)
    data = path.read_bytes()
    dice = random.Random(8)
    parts = (range(len(MAGIC), len(data)), range(len(MAGIC), len(data) // 4), range(len(data) - 3000, len(data)))
    for place in (place for part in parts for place in dice.sample(part, 40)):
        content = bytearray(data)
        content[place] ^= 1 << dice.randrange(8)
        path.write_bytes(content)
        assert not verify([path]).sound, place


@pytest.mark.check("takes 1.7 s")
def test_what_the_reader_of_the_format_fails_on_is_named(plain: bytes, tmp_path: Path) -> None:
    """Flip a bit here and there in a file without a checksum of its data, where any reader takes another text."""
    path = tmp_path / "flipped.mcap"
    failed = 0
    for place in range(len(MAGIC), len(plain), 7):
        content = bytearray(plain)
        content[place] ^= 1 << place % 8
        if reads_the_same(bytes(content), plain):
            continue
        failed += 1
        path.write_bytes(content)
        assert not verify([path]).sound, place
    assert failed > 150


def reads_the_same(data: bytes, original: bytes) -> bool:
    try:
        return contents(data) == contents(original)
    except (McapError, ValueError, KeyError, struct.error, OverflowError, MemoryError, zstandard.ZstdError):
        return False


def contents(data: bytes) -> tuple[object, ...]:
    reader = SeekingReader(io.BytesIO(data), validate_crcs=True)
    summary = reader.get_summary()
    messages = [(channel, message) for _, channel, message in reader.iter_messages()]
    return summary, messages, list(reader.iter_attachments())


def test_a_file_that_was_not_closed_is_reported_as_that(make_file: MakeFile) -> None:
    path = make_file(20, finish=False)
    assert not scan(path.read_bytes()).finished
    assert {finding.check for finding in verify([path]).findings} == {"end"}
