"""Force curves in text tables: a height and a force or a deflection, in the units that the head names.

One pair of columns has the approach, and the retraction after it where the height turns; two pairs have one each. A
curve of one way is taken for both. What is the height, and at which of its ends the sample is, follows from the names,
the units and the values: against the sample the force is greatest, and there it is positive.
"""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from telenano.extend.tables import Column, read_table, unit_of
from telenano_afm_files.recorded import Array, Curves, Recorded, Way

SUFFIXES = (".asc", ".csv", ".dat", ".tsv", ".txt")
_HEIGHT = ("z", "height", "piezo", "dist", "sep", "way", "pos", "ramp", "x")
_VALUE = ("force", "f", "defl", "vertical", "d", "volt", "signal", "y")
_FEWEST_POINTS = 16
# At each end of a curve this share of its points tells whether the sample is there.
_END = 0.1


def curves_of(path: str) -> Curves:
    """Return the force curve in a text table.

    Raises:
        ValueError: It has no height and no force, or no unit of them; the message says what its head has to name.
    """
    table = read_table(Path(path))
    pairs = list(_pairs(table.columns))
    if not pairs or len(table.lines) < _FEWEST_POINTS:
        raise ValueError(
            f"it is a table of {len(table.lines)} lines with the columns"
            f" {', '.join(column.title or 'without a name' for column in table.columns[:8])}; a force curve has"
            f" {_FEWEST_POINTS} lines and a head with units, such as `z [nm]` and `force [nN]` (or `deflection [V]`)"
        )
    ways, unit = [], ""
    for height, value in pairs:
        z = table.in_si(height, ("m",))
        force = table.in_si(value, ("N", "m", "V"))
        assert z is not None and force is not None
        unit = next(
            name
            for name in ("N", "m", "V")
            if (one := unit_of(name)) and value.known and one.powers == value.known.powers
        )
        sound = np.isfinite(z) & np.isfinite(force)
        ways.append((z[sound], force[sound]))
    found = _in_order(ways)
    return Curves((1, 1), (0.0, 0.0), iter([(lambda: Recorded((0, 0), found, unit), 1.0)]))


def _pairs(columns: tuple[Column, ...]) -> Iterator[tuple[Column, Column]]:
    """Yield the columns of a height and of a value beside it; of several values the force is taken."""
    heights = [column for column in columns if _is(column, "m") and column.name.lower().startswith(_HEIGHT)]
    heights = heights or [column for column in columns if _is(column, "m")][:1]
    forces = [column for column in columns if _is(column, "N")]
    forces = forces or [column for column in columns if _is(column, "V")]
    forces = forces or [
        one for one in columns if _is(one, "m") and one not in heights and one.name.lower().startswith(_VALUE)
    ]
    if len(heights) == 1 or len(forces) == 1:
        yield from zip(heights[:1], forces[:1], strict=False)
    elif len(heights) == len(forces) == 2:
        yield from zip(heights, forces, strict=True)
    elif heights and forces:
        yield heights[0], forces[0]


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
