"""Read force curves from text tables: a height and a force or a deflection, in the units that the header names.

One pair of columns holds the approach, followed by the retraction where the height turns; two pairs hold one each. A
curve of one branch counts as both, and pauses of the height are dropped. Columns are chosen by their names first
(`telenano.files.role_of`), then by their units; ambiguous columns are refused, naming the option that chooses. The
values tell at which end the sample is: there the force differs most from that of the free lever, and it is positive.
For a curve without a free lever this is a guess, and the remarks say so.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from telenano.files import Column, TextTable, orientation_of, parts_of, role_of, unit_of
from telenano.wire import ConfigError
from telenano_lab.afm_files.recorded import Array, Curves, RecordedCurve, Way

SUFFIXES = (".asc", ".csv", ".dat", ".tsv", ".txt")
_HEIGHT = ("z", "height", "piezo", "dist", "sep", "way", "pos", "ramp", "x")
_VALUE = ("force", "f", "defl", "vertical", "d", "volt", "signal", "y")
_THERE_AND_BACK = tuple(
    re.compile(rf"(?i)(?:^|[\W_])(?:{words})(?:$|[\W_\d])")
    for words in ("approach|extend|ext|ex|trace|fwd|forward", "retract|withdraw|ret|rt|retrace|bwd|backward")
)
_VALUES = ("N", "m", "V")
_FEWEST_POINTS = 16
# Least correlation of the deflections of both branches over the same heights.
_TOGETHER = 0.5
# Share of the points at each end of a curve that decides whether the sample is there.
_END = 0.1
# A branch covers at least this share of the whole span.
_WAY = 0.3
# At least this number of rows, and this share of them, at one extreme value mean a saturated detector.
_FEWEST_AT_END = 5
_AT_END = 0.01
# Least correlation of the heights of a sensor and of its command.
_ALIKE_HEIGHTS = 0.999


class TableOptions(NamedTuple):
    """The user's description of a table: columns by number or title (`1,2`), units of height and value, and the sign.

    value_sign: factor 1 or -1, as text, that makes the values positive where the sample pushes.
    """

    columns: str = ""
    way_unit: str = ""
    value_unit: str = ""
    value_sign: str = ""

    @property
    def sign(self) -> int | None:
        """The sign of the values; None if it was not given."""
        return int(self.value_sign) if self.value_sign else None


def table_options_of(text: str | None) -> TableOptions:
    """Parse the options of a table from a JSON object; without one, return empty options.

    Raises:
        ValueError: A unit is none of a height, or none of a force or deflection; the message gives examples.
    """
    options = TableOptions(**{name: str(value) for name, value in json.loads(text or "{}").items()})
    for name, word, kinds, examples in (
        ("way_unit", options.way_unit, ("m",), "nm"),
        ("value_unit", options.value_unit, _VALUES, "nN, nm or mV"),
    ):
        if word and _kind_of(word) not in kinds:
            raise ValueError(f"--set {name}={word}: must be a unit such as {examples}")
    if options.value_sign not in ("", "1", "-1"):
        raise ValueError(f"--set value_sign={options.value_sign}: must be 1 or -1")
    return options


NOTHING = TableOptions()


def curves_of(path: str, options: TableOptions = NOTHING) -> Curves:
    """Return the force curve in a text table.

    Raises:
        ValueError: It has no height and no force, or no unit of them; the message says what the header must name, or
            which option replaces it.
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
    ordered, remarks = _in_order(ways, options.sign)
    titles = " over ".join(repr(column.title) for column in pairs[0][::-1]) if pairs[0][0].title else "no titles"
    remarks = (*table.remarks, f"taken: {titles}; --set columns=X,Y takes others", *remarks)
    return Curves((1, 1), (0.0, 0.0), iter([(lambda: RecordedCurve((0, 0), ordered, unit, remarks=remarks), 1.0)]))


def is_of_other_columns(path: str) -> bool:
    """Return whether a text is not of NT-MDT: it has named columns, or three unnamed ones that do not belong together.

    A text of NT-MDT has a height and the deflections of both branches, of one lever over the same heights.
    """
    try:
        columns = TextTable.read(Path(path)).columns
    except ConfigError:
        return False
    if path.lower().endswith(".txt") and any(column.unit for column in columns):
        return True
    if len(columns) != 3 or any(column.title or column.bad for column in columns):
        return False
    there, back = (column.values - np.nanmean(column.values) for column in columns[1:])
    return not float(np.nansum(there * back)) > _TOGETHER * float(np.sqrt(np.nansum(there**2) * np.nansum(back**2)))


def _titles_of(table: TextTable) -> str:
    return ", ".join(column.title or "without a name" for column in table.columns[:8])


def _pairs(table: TextTable, options: TableOptions) -> Iterator[tuple[Column, Column]]:
    """Yield pairs of a height column and a value column; a force is preferred to other values."""
    columns = table.columns
    if options.columns:
        chosen = [table.column(word) for word in options.columns.split(",")]
        if len(chosen) not in (2, 4):
            raise ValueError(f"--set columns={options.columns}: must be two columns, a height and a value, or four")
        yield from zip(chosen[::2], chosen[1::2], strict=True)
        return
    heights, forces = _heights(columns), _values(columns)
    if len(columns) == 2 and not any(column.title for column in columns):
        heights, forces = [columns[0]], [columns[1]]
    forces = [column for column in forces if not _among(column, heights)]
    both = _both_ways(forces)
    if both and heights:
        yield from zip(_both_ways(heights) or [heights[0]] * 2, both, strict=True)
    elif len(heights) == len(forces) == 2 and _alternate(columns, heights, forces):
        yield from zip(heights, forces, strict=True)
    elif heights and forces:
        yield _one_of("a height", _alike(heights), columns), _one_of("a force or deflection", forces, columns)


def _heights(columns: tuple[Column, ...]) -> list[Column]:
    """Return the columns that may be the height: by name and unit, else by unit, else by name."""
    lengths = [column for column in columns if _is(column, "m")]
    named = [column for column in lengths if role_of(column.name) == "base"]
    # Without names, the first length is the height.
    unnamed = [column for column in lengths if not role_of(column.name)]
    found = named or _both_ways(unnamed) or unnamed[:1]
    if found:
        return found
    if apart := [column for column in columns if role_of(column.name) == "separation"]:
        raise ValueError(
            f"{apart[0].title!r} is a separation of tip and sample, and there is no column with the height of the base:"
            " add the height of the piezo to the file, or name a column that is it by --set columns=X,Y"
        )
    if volts := [one for one in columns if role_of(one.name) == "base" and one.known and not _is(one, "m")]:
        raise ValueError(
            f"{volts[0].title!r} is not a height in metres, and there is no other: add the height to the file, or give"
            " --set columns=X,Y and --set way_unit=nm"
        )
    return _named(columns, _HEIGHT)


def _values(columns: tuple[Column, ...]) -> list[Column]:
    """Return the columns that may be the force or the deflection: forces by name first, then by unit, then by name."""
    roles = [role_of(one.name) for one in columns]
    units = [next((unit for unit in _VALUES if _is(column, unit)), "") for column in columns]
    for wanted, kinds in (
        (("force",), ("N",)), (("deflection",), ("N", "V", "m")), (("force",), ("V", "m")), (("",), ("N",)),
        (("",), ("V",)),
    ):  # fmt: skip
        found = [
            column for column, role, unit in zip(columns, roles, units, strict=True) if role in wanted and unit in kinds
        ]
        if found:
            return found
    by_name = [
        one for one in columns if _is(one, "m") and one.name.lower().startswith(_VALUE) and not role_of(one.name)
    ]
    return by_name or _named(columns, _VALUE)


def _alternate(columns: tuple[Column, ...], heights: list[Column], forces: list[Column]) -> bool:
    """Return whether two heights and two values stand in pairs, each value right after or right before its height."""
    kinds = ["z" if any(one is h for h in heights) else "v" for one in columns if _among(one, [*heights, *forces])]
    return kinds in (["z", "v", "z", "v"], ["v", "z", "v", "z"])


def _among(column: Column, chosen: list[Column]) -> bool:
    return any(column is one for one in chosen)


def _alike(heights: list[Column]) -> list[Column]:
    """Reduce correlated heights, such as those of a sensor and its command, to one: the measured one if it is named."""
    if len(heights) < 2:
        return heights
    first = heights[0].values
    for other in heights[1:]:
        sound = np.isfinite(first) & np.isfinite(other.values)
        if sound.sum() < _FEWEST_POINTS or not np.corrcoef(first[sound], other.values[sound])[0, 1] > _ALIKE_HEIGHTS:
            return heights
    measured = [one for one in heights if re.search(r"(?i)meas|sens|snsr|lvdt", one.title)]
    return (measured or heights)[:1]


def _one_of(what: str, found: list[Column], columns: tuple[Column, ...]) -> Column:
    if len(found) > 1:
        titles = ", ".join(repr(one.title) for one in found)
        numbers = [str(1 + next(n for n, one in enumerate(columns) if one is chosen)) for chosen in found]
        raise ValueError(
            f"{titles} each may be {what}: which one is meant, --set columns=X,Y says, a height and a value by number"
            f" or title (columns {' and '.join(numbers)})"
        )
    return found[0]


def _both_ways(columns: list[Column]) -> list[Column]:
    """Return the columns of approach and retraction, told apart by a word in their titles; empty if there are none."""
    there, back = ([one for one in columns if words.search(one.title)] for words in _THERE_AND_BACK)
    return [there[0], back[0]] if len(there) == len(back) == 1 else []


def _named(columns: tuple[Column, ...], words: tuple[str, ...]) -> list[Column]:
    """Return the first column without a known unit whose name begins with one of these words, as a list."""
    matching = [column for word in words for column in columns if not column.known and _begins(column, word)]
    return matching[:1]


def _begins(column: Column, word: str) -> bool:
    name = column.name.lower()
    # A single letter must be the whole name.
    return name == word if len(word) == 1 else name.startswith(word)


def _kind_of(word: str) -> str:
    """Return N, m or V for a unit of a force, a length or a voltage, else an empty string."""
    unit = unit_of(word)
    return next((name for name in _VALUES if unit and (one := unit_of(name)) and one.powers == unit.powers), "")


def _is(column: Column, unit: str) -> bool:
    one = unit_of(unit)
    return column.known is not None and one is not None and column.known.powers == one.powers


def _in_order(ways: list[Way], sign: int | None = None) -> tuple[tuple[Way, ...], tuple[str, ...]]:
    """Return approach and retraction, heights rising away from the sample and repulsive forces positive, and remarks.

    sign: factor of the values (1 or -1) if the user gave one. The remarks list what was dropped and guessed.
    """
    remarks: list[str] = []
    if len(ways) == 1:
        ways = _parted(*ways[0], remarks)
    z = np.concatenate([way[0] for way in ways])
    value = np.concatenate([way[1] for way in ways])
    if np.ptp(z) <= 0.0 or len(z) < _FEWEST_POINTS:
        raise ValueError("its height stays at one value: it is not a force curve")
    away, turned, is_free = orientation_of(z, value, falls_first=bool(ways[0][0][0] > ways[0][0][-1]))
    if sign is not None:
        remarks.append(f"the sign of the values is that of --set value_sign={sign}")
        turned = float(sign)
    if not is_free:
        remarks.append(
            "the lever is not free at either end of this curve: where the sample is"
            + ("" if sign else " and the sign of the values")
            + " are a guess by the order of the rows (--set value_sign=-1 turns the values), and the force has an"
            " offset"
        )
    free = float(np.median(value[np.argsort(away * z)[-max(int(_END * len(z)), 2) :]]))
    remarks += _at_an_end(turned * value, turned * free)
    if turned < 0.0:
        remarks.append(
            "the values are turned, so that they are positive where the sample pushes (--set value_sign=1: not)"
        )
    if away < 0.0:
        remarks.append("the height is turned, so that it rises away from the sample")
    ways = [(away * height, turned * force) for height, force in ways]
    if ways[0][0][0] < ways[0][0][-1] and len(ways) == 2:
        ways = ways[::-1]
        remarks.append("the retraction stands before the approach")
    if len(ways) == 1:
        remarks.append("there is one way, which is taken for approach and retraction")
    both = tuple(ways) if len(ways) == 2 else (ways[0], (ways[0][0][::-1], ways[0][1][::-1]))
    return both, tuple(remarks)


def _at_an_end(value: Array, free: float) -> list[str]:
    """Return remarks on rows that share the greatest or the least value, as a saturated detector produces."""
    span, said = float(np.ptp(value)), []
    for word, extreme in (("greatest", float(value.max())), ("least", float(value.min()))):
        rows = int((value == extreme).sum())
        if rows >= max(_FEWEST_AT_END, _AT_END * len(value)) and abs(extreme - free) > 0.1 * span:
            said.append(
                f"{rows} of {len(value)} rows are at the extreme value ({word}, {extreme:.4g}): the detector was at its"
                " end there, and forces beyond it are not in the file"
            )
    return said


def _parted(height: Array, value: Array, remarks: list[str]) -> list[Way]:
    """Return the first two branches that cover much of the span; remarks gains the rows that are dropped."""
    parts = parts_of(height)
    span = float(np.ptp(height))
    moving = [part for part in parts if part.direction and np.ptp(height[part.rows]) > _WAY * span]
    joined = [moving[0]] if moving else []
    for part in moving[1:]:
        # A pause within a branch does not end it.
        if part.direction == joined[-1].direction and _goes_on(height, joined[-1].end, part):
            joined[-1] = joined[-1]._replace(end=part.end)
        else:
            joined.append(part)
    chosen = [part for part in joined if part.end - part.start >= _FEWEST_POINTS][:2]
    if len(chosen) == 2 and chosen[0].direction == chosen[1].direction:
        chosen = chosen[:1]
    if not chosen:
        return [(height, value)]
    rests = [part for part in parts if not part.direction]
    words = [f"rows {part.start + 1} to {part.end} (the height rests)" for part in rests]
    last = chosen[-1].end
    others = [part for part in parts if part.direction and part.start >= last]
    if others:
        words.append(f"rows {last + 1} to {len(height)} (another way)")
    if words:
        remarks.append(f"left out: {', '.join(words[:6])}")
    kept = np.ones(len(height), dtype=bool)
    for part in rests:
        kept[part.rows] = False
    return [(height[part.rows][kept[part.rows]], value[part.rows][kept[part.rows]]) for part in chosen]


def _goes_on(height: Array, end: int, part: Any) -> bool:
    """Return whether a part of a branch begins near the end of the part before it."""
    return abs(float(height[part.start] - height[end - 1])) < _END * float(np.ptp(height))
