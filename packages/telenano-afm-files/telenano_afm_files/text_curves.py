"""Force curves in text tables: a height and a force or a deflection, in the units that the head names.

One pair of columns has the approach, and the retraction after it where the height turns; two pairs have one each. A
curve of one way is taken for both. What is the height, and at which of its ends the sample is, follows from the names,
the units and the values: against the sample the force is greatest, and there it is positive.
"""

import json
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from telenano.files import Column, TextTable, unit_of
from telenano.wire import ConfigError
from telenano_afm_files.recorded import Array, Curves, Recorded, Way

SUFFIXES = (".asc", ".csv", ".dat", ".tsv", ".txt")
_HEIGHT = ("z", "height", "piezo", "dist", "sep", "way", "pos", "ramp", "x")
_VALUE = ("force", "f", "defl", "vertical", "d", "volt", "signal", "y")
_THERE_AND_BACK = tuple(
    re.compile(rf"(?i)(?:^|[\W_])(?:{words})(?:$|[\W_\d])")
    for words in ("approach|extend|ext|ex|trace|fwd|forward", "retract|withdraw|ret|rt|retrace|bwd|backward")
)
_VALUES = ("N", "m", "V")
_FEWEST_POINTS = 16
# The deflection on the way back has at least this correlation with that on the way there, at the same heights.
_TOGETHER = 0.5
# At each end of a curve this share of its points tells whether the sample is there.
_END = 0.1


class TableOptions(NamedTuple):
    """What a person says of a table: its columns by number or title (`1,2`), and the units of height and value."""

    columns: str = ""
    way_unit: str = ""
    value_unit: str = ""


def table_options_of(text: str | None) -> TableOptions:
    """Return what a JSON object says of a table; nothing where there is none.

    Raises:
        ValueError: A unit is that of no height or of no force and no deflection; the message says what would be.
    """
    options = TableOptions(**{name: str(value) for name, value in json.loads(text or "{}").items()})
    for name, word, kinds, examples in (
        ("way_unit", options.way_unit, ("m",), "nm"),
        ("value_unit", options.value_unit, _VALUES, "nN, nm or mV"),
    ):
        if word and _kind_of(word) not in kinds:
            raise ValueError(f"--set {name}={word}: must be a unit such as {examples}")
    return options


NOTHING = TableOptions()


def curves_of(path: str, options: TableOptions = NOTHING) -> Curves:
    """Return the force curve in a text table.

    Raises:
        ValueError: It has no height and no force, or no unit of them; the message says what its head has to name, and
            what says it instead.
    """
    table = TextTable.read(Path(path))
    pairs = list(_pairs(table, options))
    if len(table.lines) < _FEWEST_POINTS:
        raise ValueError(f"it is a table of {len(table.lines)} lines; a force curve has {_FEWEST_POINTS} and more")
    lacking = [] if pairs else ["--set columns=1,2"]
    if not (options.way_unit or (pairs and all(height.unit for height, _ in pairs))):
        lacking.append("--set way_unit=nm")
    if not (options.value_unit or (pairs and all(value.unit for _, value in pairs))):
        lacking.append("--set value_unit=nN")
    if lacking:
        raise ValueError(
            f"it is a table with the columns {_titles_of(table)}; a force curve has a head with units, such as `z [nm]`"
            f" and `force [nN]` (or `deflection [V]`), or they are given by {' '.join(lacking)}"
        )
    ways = []
    for height, value in pairs:
        z, force = (
            table.in_si(column, kinds, word, f"--set {name}")
            for column, kinds, word, name in (
                (height, ("m",), options.way_unit, "way_unit"),
                (value, _VALUES, options.value_unit, "value_unit"),
            )
        )
        assert z is not None and force is not None
        sound = np.isfinite(z) & np.isfinite(force)
        ways.append((z[sound], force[sound]))
    unit = _kind_of(options.value_unit or pairs[0][1].unit)
    ordered = _in_order(ways)
    return Curves((1, 1), (0.0, 0.0), iter([(lambda: Recorded((0, 0), ordered, unit), 1.0)]))


def is_of_other_columns(path: str) -> bool:
    """Return whether three columns without a head are no height with the deflections there and back, as NT-MDT's are.

    Those are of one lever over the same heights, and so go together.
    """
    try:
        columns = TextTable.read(Path(path)).columns
    except ConfigError:
        return False
    if len(columns) != 3 or any(column.title or column.bad for column in columns):
        return False
    there, back = (column.values - np.nanmean(column.values) for column in columns[1:])
    return not float(np.nansum(there * back)) > _TOGETHER * float(np.sqrt(np.nansum(there**2) * np.nansum(back**2)))


def _titles_of(table: TextTable) -> str:
    return ", ".join(column.title or "without a name" for column in table.columns[:8])


def _pairs(table: TextTable, options: TableOptions) -> Iterator[tuple[Column, Column]]:
    """Yield the columns of a height and of a value beside it; of several values the force is taken."""
    columns = table.columns
    if options.columns:
        chosen = [table.column(word) for word in options.columns.split(",")]
        if len(chosen) not in (2, 4):
            raise ValueError(f"--set columns={options.columns}: must be two columns, a height and a value, or four")
        yield from zip(chosen[::2], chosen[1::2], strict=True)
        return
    # a column whose unit is not known, or not named, is that of its name
    lengths = [column for column in columns if _is(column, "m")]
    heights = [column for column in lengths if column.name.lower().startswith(_HEIGHT)]
    heights = heights or _both_ways(lengths) or lengths[:1] or _named(columns, _HEIGHT)
    forces = [column for column in columns if _is(column, "N")]
    forces = forces or [column for column in columns if _is(column, "V")]
    forces = forces or [
        one for one in columns if _is(one, "m") and one not in heights and one.name.lower().startswith(_VALUE)
    ]
    forces = forces or [one for one in _named(columns, _VALUE) if one not in heights]
    if len(columns) == 2 and not any(column.title for column in columns):
        heights, forces = [columns[0]], [columns[1]]
    both = _both_ways(forces)
    if both and heights:
        yield from zip(_both_ways(heights) or [heights[0]] * 2, both, strict=True)
    elif len(heights) == 1 or len(forces) == 1:
        yield from zip(heights[:1], forces[:1], strict=False)
    elif len(heights) == len(forces) == 2:
        yield from zip(heights, forces, strict=True)
    elif heights and forces:
        yield heights[0], forces[0]


def _both_ways(columns: list[Column]) -> list[Column]:
    """Return the columns of an approach and of a retraction, by a word for each; nothing where they are not these."""
    there, back = ([one for one in columns if words.search(one.title)] for words in _THERE_AND_BACK)
    return [there[0], back[0]] if len(there) == len(back) == 1 else []


def _named(columns: tuple[Column, ...], words: tuple[str, ...]) -> list[Column]:
    """Return the column without a unit that is known whose name begins with one of these words, the first of them."""
    matching = [column for word in words for column in columns if not column.known and _begins(column, word)]
    return matching[:1]


def _begins(column: Column, word: str) -> bool:
    name = column.name.lower()
    # a letter alone is a name, and no begin of another
    return name == word if len(word) == 1 else name.startswith(word)


def _kind_of(word: str) -> str:
    """Return N, m or V for a unit of a force, a length or a voltage, else an empty text."""
    unit = unit_of(word)
    return next((name for name in _VALUES if unit and (one := unit_of(name)) and one.powers == unit.powers), "")


def _is(column: Column, unit: str) -> bool:
    one = unit_of(unit)
    return column.known is not None and one is not None and column.known.powers == one.powers


def _in_order(ways: list[Way]) -> tuple[Way, ...]:
    """Return approach and retraction with heights that rise away from the sample and a force that pushes positive."""
    z = np.concatenate([way[0] for way in ways])
    value = np.concatenate([way[1] for way in ways])
    if np.ptp(z) <= 0.0 or len(z) < _FEWEST_POINTS:
        raise ValueError("its height stays at one value: it is no force curve")
    order = np.argsort(z, kind="stable")
    count = max(int(_END * len(z)), 2)
    low, high = (float(np.mean(value[part])) for part in (order[:count], order[-count:]))
    free = float(np.median(value))
    away = -1.0 if abs(high - free) > abs(low - free) else 1.0
    sign = 1.0 if (high if away < 0.0 else low) >= free else -1.0
    ways = [(away * height, sign * force) for height, force in ways]
    if len(ways) == 1:
        ways = _cut_where_it_turns(*ways[0])
    if ways[0][0][0] < ways[0][0][-1] and len(ways) == 2:
        ways = ways[::-1]
    return tuple(ways) if len(ways) == 2 else (ways[0], (ways[0][0][::-1], ways[0][1][::-1]))


def _cut_where_it_turns(height: Array, value: Array) -> list[Way]:
    turn = int(np.argmin(height))
    edges = (0, turn + 1, len(height))
    parts = [(height[low:high], value[low:high]) for low, high in pairwise(edges) if high - low >= _FEWEST_POINTS]
    return parts if len(parts) == 2 else [(height, value)]
