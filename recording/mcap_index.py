"""Check of what other readers of a file go by: header, message indexes, and the summary with its indexes and checksums.

Every index is compared with what it ought to be by the messages, chunks and attachments that are in the file. Parts
that a writer may leave out, such as the summary, are not asked for; what is there has to be right.
"""

import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from io import BytesIO
from typing import Any

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from recording.mcap_scan import (
    MAGIC,
    MESSAGE_HEAD,
    RECORD_HEAD,
    UNREADABLE,
    Bytes,
    DamagedBlockError,
    chunk_at,
    records_of,
    unpack,
)

_INDEX_HEAD = struct.Struct("<HI")
_INDEX_ENTRY = struct.Struct("<QQ")
_FOOTER_HEAD = struct.Struct("<BQQQ")
# readers look for it at this distance from the end of the file
_FOOTER_BYTES = 20
_CRC_STEP = 1 << 20

# log time [ns] and offset within the chunk, of each message of a channel
Entries = dict[int, list[tuple[int, int]]]
# opcode, start and end of a record
Place = tuple[int, int, int]


@dataclass(frozen=True)
class _Kind:
    """A kind of record that stands in the summary: its name in messages, and the field that identifies one."""

    name: str
    read: Callable[[ReadDataStream], Any]
    key: str


_SUMMARY_KINDS = {
    Opcode.SCHEMA: _Kind("schema", Schema.read, "id"),
    Opcode.CHANNEL: _Kind("channel", Channel.read, "id"),
    Opcode.STATISTICS: _Kind("statistics", Statistics.read, ""),
    Opcode.CHUNK_INDEX: _Kind("chunk index", ChunkIndex.read, "chunk_start_offset"),
    Opcode.ATTACHMENT_INDEX: _Kind("attachment index", AttachmentIndex.read, "offset"),
    Opcode.METADATA_INDEX: _Kind("metadata index", MetadataIndex.read, "offset"),
}
_NOT_IN_DATA = (*_SUMMARY_KINDS.keys() - {Opcode.SCHEMA, Opcode.CHANNEL}, Opcode.SUMMARY_OFFSET, Opcode.HEADER)


def index_faults(data: Bytes) -> list[str]:
    """Return what is wrong with the indexes of a file that was closed and whose records are whole, as sentences."""
    check = _IndexCheck(data)
    try:
        check.run()
    except _UnreadableError as error:
        check.faults.append(str(error))
    return check.faults


class _UnreadableError(Exception):
    """A record that cannot be read; the text names it."""


def _no_statistics() -> Statistics:
    counts = dict.fromkeys(("attachment_count", "channel_count", "chunk_count", "message_count"), 0)
    counts |= dict.fromkeys(("message_start_time", "message_end_time", "metadata_count", "schema_count"), 0)
    return Statistics(channel_message_counts={}, **counts)


@dataclass
class _Actual:
    """What the indexes ought to hold, by what is in the file; records by the key of their kind."""

    statistics: Statistics = field(default_factory=_no_statistics)
    records: dict[int, dict[int, McapRecord]] = field(
        default_factory=lambda: {opcode: {} for opcode in _SUMMARY_KINDS if opcode != Opcode.STATISTICS}
    )

    def count(self, entries: Entries) -> None:
        """Count messages."""
        statistics = self.statistics
        for channel, found in entries.items():
            counts = statistics.channel_message_counts
            counts[channel] = counts.get(channel, 0) + len(found)
            first_ns, last_ns = min(found)[0], max(found)[0]
            if statistics.message_count:
                first_ns = min(first_ns, statistics.message_start_time)
            statistics.message_start_time = first_ns
            statistics.message_end_time = max(last_ns, statistics.message_end_time)
            statistics.message_count += len(found)


class _IndexCheck:
    """One walk through the records of a file, first the data, then the summary."""

    def __init__(self, data: Bytes) -> None:
        self.faults: list[str] = []
        self._data = data
        self._actual = _Actual()
        self._chunk: ChunkIndex | None = None
        # of the messages of that chunk: the indexes that have to follow; None where it cannot be read
        self._entries: Entries | None = None

    def run(self) -> None:
        """Check the whole file; _UnreadableError names a record that cannot be read."""
        summary: list[Place] | None = None
        for place in self._places():
            opcode = place[0]
            if opcode == Opcode.FOOTER:
                self._check_end(place, summary)
                return
            if summary is not None:
                summary.append(place)
            elif opcode == Opcode.DATA_END:
                self._end_chunk()
                self._check_data(place)
                summary = []
            else:
                self._add(place)

    def _places(self) -> Iterator[Place]:
        position = len(MAGIC)
        opcode, _ = self._head(position)
        if opcode != Opcode.HEADER:
            self.faults.append("the file does not begin with a header")
        else:
            end = self._head(position)[1]
            self._read(Header.read, (opcode, position, end))
            position = end
        while position < len(self._data) - len(MAGIC):
            opcode, end = self._head(position)
            yield opcode, position, end
            position = end

    def _head(self, position: int) -> tuple[int, int]:
        try:
            opcode, length = RECORD_HEAD.unpack_from(self._data, position)
        except struct.error as error:
            raise _UnreadableError(f"there is no record at byte {position}") from error
        return opcode, position + RECORD_HEAD.size + length

    def _body(self, place: Place) -> bytes:
        return self._data[place[1] + RECORD_HEAD.size : place[2]]

    def _read(self, read: Callable[[ReadDataStream], Any], place: Place) -> Any:
        """Return a record whose lengths agree with one another, which the package itself does not ask for."""
        try:
            return _parsed(read, self._body(place))
        except UNREADABLE as error:
            raise _UnreadableError(f"the record at byte {place[1]} cannot be read") from error

    def _add(self, place: Place) -> None:
        """Take note of a record of the data section, and check a message index."""
        opcode, start, end = place
        if opcode == Opcode.MESSAGE_INDEX:
            self._check_message_index(place)
            return
        self._end_chunk()
        records, statistics = self._actual.records, self._actual.statistics
        if opcode == Opcode.CHUNK:
            self._begin_chunk(place)
        elif opcode == Opcode.ATTACHMENT:
            statistics.attachment_count += 1
            records[Opcode.ATTACHMENT_INDEX][start] = self._attachment_index(place)
        elif opcode == Opcode.METADATA:
            statistics.metadata_count += 1
            name = self._read(Metadata.read, place).name
            records[Opcode.METADATA_INDEX][start] = MetadataIndex(offset=start, length=end - start, name=name)
        elif opcode in _NOT_IN_DATA:
            self.faults.append(f"the record at byte {start} does not belong in the data section")
        else:
            entries: Entries = {}
            self._add_content(opcode, self._body(place), 0, entries)
            self._actual.count(entries)

    def _attachment_index(self, place: Place) -> AttachmentIndex:
        # its own checksum covers its lengths, and was checked when it was read
        try:
            found = Attachment.read(ReadDataStream(BytesIO(self._body(place))))
        except UNREADABLE as error:
            raise _UnreadableError(f"the attachment at byte {place[1]} cannot be read") from error
        return AttachmentIndex(
            offset=place[1],
            length=place[2] - place[1],
            log_time=found.log_time,
            create_time=found.create_time,
            data_size=len(found.data),
            name=found.name,
            media_type=found.media_type,
        )

    def _add_content(self, opcode: int, body: bytes, offset: int, entries: Entries) -> None:
        """Take note of a schema or a channel, or add the entry of a message that begins at an offset of its chunk."""
        if opcode == Opcode.MESSAGE:
            channel, _, log_ns, _ = MESSAGE_HEAD.unpack_from(body)
            entries.setdefault(channel, []).append((log_ns, offset))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            try:
                record = _parsed(_SUMMARY_KINDS[Opcode(opcode)].read, body)
            except UNREADABLE as error:
                raise _UnreadableError(f"a {_SUMMARY_KINDS[Opcode(opcode)].name} cannot be read") from error
            self._actual.records[opcode][record.id] = record

    def _begin_chunk(self, place: Place) -> None:
        _, start, end = place
        block = chunk_at(self._data, start, end)
        if block is None:
            raise _UnreadableError(f"the chunk at byte {start} cannot be read")
        self._actual.statistics.chunk_count += 1
        try:
            content = unpack(self._data, block)
        except DamagedBlockError:
            # whoever reads the messages reports it
            self._entries = None
        else:
            self._entries = {}
            last = 0
            for opcode, first, last in records_of(content):
                self._add_content(opcode, content[first:last], first - RECORD_HEAD.size, self._entries)
            if last != len(content):
                rest = len(content) - last
                self.faults.append(f"the chunk at byte {start} ends with {rest} bytes that are no records")
            self._actual.count(self._entries)
            times = [log_ns for found in self._entries.values() for log_ns, _ in found]
            if times and (min(times), max(times)) != (block.first_ns, block.last_ns):
                self.faults.append(f"the chunk at byte {start} states other times than those of its messages")
        self._chunk = ChunkIndex(
            chunk_length=end - start,
            chunk_start_offset=start,
            compression=block.compression,
            compressed_size=block.data_end - block.data_start,
            message_end_time=block.last_ns,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=block.first_ns,
            uncompressed_size=block.size_bytes,
        )
        self._actual.records[Opcode.CHUNK_INDEX][start] = self._chunk

    def _check_message_index(self, place: Place) -> None:
        _, start, end = place
        chunk = self._chunk
        if chunk is None:
            self.faults.append(f"the message index at byte {start} belongs to no chunk")
            return
        body = self._body(place)
        if len(body) < _INDEX_HEAD.size:
            raise _UnreadableError(f"the message index at byte {start} cannot be read")
        channel, length = _INDEX_HEAD.unpack_from(body)
        stored = body[_INDEX_HEAD.size : _INDEX_HEAD.size + length]
        fits = len(stored) == length and length % _INDEX_ENTRY.size == 0
        found = sorted(_INDEX_ENTRY.iter_unpack(stored)) if fits else None
        if self._entries is not None and found != sorted(self._entries.pop(channel, [])):
            where = f"channel {channel} in the chunk at byte {chunk.chunk_start_offset}"
            self.faults.append(f"the message index of {where} is wrong")
        chunk.message_index_offsets[channel] = start
        chunk.message_index_length += end - start

    def _end_chunk(self) -> None:
        chunk, self._chunk = self._chunk, None
        # a writer may leave all of them out, not some
        if chunk is not None and chunk.message_index_offsets and self._entries:
            where = f"the chunk at byte {chunk.chunk_start_offset}"
            self.faults.append(f"{where} lacks the message index of channel {', '.join(map(str, self._entries))}")

    def _check_data(self, place: Place) -> None:
        stored = self._read(DataEnd.read, place).data_section_crc
        if stored and stored != _crc(self._data, 0, place[1]):
            self.faults.append("the checksum of the data section is wrong")
        statistics, records = self._actual.statistics, self._actual.records
        statistics.schema_count = len(records[Opcode.SCHEMA])
        statistics.channel_count = len(records[Opcode.CHANNEL])

    def _check_end(self, place: Place, summary: list[Place] | None) -> None:
        _, position, end = place
        if summary is None or end - position != RECORD_HEAD.size + _FOOTER_BYTES:
            self.faults.append("the end of the data section or the footer is not where other readers look for it")
            return
        footer: Footer = self._read(Footer.read, place)
        start = summary[0][1] if summary else 0
        if footer.summary_start != start:
            self.faults.append("the footer states another place of the summary than where it is")
        offsets = [first for opcode, first, _ in summary if opcode == Opcode.SUMMARY_OFFSET]
        if footer.summary_offset_start != (offsets[0] if offsets else 0):
            self.faults.append("the footer states another place of the summary offsets than where they are")
        head = _FOOTER_HEAD.pack(Opcode.FOOTER, _FOOTER_BYTES, footer.summary_start, footer.summary_offset_start)
        if summary and footer.summary_crc and footer.summary_crc != zlib.crc32(head, _crc(self._data, start, position)):
            self.faults.append("the checksum of the summary is wrong")
        self._check_summary(summary)

    def _check_summary(self, summary: Iterable[Place]) -> None:
        found: dict[int, list[Any]] = {}
        groups: dict[int, tuple[int, int]] = {}
        offsets: list[SummaryOffset] = []
        for place in summary:
            opcode, start, end = place
            if opcode == Opcode.SUMMARY_OFFSET:
                offsets.append(self._read(SummaryOffset.read, place))
                continue
            first, _ = groups.get(opcode, (start, 0))
            groups[opcode] = (first, end - first)
            if opcode not in _SUMMARY_KINDS:
                self.faults.append(f"the record at byte {start} does not belong in the summary")
                continue
            found.setdefault(opcode, []).append(self._read(_SUMMARY_KINDS[Opcode(opcode)].read, place))
        for opcode, actual in self._actual.records.items():
            if opcode in found:
                self._compare(_SUMMARY_KINDS[Opcode(opcode)], found[opcode], actual)
        self._check_statistics(found.get(Opcode.STATISTICS, []))
        stated = {each.group_opcode: (each.group_start, each.group_length) for each in offsets if each.group_length}
        if stated and stated != groups:
            self.faults.append("the summary offsets state other places than where the parts of the summary are")

    def _compare(self, kind: _Kind, found: Iterable[Any], actual: Mapping[int, McapRecord]) -> None:
        """Compare all records of a kind with what they ought to be."""
        stored = {getattr(record, kind.key): record for record in found}
        for key in sorted({*stored, *actual}):
            if key not in actual:
                self.faults.append(f"the summary has a {kind.name} with {kind.key} {key}, which is not in the file")
            elif key not in stored:
                self.faults.append(f"the summary lacks the {kind.name} with {kind.key} {key}")
            elif wrong := _different(stored[key], actual[key]):
                self.faults.append(f"the {kind.name} with {kind.key} {key} in the summary is wrong: {wrong}")

    def _check_statistics(self, found: list[Any]) -> None:
        if len(found) > 1:
            self.faults.append("the summary has more than one statistics record")
        for statistics in found:
            counts = statistics.channel_message_counts
            statistics.channel_message_counts = {channel: count for channel, count in counts.items() if count}
            if wrong := _different(statistics, self._actual.statistics):
                self.faults.append(f"the statistics in the summary are wrong: {wrong}")


def _parsed(read: Callable[[ReadDataStream], Any], body: bytes) -> Any:
    """Return a record; struct.error when its lengths do not agree with one another."""
    record = read(ReadDataStream(BytesIO(body)))
    # Any: the package carries no types
    again: Any = RecordBuilder()
    record.write(again)
    # a later version of the format may append fields
    if not body.startswith(again.end()[RECORD_HEAD.size :]):
        raise struct.error("the lengths within the record do not agree")
    return record


def _different(stored: Any, actual: Any) -> str:
    """Name the fields that differ."""
    names = [one.name for one in fields(stored) if getattr(stored, one.name) != getattr(actual, one.name)]
    return ", ".join(names)


def _crc(data: Bytes, start: int, end: int) -> int:
    crc = 0
    for position in range(start, end, _CRC_STEP):
        crc = zlib.crc32(data[position : min(position + _CRC_STEP, end)], crc)
    return crc
