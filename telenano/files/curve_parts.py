"""Segmentation of a force curve by the course of its travel: approach, return and rests, in either direction."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# A reversal by less than this share of the whole travel is modulation or noise, and no turn.
_TURN = 0.1
# A stretch is divided into this many blocks; it rests where it moves by less than the share `_RESTS` of its speed.
_BLOCKS = 100
_RESTS = 0.2
_FEWEST_IN_BLOCK = 4
# Least number of blocks, and of rows, of a rest.
_FEWEST_BLOCKS = 3
_FEWEST_ROWS = 12
# The lever is free at an end where the value changes by less than this share of its steepest change, over `_BINS` bins.
_FREE = 0.2
_BINS = 20


class Part(NamedTuple):
    """Rows [start, end) in which the travel rises (direction 1), falls (-1) or rests (0)."""

    direction: int
    start: int
    end: int

    @property
    def rows(self) -> slice:
        """The rows as a slice."""
        return slice(self.start, self.end)


def parts_of(way: Array) -> list[Part]:
    """Return the parts of a curve in order: where its travel `way`, shape (n,), rises, falls and rests."""
    parts: list[Part] = []
    stretches = list(zip(*_turns(way), strict=True))
    travel = sum(float(np.ptp(way[start:end])) for start, end in stretches)
    # The least movement of a row follows from the mean movement, so that noise in a rest does not count.
    least = _RESTS * travel / max(len(way), 1)
    for start, end in stretches:
        for part in _rests(way, start, end, least):
            if parts and parts[-1].direction == part.direction == 0:
                parts[-1] = parts[-1]._replace(end=part.end)
            else:
                parts.append(part)
    return parts


def _turns(way: Array) -> tuple[list[int], list[int]]:
    """Return the first rows and the end rows of the stretches between turns."""
    threshold = _TURN * float(np.ptp(way))
    if len(way) < 2 or not threshold > 0.0:
        return [0], [len(way)]
    turns, top, bottom, direction = [0], 0, 0, 0
    values = way.tolist()
    for place, value in enumerate(values):
        if value > values[top]:
            top = place
        if value < values[bottom]:
            bottom = place
        if direction >= 0 and values[top] - value > threshold:
            turns += [top] if direction > 0 or top > 0 else []
            direction, bottom = -1, place
        elif direction <= 0 and value - values[bottom] > threshold:
            turns += [bottom] if direction < 0 or bottom > 0 else []
            direction, top = 1, place
        if direction > 0 and value >= values[top]:
            top = place
        if direction < 0 and value <= values[bottom]:
            bottom = place
    turns = sorted(set(turns))
    return turns, [*turns[1:], len(way)]


def _rests(way: Array, start: int, end: int, least: float) -> list[Part]:
    """Split rows [start, end) into moving and resting parts; in a rest a row moves by less than `least` on average."""
    count = end - start
    size = max(_FEWEST_IN_BLOCK, count // _BLOCKS)
    direction = 1 if way[end - 1] >= way[start] else -1
    if count < 2 * size * _FEWEST_BLOCKS:
        moves = abs(float(way[end - 1] - way[start])) > least * count or count == len(way)
        return [Part(direction if moves else 0, start, end)]
    edges = np.append(np.arange(start, end - size + 1, size), end)
    means = np.array([way[low:high].mean() for low, high in pairwise(edges.tolist())])
    moved = direction * np.gradient(means)
    still = moved < max(_RESTS * float(np.quantile(moved, 0.85)), least * size)
    # A few moving blocks between rests are noise.
    for first, last in _runs(~still):
        if last - first < _FEWEST_BLOCKS:
            still[first:last] = True
    parts: list[Part] = []
    place = 0
    while place < len(still):
        last = place
        while last < len(still) and still[last] == still[place]:
            last += 1
        low, high = int(edges[place]), int(edges[last])
        rests = bool(still[place]) and last - place >= _FEWEST_BLOCKS and high - low >= _FEWEST_ROWS
        kind = 0 if rests else direction
        if parts and parts[-1].direction == kind:
            parts[-1] = parts[-1]._replace(end=high)
        else:
            parts.append(Part(kind, low, high))
        place = last
    return parts


def _runs(flags: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return start and end [start, end) of each run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


class Orientation(NamedTuple):
    """Signs of a curve: `away`, of heights that rise away from the sample; `turned`, of values that push.

    `is_free` tells whether the lever is free at one end of the curve.
    """

    away: float
    turned: float
    is_free: bool


def orientation_of(height: Array, value: Array, *, falls_first: bool) -> Orientation:
    """Return the orientation of a curve: at which end of its height the sample is, and which sign of value pushes.

    The lever is free at the end where the value hardly changes. If that holds at both ends, the sample is at the end
    whose value is farther from the median; if at neither, at the end of the first movement (`falls_first`: downwards).
    """
    edges = np.linspace(height.min(), height.max(), _BINS + 1)
    place = np.clip(np.searchsorted(edges, height, side="right") - 1, 0, _BINS - 1)
    means = np.array([float(np.mean(value[place == one])) for one in np.unique(place)])
    steps = np.abs(np.diff(means))
    steepest = float(steps.max()) if len(steps) else 0.0
    low_is_flat, high_is_flat = (
        len(steps) > 4 and abs(float(part[-1] - part[0])) < _FREE * steepest * (len(part) - 1)
        for part in (means[:3], means[-3:])
    )
    low, high, middle = float(means[0]), float(means[-1]), float(np.median(value))
    if low_is_flat and high_is_flat:
        away = -1.0 if abs(high - middle) > abs(low - middle) else 1.0
    elif low_is_flat or high_is_flat:
        away = 1.0 if high_is_flat else -1.0
    else:
        # A curve begins with its approach.
        away = 1.0 if falls_first else -1.0
    near = means if away > 0.0 else means[::-1]
    if low_is_flat or high_is_flat:
        return Orientation(away, 1.0 if near[0] >= near[-1] else -1.0, True)
    return Orientation(away, 1.0 if near[0] >= near[1] else -1.0, False)
