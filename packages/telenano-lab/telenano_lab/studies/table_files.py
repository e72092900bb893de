"""Tables of results in formats of other programs: CSV, Parquet, and MAT for MATLAB."""

import csv
import io
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

Rows = Sequence[Mapping[str, Any]]


def table_files(name: str, rows: Rows, formats: Sequence[str] = ("csv",)) -> dict[str, bytes]:
    """Return a table as the content of its files, by file name; its columns are those of all rows, in their order."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    whole = [{column: _plain(row.get(column)) for column in columns} for row in rows]
    return {f"{name}.{form}": FORMATS[form](whole) for form in formats}


def _csv(rows: Rows) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [])
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def _parquet(rows: Rows) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = io.BytesIO()
    pq.write_table(pa.Table.from_pylist(list(rows)), sink)
    return sink.getvalue()


def _mat(rows: Rows) -> bytes:
    """Return a struct `table` with a member for each column: numbers, with NaN for none, or a cell array of texts.

    MATLAB accepts names of at most 63 letters, digits and underscores that begin with a letter.
    """
    import numpy as np
    from scipy.io import savemat

    members: dict[str, Any] = {}
    for column in rows[0] if rows else ():
        values = [row[column] for row in rows]
        numbers = all(value is None or isinstance(value, bool | int | float) for value in values)
        name = re.sub(r"\W+", "_", column).strip("_")
        name = (name if name[:1].isalpha() else f"x_{name}")[:60]
        name = name if name not in members else f"{name}_{len(members)}"
        plain = np.array([float("nan") if value is None else float(value) for value in values]) if numbers else None
        members[name] = np.array([str(value) for value in values], dtype=object) if plain is None else plain
    sink = io.BytesIO()
    savemat(sink, {"table": members}, long_field_names=True, oned_as="column")
    return sink.getvalue()


def _plain(value: Any) -> Any:
    # Numbers of NumPy become plain numbers.
    value = value.item() if hasattr(value, "item") else value
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


FORMATS: dict[str, Callable[[Rows], bytes]] = {"csv": _csv, "parquet": _parquet, "mat": _mat}
