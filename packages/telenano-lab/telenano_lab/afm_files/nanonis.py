"""Read images (.sxm, with nanonispy2) and spectroscopies (.dat) of Nanonis; called in a child process with limits.

A spectroscopy is a header of `key TAB value`, a line `[DATA]`, a line of names such as `Frequency Shift [bwd] (Hz)`,
and rows of numbers. Z rises away from the sample.
"""

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.files import TextTable
from telenano_lab.afm_files.recorded import Array, Curves, RecordedCurve

# The header of a spectroscopy is a few kB long.
_LONGEST_HEAD = 1 << 18

Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]

_SWEPT = re.compile(r"Z( rel)?( \[AVG\])? \(m\)")


def load_nanonis(path: str) -> Found:
    """Return the maps of the forward lines of a Nanonis .sxm file; y rises with the row.

    A stopped scan gives its finished lines, with the depth that they cover.
    """
    from nanonispy2.read import Scan

    scan = Scan(path)
    width, depth = (float(side) for side in scan.header["scan_range"])
    units = dict(zip(scan.header["data_info"]["Name"], scan.header["data_info"]["Unit"], strict=True))
    facts, maps = [], []
    for name, directions in scan.signals.items():
        values = np.asarray(directions["forward"], dtype=np.float64)
        facts.append({"name": name, "sides": [width, depth], "unit": "m", "z": units.get(name, "")})
        # Lines are stored in the order of the scan.
        maps.append(values[::-1] if scan.header["scan_dir"] == "down" else values)
    begun = np.any([np.isfinite(values).any(axis=1) for values in maps], axis=0)
    if begun.any() and not begun.all():
        kept = slice(int(begun.argmax()), len(begun) - int(begun[::-1].argmax()))
        # The line in which the scan was stopped is incomplete.
        ends = [
            place for place in (kept.start, kept.stop - 1) if not all(np.isfinite(one[place]).all() for one in maps)
        ]
        kept = slice(kept.start + (kept.start in ends), kept.stop - (kept.stop - 1 in ends))
        for fact, values in zip(facts, maps, strict=True):
            fact["sides"] = [width, depth * (kept.stop - kept.start) / len(values)]
            fact["left_out"] = (
                f"{len(values) - (kept.stop - kept.start)} of {len(values)} lines, which were not finished"
            )
        maps = [values[kept] for values in maps]
    return {"channels": facts}, maps


def load_table(path: str) -> Found:
    """Return header and column names of a spectroscopy, and its table, shape (columns, rows)."""
    table = TextTable.read(Path(path))
    if "[DATA]" not in table.head or not table.columns[0].title:
        raise ValueError("is not a spectroscopy of Nanonis: it has no line [DATA] with names and numbers after it")
    header = dict(line.split("\t")[:2] for line in table.head if "\t" in line)
    names = [column.title for column in table.columns]
    return {"header": header, "names": names}, [np.array([table.numbers(column) for column in table.columns])]


def is_spectroscopy(path: str) -> bool:
    """Return whether a file has the line [DATA] of Nanonis in its header."""
    with Path(path).open("rb") as file:
        return b"[DATA]" in file.read(_LONGEST_HEAD)


class Sweep(NamedTuple):
    """A sweep of z: heights [m], rising away from the sample, and the columns by name, with a value at each height."""

    height_m: Array
    columns: dict[str, Array]


def sweep_of(facts: dict[str, Any], table: Array) -> Sweep:
    """Return the z sweep of a spectroscopy, without columns that were filtered afterwards.

    Raises:
        ValueError: A quantity other than z was swept.
    """
    names = facts["names"]
    if not _SWEPT.fullmatch(names[0]):
        raise ValueError(f"it is a spectroscopy over {names[0]}; a curve of force or frequency shift is one over Z")
    columns = {name: row for name, row in zip(names, table, strict=True) if not name.endswith("[filt]")}
    return Sweep(columns.pop(names[0]), columns)


def unit_of(name: str) -> str:
    """Return the unit at the end of a column's name, or an empty string."""
    match = re.search(r"\(([^()]*)\)$", name)
    return match[1] if match else ""


def backward_of(name: str) -> str:
    """Return the name of the column with the backward sweep of a column."""
    return re.sub(r" \(", " [bwd] (", name)


def curves_of(path: str) -> Curves:
    """Return the force curve of a spectroscopy over Z.

    Raises:
        ValueError: It has no force and no deflection; the message says what else can be done with it.
    """
    facts, (table,) = load_table(path)
    height, columns = sweep_of(facts, table)
    forward = [name for name in columns if "[bwd]" not in name]
    name = next((name for name in forward if unit_of(name) == "N"), None) or next(
        (name for name in forward if "deflection" in name.lower() and unit_of(name) in ("m", "V")), None
    )
    if name is None:
        raise ValueError(
            "it has no force and no deflection; a frequency shift becomes a force by `telenano sample import FILE --as "
            f"force`. Its channels are {', '.join(forward)}"
        )
    ways = [(height, columns[name])]
    if backward_of(name) in columns:
        ways.append((height[::-1], columns[backward_of(name)][::-1]))
    if height[-1] > height[0]:
        # The sweep leads away from the sample, so the backward sweep is the approach.
        ways = ways[::-1]
    return Curves((1, 1), (0.0, 0.0), iter([(lambda: RecordedCurve((0, 0), tuple(ways), unit_of(name)), 1.0)]))
