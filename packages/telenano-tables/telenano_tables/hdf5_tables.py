"""Tables in HDF5: a file with a group for each channel, and a dataset for each column."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from telenano.files import atomic_file
from telenano.recording import CopyResult, Recording, Selection, quantity
from telenano_tables.table_batches import Columns, Kinds, OpenTable, Write, copied, kind_of, topic_of, write_tables


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


def _create_dataset(group: Any, name: str, found: set[type]) -> None:
    kind = kind_of(found)
    if kind is str:
        options = {"dtype": h5py.string_dtype()}
    elif kind is list:
        options = {"dtype": h5py.vlen_dtype(np.float64)}
    elif type(None) in found:
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
