"""Tables of a recording of any length, written batch by batch in bounded memory."""

import gc
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from telenano.recording import CopyResult, RecordedMessage, Recording, Selection, columns_of
from telenano.wire import RecordingError

# The rows of a channel are written when there are this many, or this number of bytes of them.
_MOST_ROWS = 2048
_MOST_BYTES = 4 << 20
# Rows of all channels together wait to be written up to this size [bytes].
_MOST_WAITING = 4 << 20

_NONE = {type(None)}

Columns = dict[str, list[Any]]
# by column, the types of its values
Kinds = dict[str, set[type]]
Write = Callable[[Columns], None]
# open the table of a channel, with the columns that it has
OpenTable = Callable[[str, Kinds], Write]


class Tables(NamedTuple):
    """What was written: the columns of each channel, the number of messages, and what could not be read, in words."""

    columns: dict[str, Kinds]
    messages: int
    damage: list[str]


def copied(target: Path, recording: Recording, tables: Tables) -> CopyResult:
    """Return what `telenano bag export` prints of the tables of a recording."""
    skipped = (*map(str, recording.structural_damage), *tables.damage)
    return CopyResult(path=str(target), messages=tables.messages, skipped=skipped)


def file_stem(name: str) -> str:
    """Return the name of a channel in a form that is valid in a file name."""
    return name.replace("/", "_")


def topic_of(name: str) -> str:
    """Return the topic of a channel, whose name may have the site of its reception after an `@`."""
    return name.partition("@")[0]


def write_tables(
    recording: Recording, wanted: Selection, begin: Callable[[], AbstractContextManager[OpenTable]], target: Path
) -> Tables:
    """Write a table for each channel; return the columns of each, the number of messages, and what cannot be read.

    A table needs the types of all its columns before its first row. They are taken from the first batch of a channel;
    where a later one has others, the recording is read to its end for them, and is then written from its beginning.

    Args:
        recording: The recording.
        wanted: Which channels are written.
        begin: Called before the first row, and for the second time where the tables are written again.
        target: The file or folder that is named in errors.

    Raises:
        RecordingError: A number of a stranger's file is larger than the format holds.
    """
    kinds: dict[str, Kinds] = {}
    try:
        with _no_collection():
            total, damage, widened = _write_once(recording, wanted, begin, kinds)
            if widened:
                total, damage, _ = _write_once(recording, wanted, begin, kinds)
    except (OverflowError, ValueError) as error:
        raise RecordingError(f"{target}: cannot be written: {error}") from error
    return Tables(kinds, total, damage)


@contextmanager
def _no_collection() -> Iterator[None]:
    """Suspend the garbage collector, which goes through each batch again and again and finds no cycle in it."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _write_once(
    recording: Recording,
    wanted: Selection,
    begin: Callable[[], AbstractContextManager[OpenTable]],
    kinds: dict[str, Kinds],
) -> tuple[int, list[str], bool]:
    """Write the tables, or only note the types once one is met that a table was not opened with."""
    damage: list[str] = []
    tables: dict[str, Write] = {}
    total, widened = 0, False
    with begin() as open_table:
        for name, messages in _batches(recording, wanted, damage):
            columns = columns_of(messages)
            is_new = _add_kinds(kinds.setdefault(name, {}), {column: part.kinds for column, part in columns.items()})
            widened = widened or (is_new and name in tables)
            total += len(messages)
            if widened:
                continue
            if name not in tables:
                tables[name] = open_table(name, kinds[name])
            absent: list[Any] = [None] * len(messages)
            tables[name](
                {
                    column: columns[column].uniform(types) if column in columns else absent
                    for column, types in kinds[name].items()
                }
            )
    return total, damage, widened


def kind_of(types: set[type]) -> type:
    """Return the type of a column whose values are made uniform: of its only kind, float, or text of JSON."""
    kinds = types - {type(None)}
    if len(kinds) > 1:
        return float if kinds <= {int, float} else str
    return next(iter(kinds), type(None))


def _add_kinds(kinds: Kinds, batch: Kinds) -> bool:
    """Add the types in a batch to those that are known; return whether one of them is new."""
    is_new = False
    for column in {**kinds, **batch}:
        types = batch.get(column, _NONE)
        before = kinds.setdefault(column, set())
        if not types <= before:
            before |= types
            is_new = True
    return is_new


def _batches(recording: Recording, wanted: Selection, damage: list[str]) -> Iterator[tuple[str, list[RecordedMessage]]]:
    """Yield channel names and messages: each channel in its order, and no more at once than the memory is to hold."""
    waiting: dict[str, list[RecordedMessage]] = {}
    sizes: dict[str, int] = {}
    together = 0
    for message in recording.select(wanted, report=lambda part: damage.append(str(part))):
        name, size = message.channel.channel_topic, len(message.payload)
        batch = waiting.setdefault(name, [])
        batch.append(message)
        sizes[name] = sizes.get(name, 0) + size
        together += size
        if len(batch) < _MOST_ROWS and sizes[name] < _MOST_BYTES and together < _MOST_WAITING:
            continue
        if together >= _MOST_WAITING:
            name = max(sizes, key=lambda each: sizes[each])
        together -= sizes.pop(name)
        yield name, waiting.pop(name)
    yield from waiting.items()
