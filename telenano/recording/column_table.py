"""Columns of equal length with units and descriptions: a table of messages, or of a simulated session."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from telenano.files.optional_modules import required_module
from telenano.wire.errors import probably_meant

if TYPE_CHECKING:
    import pandas
    import xarray

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
        """Return a column; KeyError names the one that was probably meant, and those that there are."""
        if name not in self._columns:
            meant = _meant(name, self._columns)
            names = f"{meant} Its" if meant else "; its"
            raise KeyError(f"{self._name} has no column {name!r}{names} columns are {', '.join(self._columns)}")
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._columns)

    def __repr__(self) -> str:
        rows = len(next(iter(self._columns.values()))) if self._columns else 0
        return f"<{type(self).__name__} {self._name}: {rows} rows of {', '.join(self._columns)}>"

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a pandas DataFrame, with `units` in its attrs; ConfigError where pandas is not installed."""
        pandas = required_module("pandas", "a table as data of pandas: pandas is not installed", "export")
        frame = pandas.DataFrame({name: list(values) if values.ndim > 1 else values for name, values in self.items()})
        frame.attrs.update(units=self.units)
        return frame

    def to_xarray(self) -> "xarray.Dataset":
        """Return an xarray Dataset over `time_s`; `units` and `long_name` are attributes of each variable.

        Raises:
            ConfigError: xarray is not installed; the message says what adds it.
        """
        module = required_module("xarray", "a table as data of xarray: xarray is not installed", "export")
        facts = {name: {"units": self.units[name], "long_name": self.descriptions[name]} for name in self}
        variables = {
            name: (("time_s", *(f"{name}_{axis}" for axis in range(1, values.ndim))), values, facts[name])
            for name, values in self.items()
        }
        times = variables.pop("time_s")
        data: xarray.Dataset = module.Dataset(variables, coords={"time_s": times}, attrs={"name": self._name})
        return data


def _meant(name: object, columns: Mapping[str, Column]) -> str:
    """Return `; did you mean NAME?` for a wrong column: the components of the vector that it names, or the nearest."""
    text = str(name)
    if parts := [column for column in columns if column.startswith(f"{text}.")]:
        return f"; did you mean {' or '.join(parts)}?"
    return probably_meant(text, columns)
