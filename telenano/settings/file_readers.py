"""Readers of file formats from packages: entries of `telenano.readers`, each a `FileReader` named after a suffix.

The entry `jpk_force` reads files `*.jpk-force`, and `other` those whose suffix has no entry of its own.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from telenano.files.held_files import standing
from telenano.files.limited_child import Answer, Limits, read_in_child
from telenano.files.regular_files import open_regular
from telenano.settings import plugins
from telenano.settings.known_packages import KNOWN_PACKAGES, OWN_PACKAGES
from telenano.wire.errors import ConfigError
from telenano.wire.extras import how_to_add_package, missing

_OTHER = "other"


class FileReader(NamedTuple):
    """Functions of a package that read files, as `module:name`; empty for data that these files do not have.

    Each function is called with a path in a child process, and returns plain values by name and a list of arrays.

    Attributes:
        heights: Reads height maps. The value `channels` has for each array its `name`, `sides` (width and depth),
            `unit` (of the sides) and `z` (unit of the heights). The arrays have the shape (rows, columns) with y
            rising, and NaN where nothing was measured.
        curve: Reads a force curve. Further arguments, as texts: the number of the curve, a spring constant [N/m] and a
            sensitivity [m/V], the last two empty to use those of the file. Values: `stiffness_n_per_m`,
            `speed_m_per_s`, and `turn`, the number of points of the approach. Arrays: the position of the base, rising
            towards the sample [m], and the deflection [m].
        deflections: Reads approaches. Arrays: the number of points of each approach and, for all approaches one after
            the other, the height, rising away from the sample [m], and the deflection [V].
        spectrum: Reads a thermal spectrum. Values: the `unit` of the density and its `averages`. Arrays: the
            frequencies [Hz] and the density.
        map: The recorded map that these files hold, a `telenano.extend.maps.MapFormat`, which the instrument steps
            over: no text and no function for a child process.
        limits: Returns the limits of the child process for the size of the file [bytes].
    """

    heights: str = ""
    curve: str = ""
    deflections: str = ""
    spectrum: str = ""
    map: Any = None
    limits: Callable[[int], Limits] = Limits.of_size


def checked_reader(_: str, value: Any) -> FileReader:
    """Return the reader of an entry point; TypeError for another entry."""
    if not isinstance(value, FileReader):
        raise TypeError(f"it is {type(value).__name__}, and must be a telenano.settings.FileReader")
    return value


def read_by_package(path: Path, what: str, *arguments: str) -> Answer:
    """Return the data that the reader of an installed package finds in a file.

    Args:
        path: The file.
        what: The function to call: `heights`, `curve`, `deflections` or `spectrum`.
        *arguments: Its arguments after the path.

    Raises:
        ConfigError: The file is empty, no installed package reads it, or its reader lacks a dependency.
        OSError, ValueError: As `read_in_child`.
    """
    path = standing(path)
    open_regular(path).close()
    if path.stat().st_size == 0:
        raise ConfigError(f"{path}: is empty")
    for name in (plugins.name_of_ending(path), _OTHER):
        loaded = plugins.load("readers", checked_reader, only=name)
        plugins.refuse(loaded, name)
        reader = loaded.found.get(name, FileReader())
        if function := getattr(reader, what):
            package = plugins.installed("readers")[name].package
            try:
                return read_in_child(function, path, *arguments, limits=reader.limits(path.stat().st_size))
            except ImportError as error:
                own = package in OWN_PACKAGES
                how = missing(error.name or "") if own else f"install {package} with its dependencies"
                raise ConfigError(f"{path}: needs {error.name} to be read: {how}") from error
            except ValueError as error:
                raise ValueError(f"{error} (as the package {package} reads it)") from error
    package = KNOWN_PACKAGES["reader other"]
    readers = plugins.load("readers", checked_reader).found
    suffixes = [
        f".{name.replace('_', '-')}" for name, reader in readers.items() if name != _OTHER and getattr(reader, what)
    ]
    if suffixes:
        raise ConfigError(f"{path}: is of no format that is known here; for this they are {', '.join(suffixes)}")
    raise ConfigError(f"{path}: files of other makers are read by the package {package}: {how_to_add_package(package)}")
