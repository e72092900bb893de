"""Fields of the messages of one channel as arrays, for figures and reports.

hand = Recording(path).columns("haptic/state", ("t_ns", "position_m.2"))
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np
import numpy.typing as npt

from telenano.recording.messages import BEYOND_RANGE, LeftOut, RecordedChannel, RecordedMessage, readable
from telenano.recording.record_topics import RECORD_TOPICS
from telenano.wire.errors import RecordingError, probably_meant

Column = npt.NDArray[Any]
# the keys and places that lead to a field
_Path = tuple[str | int, ...]

# These belong to the record and not to the message; seq and t_ns are in the message as well.
_RECORD_FIELDS = ("log_ns", "publish_ns")
# this number of messages are put into arrays at once
_AT_ONCE = 8192
# The types of fields that become columns, and of those that become numbers.
_SCALARS = frozenset((bool, int, float, str, type(None)))
_NUMBERS = frozenset((int, float))
_YES_OR_NUMBERS = frozenset((bool, int, float, type(None)))
# Reasons for which a message is of a model that is not known here.
_UNKNOWN = frozenset(("topic", "newer_version"))


class Source(Protocol):
    """What columns are read from: the part of `telenano.recording.recorded_fields.RecordedFields` that it takes."""

    path: Path
    left_out: LeftOut

    @property
    def channels(self) -> tuple[RecordedChannel, ...]:
        """Channels in the order of their first appearance."""

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[RecordedMessage]:
        """Yield the messages of channels by name."""


def columns(recording: Source, channel_topic: str, fields: Sequence[str]) -> dict[str, Column]:
    """Return fields of every message of a channel, in the order received.

    Args:
        recording: The recording to read.
        channel_topic: The topic of the channel.
        fields: Keys of the message, dotted into its parts (`position_m.2`, `forward.delay_mean_s`), and `log_ns` and
            `publish_ns` of the record.

    Returns:
        Arrays of one dimension by field: int64; float64, NaN where a message has nil or lacks the key, also of a yes or
        no, which is 1 or 0 then; bool where each message has one; or objects for text, None where there is none. Of a
        field whose values are of several kinds, numbers are floats, and what is text and numbers are objects.

    Raises:
        RecordingError: There is no such channel or field; the message names file, channel and field.
    """
    pieces = list(column_pieces(recording, channel_topic, fields))
    return {field: _joined([piece[field] for piece in pieces]) for field in fields}


def column_pieces(recording: Source, channel_topic: str, fields: Sequence[str]) -> Iterator[dict[str, Column]]:
    """Yield what `columns` returns in pieces of some thousand messages, so that no recording is too long; at least one.

    A piece is of the types that have come so far: whole numbers become floats with the first one that is none.
    """
    names = {channel.channel_topic for channel in recording.channels}
    if channel_topic not in names:
        shown = ", ".join(sorted(names)) or "none"
        near = probably_meant(channel_topic, names)
        raise RecordingError(f"{recording.path}: has no channel {channel_topic}{near}; its channels are {shown}")
    paths: dict[str, _Path] = {
        field: tuple(int(part) if part.isdecimal() else part for part in field.split("."))
        for field in fields
        if field not in _RECORD_FIELDS
    }
    kinds: dict[str, set[type]] = {field: set() for field in fields}
    read = _reader(paths)
    messages = recording.messages((channel_topic,))
    is_first = True
    while (batch := list(islice(messages, _AT_ONCE))) or is_first:
        is_first = False
        found = read(batch)
        if found is None or not all(
            _is_column(found[field], kinds[field]) and _are_taken(found[field], batch) for field in paths
        ):
            batch, found = _read_each(recording, batch, paths)
        values: dict[str, list[Any]] = {
            field: [getattr(message, field) for message in batch] for field in fields if field not in paths
        }
        values |= found
        for field in fields:
            kinds[field].update(map(type, values[field]))
        yield {field: _array(recording, channel_topic, field, values[field], kinds[field]) for field in fields}


def _reader(paths: Mapping[str, _Path]) -> Callable[[Sequence[RecordedMessage]], dict[str, list[Any]] | None]:
    """Return what reads fields of messages without decoding the others; None where it leaves that to `_read_each`."""
    keys = {path[0]: f"key_{number}" for number, path in enumerate(paths.values())}
    wanted = [(name, Any, msgspec.UNSET) for name in keys.values()]
    renamed = {name: str(key) for key, name in keys.items()}
    decode = msgspec.msgpack.Decoder(msgspec.defstruct("Wanted", wanted, rename=renamed, gc=False)).decode

    def read(messages: Sequence[RecordedMessage]) -> dict[str, list[Any]] | None:
        rows_of: dict[str, list[Any]] = {}
        try:
            rows = [decode(message.payload) for message in messages]
            for field, (first, *rest) in paths.items():
                values = list(map(attrgetter(keys[first]), rows))
                for part in rest:
                    values = [None if value is None else value[part] for value in values]
                rows_of[field] = values
        except (msgspec.MsgspecError, LookupError, TypeError, ValueError, RecursionError):
            return None
        return rows_of

    return read


def _is_column(values: Sequence[Any], before: set[type]) -> bool:
    """Return whether unchecked values are all of one kind, with those before, and finite numbers."""
    kinds = before.union(map(type, values)) - {type(None)}
    if not kinds <= _NUMBERS:
        return len(kinds) == 1 and kinds < _SCALARS
    try:
        kind = np.float64 if float in kinds else np.int64
        numbers = np.array([value for value in values if value is not None], dtype=kind)
    except OverflowError:
        return False
    return bool(np.isfinite(numbers).all())


def _are_taken(values: Sequence[Any], messages: Sequence[RecordedMessage]) -> bool:
    """Return whether a node would take a field that has some values in some messages.

    A range is an interval: what lies between the least and the greatest value is in it if both are. A field may be nil
    in all messages if it may be in one.
    """
    if not messages or messages[0].topic in RECORD_TOPICS:
        return True
    numbers = [place for place, value in enumerate(values) if type(value) in _NUMBERS]
    places = {choose(numbers, key=values.__getitem__) for choose in (min, max)} if numbers else set()
    left_out = LeftOut()
    for _ in readable([messages[place] for place in places], left_out):
        pass
    nil = LeftOut()
    for _ in readable([messages[values.index(None)]] if None in values else (), nil):
        pass
    return BEYOND_RANGE not in left_out.rejected and nil.rejected.keys() <= _UNKNOWN


def _read_each(
    recording: Source, messages: Sequence[RecordedMessage], paths: Mapping[str, _Path]
) -> tuple[list[RecordedMessage], dict[str, list[Any]]]:
    """Return the messages that are valid, each decoded as a whole, and their fields; RecordingError for one it lacks.

    Those that are not valid are counted and left out. Where all are of a model that is not known here, they are taken
    as they are.
    """
    values: dict[str, list[Any]] = {field: [] for field in paths}
    left_out = LeftOut()
    taken = list(readable(messages, left_out))
    if not taken and left_out.rejected.keys() <= _UNKNOWN:
        taken = [(message, message.fields()) for message in messages]
    else:
        recording.left_out.add(left_out)
    for message, decoded in taken:
        for field, path in paths.items():
            value: Any = decoded
            try:
                for part in path:
                    # an optional vector may be nil as a whole
                    value = None if value is None else value[part]
            except (KeyError, IndexError, TypeError) as error:
                where = f"{recording.path}: {message.channel_topic}, seq {message.seq}"
                near, shown = probably_meant(str(path[0]), decoded), ", ".join(decoded)
                raise RecordingError(f"{where}: has no field {field}{near}; its fields are {shown}") from error
            values[field].append(value)
    return [message for message, _ in taken], values


def _joined(pieces: list[Column]) -> Column:
    """Return the pieces of a column as one array, of the last one's type: each is of all types that came before it."""
    last = pieces[-1].dtype
    if last == np.object_:
        # a piece of numbers has none where a message has nil
        pieces = [piece if piece.dtype == last else _as_objects(piece) for piece in pieces]
    elif last == np.float64:
        pieces = [piece.astype(last, copy=False) for piece in pieces]
    return np.concatenate(pieces)


def _as_objects(piece: Column) -> Column:
    found = np.empty(piece.shape, dtype=np.object_)
    found[:] = [None if value != value else value for value in piece.tolist()]
    return found


def _array(recording: Source, channel_topic: str, field: str, values: list[Any], kinds: set[type]) -> Column:
    """Return values as an array; `kinds` are the types of these and of all before them, and get that of the array."""
    if kinds == {int}:
        try:
            return np.array(values, dtype=np.int64)
        except OverflowError:
            # beyond 64 bits with a sign: floats from here on
            kinds.add(float)
    if kinds == {bool}:
        return np.array(values, dtype=np.bool_)
    if kinds <= _YES_OR_NUMBERS:
        # nil alone says nothing of the kind, and may stand before text
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    if kinds <= _SCALARS:
        found = np.empty(len(values), dtype=np.object_)
        found[:] = values
        return found
    kind = " or ".join(sorted(kind.__name__ for kind in kinds - {type(None)}))
    raise RecordingError(
        f"{recording.path}: {channel_topic}: {field} is a {kind}; name one of its parts, such as {field}.0"
    )
