"""Fields of the messages of one channel as arrays, for figures and reports.

hand = Recording(path).columns("haptic/state", ("t_ns", "position_m.2"))
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np
import numpy.typing as npt

from telenano.recording.messages import LeftOut, RecordedChannel, RecordedMessage
from telenano.wire.errors import RecordingError, probably_meant

Column = npt.NDArray[Any]
# The keys and indices that lead to a field.
_Path = tuple[str | int, ...]

# These belong to the record and not to the message; seq and t_ns are in the message as well.
_RECORD_FIELDS = ("log_ns", "publish_ns")
# Messages that are converted to arrays at once.
_AT_ONCE = 8192
# The types that a column can hold, and those that become numbers.
_SCALARS = frozenset((bool, int, float, str, type(None)))
_YES_OR_NUMBERS = frozenset((bool, int, float, type(None)))
# Reasons of rejection that mean that this version does not know the model of a message.
_UNKNOWN = frozenset(("topic", "newer_version"))


class Source(Protocol):
    """Source of columns: the part of `telenano.recording.recorded_fields.RecordedFields` that this module needs."""

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
        Arrays of shape (n,) by field. Integers are int64 and numbers float64, NaN where a message has nil or lacks the
        key. Booleans are bool if every message has one, else float64 of 1, 0 and NaN. Text is objects, None where
        there is none; so is a field that mixes text and numbers.

    Raises:
        RecordingError: There is no such channel or field; the message names file, channel and field.
    """
    pieces = list(column_pieces(recording, channel_topic, fields))
    return {field: _joined([piece[field] for piece in pieces]) for field in fields}


def column_pieces(recording: Source, channel_topic: str, fields: Sequence[str]) -> Iterator[dict[str, Column]]:
    """Yield the result of `columns` in pieces of `_AT_ONCE` messages, at least one, so that memory is bounded.

    The type of a piece follows from all values so far: integers become floats from the first piece with another number.
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
    messages = recording.messages((channel_topic,))
    is_first = True
    while (batch := list(islice(messages, _AT_ONCE))) or is_first:
        is_first = False
        taken, found = _fields_of(recording, batch, paths)
        values: dict[str, list[Any]] = {
            field: [getattr(message, field) for message in taken] for field in fields if field not in paths
        }
        values |= found
        for field in fields:
            kinds[field].update(map(type, values[field]))
        yield {field: _array(recording, channel_topic, field, values[field], kinds[field]) for field in fields}


def _fields_of(
    recording: Source, messages: Sequence[RecordedMessage], paths: Mapping[str, _Path]
) -> tuple[Sequence[RecordedMessage], dict[str, list[Any]]]:
    """Return the messages that a node would accept, each decoded as a whole, and the values of their fields.

    Messages that a node would reject are counted and left out. If all have an unknown model, none is checked.

    Raises:
        RecordingError: A message lacks a field; the error names it.
    """
    taken: list[RecordedMessage] = []
    read: list[Any] = []
    left_out = LeftOut()
    for message in messages:
        try:
            read.append(message.accepted())
        except RecordingError as error:
            left_out.note_error(error, message)
        else:
            taken.append(message)
    if not taken and left_out.rejected.keys() <= _UNKNOWN:
        taken, read = list(messages), [message.fields() for message in messages]
    else:
        recording.left_out.add(left_out)
    values: dict[str, list[Any]] = {}
    for field, (first, *rest) in paths.items():
        try:
            column = list(map(attrgetter(str(first)), read))
        except AttributeError:
            # The model lacks this key, or is unknown.
            column = [_plain(recording, message, field, first) for message in taken]
        for part in rest:
            column = [
                _part(recording, message, field, value, part) for message, value in zip(taken, column, strict=True)
            ]
        values[field] = column
    return taken, values


def _plain(recording: Source, message: RecordedMessage, field: str, key: str | int) -> Any:
    fields = message.fields()
    if key not in fields:
        raise _lacking(recording, message, field)
    return fields[str(key)]


def _part(recording: Source, message: RecordedMessage, field: str, value: Any, part: str | int) -> Any:
    """Return one component of a field's value; None if the whole value is nil, such as an optional vector."""
    try:
        if value is None:
            return None
        return getattr(value, str(part)) if isinstance(value, msgspec.Struct) else value[part]
    except (AttributeError, LookupError, TypeError) as error:
        raise _lacking(recording, message, field) from error


def _lacking(recording: Source, message: RecordedMessage, field: str) -> RecordingError:
    names = message.fields()
    near, shown = probably_meant(field.partition(".")[0], names), ", ".join(names)
    where = f"{recording.path}: {message.channel_topic}, seq {message.seq}"
    return RecordingError(f"{where}: has no field {field}{near}; its fields are {shown}")


def _joined(pieces: list[Column]) -> Column:
    """Join the pieces of a column to one array of the last one's type, which covers all values before it."""
    last = pieces[-1].dtype
    if last == np.object_:
        # A numeric piece has NaN where a message has nil; an object column has None there.
        pieces = [piece if piece.dtype == last else _as_objects(piece) for piece in pieces]
    elif last == np.float64:
        pieces = [piece.astype(last, copy=False) for piece in pieces]
    return np.concatenate(pieces)


def _as_objects(piece: Column) -> Column:
    found = np.empty(piece.shape, dtype=np.object_)
    found[:] = [None if value != value else value for value in piece.tolist()]
    return found


def _array(recording: Source, channel_topic: str, field: str, values: list[Any], kinds: set[type]) -> Column:
    """Return values as an array; `kinds`, the types of all values so far, gains float if the values exceed int64."""
    if kinds == {int}:
        try:
            return np.array(values, dtype=np.int64)
        except OverflowError:
            # Beyond int64 the column has floats from here on.
            kinds.add(float)
    if kinds == {bool}:
        return np.array(values, dtype=np.bool_)
    if kinds <= _YES_OR_NUMBERS:
        # A column of nil alone becomes NaN; `_joined` converts it if text follows.
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    if kinds <= _SCALARS:
        found = np.empty(len(values), dtype=np.object_)
        found[:] = values
        return found
    kind = " or ".join(sorted(kind.__name__ for kind in kinds - {type(None)}))
    raise RecordingError(
        f"{recording.path}: {channel_topic}: {field} is a {kind}; name one of its parts, such as {field}.0"
    )
