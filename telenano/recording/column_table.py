"""Columns of equal length with units and descriptions: a table of messages, or of a simulated session."""

import sys
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
        """Return a column, shape (n,) or more; KeyError suggests the probable name and lists the columns."""
        if not isinstance(name, str):
            raise KeyError(
                f"{self._name} takes the name of a column, not {name!r}: `to_pandas()` gives rows, slices and several"
                f" columns; its columns are {', '.join(self._columns)}"
            )
        if name not in self._columns:
            meant = probably_meant(name, self._columns)
            names = f"{meant} Its" if meant else "; its"
            raise KeyError(f"{self._name} has no column {name!r}{names} columns are {', '.join(self._columns)}")
        return self._columns[name]

    if not TYPE_CHECKING:
        # Hidden from type checkers, so that they still report an unknown attribute.
        def __getattr__(self, name: str) -> Any:
            raise AttributeError(no_attribute(self, name, self.__dict__.get("_columns", {})))

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
        """Return a pandas DataFrame, with `units` in its attrs; raise ConfigError if pandas is not installed."""
        pandas = required_module("pandas", "a table as data of pandas: pandas is not installed", "export")
        frame = pandas.DataFrame({name: list(values) if values.ndim > 1 else values for name, values in self.items()})
        frame.attrs.update(units=self.units)
        return frame

    def to_xarray(self) -> "xarray.Dataset":
        """Return an xarray Dataset over `time_s`; `units` and `long_name` are attributes of each variable.

        Raises:
            ConfigError: xarray is not installed; the message says how to install it.
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


def no_attribute(table: object, name: str, columns: Mapping[str, Any]) -> str:
    """Return the message of an AttributeError, which says how to get a column or a feature of pandas instead."""
    text = f"{type(table).__name__!r} object has no attribute {name!r}"
    if name in columns:
        return f"{text}: [{name!r}] is the column"
    if name == "columns":
        return f"{text}: list() of it gives the names of its columns"
    pandas = sys.modules.get("pandas")
    if pandas is not None and not name.startswith("_") and hasattr(pandas.DataFrame, name):
        return f"{text}: `to_pandas()` gives a DataFrame, which has it"
    own = [each for each in dir(type(table)) if not each.startswith("_")]
    return text + (probably_meant(name, own) or f"; it has {', '.join(own)}")
