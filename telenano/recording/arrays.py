"""Fields of the messages of one channel as arrays, for figures and reports."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from operator import attrgetter
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from telenano.recording.messages import LeftOut, RecordedChannel, RecordedMessage, readable
from telenano.recording.multi_file import RecordingSource
from telenano.wire.errors import RecordingError, probably_meant

Column = npt.NDArray[Any]
# the keys and places that lead to a field
_Path = tuple[str | int, ...]

# These belong to the record and not to the message; seq and t_ns are in the message as well.
_RECORD_FIELDS = ("log_ns", "publish_ns")
# topics of the loop, by their declared rate [Hz]
_FAST_HZ = 100.0
# This number of older samples in a row come from a player that was set back.
_REWIND_RUN = 8
# They are older than the newest sample by more than this.
_REWIND_NS = 1_000_000_000
# this number of messages are put into arrays at once
_AT_ONCE = 8192
# The types of fields that become columns, and of those that become numbers.
_SCALARS = frozenset((bool, int, float, str, type(None)))
_NUMBERS = frozenset((int, float))
# Reasons for which a message is of a model that is not known here.
_UNKNOWN = frozenset(("topic", "newer_version"))
# a launcher reports a session when the device has answered that its force profile runs
_START_REPORT_NS = 2_000_000_000


def columns(recording: RecordingSource, channel_topic: str, fields: Sequence[str]) -> dict[str, Column]:
    """Return fields of every message of a channel, in the order received.

    Args:
        recording: The recording to read.
        channel_topic: The topic of the channel.
        fields: Keys of the message, dotted into its parts (`position_m.2`, `forward.delay_mean_s`), and `log_ns` and
            `publish_ns` of the record.

    Returns:
        Arrays of one dimension by field: int64, float64 (NaN where a message has nil), bool, or objects for text.

    Raises:
        RecordingError: There is no such channel or field; the message names file, channel and field.
    """
    pieces = list(column_pieces(recording, channel_topic, fields))
    return {field: _joined([piece[field] for piece in pieces]) for field in fields}


def column_pieces(recording: RecordingSource, channel_topic: str, fields: Sequence[str]) -> Iterator[dict[str, Column]]:
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
        if found is None or not all(_is_column(found[field], kinds[field]) for field in paths):
            batch, found = _read_each(recording, batch, paths)
        values: dict[str, list[Any]] = {
            field: [getattr(message, field) for message in batch] for field in fields if field not in paths
        }
        values |= found
        for field in fields:
            kinds[field].update(map(type, values[field]))
        yield {field: _array(recording, channel_topic, field, values[field], kinds[field]) for field in fields}


def replayed_sources(recording: RecordingSource, *, newest: bool = False) -> set[str]:
    """Return the nodes whose messages a player sent in their place; with `newest`, by the last report of each."""

    def is_health(channel: RecordedChannel) -> bool:
        return channel.channel_topic == "node/health"

    last_ns = recording.span_ns[1] + 1
    health = recording.newest_before(last_ns, is_health).values() if newest else recording.select(is_health)
    return {message.src for message, fields in readable(health, recording.left_out) if fields["replay"]}


def replay_shifts(recording: RecordingSource, *, newest: bool = False) -> dict[str, int]:
    """Return by how much [ns] the time stamps of each replayed source lie behind those of live nodes.

    A rig in which a player stood in for some nodes has old stamps beside new ones; the time of reception puts them on
    one axis. Empty where none was replayed, or all were: then the stamps agree with one another as they are.
    """
    replayed = replayed_sources(recording, newest=newest)
    fast = {c.src: c.channel_topic for c in recording.channels if c.via == "direct" and (c.rate_hz or 0.0) >= _FAST_HZ}
    if not replayed & set(fast) or set(fast) <= replayed:
        return {}
    shifts = {}
    for src in replayed & set(fast):
        times = columns(recording, fast[src], ("log_ns", "publish_ns"))
        shifts[src] = round(float(np.median(times["log_ns"] - times["publish_ns"])))
    return shifts


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


def _read_each(
    recording: RecordingSource, messages: Sequence[RecordedMessage], paths: Mapping[str, _Path]
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
        # a piece in which all values were nil is one of numbers that are none
        pieces = [piece if piece.dtype == last else np.full(piece.shape, None, dtype=np.object_) for piece in pieces]
    return np.concatenate([piece.astype(last, copy=False) for piece in pieces])


def _array(recording: RecordingSource, channel_topic: str, field: str, values: list[Any], kinds: set[type]) -> Column:
    """Return values as an array; `kinds` are the types of these and of all before them."""
    if not kinds or (kinds <= {float, int, type(None)} and kinds & {float, type(None)}):
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    if kinds <= {int}:
        return np.array(values, dtype=np.int64)
    if kinds <= {bool}:
        return np.array(values, dtype=np.bool_)
    if kinds <= {str, type(None)}:
        return np.array(values, dtype=np.object_)
    kind = " or ".join(sorted(kind.__name__ for kind in kinds))
    raise RecordingError(
        f"{recording.path}: {channel_topic}: {field} is a {kind}; name one of its parts, such as {field}.0"
    )


def last_force_profile(session_s: Column, t_ns: Column) -> npt.NDArray[np.intp]:
    """Return the indices of the last run of the operator's force profile.

    It begins where the time of the force profile falls while the time of sending continues, or where a player was set
    back. A message that stands behind later ones, or is repeated, is in none.

    Args:
        session_s: session_s of `haptic/state` [s], negative while no force profile runs, shape (n,).
        t_ns: The times of sending [ns], shape (n,).

    Returns:
        The indices, fewer than two when no force profile ran.
    """
    running = np.flatnonzero(session_s >= 0.0)
    old = t_ns[running] < np.maximum.accumulate(t_ns[running])
    while old.any():
        begins, ends = np.flatnonzero(np.diff(old, prepend=False, append=False)).reshape(-1, 2).T
        set_back_ns = t_ns[running[begins - 1]] - t_ns[running[begins]]
        rewinds = begins[(ends - begins >= _REWIND_RUN) & (set_back_ns > _REWIND_NS)]
        if not rewinds.size:
            running = running[~old]
            break
        running = running[rewinds[0] :]
        old = t_ns[running] < np.maximum.accumulate(t_ns[running])
    restarts = np.flatnonzero(np.diff(session_s[running]) < 0.0)
    return running[restarts[-1] + 1 :] if restarts.size else running


def last_session(
    session_s: Column, seq: Column, t_ns: Column, starts_ns: Sequence[int] = (), ends_ns: Sequence[int] = ()
) -> npt.NDArray[np.intp]:
    """Return the indices of the last session: the last force profile, and those that a restart has cut off.

    A device whose process died while the force profile ran begins it again when it is commanded to; that is the same
    session, unless a launcher has started one since. What the new process sent until then, or until a launcher ended
    the session where no command came, is of the session too.

    Args:
        session_s: session_s of `haptic/state` [s], negative while no force profile runs, shape (n,).
        seq: The seq of its messages, shape (n,).
        t_ns: The times of sending of its messages [ns], shape (n,).
        starts_ns: The times at which launchers reported that a session runs [ns].
        ends_ns: The times at which launchers reported that a session is over [ns].

    Returns:
        The indices, fewer than two when no force profile ran.
    """
    session = last_force_profile(session_s, t_ns)
    if session.size and (last := int(session[-1])) + 1 < len(seq) and _died(last, seq, t_ns):
        end_ns = min((end_ns for end_ns in ends_ns if end_ns > t_ns[last]), default=t_ns.max() + 1)
        after = _rising(np.arange(last + 1, len(seq)), t_ns)
        session = np.concatenate((session, after[t_ns[after] < end_ns]))
    while session.size and (first := int(session[0])) > 0:
        before = last_force_profile(session_s[:first], t_ns[:first])
        if not before.size or not _was_cut_off(int(before[-1]), first, seq, t_ns, starts_ns):
            break
        between = _rising(np.arange(before[-1] + 1, first), t_ns)
        session = np.concatenate((before, between[t_ns[between] < t_ns[first]], session))
    return session


def _died(last: int, seq: Column, t_ns: Column) -> bool:
    """Return whether the message after one is the first of a new process: its number begins again, and its time not."""
    return bool(seq[last + 1] <= seq[last] and t_ns[last + 1] > t_ns[last])


def _rising(places: npt.NDArray[np.intp], t_ns: Column) -> npt.NDArray[np.intp]:
    """Return the places without those that stand behind later messages."""
    return places[t_ns[places] >= np.maximum.accumulate(t_ns[places])] if places.size else places


def _was_cut_off(last: int, first: int, seq: Column, t_ns: Column, starts_ns: Sequence[int]) -> bool:
    """Return whether a force profile ended with its process, and the one that follows is of the same session."""
    is_restarted = any(t_ns[last] < start_ns < t_ns[first] + _START_REPORT_NS for start_ns in starts_ns)
    return _died(last, seq, t_ns) and not is_restarted
