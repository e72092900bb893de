"""Messages and channels of a recording, and the count of those that a reader leaves out."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import msgpack
from mcap.records import Channel, Schema

# The codec is imported when the first message is decoded: a summary from the index needs none.
from telenano.recording.record_topics import RECORD_TOPICS
from telenano.wire.errors import RecordingError, described

if TYPE_CHECKING:
    from telenano.wire.messages import Message, Record

_T = TypeVar("_T")
# The reason of rejection of a message that is valid except for a quantity beyond its range.
BEYOND_RANGE = "range"
# Most messages whose identity is remembered, so that they are counted only once.
_MOST_COUNTED = 1 << 16


class LeftOut:
    """Counts, by reason, of the messages that a reader skips instead of failing.

    A message that does not fit its model has the reason of its error, `unreadable` means that the reader itself raised,
    and `range` that a node rejects an otherwise valid message. `rejected` and `last_error` have the names of a bus
    reader's counts, which are published in node/health.
    """

    def __init__(self) -> None:
        self.rejected: dict[str, int] = {}
        self.last_error = ""
        # Last error of a message beyond its range; kept apart because it is no fault of the recording.
        self._last_beyond = ""
        # Reason by message, so that a message that several readers leave out is counted once.
        self._counted: dict[object, str] = {}

    def guard(self, take: Callable[[_T], object], message: _T) -> bool:
        """Call `take` with a message; if it raises, count the message and return False."""
        try:
            take(message)
        except Exception as error:  # noqa: BLE001
            self.note(getattr(error.__cause__, "reason", "unreadable"), described(error))
            return False
        return True

    def note(self, reason: str, text: str, key: object = None) -> None:
        """Count a message that was left out; a message whose `key` was counted before is ignored."""
        if key is not None and key in self._counted:
            return
        if key is not None and len(self._counted) < _MOST_COUNTED:
            self._counted[key] = reason
        self.rejected[reason] = self.rejected.get(reason, 0) + 1
        if reason == BEYOND_RANGE:
            self._last_beyond = text[:400]
        else:
            self.last_error = text[:400]

    def note_error(self, error: RecordingError, message: "RecordedMessage") -> None:
        """Count an invalid message, or one beyond a range, under the reason of its error."""
        self.note(getattr(error.__cause__, "reason", "schema"), str(error), message.identity)

    def add(self, other: "LeftOut") -> None:
        """Add the counts of another reader; a message that both left out counts once."""
        texts = (other._last_beyond, other.last_error)
        for key, reason in other._counted.items():
            self.note(reason, texts[reason != BEYOND_RANGE], key)
        for reason, count in (Counter(other.rejected) - Counter(other._counted.values())).items():
            self.rejected[reason] = self.rejected.get(reason, 0) + count

    def sentences(self) -> list[str]:
        """Return one sentence on the invalid messages; none if there are none. `beyond_range` has the others."""
        rejected = {reason: count for reason, count in self.rejected.items() if reason != BEYOND_RANGE}
        if not rejected:
            return []
        counts = ", ".join(f"{count} {reason}" for reason, count in sorted(rejected.items()))
        return [f"messages that are not valid were left out ({counts}), the last: {self.last_error}"]

    def beyond_range(self) -> list[str]:
        """Return one sentence on the messages that a node would reject for a value beyond its range, if any."""
        count = self.rejected.get(BEYOND_RANGE, 0)
        what = (
            "1 message with a value beyond its range was"
            if count == 1
            else f"{count} messages with values beyond their ranges were"
        )
        return [f"{what} left out, as a node leaves it out, the last: {self._last_beyond}"] if count else []


class RecordedChannel(NamedTuple):
    """Channel of the messages from one publisher (`src`) on one bus topic, received at one site.

    `channel_topic` is the bus topic, with `@site` appended if it was received behind the link. `rate_hz` is the
    declared rate, None for topics sent on change. In a file of another program, `site` and `src` are empty.
    """

    channel_topic: str
    topic: str
    site: str
    via: str
    src: str
    rate_hz: float | None
    delivery: str


class RecordedMessage(NamedTuple):
    """A received message; `log_ns` is its reception by the recorder's clock, `publish_ns` by the publisher's [ns]."""

    channel: RecordedChannel
    log_ns: int
    publish_ns: int
    seq: int
    payload: bytes

    @property
    def channel_topic(self) -> str:
        return self.channel.channel_topic

    @property
    def topic(self) -> str:
        return self.channel.topic

    @property
    def site(self) -> str:
        return self.channel.site

    @property
    def via(self) -> str:
        """`direct` at its publisher, `link` behind the link."""
        return self.channel.via

    @property
    def src(self) -> str:
        return self.channel.src

    @property
    def identity(self) -> tuple[str, str, int, int]:
        """Key that distinguishes a message from all others of its recording."""
        return self.channel.channel_topic, self.channel.src, self.seq, self.publish_ns

    @property
    def run(self) -> int | None:
        """The process of the publisher that numbered the message; None if it does not say."""
        found: int | None = _codec().run_in(self.payload)
        return found

    def decode(self) -> "Record":
        """Return the validated message: a proto Message, or the recorder's own GapRecord or RejectedRecord.

        Its quantities may have any finite value; use `accepted` for computations.

        Raises:
            RecordingError: The message is not valid; the error names the channel and the fault.
        """
        return self._read(_codec().decode)

    def accepted(self) -> "Record":
        """Return the message as `decode` does; raise RecordingError also if a quantity is beyond its range."""
        return self._read(_codec().accept)

    def _read(self, read: "Callable[[str, bytes], Message]") -> "Record":
        topic = self.channel.topic
        try:
            if topic in RECORD_TOPICS:
                from telenano.recording.records import RECORDS
                from telenano.wire.refusals import made

                return made(RECORDS[topic], self.fields())
            return read(topic, self.payload)
        except ValueError as error:
            raise RecordingError(f"{self.channel_topic}, seq {self.seq}: {error}") from error

    def fields(self) -> dict[str, Any]:
        """Return the fields as plain Python values, not validated.

        Raises:
            RecordingError: The payload is not a msgpack map; the message names the channel.
        """
        try:
            document = msgpack.unpackb(self.payload, use_list=False)
        except (ValueError, msgpack.exceptions.UnpackException, RecursionError) as error:
            raise RecordingError(f"{self.channel_topic}, seq {self.seq}: not msgpack: {error}") from error
        if not isinstance(document, dict):
            raise RecordingError(f"{self.channel_topic}, seq {self.seq}: not a msgpack map")
        return document

    def plain(self) -> dict[str, Any]:
        """Return the message as JSON values: arrays as lists of numbers, bytes as base64.

        The fields of a message that this version cannot decode are returned as they are.

        Raises:
            RecordingError: The payload is not a msgpack map either.
        """
        from telenano.recording.json_values import json_fields, json_value

        try:
            return json_fields(self.decode())
        except RecordingError:
            return {key: json_value(value) for key, value in self.fields().items()}

    def checked_fields(self) -> Mapping[str, Any]:
        """Return the fields of the message, validated by its model and in range; raise RecordingError as `accepted`.

        An optional key that is absent has the value None, as one that is nil.
        """
        from telenano.wire.codec import fields_of

        return fields_of(self.accepted())


@cache
def _codec() -> ModuleType:
    # This import registers the topics that installed packages declare.
    from telenano.settings import package_topics  # noqa: F401
    from telenano.wire import codec

    return codec


ChannelFilter = Callable[[RecordedChannel], bool]


def readable(
    messages: Iterable[RecordedMessage], left_out: LeftOut
) -> Iterator[tuple[RecordedMessage, Mapping[str, Any]]]:
    """Yield messages with their checked fields; count in `left_out` those that are invalid or beyond a range.

    All computations with recorded messages read them through this function or `telenano.recording.columns`.
    """
    for message in messages:
        try:
            fields = message.checked_fields()
        except RecordingError as error:
            left_out.note_error(error, message)
        else:
            yield message, fields


class RawChannel(NamedTuple):
    """Complete description of a channel for copies; `schema` is name, encoding and data, or None."""

    topic: str
    encoding: str
    metadata: tuple[tuple[str, str], ...]
    schema: tuple[str, str, bytes] | None

    @property
    def channel_topic(self) -> str:
        return self.topic

    @property
    def src(self) -> str:
        """Publisher, `node@site`; empty in a file of another program."""
        return dict(self.metadata).get("src", "")


class RawMessage(NamedTuple):
    """A message with everything that a copy needs; times are in ns."""

    channel: RawChannel
    log_ns: int
    publish_ns: int
    seq: int
    payload: bytes


def raw_channel(channel: Channel, schemas: Mapping[int, Schema]) -> RawChannel:
    """Return a channel of the file together with its schema."""
    schema = schemas.get(channel.schema_id)
    described = None if schema is None else (schema.name, schema.encoding, schema.data)
    return RawChannel(channel.topic, channel.message_encoding, tuple(sorted(channel.metadata.items())), described)


def recorded_channel(channel: Channel) -> RecordedChannel:
    """Return a channel described by its metadata; `site` and `src` are empty in a file of another program."""
    facts = channel.metadata
    return RecordedChannel(
        channel_topic=channel.topic,
        topic=facts.get("topic", channel.topic),
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


def topic_of(channel_topic: str) -> str:
    """Return the topic of a channel: its name without `@` and the site of reception."""
    return channel_topic.partition("@")[0]
