"""Tables in Parquet, written in memory that does not grow with their length.

What a file says of a row group stays in memory until the file is closed, 0.9 kB a column. So rows wait until a group is
large, and a file that has many groups is followed by another one.
"""

import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as arrow
import pyarrow.parquet as parquet

from telenano.files import whole_folder
from telenano.recording import CopyResult, Recording, Selection, quantity
from telenano_tables.table_batches import (
    Columns,
    Kinds,
    OpenTable,
    Write,
    copied,
    file_stem,
    kind_of,
    topic_of,
    write_tables,
)

# rows of a group, and of all channels what waits to become one [bytes]
_MOST_ROWS = 1 << 16
_MOST_WAITING = 16 << 20
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
                if table.rows >= _MOST_ROWS:
                    table.write()
                elif sum(each.size_bytes for each in waiting.values()) >= _MOST_WAITING:
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
