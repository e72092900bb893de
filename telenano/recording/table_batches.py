"""Tables of a recording of any length, written batch by batch in bounded memory."""

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from telenano.recording.mcap_scan import Damage
from telenano.recording.messages import ChannelFilter, RecordedMessage
from telenano.recording.reader import Recording
from telenano.recording.tables import TypedColumn, typed_columns, uniform

# The rows of a channel are written when there are so many, or so many bytes of them.
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


def write_tables(
    recording: Recording, wanted: ChannelFilter, begin: Callable[[], AbstractContextManager[OpenTable]]
) -> tuple[dict[str, Kinds], int, list[Damage]]:
    """Write a table for each channel; return the columns of each, the number of messages, and what cannot be read.

    A table needs the types of all its columns before its first row. They are taken from the first batch of a channel;
    where a later one has others, the recording is read to its end for them, and is then written from its beginning.

    Parameters: begin, called before the first row, and for the second time where the tables are written again.
    """
    kinds: dict[str, Kinds] = {}
    with _no_collection():
        total, damage, widened = _write_once(recording, wanted, begin, kinds)
        if widened:
            total, damage, _ = _write_once(recording, wanted, begin, kinds)
    return kinds, total, damage


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
    wanted: ChannelFilter,
    begin: Callable[[], AbstractContextManager[OpenTable]],
    kinds: dict[str, Kinds],
) -> tuple[int, list[Damage], bool]:
    """Write the tables, or only note the types once one is met that a table was not opened with."""
    damage: list[Damage] = []
    tables: dict[str, Write] = {}
    total, widened = 0, False
    with begin() as open_table:
        for name, messages in _batches(recording, wanted, damage.append):
            columns = typed_columns(messages)
            is_new = _add_kinds(kinds.setdefault(name, {}), columns)
            widened = widened or (is_new and name in tables)
            total += len(messages)
            if widened:
                continue
            if name not in tables:
                tables[name] = open_table(name, kinds[name])
            absent: TypedColumn = [None] * len(messages), _NONE
            tables[name](
                {column: uniform(columns.get(column, absent)[0], found) for column, found in kinds[name].items()}
            )
    return total, damage, widened


def kind_of(found: set[type]) -> type:
    """Return the type of a column whose values are made uniform: of its only kind, float, or text of JSON."""
    kinds = found - {type(None)}
    if len(kinds) > 1:
        return float if kinds <= {int, float} else str
    return next(iter(kinds), type(None))


def _add_kinds(known: Kinds, batch: Mapping[str, TypedColumn]) -> bool:
    """Add the types in a batch to those that are known; return whether one of them is new."""
    is_new = False
    for column in {**known, **batch}:
        found = batch[column][1] if column in batch else _NONE
        before = known.setdefault(column, set())
        if not found <= before:
            before |= found
            is_new = True
    return is_new


def _batches(
    recording: Recording, wanted: ChannelFilter, report: Callable[[Damage], None]
) -> Iterator[tuple[str, list[RecordedMessage]]]:
    """Yield channel names and messages: each channel in its order, and no more at once than the memory is to hold."""
    waiting: dict[str, list[RecordedMessage]] = {}
    sizes: dict[str, int] = {}
    together = 0
    for message in recording.select(wanted, report=report):
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
