"""Tables of a recording of any length, written batch by batch in bounded memory."""

import csv
import gc
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pyarrow as arrow
import pyarrow.parquet as parquet

from telenano.files import atomic_file, whole_folder
from telenano.recording import CopyResult, RecordedMessage, Recording, Selection, columns_of, quantity
from telenano.wire import RecordingError

# The rows of a channel are written when there are this many, or this number of bytes of them.
_MOST_ROWS = 2048
_MOST_BYTES = 4 << 20
# Rows of all channels together wait to be written up to this size [bytes].
_MOST_WAITING = 4 << 20

_NONE = {type(None)}

Columns = dict[str, list[Any]]
# The types of the values of each column.
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


def export_csv(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write a folder with a file for each channel, `columns.csv`, `metadata.json` and the attachments.

    Raises:
        RecordingError: A value is beyond what a table holds.
        OSError: The folder exists, or cannot be written.
    """
    with whole_folder(target) as folder:
        tables = write_tables(recording, selection, partial(_csv_tables, folder), target)
        _write_descriptions(folder, tables.columns)
        _write_origin(folder, recording)
    return copied(target, recording, tables)


@contextmanager
def _csv_tables(folder: Path) -> Iterator[OpenTable]:
    """Write a file for each channel into a folder."""
    with ExitStack() as files:

        def open_table(name: str, kinds: Kinds) -> Write:
            path = folder / f"{file_stem(name)}.csv"
            file = files.enter_context(path.open("w", newline="", encoding="utf-8"))
            writer = csv.writer(file)
            writer.writerow(kinds)
            return partial(_write_rows, writer)

        yield open_table


def _write_rows(writer: Any, columns: Columns) -> None:
    # float repr has all digits
    writer.writerows(zip(*columns.values(), strict=True))


def _write_descriptions(folder: Path, tables: Mapping[str, Kinds]) -> None:
    described: list[tuple[str, ...]] = [("channel", "column", "unit", "description")]
    for name, columns in tables.items():
        described += [(name, column, *quantity(topic_of(name), column)) for column in columns]
    with (folder / "columns.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(described)


def _write_origin(folder: Path, recording: Recording) -> None:
    """Write where tables of text are from: scenario, site file and what else is attached, and `metadata.json`."""
    text = json.dumps(recording.metadata, indent=2, ensure_ascii=False)
    (folder / "metadata.json").write_text(text + "\n", encoding="utf-8")
    for name, data in recording.attachments.items():
        # a recording may come from anybody: no folder but this one
        path = folder / file_stem(name).replace("\\", "_").lstrip(".")
        if not path.exists():
            path.write_bytes(data)


def export_hdf5(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write a file with a group for each channel, and the groups `metadata` and `attachments`.

    Raises:
        RecordingError: A value is beyond what a dataset holds.
        OSError: The file exists, or cannot be written.
    """
    with atomic_file(target, replace=False) as file:
        tables = write_tables(recording, selection, partial(_hdf5_tables, recording, file), target)
    return copied(target, recording, tables)


@contextmanager
def _hdf5_tables(recording: Recording, target: Path) -> Iterator[OpenTable]:
    """Write a group for each channel into a file."""
    with h5py.File(target, "w") as file:
        for name, facts in recording.metadata.items():
            file.create_group(f"metadata/{name}").attrs.update(facts)
        for name, data in recording.attachments.items():
            file[f"attachments/{name}"] = np.void(data)

        def open_table(name: str, kinds: Kinds) -> Write:
            group = file.create_group(name)
            group.attrs["topic"] = topic_of(name)
            for column, types in kinds.items():
                _create_dataset(group, column, types)
                group[column].attrs.update(quantity(topic_of(name), column)._asdict())

            def write(columns: Columns) -> None:
                for column, values in columns.items():
                    _append(group[column], kind_of(kinds[column]), values)

            return write

        yield open_table


def _create_dataset(group: Any, name: str, types: set[type]) -> None:
    kind = kind_of(types)
    if kind is str:
        options = {"dtype": h5py.string_dtype()}
    elif kind is list:
        options = {"dtype": h5py.vlen_dtype(np.float64)}
    elif type(None) in types:
        # nan represents what is not there
        options = {"dtype": np.float64}
    else:
        options = {"dtype": np.dtype(kind), "compression": "gzip", "shuffle": True}
    group.create_dataset(name, (0,), maxshape=(None,), **options)


def _append(dataset: Any, kind: type, values: list[Any]) -> None:
    before = len(dataset)
    dataset.resize((before + len(values),))
    if kind is str:
        dataset[before:] = [value or "" for value in values]
    elif kind is list:
        for number, value in enumerate(values, before):
            dataset[number] = np.asarray(value or [], dtype=np.float64)
    else:
        array = values if dataset.dtype != np.float64 else [np.nan if value is None else value for value in values]
        dataset[before:] = np.array(array, dtype=dataset.dtype)


# rows of a group, and of all channels what waits to become one [bytes]
_GROUP_ROWS = 1 << 16
_GROUP_WAITING = 16 << 20
# row groups of a file times its columns: 4 MB for each channel, and more than an hour at 1 kHz
_MOST_PARTS = 4096


def export_parquet(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write a folder with a file for each channel, each with the recording's metadata and attachments.

    The first file of a channel is `NAME.parquet`, and what comes after some five million rows is in `NAME.2.parquet`.

    Raises:
        RecordingError: A value is beyond what a column holds.
        OSError: The folder exists, or cannot be written.
    """
    with whole_folder(target) as folder:
        tables = write_tables(recording, selection, partial(_parquet_tables(recording), folder), target)
    return copied(target, recording, tables)


def _parquet_tables(recording: Recording) -> Callable[[Path], AbstractContextManager[OpenTable]]:
    origin = {f"telenano.{name}": json.dumps(facts) for name, facts in recording.metadata.items()}
    origin |= {f"telenano.{name}": data.decode(errors="replace") for name, data in recording.attachments.items()}
    types = {int: arrow.int64(), float: arrow.float64(), bool: arrow.bool_(), str: arrow.string()}
    types |= {list: arrow.list_(arrow.float64()), type(None): arrow.null()}

    def type_of(column: str, kind: type) -> Any:
        # times are whole numbers that a float does not hold
        is_times = kind is list and column.endswith("_ns")
        return arrow.list_(arrow.int64()) if is_times else types[kind]

    def schema_of(topic: str, kinds: Kinds) -> Any:
        fields = [
            arrow.field(column, type_of(column, kind_of(types)), metadata=quantity(topic, column)._asdict())
            for column, types in kinds.items()
        ]
        # pandas gives what is under this name as the `attrs` of its table
        attrs = {"topic": topic, "units": {column: quantity(topic, column).unit for column in kinds}}
        return arrow.schema(fields, metadata={**origin, "PANDAS_ATTRS": json.dumps(attrs)})

    @contextmanager
    def tables(folder: Path) -> Iterator[OpenTable]:
        # The files that were written before the types of all columns were known are written again.
        for path in folder.glob("*.parquet"):
            path.unlink()
        waiting: dict[str, _Table] = {}
        # Arrow's own pool keeps what was freed, some 20 MB, and is no faster with columns of this size.
        pool = arrow.default_memory_pool()
        arrow.set_memory_pool(arrow.system_memory_pool())

        def open_table(name: str, kinds: Kinds) -> Write:
            schema = schema_of(topic_of(name), kinds)
            table = waiting[name] = _Table(folder / file_stem(name), schema)

            def write(columns: Columns) -> None:
                table.add(columns)
                if table.rows >= _GROUP_ROWS:
                    table.write()
                elif sum(each.size_bytes for each in waiting.values()) >= _GROUP_WAITING:
                    max(waiting.values(), key=lambda each: each.size_bytes).write()

            return write

        try:
            yield open_table
            for table in waiting.values():
                table.write()
        finally:
            for table in waiting.values():
                table.close()
            arrow.set_memory_pool(pool)

    return tables


class _Table:
    """The files of a channel, and the rows that wait for the next row group."""

    def __init__(self, stem: Path, schema: Any) -> None:
        self.rows = 0
        self.size_bytes = 0
        self._stem = stem
        self._schema = schema
        # a dictionary of numbers that differ takes three times as long, and more room
        self._texts = [field.name for field in schema if field.type == arrow.string()]
        self._waiting: list[Any] = []
        self._files = 0
        self._parts = 0
        self._writer: Any = None
        self._open()

    def add(self, columns: Columns) -> None:
        table = arrow.table(columns, schema=self._schema)
        self._waiting.append(table)
        self.rows += table.num_rows
        self.size_bytes += table.nbytes

    def write(self) -> None:
        """Write what waits as a row group."""
        if not self._waiting:
            return
        if self._parts >= _MOST_PARTS:
            self._open()
        self._writer.write_table(arrow.concat_tables(self._waiting))
        self._parts += len(self._schema)
        self._waiting.clear()
        self.rows = self.size_bytes = 0

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()

    def _open(self) -> None:
        self.close()
        self._files += 1
        self._parts = 0
        path = self._stem.with_name(f"{self._stem.name}{f'.{self._files}' if self._files > 1 else ''}.parquet")
        self._writer = parquet.ParquetWriter(
            path, self._schema, compression="zstd", use_dictionary=self._texts or False
        )
