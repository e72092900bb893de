"""Reading a recording, whether it was finished, killed, cut off or damaged."""

import mmap
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import Generic, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Schema

from proto.errors import RecordingError
from recording.info import AttachmentInfo, ChannelStatistics, RecordingInfo
from recording.mcap_scan import (
    MAGIC,
    RECORD_HEAD,
    UNREADABLE,
    Block,
    Damage,
    DamagedBlockError,
    Layout,
    describe_damage,
    scan,
    unpack,
)
from recording.messages import (
    ChannelFilter,
    RawMessage,
    RecordedChannel,
    RecordedMessage,
    raw_channel,
    recorded_channel,
)

_MESSAGE_HEAD = Struct("<HIQQ")
_END_OF_TIME = 2**64

DamageCallback = Callable[[Damage], None]

_ChannelT = TypeVar("_ChannelT")
_MessageT = TypeVar("_MessageT")


class Recording:
    """A recording on disk, as far as it had been written when this object was made."""

    def __init__(self, path: str | Path) -> None:
        """Scan the structure of a file; RecordingError names the file and what is wrong with it."""
        self.path = Path(path)
        try:
            self.size_bytes = self.path.stat().st_size
            with self.path.open("rb") as file:
                start = file.read(len(MAGIC))
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read: {error.strerror}") from error
        if not start:
            raise RecordingError(f"{self.path}: is empty")
        if start != MAGIC:
            what = "ends before its first record" if MAGIC.startswith(start) else "is not an MCAP file"
            raise RecordingError(f"{self.path}: {what}")
        with self._open() as data:
            self._layout = scan(data)

    @property
    def complete(self) -> bool:
        """Whether the file was closed properly, with index and end mark."""
        return self._layout.finished

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata records by name: `recording` and `versions` in a recording of ours."""
        return self._layout.metadata

    @property
    def attachments(self) -> dict[str, bytes]:
        """Files within the recording, by name: `site.yaml` and `scenario.yaml` in a recording of ours."""
        return {name: attachment.data for name, attachment in self._layout.attachments.items()}

    @cached_property
    def channels(self) -> tuple[RecordedChannel, ...]:
        return tuple(dict.fromkeys(self._channels_by_number.values()))

    @cached_property
    def _channels_by_number(self) -> dict[int, RecordedChannel]:
        table = self._recorded_channels(lambda channel: False)
        if not self.complete:
            for _ in self._walk(table, RecordedMessage):
                pass
        return table.known

    @cached_property
    def span_ns(self) -> tuple[int, int]:
        """First and last time of reception [ns]; zeros in a recording without messages."""
        blocks = [block for block in self._layout.blocks if block.first_ns or block.last_ns]
        bounded = bool(blocks) and all(block.whole and block.last_ns != _END_OF_TIME for block in blocks)
        if self.complete and bounded:
            return min(block.first_ns for block in blocks), max(block.last_ns for block in blocks)
        times = [message.log_ns for message in self.select()]
        return (min(times), max(times)) if times else (0, 0)

    def messages(
        self, topics: Iterable[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RecordedMessage]:
        """Yield messages in the order in which they were received.

        Parameters: topics, names of channels such as `teleop/forward@slave`, all when None; start_ns (included) and
        end_ns (excluded), bounds of the time of reception [ns], none when None.
        """
        if topics is None:
            return self.select(None, start_ns, end_ns)
        names = frozenset(topics)
        return self.select(lambda channel: channel.channel_topic in names, start_ns, end_ns)

    def select(
        self,
        wanted: ChannelFilter | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
        report: DamageCallback | None = None,
    ) -> Iterator[RecordedMessage]:
        """Yield messages as `messages` does, of the channels for which `wanted` holds.

        Chunks outside of the bounds are not read. `report` is called for each part that cannot be used.
        """
        first = 0 if start_ns is None else start_ns
        after = _END_OF_TIME if end_ns is None else end_ns
        table = self._recorded_channels(wanted, None if start_ns is None else self._channels_by_number)
        for message in self._walk(table, RecordedMessage, report, first, after):
            if first <= message.log_ns < after:
                yield message

    def newest_before(
        self, time_ns: int, wanted: ChannelFilter | None = None
    ) -> dict[RecordedChannel, RecordedMessage]:
        """Return the newest message of each wanted channel received before a time [ns], reading backwards from it."""
        missing = {channel for channel in self.channels if wanted is None or wanted(channel)}
        newest: dict[RecordedChannel, RecordedMessage] = {}
        for block in reversed(self._layout.blocks):
            if not missing:
                break
            if block.first_ns >= time_ns:
                continue
            found: dict[RecordedChannel, RecordedMessage] = {}
            table = self._recorded_channels(missing.__contains__, self._channels_by_number)
            for message in self._walk(table, RecordedMessage, blocks=(block,)):
                if message.log_ns < time_ns:
                    found[message.channel] = message
            newest |= found
            missing -= set(found)
        return newest

    def raw(self, report: DamageCallback | None = None) -> Iterator[RawMessage]:
        """Yield every message with the whole description of its channel, in the order of the file: for copies.

        `report` is called for each part that cannot be used while reading; `structural_damage` has what is known
        before.
        """
        return self._walk(_ChannelTable(self._layout, raw_channel), RawMessage, report)

    @property
    def structural_damage(self) -> tuple[Damage, ...]:
        """Parts of the file that are no records, or damaged ones outside of the chunks."""
        return tuple(self._layout.damage)

    @property
    def attachment_records(self) -> dict[str, Attachment]:
        """The same as `attachments`, with media types and times."""
        return self._layout.attachments

    def info(self) -> RecordingInfo:
        """Read the whole file and return its summary."""
        damage = list(self._layout.damage)
        statistics: dict[RecordedChannel, ChannelStatistics] = {}
        for message in self._walk(self._recorded_channels(), RecordedMessage, damage.append):
            channel = statistics.get(message.channel)
            if channel is None:
                channel = statistics[message.channel] = ChannelStatistics(message)
            channel.add(message)
        start = min((channel.first_ns for channel in statistics.values()), default=0)
        end = max((channel.last_ns for channel in statistics.values()), default=0)
        return RecordingInfo(
            path=str(self.path),
            size_bytes=self.size_bytes,
            start_ns=start,
            end_ns=end,
            duration_s=(end - start) * 1e-9,
            messages=sum(channel.messages for channel in statistics.values()),
            complete=self.complete,
            skipped_bytes=sum(part.size_bytes for part in damage),
            damage=describe_damage(damage),
            channels=tuple(channel.info() for channel in statistics.values()),
            attachments=tuple(
                AttachmentInfo(name=name, media_type=found.media_type, size_bytes=len(found.data))
                for name, found in self._layout.attachments.items()
            ),
            metadata=self.metadata,
        )

    def _open(self) -> mmap.mmap:
        try:
            with self.path.open("rb") as file:
                return mmap.mmap(file.fileno(), self.size_bytes, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self.path}: cannot be read any more: {error}") from error

    def _recorded_channels(
        self, wanted: ChannelFilter | None = None, known: Mapping[int, RecordedChannel] | None = None
    ) -> "_ChannelTable[RecordedChannel]":
        return _ChannelTable(self._layout, lambda found, _: recorded_channel(found), wanted, known)

    def _walk(
        self,
        channels: "_ChannelTable[_ChannelT]",
        message_type: Callable[[_ChannelT, int, int, int, bytes], _MessageT],
        report: DamageCallback | None = None,
        first_ns: int = 0,
        after_ns: int = _END_OF_TIME,
        blocks: Iterable[Block] | None = None,
    ) -> Iterator[_MessageT]:
        """Yield the messages of the selected channels, add new channels to the table, report what cannot be used.

        Blocks that lie outside of the bounds [ns] as a whole are skipped.
        """
        known, selected = channels.known, channels.selected
        with self._open() as data:
            for block in self._layout.blocks if blocks is None else blocks:
                if block.last_ns < first_ns or block.first_ns >= after_ns:
                    continue
                try:
                    content = unpack(data, block)
                except DamagedBlockError as error:
                    if report is not None:
                        report(Damage(block.offset, block.data_end - block.offset, str(error)))
                    continue
                for opcode, start, end in _records(content):
                    if opcode == Opcode.MESSAGE:
                        number, seq, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(content, start)
                        channel = selected.get(number)
                        if channel is not None:
                            payload = content[start + _MESSAGE_HEAD.size : end]
                            yield message_type(channel, log_ns, publish_ns, seq, payload)
                        elif number not in known and report is not None:
                            report(Damage(block.offset, end - start, f"a message of the unknown channel {number}"))
                    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                        channels.read(opcode, content[start:end])


class _ChannelTable(Generic[_ChannelT]):
    """Channels of a file by their number, `known` so far, and those of them that are `selected`."""

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
        self._convert = convert
        self._wanted = wanted
        for number, channel in (known or {}).items():
            self._add(number, channel)
        # the summary helps where the chunk that introduced a channel is damaged
        for number, found in layout.summary_channels.items():
            if number not in self.known:
                self._add(number, convert(found, self._schemas))

    def read(self, opcode: int, body: bytes) -> None:
        """Read a schema or channel record; the messages of an unreadable channel are those of an unknown one."""
        stream = ReadDataStream(BytesIO(body))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema
            else:
                found = Channel.read(stream)
                self._add(found.id, self._convert(found, self._schemas))
        except UNREADABLE:
            return

    def _add(self, number: int, channel: _ChannelT) -> None:
        # the object stays the same when a channel is introduced again: copies recognise channels by identity
        if number in self.known and self.known[number] == channel:
            return
        self.known[number] = channel
        if self._wanted is None or self._wanted(channel):
            self.selected[number] = channel
        else:
            self.selected.pop(number, None)


def _records(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of the body of each whole record in a chunk."""
    position, size = 0, len(content) - RECORD_HEAD.size
    while position <= size:
        opcode, length = RECORD_HEAD.unpack_from(content, position)
        start = position + RECORD_HEAD.size
        position = start + length
        if position > len(content) or (opcode == Opcode.MESSAGE and length < _MESSAGE_HEAD.size):
            return
        yield opcode, start, position
