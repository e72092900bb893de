"""Writes a recording of any length as tables (CSV, HDF5, Parquet), batch by batch in bounded memory."""

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

# The rows of a channel are written when there are this many of them, or this many bytes.
_MOST_ROWS = 2048
_MOST_BYTES = 4 << 20
# The largest size of the waiting rows of all channels together [bytes].
_MOST_WAITING = 4 << 20

_NONE = {type(None)}

Columns = dict[str, list[Any]]
# The types of the values of each column.
Kinds = dict[str, set[type]]
Write = Callable[[Columns], None]
# Function that opens the table of a channel, given its name and columns, and returns the function that writes rows.
OpenTable = Callable[[str, Kinds], Write]


class Tables(NamedTuple):
    """The tables written: columns of each channel, number of messages, and texts about the unreadable parts."""

    columns: dict[str, Kinds]
    messages: int
    damage: list[str]


def copied(target: Path, recording: Recording, tables: Tables) -> CopyResult:
    """Return the result of an export as `telenano bag export` prints it."""
    skipped = (*map(str, recording.structural_damage), *tables.damage)
    return CopyResult(path=str(target), messages=tables.messages, skipped=skipped)


def file_stem(name: str) -> str:
    """Return the name of a channel in a form that is valid in a file name."""
    return name.replace("/", "_")


def topic_of(name: str) -> str:
    """Return the topic of a channel; the name of a channel may end with `@` and the site that received it."""
    return name.partition("@")[0]


def write_tables(
    recording: Recording, wanted: Selection, begin: Callable[[], AbstractContextManager[OpenTable]], target: Path
) -> Tables:
    """Write a table for each channel, and return a report on them.

    A table needs the types of all its columns before its first row. They are taken from the first batch of a channel;
    if a later batch has other types, the recording is read to its end for all types, and then written again from its
    beginning.

    Args:
        recording: The recording.
        wanted: The selection of the channels to write.
        begin: The function that begins the output, called again if the tables are written again.
        target: The file or folder, for errors.

    Raises:
        RecordingError: A value does not fit into the format.
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
    """Suspend the garbage collector, which would scan each batch repeatedly without finding any cycle in it."""
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
    """Write the tables; from the first type with which a table was not opened, only collect the types.

    Returns:
        The number of messages, texts about the unreadable parts, and whether the tables have to be written again.
    """
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
    """Return the uniform type of a column with values of these types: the only one, float, or str for JSON texts."""
    kinds = types - {type(None)}
    if len(kinds) > 1:
        return float if kinds <= {int, float} else str
    return next(iter(kinds), type(None))


def _add_kinds(kinds: Kinds, batch: Kinds) -> bool:
    """Add the types in a batch to the known ones, in place; return whether one of them is new."""
    is_new = False
    for column in {**kinds, **batch}:
        types = batch.get(column, _NONE)
        before = kinds.setdefault(column, set())
        if not types <= before:
            before |= types
            is_new = True
    return is_new


def _batches(recording: Recording, wanted: Selection, damage: list[str]) -> Iterator[tuple[str, list[RecordedMessage]]]:
    """Yield batches as channel name and messages: each channel in its order, with a bounded size of all that wait."""
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
        RecordingError: A value does not fit into a table.
        OSError: The folder exists, or cannot be written.
    """
    with whole_folder(target) as folder:
        tables = write_tables(recording, selection, partial(_csv_tables, folder), target)
        _write_descriptions(folder, tables.columns)
        _write_origin(folder, recording)
    return copied(target, recording, tables)


@contextmanager
def _csv_tables(folder: Path) -> Iterator[OpenTable]:
    """Yield the function that opens a CSV file for a channel in a folder."""
    with ExitStack() as files:

        def open_table(name: str, kinds: Kinds) -> Write:
            path = folder / f"{file_stem(name)}.csv"
            file = files.enter_context(path.open("w", newline="", encoding="utf-8"))
            writer = csv.writer(file)
            writer.writerow(kinds)
            return partial(_write_rows, writer)

        yield open_table


def _write_rows(writer: Any, columns: Columns) -> None:
    # The csv module writes a float with all its digits.
    writer.writerows(zip(*columns.values(), strict=True))


def _write_descriptions(folder: Path, tables: Mapping[str, Kinds]) -> None:
    described: list[tuple[str, ...]] = [("channel", "column", "unit", "description")]
    for name, columns in tables.items():
        described += [(name, column, *quantity(topic_of(name), column)) for column in columns]
    with (folder / "columns.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(described)


def _write_origin(folder: Path, recording: Recording) -> None:
    """Write the origin of the tables: `metadata.json`, and the attachments, such as scenario and site file."""
    text = json.dumps(recording.metadata, indent=2, ensure_ascii=False)
    (folder / "metadata.json").write_text(text + "\n", encoding="utf-8")
    for name, data in recording.attachments.items():
        # A recording may come from a stranger, so its names must not lead out of this folder.
        path = folder / file_stem(name).replace("\\", "_").lstrip(".")
        if not path.exists():
            path.write_bytes(data)


def export_hdf5(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write a file with a group for each channel, and the groups `metadata` and `attachments`.

    Raises:
        RecordingError: A value does not fit into a dataset.
        OSError: The file exists, or cannot be written.
    """
    with atomic_file(target, replace=False) as file:
        tables = write_tables(recording, selection, partial(_hdf5_tables, recording, file), target)
    return copied(target, recording, tables)


@contextmanager
def _hdf5_tables(recording: Recording, target: Path) -> Iterator[OpenTable]:
    """Write metadata and attachments into a file; yield the function that opens the group of a channel there."""
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
        # NaN stands for a missing value.
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


# Number of rows in a row group.
_GROUP_ROWS = 1 << 16
# The largest size of the rows of all channels that wait for a row group [bytes].
_GROUP_WAITING = 16 << 20
# The largest number of row groups times columns of a file: 4 MB for each channel, and more than an hour at 1 kHz.
_MOST_PARTS = 4096


def export_parquet(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write a folder with a file for each channel, each with the recording's metadata and attachments.

    The first file of a channel is `NAME.parquet`; after some five million rows the next file is `NAME.2.parquet`.

    Raises:
        RecordingError: A value does not fit into a column.
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
        # Times are whole numbers that a float cannot represent exactly.
        is_times = kind is list and column.endswith("_ns")
        return arrow.list_(arrow.int64()) if is_times else types[kind]

    def schema_of(topic: str, kinds: Kinds) -> Any:
        fields = [
            arrow.field(column, type_of(column, kind_of(types)), metadata=quantity(topic, column)._asdict())
            for column, types in kinds.items()
        ]
        # pandas reads the entry of this name as the `attrs` of its table.
        attrs = {"topic": topic, "units": {column: quantity(topic, column).unit for column in kinds}}
        return arrow.schema(fields, metadata={**origin, "PANDAS_ATTRS": json.dumps(attrs)})

    @contextmanager
    def tables(folder: Path) -> Iterator[OpenTable]:
        # Files written before the types of all columns were known are written again.
        for path in folder.glob("*.parquet"):
            path.unlink()
        waiting: dict[str, _Table] = {}
        # Arrow's own pool keeps freed memory, some 20 MB, and is no faster with columns of this size.
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
        # Only texts are encoded by a dictionary: with different numbers that takes three times as long, and more room.
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
        """Write the waiting rows as a row group."""
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
