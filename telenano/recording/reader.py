"""Reader of recordings that also reads files which are unfinished, cut off or damaged."""

import mmap
import os
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Schema

from telenano.files.regular_files import open_regular
from telenano.recording.info import (
    END_NAME,
    PartInfo,
    RecordingInfo,
    RecordingStatistics,
    attachments_of,
    notes_of,
    unclosed_text,
)
from telenano.recording.mcap_index import index_faults
from telenano.recording.mcap_scan import (
    MAGIC,
    MESSAGE_HEAD,
    MOST_DEFINITIONS,
    MOST_MAPPED,
    UNREADABLE,
    Block,
    Damage,
    DamagedBlockError,
    Layout,
    describe_damage,
    records_of,
    release,
    scan,
    too_many_definitions,
    unpack,
)
from telenano.recording.messages import (
    ChannelFilter,
    LeftOut,
    RawMessage,
    RecordedChannel,
    RecordedMessage,
    raw_channel,
    recorded_channel,
)
from telenano.recording.odd_times import LONGEST_PAUSE_NS, Dates, odd_text
from telenano.recording.recorded_fields import RecordedFields
from telenano.wire.errors import NoRecordingError, RecordingError
from telenano.wire.nodes import site_of

END_OF_TIME = 2**64
# A file that ended for this reason is followed by the next one without a pause.
# The uncompressed data of a recording whose records are found once; a longer one is read anew each time [bytes].
_MOST_KEPT = 32 << 20
_PLANNED_END = "split"
# Most bytes of a piece that has several chunks.
_LARGEST_PIECE = 16 << 20
# The lead of a piece may have at least this number of chunks, even if the piece has one.
_LEAD = 2
# Most groups of messages with odd times that are named.
_MOST_NAMED = 5

DamageCallback = Callable[[Damage], None]
SeeMessage = Callable[[RecordedMessage], object]

_ChannelT = TypeVar("_ChannelT")
_MessageT = TypeVar("_MessageT", RecordedMessage, RawMessage)
# `tuple.__new__`: the constructor of a named tuple is a Python function and would take as long as all else.
_new: Any = tuple.__new__


class Recording(RecordedFields):
    """A recording on disk, up to the size that it had when this object was created."""

    def __init__(self, path: str | Path) -> None:
        """Scan the structure of a file; raise RecordingError if it is missing, unreadable or not MCAP."""
        self.path, self.left_out = Path(path), LeftOut()
        # The records of the blocks that were read twice or more, by the place of a block in the file.
        self._sorted: dict[int, SortedBlock] = {}
        self._read: set[int] = set()
        self._kept_bytes = 0
        try:
            # The file stays open, so that a replacement on disk does not affect this object.
            file = open_regular(self.path)
            weakref.finalize(self, file.close)
            self._file = file
            self.size_bytes = os.fstat(file.fileno()).st_size
            start = file.read(len(MAGIC))
        except OSError as error:
            kind = NoRecordingError if isinstance(error, FileNotFoundError) else RecordingError
            raise kind(f"{self.path}: cannot be read: {error.strerror}") from error
        if start != MAGIC:
            what = "ends before its first record" if MAGIC.startswith(start) else "is not an MCAP file"
            raise RecordingError(f"{self.path}: {what if start else 'is empty'}")
        with self._open() as data:
            self._layout = scan(data, str(self.path))

    @property
    def closed(self) -> bool:
        """Whether the file was closed properly, with index and end mark."""
        return self._layout.finished

    @property
    def ending(self) -> str:
        """Reason for which the recorder ended the file: stopped, split or quota; empty if not recorded."""
        return self.metadata.get(END_NAME, {}).get("state", "")

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata records by name, such as `recording` and `versions`."""
        return self._layout.metadata

    @property
    def attachments(self) -> dict[str, bytes]:
        """Files within the recording, by name, such as `site.yaml` and `scenario.yaml`."""
        return {name: attachment.data for name, attachment in self._layout.attachments.items()}

    @cached_property
    def channels(self) -> tuple[RecordedChannel, ...]:
        return tuple(dict.fromkeys(self._channels_by_number.values()))

    @cached_property
    def _channels_by_number(self) -> dict[int, RecordedChannel]:
        table = self._recorded_channels(lambda channel: False)
        if not self.closed:
            for _ in self._walk(table, RecordedMessage):
                pass
        return table.known

    @cached_property
    def span_ns(self) -> tuple[int, int]:
        """First and last reception time of the largest group of messages [ns]; zeros without messages. See `odd`."""
        return self._dates.most()

    @cached_property
    def odd(self) -> tuple[str, ...]:
        """Sentences on oddities that are no loss: messages outside of `span_ns`, and an index that repeats chunks."""
        first_ns, last_ns = span_ns = self.span_ns
        dates, examples = Dates(), dict[int, str]()
        outside = [block for block in self._layout.blocks if block.first_ns < first_ns or block.last_ns > last_ns]
        table = self._recorded_channels(None, self._channels_by_number)
        for message in self._walk(table, RecordedMessage, blocks=outside if len(self._dates.groups()) > 1 else ()):
            if not first_ns <= message.log_ns <= last_ns:
                dates.add(message.log_ns, message.log_ns, 1)
                examples.setdefault(message.log_ns // LONGEST_PAUSE_NS, f"{message.channel_topic}, seq {message.seq}")
        spans = [
            odd_text(group, examples[group.first_ns // LONGEST_PAUSE_NS], span_ns)
            for group in islice(dates.groups(), _MOST_NAMED)
        ]
        if self._layout.repeated:
            spans.append(f"the index names chunks again, {self._layout.repeated} times: each is read once")
        return tuple(spans)

    @cached_property
    def _dates(self) -> Dates:
        """Bytes dated to each day, by the time bounds of the chunks, or by the messages of chunks without bounds."""
        dates, table = Dates(), self._recorded_channels()
        for block in self._layout.blocks:
            if self.closed and block.whole and block.last_ns - block.first_ns <= LONGEST_PAUSE_NS:
                # A chunk without messages has the bounds 0.
                if block.last_ns:
                    dates.add(block.first_ns, block.last_ns, block.size_bytes)
                continue
            for message in self._walk(table, RecordedMessage, blocks=(block,)):
                dates.add(message.log_ns, message.log_ns, MESSAGE_HEAD.size + len(message.payload))
        return dates

    def messages(
        self, topics: Iterable[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RecordedMessage]:
        """Yield messages in the order in which they were received.

        Args:
            topics: Names of channels such as `teleop/forward@slave`, or a single name; None for all.
            start_ns: Earliest reception time, inclusive [ns]; None for no bound.
            end_ns: Latest reception time, exclusive [ns]; None for no bound.
        """
        names = None if topics is None else frozenset([topics] if isinstance(topics, str) else topics)
        return self.select(lambda channel: names is None or channel.channel_topic in names, start_ns, end_ns)

    def select(
        self,
        wanted: ChannelFilter | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
        report: DamageCallback | None = None,
        blocks: Sequence[Block] | None = None,
    ) -> Iterator[RecordedMessage]:
        """Yield messages as `messages` does, of the channels for which `wanted` returns True.

        Chunks outside of the bounds are skipped; if `blocks` are given, only these are read. `report` is called with
        each part that cannot be used.
        """
        first = 0 if start_ns is None else start_ns
        after = END_OF_TIME if end_ns is None else end_ns
        is_whole = start_ns is None and blocks is None
        table = self._recorded_channels(wanted, None if is_whole else self._channels_by_number)
        yield from self._walk(table, RecordedMessage, report, first, after, blocks)

    def pieces(self, length_ns: int, lead_ns: int) -> Iterator["Piece"]:
        """Yield the file in order, in pieces of about `length_ns` [ns]; each chunk is in one piece.

        A piece of several chunks has at most 16 MiB of uncompressed data. Its lead consists of the chunks within
        `lead_ns` before it, at most as many as the piece has (or 2).
        """
        blocks, first, size = self._layout.blocks, 0, 0
        for place, block in enumerate((*blocks, None)):
            size += block.size_bytes if block else 0
            begin_ns = blocks[first].first_ns if blocks else 0
            if place > first and (block is None or block.last_ns - begin_ns > length_ns or size > _LARGEST_PIECE):
                before = blocks[max(0, first - max(_LEAD, place - first)) : first]
                lead = [each for each in before if each.last_ns >= begin_ns - lead_ns]
                yield Piece(self, blocks[first:place], lead)
                first, size = place, block.size_bytes if block else 0

    def newest_before(
        self, time_ns: int, wanted: ChannelFilter | None = None
    ) -> dict[RecordedChannel, RecordedMessage]:
        """Return the newest message of each wanted channel received before a time [ns]; reads the chunks backwards."""
        missing = {channel for channel in self.channels if wanted is None or wanted(channel)}
        newest: dict[RecordedChannel, RecordedMessage] = {}
        for block in reversed(self._layout.blocks):
            if not missing:
                break
            if block.first_ns >= time_ns:
                continue
            newest_of: dict[RecordedChannel, RecordedMessage] = {}
            table = self._recorded_channels(missing.__contains__, self._channels_by_number)
            for message in self._walk(table, RecordedMessage, blocks=(block,)):
                if message.log_ns < time_ns:
                    newest_of[message.channel] = message
            newest |= newest_of
            missing -= set(newest_of)
        return newest

    def raw(self, report: DamageCallback | None = None) -> Iterator[RawMessage]:
        """Yield every message with the complete description of its channel, in the order of the file, for copies.

        `report` is called with each part that proves unusable while reading; `structural_damage` has those found by
        the scan.
        """
        return self._walk(_ChannelTable(self._layout, raw_channel), RawMessage, report)

    @property
    def structural_damage(self) -> tuple[Damage, ...]:
        """Parts of the file that are not records, or damaged records outside of the chunks."""
        return tuple(self._layout.damage)

    def index_faults(self, messages: int) -> list[str]:
        """Return sentences on faults of header and summary, on which other readers rely.

        `messages` is the number of messages that were read from the file, for comparison.
        """
        with self._open() as data:
            return index_faults(data, self._layout, messages)

    @property
    def attachment_records(self) -> dict[str, Attachment]:
        """The attachments with media types and times, by name."""
        return self._layout.attachments

    def info(self, see: SeeMessage | None = None) -> RecordingInfo:
        """Read the whole file, call `see` with each message, and return the summary."""
        return info_of((self,), see)

    def _open(self) -> mmap.mmap:
        try:
            return mmap.mmap(self._file.fileno(), self.size_bytes, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self.path}: cannot be read any more: {error}") from error

    def _content(self, data: mmap.mmap, block: Block) -> bytes:
        """Return the records of a block; raise DamagedBlockError if they cannot be read."""
        return unpack(data, block)

    def _recorded_channels(
        self, wanted: ChannelFilter | None = None, known: Mapping[int, RecordedChannel] | None = None
    ) -> "_ChannelTable[RecordedChannel]":
        return _ChannelTable(self._layout, lambda found, _: recorded_channel(found), wanted, known)

    def _walk(
        self,
        channels: "_ChannelTable[_ChannelT]",
        message_type: type[_MessageT],
        report: DamageCallback | None = None,
        first_ns: int = 0,
        after_ns: int = END_OF_TIME,
        blocks: Iterable[Block] | None = None,
    ) -> Iterator[_MessageT]:
        """Yield the messages of the selected channels, add new channels to the table, report unusable parts.

        Only messages with `first_ns` <= `log_ns` < `after_ns` [ns] are yielded; blocks entirely outside are not read.
        """
        with self._open() as data:
            for block in each_block(data, self._layout.blocks if blocks is None else blocks):
                if block.last_ns < first_ns or block.first_ns >= after_ns:
                    continue
                if report is None and not self._layout.may_have(block, channels.selected, channels.known.keys()):
                    continue
                try:
                    found = self._sorted.get(block.offset) or self._content(data, block)
                except DamagedBlockError as error:
                    if report is not None:
                        report(Damage(block.offset, block.data_end - block.offset, str(error)))
                    continue
                if block.offset not in self._read:
                    self._read.add(block.offset)
                elif isinstance(found, bytes) and block.whole and self._kept_bytes + len(found) <= _MOST_KEPT:
                    found = SortedBlock.of(found) or found
                    if isinstance(found, SortedBlock):
                        self._kept_bytes += len(found.content)
                        self._sorted[block.offset] = found
                if isinstance(found, SortedBlock) and found.define(channels):
                    yield from found.messages(channels.selected, message_type, first_ns, after_ns)
                    continue
                content = found.content if isinstance(found, SortedBlock) else found
                yield from _walked(block, content, channels, message_type, report, first_ns, after_ns)


class SortedBlock(NamedTuple):
    """The records of a whole block, found once for all readings of a recording.

    `rows` has channel number, times, number, begin and end of the payload of each message, in order; `of_channel` the
    same by channel; `definitions` the schemas and channels, each of them before the messages of its channel.
    """

    content: bytes
    rows: list[tuple[int, int, int, int, int, int]]
    of_channel: dict[int, list[tuple[int, int, int, int, int, int]]]
    definitions: list[tuple[int, bytes]]

    @classmethod
    def of(cls, content: bytes) -> "SortedBlock | None":
        """Return the records of a block; None if they have to be read one by one, because something is odd."""
        rows: list[tuple[int, int, int, int, int, int]] = []
        of_channel: dict[int, list[tuple[int, int, int, int, int, int]]] = {}
        definitions: dict[tuple[int, bytes], bytes] = {}
        size, end, unpack_head = MESSAGE_HEAD.size, 0, MESSAGE_HEAD.unpack_from
        for opcode, start, end in records_of(content):
            if opcode == Opcode.MESSAGE:
                number, seq, log_ns, publish_ns = unpack_head(content, start)
                row = (number, log_ns, publish_ns, seq, start + size, end)
                rows.append(row)
                of_channel.setdefault(number, []).append(row)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                body = content[start:end]
                known = definitions.setdefault((opcode, body[:2]), body)
                late = opcode == Opcode.CHANNEL and int.from_bytes(body[:2], "little") in of_channel
                if known != body or (late and known is body):
                    return None
        if end != len(content):
            return None
        return cls(content, rows, of_channel, [(opcode, body) for (opcode, _), body in definitions.items()])

    def define(self, channels: "_ChannelTable[Any]") -> bool:
        """Add the channels of the block to a table; return whether it then has the channel of every message."""
        for opcode, body in self.definitions:
            channels.read(opcode, body)
        return self.of_channel.keys() <= channels.known.keys()

    def messages(
        self, selected: Mapping[int, _ChannelT], message_type: type[_MessageT], first_ns: int, after_ns: int
    ) -> list[_MessageT]:
        """Return the messages of the selected channels with `first_ns` <= `log_ns` < `after_ns` [ns], in order."""
        chosen = [number for number in self.of_channel if number in selected]
        rows = self.of_channel[chosen[0]] if len(chosen) == 1 else self.rows if chosen else []
        content = self.content
        return [
            _new(message_type, (selected[number], log_ns, publish_ns, seq, content[start:end]))
            for number, log_ns, publish_ns, seq, start, end in rows
            if number in selected and first_ns <= log_ns < after_ns
        ]


def _walked(
    block: Block,
    content: bytes,
    channels: "_ChannelTable[_ChannelT]",
    message_type: type[_MessageT],
    report: DamageCallback | None,
    first_ns: int,
    after_ns: int,
) -> Iterator[_MessageT]:
    """Yield the messages of one block as `Recording._walk` does, record by record."""
    selected, end = channels.selected, 0
    for opcode, start, end in records_of(content):
        if opcode == Opcode.MESSAGE:
            number, seq, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(content, start)
            channel = selected.get(number)
            if channel is not None:
                if first_ns <= log_ns < after_ns:
                    row = (channel, log_ns, publish_ns, seq, content[start + MESSAGE_HEAD.size : end])
                    yield _new(message_type, row)
            elif number not in channels.known and report is not None:
                report(_unknown_channel(block, end - start, number))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            channels.read(opcode, content[start:end])
    # The scan has already reported the missing end of a block that is cut off.
    if block.whole and end != len(content) and report is not None:
        rest = len(content) - end
        report(Damage(block.offset, rest, f"the block ends with {rest} bytes that are no records"))


def _unknown_channel(block: Block, size_bytes: int, number: int) -> Damage:
    return Damage(block.offset, size_bytes, f"a message of the unknown channel {number}")


class Piece(NamedTuple):
    """Chunks of a recording that are read together, and the `lead` of chunks before them."""

    recording: Recording
    blocks: Sequence[Block]
    lead: Sequence[Block]

    def has(self, from_ns: int, to_ns: int) -> bool:
        """Return whether the piece may have messages received between two times [ns]."""
        return any(block.first_ns <= to_ns and block.last_ns >= from_ns for block in self.blocks)


def each_block(data: mmap.mmap, blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield the blocks; release the memory of a mapped file after every 16 MiB that were read."""
    read = 0
    for block in blocks:
        yield block
        read += block.data_end - block.offset
        if read > MOST_MAPPED:
            release(data)
            read = 0


def info_of(recordings: Sequence[Recording], see: SeeMessage | None = None) -> RecordingInfo:
    """Read the files of one recording, which are in order of time, and return their summary.

    `see` is called with each message.
    """
    first = recordings[0]
    statistics = RecordingStatistics(site_of(first.metadata.get("recording", {}).get("node", "")))
    damage: list[Damage] = []
    parts: list[PartInfo] = []
    missing: list[str] = []
    for number, recording in enumerate(recordings):
        statistics.begin_file(after_pause=not number or recordings[number - 1].ending != _PLANNED_END)
        part, counted = _count(recording, statistics, parts[-1] if parts else None, see)
        damage += counted
        # If no sequence number is missing, nothing was sent in the pause.
        if number and statistics.lost_between and recordings[number - 1].ending != _PLANNED_END:
            before = Path(parts[-1].path).name
            missing.append(f"nothing was recorded for {part.pause_s:.3f} s between {before} and {recording.path.name}")
        if not part.closed:
            missing.append(unclosed_text(recording.path.name, part.start_ns, part.end_ns))
        if counted:
            missing.append(f"{sum(each.size_bytes for each in counted)} bytes of {recording.path.name} cannot be read")
        parts.append(part)
    statistics.finish()
    missing += [*statistics.missing(), *notes_of(recording.metadata for recording in recordings)]
    start = min((part.start_ns for part in parts if part.messages), default=0)
    end = max((part.end_ns for part in parts if part.messages), default=0)
    attachments = {name: counted for each in reversed(recordings) for name, counted in each.attachment_records.items()}
    return RecordingInfo(
        path=str(first.path),
        size_bytes=sum(recording.size_bytes for recording in recordings),
        start_ns=start,
        end_ns=end,
        duration_s=(end - start) * 1e-9,
        messages=sum(part.messages for part in parts),
        complete=not missing,
        missing=tuple(missing),
        lost=statistics.lost,
        commands=statistics.commands.answered,
        commands_by_answer=statistics.commands.by_answer_alone,
        closed=all(part.closed for part in parts),
        recorder_lag=statistics.lag(),
        skipped_bytes=sum(part.size_bytes for part in damage),
        damage=describe_damage(damage),
        odd=tuple(
            f"{recording.path.name}: {text}" if len(recordings) > 1 else text
            for recording in recordings
            for text in recording.odd
        ),
        parts=tuple(parts) if len(parts) > 1 else (),
        channels=tuple(channel.info() for channel in statistics.channels.values()),
        attachments=attachments_of(attachments),
        metadata=first.metadata,
    )


def _count(
    recording: Recording, statistics: RecordingStatistics, before: PartInfo | None, see: SeeMessage | None
) -> tuple[PartInfo, list[Damage]]:
    """Add the messages of a file to the statistics; return its summary and its unusable parts."""
    damage = list(recording.structural_damage)
    first_ns, last_ns, messages = 2**64, 0, 0
    for message in recording.select(report=damage.append):
        statistics.add(message)
        if see is not None:
            see(message)
        messages += 1
        first_ns, last_ns = min(first_ns, message.log_ns), max(last_ns, message.log_ns)
    if last_ns - first_ns > LONGEST_PAUSE_NS:
        first_ns, last_ns = recording.span_ns
    if messages == 0:
        first_ns = last_ns = before.end_ns if before is not None else 0
    pause_ns = 0 if before is None else first_ns - before.end_ns
    part = PartInfo(
        path=str(recording.path),
        start_ns=first_ns,
        end_ns=last_ns,
        messages=messages,
        closed=recording.closed,
        pause_s=pause_ns * 1e-9,
    )
    return part, damage


class _ChannelTable(Generic[_ChannelT]):
    """Channels of a file by number: all that are `known` so far, and those of them that are `selected`."""

    def __init__(
        self,
        layout: Layout,
        convert: Callable[[Channel, Mapping[int, Schema]], _ChannelT],
        wanted: Callable[[_ChannelT], bool] | None = None,
        known: Mapping[int, _ChannelT] | None = None,
    ) -> None:
        self.known: dict[int, _ChannelT] = {}
        self.selected: dict[int, _ChannelT] = {}
        self._schemas = dict(layout.summary_schemas)
        self._path = layout.path
        # The newest definition by opcode and number: repeated definitions cost only a comparison.
        self._definitions: dict[tuple[int, bytes], bytes] = {}
        self._read = 0
        self._convert = convert
        self._wanted = wanted
        for number, channel in (known or {}).items():
            self._add(number, channel)
        # The summary also has the channels whose introducing chunk is damaged.
        for number, found in layout.summary_channels.items():
            if number not in self.known:
                self._add(number, convert(found, self._schemas))

    def read(self, opcode: int, body: bytes) -> None:
        """Read a schema or channel record; an unreadable one is ignored, so its messages have an unknown channel.

        Raises RecordingError if the file introduces more than `MOST_DEFINITIONS` of them.
        """
        key = (opcode, body[:2])
        if self._definitions.get(key) == body:
            return
        self._definitions[key] = body
        self._read += 1
        if self._read > MOST_DEFINITIONS:
            raise too_many_definitions(self._path)
        stream = ReadDataStream(BytesIO(body))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema
            else:
                record = Channel.read(stream)
                self._add(record.id, self._convert(record, self._schemas))
        except UNREADABLE:
            return

    def _add(self, number: int, channel: _ChannelT) -> None:
        # A channel that is introduced again keeps its object, because copies recognise channels by identity.
        if number in self.known and self.known[number] == channel:
            return
        self.known[number] = channel
        if self._wanted is None or self._wanted(channel):
            self.selected[number] = channel
        else:
            self.selected.pop(number, None)
