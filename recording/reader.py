"""Reading a recording, whether it was finished, killed, cut off or damaged."""

import mmap
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple, Protocol

import msgpack
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Schema
from pydantic import BaseModel, ConfigDict, ValidationError

from proto import WireError, decode
from proto.errors import RecordingError
from proto.messages import Record
from proto.sequence import SequenceTracker
from recording.mcap_scan import MAGIC, RECORD_HEAD, UNREADABLE, Block, Damage, DamagedBlockError, scan, unpack
from recording.records import RECORDS

_MESSAGE_HEAD = Struct("<HIQQ")
_END_OF_TIME = 2**64

Report = Callable[[Damage], None]


class RecordedChannel(NamedTuple):
    """What one publisher (`src`) said on one bus topic, as heard at one site.

    `channel_topic` is the bus topic, with `@site` where it was heard behind the link. `rate_hz` is the declared rate,
    None for topics sent on change. In a file that is not a recording of ours, `site` and `src` are empty.
    """

    channel_topic: str
    topic: str
    site: str
    via: str
    src: str
    rate_hz: float | None
    delivery: str


class RecordedMessage(NamedTuple):
    """A message as it was heard: times in ns, `log_ns` on the recorder's clock, `publish_ns` on the publisher's."""

    channel: RecordedChannel
    log_ns: int
    publish_ns: int
    seq: int
    payload: bytes

    @property
    def channel_topic(self) -> str:
        """Name of the channel."""
        return self.channel.channel_topic

    @property
    def topic(self) -> str:
        """Bus topic."""
        return self.channel.topic

    @property
    def site(self) -> str:
        """Site at which it was heard."""
        return self.channel.site

    @property
    def via(self) -> str:
        """`direct` at its publisher, `link` behind the link."""
        return self.channel.via

    @property
    def src(self) -> str:
        """Publisher, node@site."""
        return self.channel.src

    def decode(self) -> Record:
        """Give the validated message: a proto Message, or a GapRecord or RejectedRecord of the recorder's own.

        Raises RecordingError naming the channel and what is wrong.
        """
        try:
            if self.topic in RECORDS:
                return RECORDS[self.topic].model_validate(self.fields())
            return decode(self.topic, self.payload)
        except (WireError, ValidationError) as error:
            raise RecordingError(f"{self.channel_topic}, seq {self.seq}: {error}") from error

    def fields(self) -> dict[str, Any]:
        """Give the fields as plain Python values, without a check of their meaning.

        Raises RecordingError naming the channel when the payload is no msgpack map.
        """
        try:
            found = msgpack.unpackb(self.payload, use_list=False)
        except (ValueError, msgpack.exceptions.UnpackException, RecursionError) as error:
            raise RecordingError(f"{self.channel_topic}, seq {self.seq}: not msgpack: {error}") from error
        if not isinstance(found, dict):
            raise RecordingError(f"{self.channel_topic}, seq {self.seq}: not a msgpack map")
        return found


Wanted = Callable[[RecordedChannel], bool]


def _every(channel: RecordedChannel) -> bool:
    return True


def _none(channel: RecordedChannel) -> bool:
    return False


class RawChannel(NamedTuple):
    """All that a file says of a channel; `schema` is name, encoding and data, None where there is none."""

    topic: str
    encoding: str
    metadata: tuple[tuple[str, str], ...]
    schema: tuple[str, str, bytes] | None

    @property
    def channel_topic(self) -> str:
        """Name of the channel."""
        return self.topic

    @property
    def src(self) -> str:
        """Publisher, empty in a file that is not a recording of ours."""
        return dict(self.metadata).get("src", "")


class RawMessage(NamedTuple):
    """A message with everything that a copy needs."""

    channel: RawChannel
    log_ns: int
    publish_ns: int
    seq: int
    payload: bytes


class _Info(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class ChannelInfo(_Info):
    """Account of one channel; times in ns on the recorder's clock, `rate_hz` as measured from them."""

    channel_topic: str
    topic: str
    src: str
    site: str
    via: str
    declared_rate_hz: float | None
    messages: int
    size_bytes: int
    rate_hz: float
    first_ns: int
    last_ns: int
    gaps: int
    lost: int
    repeated: int
    restarts: int


class AttachmentInfo(_Info):
    """A file within the recording."""

    name: str
    media_type: str
    size_bytes: int


class RecordingInfo(_Info):
    """Account of a recording.

    `complete`: it was closed in order. `skipped_bytes`: bytes that could not be used; `damage` says where and why.
    """

    path: str
    size_bytes: int
    start_ns: int
    end_ns: int
    duration_s: float
    messages: int
    complete: bool
    skipped_bytes: int
    damage: tuple[str, ...]
    channels: tuple[ChannelInfo, ...]
    attachments: tuple[AttachmentInfo, ...]
    metadata: dict[str, dict[str, str]]


class Recording:
    """A recording on disk, as far as it had been written when this object was made."""

    def __init__(self, path: str | Path) -> None:
        """Look through the structure of a file; RecordingError names the file and what is wrong with it."""
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
        """The file was closed in order."""
        return self._layout.finished

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Named facts: `recording` and `versions` in a recording of ours."""
        return self._layout.metadata

    @property
    def attachments(self) -> dict[str, bytes]:
        """Files within the recording, by name: `site.yaml` and `scenario.yaml` in a recording of ours."""
        return {name: attachment.data for name, attachment in self._layout.attachments.items()}

    @cached_property
    def channels(self) -> tuple[RecordedChannel, ...]:
        """Everything that was said, by whom and where heard, in the order of its first appearance."""
        return tuple(dict.fromkeys(self._numbers.values()))

    @cached_property
    def _numbers(self) -> dict[int, RecordedChannel]:
        """The channels by their number in the file."""
        known = {number: recorded_channel(found) for number, found in self._layout.summary_channels.items()}
        if not self.complete:
            for _ in self._walk(known, _none, _ignore):
                pass
        return known

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
        """Give messages in the order in which they were heard.

        Parameters: topics, names of channels such as `teleop/forward@slave`, all when None; start_ns (included) and
        end_ns (excluded), bounds of the time of reception [ns], none when None.
        """
        if topics is None:
            return self.select(_every, start_ns, end_ns)
        names = frozenset(topics)
        return self.select(lambda channel: channel.channel_topic in names, start_ns, end_ns)

    def select(
        self,
        wanted: Wanted | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
        report: Report | None = None,
    ) -> Iterator[RecordedMessage]:
        """Give messages as `messages` does, of the channels for which `wanted` holds.

        Chunks outside of the bounds are not read. `report` is told of each part that cannot be used.
        """
        first = 0 if start_ns is None else start_ns
        after = _END_OF_TIME if end_ns is None else end_ns
        known: dict[int, RecordedChannel] = {} if start_ns is None else dict(self._numbers)
        for message in self._walk(known, wanted or _every, report or _ignore, first, after):
            if first <= message.log_ns < after:
                yield message

    def newest_before(self, time_ns: int, wanted: Wanted | None = None) -> dict[RecordedChannel, RecordedMessage]:
        """Give the newest message of each wanted channel heard before a time [ns], reading backwards from there."""
        missing = {channel for channel in self.channels if wanted is None or wanted(channel)}
        newest: dict[RecordedChannel, RecordedMessage] = {}
        for block in reversed(self._layout.blocks):
            if not missing:
                break
            if block.first_ns >= time_ns:
                continue
            found: dict[RecordedChannel, RecordedMessage] = {}
            for message in self._walk(dict(self._numbers), missing.__contains__, _ignore, blocks=(block,)):
                if message.log_ns < time_ns:
                    found[message.channel] = message
            newest |= found
            missing -= set(found)
        return newest

    def raw(self, report: Report | None = None) -> Iterator[RawMessage]:
        """Give every message with all that the file says of its channel, in the order of the file: for copies.

        `report` is told of each part that cannot be used while reading; `structural_damage` has what is known before.
        """
        report = report or _ignore
        schemas = dict(self._layout.summary_schemas)
        channels = {number: _raw_channel(found, schemas) for number, found in self._layout.summary_channels.items()}
        with self._open() as data:
            for block in self._layout.blocks:
                try:
                    content = unpack(data, block)
                except DamagedBlockError as error:
                    report(Damage(block.offset, block.data_end - block.offset, str(error)))
                    continue
                for opcode, start, end in _records(content):
                    if opcode == Opcode.MESSAGE:
                        number, seq, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(content, start)
                        if number in channels:
                            payload = content[start + _MESSAGE_HEAD.size : end]
                            yield RawMessage(channels[number], log_ns, publish_ns, seq, payload)
                        else:
                            report(Damage(block.offset, end - start, f"a message of the unknown channel {number}"))
                    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                        _learn_raw(opcode, content[start:end], schemas, channels)

    @property
    def structural_damage(self) -> tuple[Damage, ...]:
        """The parts of the file that are no records, or damaged ones outside of the chunks."""
        return tuple(self._layout.damage)

    @property
    def attached(self) -> dict[str, Attachment]:
        """The same as `attachments`, with media types and times."""
        return self._layout.attachments

    def info(self) -> RecordingInfo:
        """Read the whole file and give its account."""
        damage = list(self._layout.damage)
        accounts: dict[RecordedChannel, _Account] = {}
        for message in self._walk({}, lambda channel: True, damage.append):
            account = accounts.get(message.channel)
            if account is None:
                account = accounts[message.channel] = _Account(message)
            account.enter(message)
        start = min((account.first_ns for account in accounts.values()), default=0)
        end = max((account.last_ns for account in accounts.values()), default=0)
        return RecordingInfo(
            path=str(self.path),
            size_bytes=self.size_bytes,
            start_ns=start,
            end_ns=end,
            duration_s=(end - start) * 1e-9,
            messages=sum(account.messages for account in accounts.values()),
            complete=self.complete,
            skipped_bytes=sum(part.size_bytes for part in damage),
            damage=tuple(f"byte {part.offset}, {part.size_bytes} bytes: {part.reason}" for part in damage),
            channels=tuple(account.info() for account in accounts.values()),
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

    def _walk(
        self,
        known: dict[int, RecordedChannel],
        wanted: Wanted,
        report: Report,
        first_ns: int = 0,
        after_ns: int = _END_OF_TIME,
        blocks: Iterable[Block] | None = None,
    ) -> Iterator[RecordedMessage]:
        """Give the messages of the wanted channels, enter every channel in `known`, report what cannot be used.

        Blocks that lie outside of the bounds [ns] as a whole are passed over.
        """
        # what the summary says helps where the chunk that introduced a channel is damaged
        for number, channel in self._layout.summary_channels.items():
            known.setdefault(number, recorded_channel(channel))
        selected = {number: channel for number, channel in known.items() if wanted(channel)}
        with self._open() as data:
            for block in self._layout.blocks if blocks is None else blocks:
                if block.last_ns < first_ns or block.first_ns >= after_ns:
                    continue
                try:
                    content = unpack(data, block)
                except DamagedBlockError as error:
                    report(Damage(block.offset, block.data_end - block.offset, str(error)))
                    continue
                for opcode, start, end in _records(content):
                    if opcode == Opcode.MESSAGE:
                        number, seq, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(content, start)
                        channel_of = selected.get(number)
                        if channel_of is not None:
                            payload = content[start + _MESSAGE_HEAD.size : end]
                            yield RecordedMessage(channel_of, log_ns, publish_ns, seq, payload)
                        elif number not in known:
                            report(Damage(block.offset, end - start, f"a message of the unknown channel {number}"))
                    elif opcode == Opcode.CHANNEL:
                        _learn(content[start:end], known, selected, wanted)


class Source(Protocol):
    """What can be played and searched: a recording, or the parts of one."""

    @property
    def path(self) -> Path:
        """File, or the first of several."""

    @property
    def channels(self) -> tuple[RecordedChannel, ...]:
        """Everything that was said, by whom and where heard."""

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last time of reception [ns]."""

    def select(
        self, wanted: Wanted | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RecordedMessage]:
        """Give messages of wanted channels within bounds [ns]."""

    def newest_before(self, time_ns: int, wanted: Wanted | None = None) -> dict[RecordedChannel, RecordedMessage]:
        """Give the newest message of each wanted channel that was heard before a time [ns]."""


class Series:
    """The parts of a recording that was split, read as one."""

    def __init__(self, parts: Sequence[Recording]) -> None:
        """Take recordings, which are put in the order of time."""
        filled = [part for part in parts if part.span_ns != (0, 0)] or list(parts[:1])
        self.parts = sorted(filled, key=lambda part: part.span_ns)
        self.path = self.parts[0].path

    @property
    def channels(self) -> tuple[RecordedChannel, ...]:
        """Everything that was said, by whom and where heard."""
        return tuple(dict.fromkeys(channel for part in self.parts for channel in part.channels))

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last time of reception [ns]."""
        return self.parts[0].span_ns[0], max(part.span_ns[1] for part in self.parts)

    def select(
        self, wanted: Wanted | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RecordedMessage]:
        """Give messages of wanted channels within bounds [ns], part by part."""
        for part in self.parts:
            yield from part.select(wanted, start_ns, end_ns)

    def newest_before(self, time_ns: int, wanted: Wanted | None = None) -> dict[RecordedChannel, RecordedMessage]:
        """Give the newest message of each wanted channel that was heard before a time [ns]."""
        newest: dict[RecordedChannel, RecordedMessage] = {}
        for part in self.parts:
            newest |= part.newest_before(time_ns, wanted)
        return newest


def open_recordings(paths: Sequence[str | Path]) -> Source:
    """Open a recording, or the parts of one; RecordingError names the file that cannot be read."""
    if not paths:
        raise RecordingError("no recording was named")
    parts = [Recording(path) for path in paths]
    return parts[0] if len(parts) == 1 else Series(parts)


class _Account:
    """Running account of one channel."""

    def __init__(self, first: RecordedMessage) -> None:
        self.channel = first.channel
        self.first_ns = first.log_ns
        self.last_ns = first.log_ns
        self.messages = 0
        self.size_bytes = 0
        self._tracker = SequenceTracker()

    def enter(self, message: RecordedMessage) -> None:
        self.messages += 1
        self.size_bytes += len(message.payload)
        self.last_ns = message.log_ns
        self._tracker.accept(message.seq, message.publish_ns)

    def info(self) -> ChannelInfo:
        channel, tracker = self.channel, self._tracker
        span_ns = self.last_ns - self.first_ns
        return ChannelInfo(
            channel_topic=channel.channel_topic,
            topic=channel.topic,
            src=channel.src,
            site=channel.site,
            via=channel.via,
            declared_rate_hz=channel.rate_hz,
            messages=self.messages,
            size_bytes=self.size_bytes,
            rate_hz=(self.messages - 1) * 1e9 / span_ns if span_ns > 0 else 0.0,
            first_ns=self.first_ns,
            last_ns=self.last_ns,
            gaps=tracker.gaps,
            lost=tracker.lost,
            repeated=tracker.late + tracker.duplicates,
            restarts=tracker.restarts,
        )


def _records(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Give opcode, start and end of the body of each whole record in a chunk."""
    position, size = 0, len(content) - RECORD_HEAD.size
    while position <= size:
        opcode, length = RECORD_HEAD.unpack_from(content, position)
        start = position + RECORD_HEAD.size
        position = start + length
        if position > len(content) or (opcode == Opcode.MESSAGE and length < _MESSAGE_HEAD.size):
            return
        yield opcode, start, position


def _learn(
    body: bytes,
    known: dict[int, RecordedChannel],
    selected: dict[int, RecordedChannel],
    wanted: Wanted,
) -> None:
    try:
        found = Channel.read(ReadDataStream(BytesIO(body)))
        channel = recorded_channel(found)
    except UNREADABLE:
        # its messages are reported as those of an unknown channel
        return
    known[found.id] = channel
    if wanted(channel):
        selected[found.id] = channel


def _learn_raw(opcode: int, body: bytes, schemas: dict[int, Schema], channels: dict[int, RawChannel]) -> None:
    stream = ReadDataStream(BytesIO(body))
    try:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            schemas[schema.id] = schema
        else:
            found = Channel.read(stream)
            channels.setdefault(found.id, _raw_channel(found, schemas))
    except UNREADABLE:
        # its messages are reported as those of an unknown channel
        return


def _raw_channel(found: Channel, schemas: dict[int, Schema]) -> RawChannel:
    schema = schemas.get(found.schema_id)
    described = None if schema is None else (schema.name, schema.encoding, schema.data)
    return RawChannel(found.topic, found.message_encoding, tuple(sorted(found.metadata.items())), described)


def recorded_channel(found: Channel) -> RecordedChannel:
    """Give what a channel of the file says of itself; empty where it is not one of ours."""
    facts = found.metadata
    return RecordedChannel(
        channel_topic=found.topic,
        topic=facts.get("topic", found.topic),
        site=facts.get("site", ""),
        via=facts.get("via", "direct"),
        src=facts.get("src", ""),
        rate_hz=_number(facts.get("rate_hz", "")),
        delivery=facts.get("delivery", ""),
    )


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _ignore(damage: Damage) -> None:
    """Go on without a word; `info` tells what was skipped."""
