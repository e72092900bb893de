"""Recordings as no recorder writes them: sound by every checksum, and with times or an index that ask for too much."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

from mcap.opcode import Opcode

from telenano.recording.mcap_scan import MAGIC, RECORD_HEAD, records_of
from telenano.recording.reader import Recording
from telenano.recording.writer import FileSettings, RecordingWriter

# the number of a message in the file and its time of reception [ns] -> the time that the forged file has for it
Times = Callable[[int, int], int]
_FOOTER = struct.Struct("<BQQQI")
_INDEXES = {
    "chunks": Opcode.CHUNK_INDEX,
    "attachments": Opcode.ATTACHMENT_INDEX,
    "metadata": Opcode.METADATA_INDEX,
}


def copied(
    source: Path,
    target: Path,
    times: Times = lambda place, log_ns: log_ns,
    *,
    sent: Times = lambda place, publish_ns: publish_ns,
    chunk_bytes: int = 16384,
    closed: bool = True,
) -> Path:
    """Write a recording again, in chunks of another size and with other times of reception and sending [ns]."""
    whole = Recording(source)
    settings = FileSettings(directory=target.parent, file_name=target.name, chunk_size_bytes=chunk_bytes)
    writer = RecordingWriter.create("recorder@master", settings)
    for name, data in whole.attachments.items():
        writer.attach(name, "application/yaml", data, 0)
    writer.add_metadata("recording", {"node": "recorder@master"})
    numbers: dict[int, int] = {}
    for place, message in enumerate(whole.select()):
        channel = message.channel
        if id(channel) not in numbers:
            numbers[id(channel)] = writer.channel(channel.topic, channel.src, channel.site)
        log_ns, publish_ns = times(place, message.log_ns), sent(place, message.publish_ns)
        writer.write(numbers[id(channel)], log_ns, publish_ns, message.seq, message.payload)
    if closed:
        writer.finish()
    else:
        writer.flush()
        writer.abandon()
    return target


def with_summary(content: bytes, change: Callable[[int, bytes], bytes]) -> bytes:
    """Return a closed file whose summary has other records, by opcode and whole record, and the right checksum."""
    footer = len(content) - len(MAGIC) - _FOOTER.size
    _, _, start, _, _ = _FOOTER.unpack_from(content, footer)
    section = content[start:footer]
    kept = [
        change(opcode, section[first - RECORD_HEAD.size : last])
        for opcode, first, last in records_of(section)
        if opcode != Opcode.SUMMARY_OFFSET
    ]
    summary = b"".join(kept)
    end = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0)
    return content[:start] + summary + end + struct.pack("<I", zlib.crc32(summary + end)) + MAGIC


def repeated_index(content: bytes, what: str, times: int) -> bytes:
    """Return a file whose index names the chunks, attachments or metadata so many times, and states their number so."""

    def change(opcode: int, record: bytes) -> bytes:
        if opcode == Opcode.STATISTICS and what == "chunks":
            # behind the number of messages, schemas, channels, attachments and metadata
            place = RECORD_HEAD.size + 8 + 2 + 4 + 4 + 4
            (chunks,) = struct.unpack_from("<I", record, place)
            return record[:place] + struct.pack("<I", times * chunks) + record[place + 4 :]
        return times * record if opcode == _INDEXES[what] else record

    return with_summary(content, change)


def wide_index(content: bytes, first_ns: int, last_ns: int) -> bytes:
    """Return a file whose chunks and their index all state these times [ns]."""
    times = struct.pack("<QQ", first_ns, last_ns)

    def change(opcode: int, record: bytes) -> bytes:
        found = opcode == Opcode.CHUNK_INDEX
        return record[: RECORD_HEAD.size] + times + record[RECORD_HEAD.size + 16 :] if found else record

    changed = bytearray(with_summary(content, change))
    for opcode, first, _ in records_of(content[len(MAGIC) :]):
        if opcode == Opcode.CHUNK:
            changed[len(MAGIC) + first : len(MAGIC) + first + 16] = times
    # 0 stands for no checksum of the data
    (start,) = struct.unpack_from("<Q", changed, len(changed) - len(MAGIC) - _FOOTER.size + RECORD_HEAD.size)
    changed[start - 4 : start] = bytes(4)
    return bytes(changed)
