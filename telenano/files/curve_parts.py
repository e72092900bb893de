"""Parts of a curve by the course of its way: there, back, and where it rests, without a word of which end is near."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# A way that turns by less than this share of its span goes on: it is modulated, or it is noise.
_TURN = 0.1
# A part is looked at in so many blocks, and rests where it moves by less than this share of what it does elsewhere.
_BLOCKS = 100
_RESTS = 0.2
_FEWEST_IN_BLOCK = 4
# A rest has this number of blocks, and of rows.
_FEWEST_BLOCKS = 3
_FEWEST_ROWS = 12


class Part(NamedTuple):
    """Rows [start, end) in which the way rises (1), falls (-1) or rests (0)."""

    direction: int
    start: int
    end: int

    @property
    def rows(self) -> slice:
        """The rows as a slice."""
        return slice(self.start, self.end)


def parts_of(way: Array) -> list[Part]:
    """Return the parts of a course, one after another: where its way rises, falls and rests."""
    parts: list[Part] = []
    for start, end in zip(*_turns(way), strict=True):
        parts += _rests(way, start, end)
    return parts


def _turns(way: Array) -> tuple[list[int], list[int]]:
    """Return where each stretch between two turns begins and ends."""
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


def _rests(way: Array, start: int, end: int) -> list[Part]:
    """Return a stretch as its moving parts and those in which it rests."""
    count = end - start
    size = max(_FEWEST_IN_BLOCK, count // _BLOCKS)
    direction = 1 if way[end - 1] >= way[start] else -1
    if count < 2 * size * _FEWEST_BLOCKS:
        return [Part(direction, start, end)]
    edges = np.append(np.arange(start, end - size + 1, size), end)
    means = np.array([way[low:high].mean() for low, high in pairwise(edges.tolist())])
    moved = direction * np.gradient(means)
    still = moved < _RESTS * float(np.quantile(moved, 0.85))
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
