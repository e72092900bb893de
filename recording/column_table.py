"""Columns of equal length with units and descriptions: a table of messages, or of a simulated session."""

import importlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy.typing as npt

from proto.errors import ConfigError

Column = npt.NDArray[Any]


class ColumnTable(Mapping[str, Column]):
    """Columns of shape (n,) by name; `units` and `descriptions` have an entry for each."""

    def __init__(
        self, name: str, columns: Mapping[str, Column], units: Mapping[str, str], descriptions: Mapping[str, str]
    ) -> None:
        self._name = name
        self._columns = dict(columns)
        self.units = dict(units)
        self.descriptions = dict(descriptions)

    def __getitem__(self, name: str) -> Column:
        """Return a column; KeyError names those that there are."""
        if name not in self._columns:
            raise KeyError(f"{self._name} has no column {name!r}; its columns are {', '.join(self._columns)}")
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame, with `units` in its attrs; ConfigError where pandas is not installed."""
        try:
            pandas = importlib.import_module("pandas")
        except ImportError as error:
            raise ConfigError("tables as data frames need the package pandas: pip install pandas") from error
        frame = pandas.DataFrame({name: list(values) if values.ndim > 1 else values for name, values in self.items()})
        frame.attrs.update(units=self.units)
        return frame
