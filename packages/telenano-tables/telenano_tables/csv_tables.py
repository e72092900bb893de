"""Tables of text: a file for each channel, and beside them what the columns are and where they are from."""

import csv
import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from telenano.files import whole_folder
from telenano.recording import CopyResult, Recording, Selection, quantity
from telenano_tables.table_batches import Columns, Kinds, OpenTable, Write, copied, file_stem, topic_of, write_tables


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
