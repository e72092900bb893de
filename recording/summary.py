"""The summary of a closed recording by its own index, without reading its messages.

It is given only where the numbers agree: on each channel that was received at its publisher, the first and the last
number, the count in the statistics and the gaps that the recorder has recorded. A file in which a process was started
again, from which a part is missing, or whose index is damaged has to be read as a whole.
"""

import mmap
import struct
import zlib
from collections.abc import Collection, Iterable, Iterator
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, Metadata, MetadataIndex, Statistics

from presets.regular_files import open_regular
from recording.info import AttachmentInfo, ChannelInfo, RecordingInfo, notes_of
from recording.mcap_scan import (
    MAGIC,
    MESSAGE_HEAD,
    MOST_DEFINITIONS,
    RECORD_HEAD,
    UNREADABLE,
    Block,
    DamagedBlockError,
    Layout,
    add_other,
    add_record,
    chunk_at,
    records_of,
    unpack,
)
from recording.messages import RecordedChannel, recorded_channel
from recording.record_topics import GAP_TOPIC, RECORD_TOPICS

_FOOTER = struct.Struct("<BQQQI")
_CHUNK_INDEX = struct.Struct("<QQQQI")
_OFFSET = struct.Struct("<HQ")
# the same, and the channel alone
_NUMBER = struct.Struct("<H8x")
_ENTRY = struct.Struct("<QQ")
INDEX_HEAD = struct.Struct("<HI")
_NAME_LENGTH = struct.Struct("<I")
_SIZES = struct.Struct("<QQ")
_SEQUENCE_MASK = 0xFFFF_FFFF


class _DisagreementError(Exception):
    """The summary does not say it all."""


class _Chunk(NamedTuple):
    """A chunk: its place, and those of the message indexes of its channels, as the file has them."""

    offset: int
    length: int
    indexes: bytes


def quick_info(path: Path) -> RecordingInfo | None:
    """Return the summary of a closed file by its index; None where all of its messages have to be read for it.

    What only the messages tell is None: sizes, repetitions and restarts of a channel, and the lag of the recorder.
    Raises OSError when the file cannot be read.
    """
    with open_regular(path) as file:
        size = path.stat().st_size
        if size < 2 * len(MAGIC) + _FOOTER.size:
            return None
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            try:
                return _Summary(data).info(path)
            except (_DisagreementError, DamagedBlockError, *UNREADABLE, ValueError, KeyError, IndexError):
                return None


class _Summary:
    """The summary section of a file, and what it points to."""

    def __init__(self, data: mmap.mmap) -> None:
        self._data = data
        self._statistics: Statistics | None = None
        self._channels: dict[int, RecordedChannel] = {}
        self._chunks: list[_Chunk] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: dict[str, dict[str, str]] = {}
        # the chunk that was unpacked last
        self._unpacked: tuple[int, bytes] = (-1, b"")
        for opcode, body in _summary_records(data):
            self._add(opcode, body)

    def info(self, path: Path) -> RecordingInfo:
        """Return what `Recording.info` returns; _DisagreementError where it may be more."""
        statistics = self._statistics
        _demand(statistics is not None and statistics.chunk_count == len(self._chunks))
        assert statistics is not None
        counts = {number: statistics.channel_message_counts.get(number, 0) for number in self._channels}
        numbers = [number for number, count in counts.items() if count > 0]
        first, last = self._ends(numbers, self._chunks, 0), self._ends(numbers, reversed(self._chunks), -1)
        gaps = self._gaps()
        found = [self._row(number, counts[number], first[number], last[number], gaps) for number in numbers]
        _demand(sum(row.messages for row in found) == statistics.message_count)
        lost = [(row.lost, row) for row in found if row.via == "direct" and row.lost]
        missing = [
            f"{count} messages of {row.src or 'a source'} on {row.channel_topic} are missing" for count, row in lost
        ]
        # a sentence for each of many is for the other way
        _demand(len(missing) <= 5)
        missing += notes_of([self._metadata])
        start_ns, end_ns = statistics.message_start_time, statistics.message_end_time
        return RecordingInfo(
            path=str(path),
            size_bytes=len(self._data),
            start_ns=start_ns,
            end_ns=end_ns,
            duration_s=(end_ns - start_ns) * 1e-9,
            messages=statistics.message_count,
            complete=not missing,
            missing=tuple(missing),
            lost=sum(count for count, _ in lost),
            closed=True,
            basis="summary",
            recorder_lag=None,
            skipped_bytes=0,
            damage=(),
            parts=(),
            channels=tuple(found),
            attachments=tuple(map(_attachment, self._attachments)),
            metadata=self._metadata,
        )

    def _add(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.CHUNK_INDEX:
            _, _, offset, length, size = _CHUNK_INDEX.unpack_from(body)
            self._chunks.append(_Chunk(offset, length, body[_CHUNK_INDEX.size : _CHUNK_INDEX.size + size]))
        elif opcode == Opcode.CHANNEL:
            found = Channel.read(stream)
            self._channels[found.id] = recorded_channel(found)
            _demand(len(self._channels) <= MOST_DEFINITIONS)
        elif opcode == Opcode.STATISTICS:
            self._statistics = Statistics.read(stream)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            self._attachments.append(AttachmentIndex.read(stream))
        elif opcode == Opcode.METADATA_INDEX:
            self._add_metadata(MetadataIndex.read(stream))

    def _add_metadata(self, index: MetadataIndex) -> None:
        start = index.offset + RECORD_HEAD.size
        opcode, length = RECORD_HEAD.unpack_from(self._data, index.offset)
        _demand(opcode == Opcode.METADATA and RECORD_HEAD.size + length == index.length)
        found = Metadata.read(ReadDataStream(BytesIO(self._data[start : start + length])))
        self._metadata[found.name] = found.metadata

    def _ends(self, numbers: Collection[int], chunks: Iterable[_Chunk], place: int) -> dict[int, tuple[int, int]]:
        """Return the time of reception [ns] and the number of the first (place 0) or last (-1) message of channels.

        The chunks come in the order in which they are searched, and each is unpacked once.
        """
        missing, found = set(numbers), {}
        for chunk in chunks:
            if not missing:
                break
            for number in missing.intersection(_numbers_in(chunk.indexes)):
                found[number] = self._message(chunk, number, place)
                missing.remove(number)
        _demand(not missing)
        return found

    def _gaps(self) -> dict[tuple[str, str], list[int]]:
        """Return the numbers of messages in the gaps that the recorder has recorded, by channel name and source."""
        gaps: dict[tuple[str, str], list[int]] = {}
        numbers = {number for number, channel in self._channels.items() if channel.topic == GAP_TOPIC}
        for chunk in self._chunks if numbers else ():
            for number in numbers.intersection(_numbers_in(chunk.indexes)):
                content = self._content(chunk)
                for _, offset in self._entries(chunk, number):
                    fields = msgpack.unpackb(self._payload(content, offset), use_list=False)
                    gaps.setdefault((fields["channel_topic"], fields["src"]), []).append(fields["count"])
        return gaps

    def _row(
        self,
        number: int,
        count: int,
        begin: tuple[int, int],
        end: tuple[int, int],
        gaps: dict[tuple[str, str], list[int]],
    ) -> ChannelInfo:
        channel, (first_ns, first), (last_ns, last) = self._channels[number], begin, end
        found = gaps.get((channel.channel_topic, channel.src), [])
        if channel.via == "direct" and channel.topic not in RECORD_TOPICS:
            _demand(((last - first) & _SEQUENCE_MASK) + 1 == count + sum(found))
        span_ns = last_ns - first_ns
        return ChannelInfo(
            channel_topic=channel.channel_topic,
            topic=channel.topic,
            src=channel.src,
            site=channel.site,
            via=channel.via,
            declared_rate_hz=channel.rate_hz,
            messages=count,
            size_bytes=None,
            rate_hz=(count - 1) * 1e9 / span_ns if span_ns > 0 else 0.0,
            first_ns=first_ns,
            last_ns=last_ns,
            gaps=len(found),
            lost=sum(found),
            repeated=None,
            restarts=None,
        )

    def _message(self, chunk: _Chunk, number: int, place: int) -> tuple[int, int]:
        """Return the time of reception [ns] and the number of the first or last message of a channel in a chunk."""
        log_ns, offset = list(self._entries(chunk, number))[place]
        channel, seq, stated_ns, _ = MESSAGE_HEAD.unpack_from(self._content(chunk), offset + RECORD_HEAD.size)
        _demand((channel, stated_ns) == (number, log_ns))
        return log_ns, seq

    def _entries(self, chunk: _Chunk, number: int) -> Iterator[tuple[int, int]]:
        start = channels_in(chunk.indexes)[number]
        opcode, length = RECORD_HEAD.unpack_from(self._data, start)
        body = self._data[start + RECORD_HEAD.size : start + RECORD_HEAD.size + length]
        channel, size = INDEX_HEAD.unpack_from(body)
        _demand((opcode, channel) == (Opcode.MESSAGE_INDEX, number) and size == len(body) - INDEX_HEAD.size)
        found: Any = _ENTRY.iter_unpack(body[INDEX_HEAD.size :])
        yield from found

    def _content(self, chunk: _Chunk) -> bytes:
        if self._unpacked[0] != chunk.offset:
            block = chunk_at(self._data, chunk.offset, chunk.offset + chunk.length)
            _demand(block is not None)
            assert block is not None
            self._unpacked = chunk.offset, unpack(self._data, block)
        return self._unpacked[1]

    @staticmethod
    def _payload(content: bytes, offset: int) -> bytes:
        _, length = RECORD_HEAD.unpack_from(content, offset)
        start = offset + RECORD_HEAD.size
        return content[start + MESSAGE_HEAD.size : start + length]


# by the place of a chunk, the channels in it and the places of their message indexes, as the file has them
ChannelIndexes = dict[int, bytes]


def layout_by_index(data: mmap.mmap, path: str) -> tuple[Layout, ChannelIndexes] | None:
    """Return the structure of a closed file by its index, and where the messages of a channel are.

    None stands for a file that has to be read as a whole. What lies between the chunks is not looked at, and the
    checksum of a chunk is in its head.
    """
    try:
        return _layout_by_index(data, path)
    except (_DisagreementError, *UNREADABLE, ValueError, KeyError, IndexError):
        return None


def _layout_by_index(data: mmap.mmap, path: str) -> tuple[Layout, ChannelIndexes]:
    layout, indexes, counts = Layout(path=path, finished=True), ChannelIndexes(), None
    _demand(len(data) >= 2 * len(MAGIC) + _FOOTER.size)
    for opcode, body in _summary_records(data):
        if opcode == Opcode.CHUNK_INDEX:
            first_ns, last_ns, offset, length, size = _CHUNK_INDEX.unpack_from(body)
            end = _CHUNK_INDEX.size + size
            indexes[offset] = body[_CHUNK_INDEX.size : end]
            (name_length,) = _NAME_LENGTH.unpack_from(body, end + 8)
            name = body[end + 12 : end + 12 + name_length].decode("ascii")
            stored, unpacked = _SIZES.unpack_from(body, end + 12 + name_length)
            block_end = offset + length
            layout.blocks.append(
                Block(offset, block_end - stored, block_end, name, unpacked, first_ns=first_ns, last_ns=last_ns)
            )
        elif opcode == Opcode.STATISTICS:
            counts = Statistics.read(ReadDataStream(BytesIO(body)))
        elif opcode in (Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX):
            place = int.from_bytes(body[:8], "little")
            kind, length = RECORD_HEAD.unpack_from(data, place)
            _demand(kind == (Opcode.ATTACHMENT if opcode == Opcode.ATTACHMENT_INDEX else Opcode.METADATA))
            add_other(data, place, place + RECORD_HEAD.size + length, kind, layout)
        elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
            add_record(opcode, body, layout)
    # Messages outside of chunks are in no index.
    _demand(counts is not None and counts.chunk_count == len(layout.blocks) > 0 and not layout.damage)
    assert counts is not None
    _demand(sum(counts.channel_message_counts.values()) == counts.message_count)
    layout.blocks.sort(key=lambda block: block.offset)
    return layout, indexes


def channels_in(indexes: bytes) -> dict[int, int]:
    """Return by its number each channel that a chunk has, and the place of its message index in the file."""
    return dict(_OFFSET.iter_unpack(indexes))


def _numbers_in(indexes: bytes) -> Iterable[int]:
    """Return the numbers of the channels that a chunk has."""
    return chain.from_iterable(_NUMBER.iter_unpack(indexes))


def _summary_records(data: mmap.mmap) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and body of each record of the summary; _DisagreementError where it is not whole."""
    footer = len(data) - len(MAGIC) - _FOOTER.size
    opcode, _, start, _, crc = _FOOTER.unpack_from(data, footer)
    _demand(data[: len(MAGIC)] == MAGIC == data[-len(MAGIC) :] and opcode == Opcode.FOOTER)
    _demand(0 < start < footer and crc == zlib.crc32(data[start : footer + _FOOTER.size - 4]))
    section = data[start:footer]
    for opcode, first, last in records_of(section):
        yield opcode, section[first:last]


def _attachment(index: AttachmentIndex) -> AttachmentInfo:
    return AttachmentInfo(name=index.name, media_type=index.media_type, size_bytes=index.data_size)


def _demand(agreed: bool) -> None:
    if not agreed:
        raise _DisagreementError
