"""Summary of a closed recording from its own index, without reading its messages.

It is returned only if the numbers agree: for each channel received at its publisher's site, the first and last sequence
number must fit the count in the statistics and the recorded gaps. If a process was restarted its numbers restart too,
and bisection finds the place. A file with a missing part, odd times, or an index that is damaged or names a part twice
must be read as a whole.
"""

import mmap
import struct
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator
from io import BytesIO
from itertools import accumulate, chain, pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgpack
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Statistics

from telenano.files.regular_files import open_regular
from telenano.recording.answered_commands import ANSWER_TOPIC, COMMAND_TOPIC, AnsweredCommands
from telenano.recording.info import ChannelInfo, RecordingInfo, attachments_of, notes_of
from telenano.recording.mcap_scan import (
    MAGIC,
    MESSAGE_HEAD,
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
from telenano.recording.messages import ChannelFilter, RecordedMessage, recorded_channel
from telenano.recording.odd_times import LONGEST_PAUSE_NS, Dates
from telenano.recording.record_topics import GAP_TOPIC, RECORD_TOPICS
from telenano.wire.errors import RecordingError
from telenano.wire.sequence import total

_FOOTER = struct.Struct("<BQQQI")
_CHUNK_INDEX = struct.Struct("<QQQQI")
_OFFSET = struct.Struct("<HQ")
# The same entry, of which only the channel number is read.
_NUMBER = struct.Struct("<H8x")
_ENTRY = struct.Struct("<QQ")
_INDEX_HEAD = struct.Struct("<HI")
_NAME_LENGTH = struct.Struct("<I")
_SIZES = struct.Struct("<QQ")
_SEQUENCE_MASK = 0xFFFF_FFFF
# Unpacked chunks are kept up to this size [bytes].
_MOST_KEPT = 32 << 20

_T = TypeVar("_T")


class _DisagreementError(Exception):
    """The index does not suffice for a summary, so the messages must be read."""


class _Stamp(NamedTuple):
    """Reception time and publisher's time [ns] and sequence number of a message."""

    log_ns: int
    publish_ns: int
    seq: int


# Counts of each person's commands, as `telenano.recording.people` returns them.
People = dict[str, dict[str, int]]


def quick_info(path: Path) -> RecordingInfo | None:
    """Return the summary of a closed file from its index; None if the messages must be read for it.

    Facts that only messages reveal are None: size and repetitions of a channel, restarts unless counted, the recorder's
    lag. Raises OSError if the file cannot be opened.
    """
    return _quickly(path, lambda summary: summary.info())


def quick_info_with_people(path: Path) -> tuple[RecordingInfo, People] | None:
    """Return the result of `quick_info` and the counts of people's commands; None if the messages must be read."""
    return _quickly(path, lambda summary: (summary.info(), summary.people()))


def _quickly(path: Path, read: "Callable[[_Summary], _T]") -> "_T | None":
    with open_regular(path) as file:
        try:
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                return read(_Summary(data, path))
        except (_DisagreementError, DamagedBlockError, RecordingError, *UNREADABLE, ValueError, KeyError, IndexError):
            return None


class _Summary:
    """Structure of a file from its index, and the facts on its messages that follow from it."""

    def __init__(self, data: mmap.mmap, path: Path) -> None:
        self._data, self._path = data, path
        self._layout, self._indexes, self._statistics = _layout_by_index(data, str(path))
        self._channels = {
            number: recorded_channel(channel) for number, channel in self._layout.summary_channels.items()
        }
        # Recently unpacked chunks, by their offset.
        self._unpacked: dict[int, bytes] = {}

    def info(self) -> RecordingInfo:
        """Return the summary; raise _DisagreementError if `Recording.info` might find more."""
        statistics, layout = self._statistics, self._layout
        counts = {number: statistics.channel_message_counts.get(number, 0) for number in self._channels}
        numbers = [number for number, count in counts.items() if count > 0]
        first, last = self._ends(numbers, layout.blocks, 0), self._ends(numbers, reversed(layout.blocks), -1)
        gaps = self._gaps()
        rows = [self._row(number, counts[number], first[number], last[number], gaps) for number in numbers]
        _demand(sum(row.messages for row in rows) == statistics.message_count)
        lost = [(row.lost, row) for row in rows if row.via == "direct" and row.lost]
        missing = [
            f"{count} messages of {row.src or 'a source'} on {row.channel_topic} are missing" for count, row in lost
        ]
        # More sentences are summarised by `RecordingStatistics.missing`, in the reading of all messages.
        _demand(len(missing) <= 5)
        commands = AnsweredCommands()
        for message in self.select(lambda channel: channel.topic in (COMMAND_TOPIC, ANSWER_TOPIC)):
            commands.add(message.channel.topic, message.fields())
        missing += commands.missing()
        missing += notes_of([layout.metadata])
        start_ns, end_ns = self._span()
        return RecordingInfo(
            path=str(self._path),
            size_bytes=len(self._data),
            start_ns=start_ns,
            end_ns=end_ns,
            duration_s=(end_ns - start_ns) * 1e-9,
            messages=statistics.message_count,
            complete=not missing,
            missing=tuple(missing),
            lost=total(count for count, _ in lost),
            commands=commands.answered,
            commands_by_answer=commands.by_answer_alone,
            closed=True,
            basis="summary",
            recorder_lag=None,
            skipped_bytes=0,
            damage=(),
            odd=(),
            parts=(),
            channels=tuple(rows),
            attachments=attachments_of(layout.attachments),
            metadata=layout.metadata,
        )

    def people(self) -> People:
        """Return the counts of people's commands; without a `session/` channel no message is read."""
        if not any(channel.topic.startswith("session/") for channel in self._channels.values()):
            return {}
        from telenano.recording.people import people_in

        return people_in(self)

    def select(self, wanted: ChannelFilter) -> Iterator[RecordedMessage]:
        """Yield the messages of the wanted channels, in the order of the file."""
        channels = {number: channel for number, channel in self._channels.items() if wanted(channel)}
        for chunk in self._layout.blocks:
            found = [
                (offset, number, log_ns)
                for number in channels.keys() & set(self._numbers_in(chunk))
                for log_ns, offset in self._entries(chunk, number)
            ]
            for offset, number, log_ns in sorted(found):
                stamp = self._stamp(chunk, number, log_ns, offset)
                yield RecordedMessage(channels[number], *stamp, self._payload(self._content(chunk), offset))
            # Release the chunk at once: reused memory is cheaper than new memory.
            self._unpacked.pop(chunk.offset, None)

    def _span(self) -> tuple[int, int]:
        """Return the times of the first and the last message [ns]; raise _DisagreementError if some are odd."""
        dates, span = Dates(), (self._statistics.message_start_time, self._statistics.message_end_time)
        for chunk in self._layout.blocks:
            # A chunk without messages has the bounds 0.
            if chunk.last_ns:
                _demand(chunk.last_ns - chunk.first_ns <= LONGEST_PAUSE_NS)
                dates.add(chunk.first_ns, chunk.last_ns, 1)
        _demand(len(dates.groups()) == 1 and dates.most() == span)
        return span

    def _ends(self, numbers: Collection[int], chunks: Iterable[Block], place: int) -> dict[int, _Stamp]:
        """Return the stamp of the first (place 0) or last (place -1) message of each channel number.

        `chunks` are in the order of the search; each is unpacked once.
        """
        missing, ends = set(numbers), {}
        for chunk in chunks:
            if not missing:
                break
            for number in missing.intersection(self._numbers_in(chunk)):
                ends[number] = self._message(chunk, number, place)
                missing.remove(number)
        _demand(not missing)
        return ends

    def _gaps(self) -> "_Gaps":
        """Return first missing number and count of each recorded gap, by channel name and source."""
        gaps: _Gaps = {}
        numbers = {number for number, channel in self._channels.items() if channel.topic == GAP_TOPIC}
        for chunk in self._layout.blocks if numbers else ():
            for number in numbers.intersection(self._numbers_in(chunk)):
                content = self._content(chunk)
                for _, offset in self._entries(chunk, number):
                    fields = msgpack.unpackb(self._payload(content, offset), use_list=False)
                    gaps.setdefault((fields["channel_topic"], fields["src"]), []).append(
                        (fields["first_missing"] & _SEQUENCE_MASK, fields["count"])
                    )
        return gaps

    def _row(self, number: int, count: int, begin: _Stamp, end: _Stamp, gaps: "_Gaps") -> ChannelInfo:
        channel, restarts = self._channels[number], None
        gaps_of_channel = gaps.get((channel.channel_topic, channel.src), [])
        lost = sum(missing for _, missing in gaps_of_channel)
        if channel.via == "direct" and channel.topic not in RECORD_TOPICS and _grown(begin, end) != count + lost:
            restarts = self._restarts(number, count, begin, end, gaps_of_channel)
        span_ns = end.log_ns - begin.log_ns
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
            first_ns=begin.log_ns,
            last_ns=end.log_ns,
            gaps=len(gaps_of_channel),
            lost=lost,
            repeated=None,
            restarts=restarts,
        )

    def _restarts(self, number: int, count: int, begin: _Stamp, end: _Stamp, gaps: Iterable[tuple[int, int]]) -> int:
        """Return the number of restarts of a channel's sequence; raise _DisagreementError for an unexplained step.

        Bisection unpacks only chunks around which the numbers do not grow by the count of messages between them.
        """
        chunks = [chunk for chunk in self._layout.blocks if number in self._numbers_in(chunk)]
        counts = [0, *accumulate(self._index(chunk, number)[1] // _ENTRY.size for chunk in chunks)]
        _demand(counts[-1] == count)

        left = list(gaps)

        def take(first: int) -> int:
            """Return the length of the next gap, and remove it, if it begins with a number; else 0."""
            return left.pop(0)[1] if left and left[0][0] == first else 0

        def step(before: _Stamp, after: _Stamp) -> int:
            # The last messages of the process that ended may also be missing.
            missing = take(before.seq + 1)
            if after.seq > before.seq:
                _demand(_grown(before, after) == 2 + missing)
                return 0
            # And so may the first of the next one.
            _demand(after.publish_ns > before.publish_ns and take(0) == after.seq)
            return 1

        def sought(first: int, last: int, begin: _Stamp, end: _Stamp) -> int:
            if _grown(begin, end) == counts[last + 1] - counts[first]:
                return 0
            if first == last:
                return sum(step(*pair) for pair in pairwise(self._messages(chunks[first], number)))
            middle = (first + last) // 2
            before, after = self._message(chunks[middle], number, -1), self._message(chunks[middle + 1], number, 0)
            return sought(first, middle, begin, before) + step(before, after) + sought(middle + 1, last, after, end)

        restarts = sought(0, len(chunks) - 1, begin, end)
        take(end.seq + 1)
        _demand(not left)
        return restarts

    def _message(self, chunk: Block, number: int, place: int) -> _Stamp:
        """Return the stamp of the first (place 0) or last (place -1) message of a channel in a chunk."""
        start, size = self._index(chunk, number)
        start += place % max(1, size // _ENTRY.size) * _ENTRY.size
        return self._stamp(chunk, number, *_ENTRY.unpack_from(self._data, start))

    def _messages(self, chunk: Block, number: int) -> Iterator[_Stamp]:
        return (self._stamp(chunk, number, *entry) for entry in self._entries(chunk, number))

    def _stamp(self, chunk: Block, number: int, log_ns: int, offset: int) -> _Stamp:
        """Return the stamp of a message from its index entry; raise _DisagreementError if the entry is wrong."""
        channel, seq, stated_ns, publish_ns = MESSAGE_HEAD.unpack_from(self._content(chunk), offset + RECORD_HEAD.size)
        _demand((channel, stated_ns) == (number, log_ns))
        return _Stamp(log_ns, publish_ns, seq)

    def _index(self, chunk: Block, number: int) -> tuple[int, int]:
        """Return file offset and size of the index entries of a channel in a chunk [bytes]."""
        start = _channels_in(self._indexes[chunk.offset])[number]
        opcode, length = RECORD_HEAD.unpack_from(self._data, start)
        channel, size = _INDEX_HEAD.unpack_from(self._data, start + RECORD_HEAD.size)
        _demand((opcode, channel) == (Opcode.MESSAGE_INDEX, number) and size == length - _INDEX_HEAD.size)
        return start + RECORD_HEAD.size + _INDEX_HEAD.size, size

    def _entries(self, chunk: Block, number: int) -> Iterator[tuple[int, int]]:
        start, size = self._index(chunk, number)
        unpacked: Any = _ENTRY.iter_unpack(self._data[start : start + size])
        yield from unpacked

    def _content(self, chunk: Block) -> bytes:
        if chunk.offset not in self._unpacked:
            block = chunk_at(self._data, chunk.offset, chunk.data_end)
            _demand(block is not None)
            assert block is not None
            if sum(map(len, self._unpacked.values())) > _MOST_KEPT:
                self._unpacked.clear()
            self._unpacked[chunk.offset] = unpack(self._data, block)
        return self._unpacked[chunk.offset]

    def _numbers_in(self, chunk: Block) -> Iterable[int]:
        """Return the numbers of the channels in a chunk."""
        return chain.from_iterable(_NUMBER.iter_unpack(self._indexes[chunk.offset]))

    @staticmethod
    def _payload(content: bytes, offset: int) -> bytes:
        _, length = RECORD_HEAD.unpack_from(content, offset)
        start = offset + RECORD_HEAD.size
        return content[start + MESSAGE_HEAD.size : start + length]


# First missing number and count of each gap, by channel name and source.
_Gaps = dict[tuple[str, str], list[tuple[int, int]]]
# Packed channel numbers and message index offsets of each chunk, by the chunk's offset.
_ChannelIndexes = dict[int, bytes]


def _layout_by_index(data: mmap.mmap, path: str) -> tuple[Layout, _ChannelIndexes, Statistics]:
    """Return the structure of a closed file from its index, the message indexes of its chunks, and the statistics.

    Bytes between the indexed parts are not read. Raises _DisagreementError if the index is incomplete.
    """
    layout, indexes, counts = Layout(path=path, finished=True), _ChannelIndexes(), None
    others: list[tuple[int, int, int]] = []
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
            others.append((place, RECORD_HEAD.size + length, kind))
        elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
            add_record(opcode, body, layout)
    _demand_apart(
        [*(part[:2] for part in others), *((block.offset, block.data_end - block.offset) for block in layout.blocks)]
    )
    for place, length, kind in others:
        add_other(data, place, place + length, kind, layout)
    # Without a chunk the messages may lie outside of chunks, where no index has them.
    _demand(counts is not None and counts.chunk_count == len(layout.blocks) > 0 and not layout.damage)
    assert counts is not None
    _demand(sum(counts.channel_message_counts.values()) == counts.message_count)
    layout.blocks.sort(key=lambda block: block.offset)
    return layout, indexes, counts


def _channels_in(indexes: bytes) -> dict[int, int]:
    """Return the file offset of the message index of each channel in a chunk, by channel number."""
    return dict(_OFFSET.iter_unpack(indexes))


def _summary_records(data: mmap.mmap) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and body of each record of the summary; raise _DisagreementError if its checksum is wrong."""
    footer = len(data) - len(MAGIC) - _FOOTER.size
    opcode, _, start, _, crc = _FOOTER.unpack_from(data, footer)
    _demand(data[: len(MAGIC)] == MAGIC == data[-len(MAGIC) :] and opcode == Opcode.FOOTER)
    _demand(0 < start < footer and crc == zlib.crc32(data[start : footer + _FOOTER.size - 4]))
    section = data[start:footer]
    for opcode, first, last in records_of(section):
        yield opcode, section[first:last]


def _grown(begin: _Stamp, end: _Stamp) -> int:
    """Return the count of sequence numbers from one message to another, both included, modulo 2^32."""
    return ((end.seq - begin.seq) & _SEQUENCE_MASK) + 1


def _demand_apart(parts: Iterable[tuple[int, int]]) -> None:
    """Raise _DisagreementError if two parts of the file, given as offset and length, overlap or are the same."""
    end = 0
    for place, length in sorted(parts):
        _demand(place >= end)
        end = place + length


def _demand(agreed: bool) -> None:
    if not agreed:
        raise _DisagreementError
