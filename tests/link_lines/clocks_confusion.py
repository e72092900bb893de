"""How often two clocks that run alike are said to differ or to change, and how often a change of a clock is found.

    python tests/link_lines/clocks_confusion.py --seeds 0:100

The exchanges are drawn by a program that shares nothing with what estimates the clocks: ways whose delays are
independent, correlated, bursty or periodic, each way with a scale of its own, for a minute to ten of them. A clock that
changes is set in the middle, or runs at another rate from there on, so that it is off at the end by as much.
"""

import argparse
import math
import sys
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from telenano.analysis import wilson
from telenano.recording.clock_course import bounds_of, stretches
from telenano.timing import OffsetFilter
from telenano.timing.clock_fit import Bounds

Column = NDArray[np.float64]
BEGAN_NS = 1_700_000_000 * 10**9
# Exchanges a second, and the seconds of a piece of a recording.
HZ, PIECE_S = 10, 4
# The clock changes by this much, in median absolute deviations of the round trip beside the least change [s].
SIZES, LEAST_S = (1.0, 3.0), 2e-3


class Clocks(NamedTuple):
    """Drawn clocks: the kind of their ways, exchanges of four stamps [ns], by how much they change [s], and when."""

    kind: str
    exchanges: NDArray[np.int64]
    drift: float
    change_s: float
    changed_at_s: float


def independent(draw: np.random.Generator, count: int) -> Column:
    spread = (
        draw.lognormal(0.0, draw.uniform(0.1, 1.0), count),
        draw.gamma(draw.uniform(0.7, 4.0), size=count),
        np.where(draw.random(count) < draw.uniform(0.02, 0.5), 4.0, 0.0) + draw.random(count),
        np.abs(draw.standard_t(3.0, count)),
    )
    return np.asarray(spread[draw.integers(4)])


def correlated(draw: np.random.Generator, count: int) -> Column:
    time = 10.0 ** draw.uniform(0.3, math.log10(count / 60))
    rho = math.exp(-1.0 / time)
    fresh = math.sqrt(1.0 - rho * rho) * draw.standard_normal(count)
    fresh[0] /= math.sqrt(1.0 - rho * rho)
    return np.asarray(np.exp(draw.uniform(0.1, 0.8) * signal.lfilter([1.0], [1.0, -rho], fresh)))


def bursty(draw: np.random.Generator, count: int) -> Column:
    lengths = 10.0 ** draw.uniform(0.5, math.log10(count / 100), 2)
    busy, at, state = np.zeros(count, dtype=bool), 0, bool(draw.integers(2))
    while at < count:
        end = at + max(1, int(draw.exponential(lengths[int(state)])))
        busy[at:end] = state
        at, state = end, not state
    return independent(draw, count) * np.where(busy, draw.uniform(1.5, 5.0), 1.0)


def periodic(draw: np.random.Generator, count: int) -> Column:
    phase = (draw.integers(8, 100) * np.arange(count) / count + draw.random()) % 1.0
    shape = (phase, np.sin(2 * math.pi * phase) + 1.0, (phase < 0.1).astype(float))[draw.integers(3)]
    delays = independent(draw, count)
    return np.asarray(delays + float(np.median(delays)) * draw.uniform(0.2, 3.0) * shape)


KINDS: tuple[Callable[[np.random.Generator, int], Column], ...] = (independent, correlated, bursty, periodic)
# A clock is set, or its rate changes, or it stays as it is.
CHANGES = ("none", "set", "rate")


def drawn(seed: int, kind: int, change: str = "none", size: float = 1.0, longest_s: float = 600.0) -> Clocks:
    """Draw two clocks over ways of a kind, of which one changes in the middle or none does."""
    draw = np.random.default_rng((seed, kind))
    seconds = 60.0 * (longest_s / 60.0) ** draw.random()
    count = int(seconds * HZ)
    ways_s = [draw.uniform(1e-4, 0.04) + 10.0 ** draw.uniform(-4.0, -2.0) * KINDS[kind](draw, count) for _ in range(2)]
    offset_s, drift = draw.choice([0.0, 5.0, -0.3]), draw.choice([0.0, 0.0, draw.uniform(-1e-4, 1e-4)])
    both_s = ways_s[0] + ways_s[1]
    change_s = LEAST_S + size * float(np.median(np.abs(both_s - np.median(both_s))))
    change_s = {"none": 0.0, "set": change_s, "rate": change_s}[change] * draw.choice([-1.0, 1.0])
    asked_s = np.arange(count) / HZ

    def ahead_s(at_s: Column) -> Column:
        after_s = np.maximum(0.0, at_s - 0.5 * seconds)
        changed = (after_s > 0.0) if change == "set" else after_s / (0.5 * seconds)
        return np.asarray(offset_s + drift * at_s + change_s * changed)

    there_s = asked_s + ways_s[0]
    answered_s = there_s + 1e-4
    back_s = answered_s + ways_s[1]
    columns = asked_s, there_s + ahead_s(there_s), answered_s + ahead_s(answered_s), back_s
    arrived = draw.random(count) >= draw.choice([0.0, 0.02])
    stamps = np.stack([BEGAN_NS + np.rint(1e9 * column).astype(np.int64) for column in columns], axis=1)[arrived]
    return Clocks(KINDS[kind].__name__, stamps, drift, change_s, 0.5 * seconds)


def pieces_of(clocks: Clocks) -> Iterator[Bounds]:
    """Yield the bounds of the pieces of a recording."""
    at = (clocks.exchanges[:, 0] - BEGAN_NS) // (PIECE_S * 10**9)
    for piece in np.unique(at).tolist():
        rows = clocks.exchanges[at == piece].tolist()
        found = bounds_of(
            [(asked, there - asked) for asked, there, _, _ in rows],
            [(received, answered - received) for _, _, answered, received in rows],
        )
        if found is not None:
            yield found


class Said(NamedTuple):
    """What is said of clocks: whether they drift apart and one changed by a recording, and the latter by the link."""

    drifts: bool
    changed: bool
    changed_live: bool


def said_of(clocks: Clocks) -> Said:
    """Return what is said of clocks by a recording of them, and by the link while it runs."""
    parts = stretches(list(pieces_of(clocks)))
    seen, most, fell = OffsetFilter(64), 0, False
    for number, exchange in enumerate(clocks.exchanges.tolist()):
        seen.record(*exchange)
        if number % HZ == 0:
            seen.estimate()
            fell = fell or len(seen.state.blocks) < most
            most = max(most, len(seen.state.blocks))
    return Said(any(part.line.drift != 0.0 for part in parts), len(parts) > 1, fell)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:50", help="first and last seed, one pair of clocks of each kind a seed")
    parser.add_argument("--longest", type=float, default=600.0, help="length of the longest session [s]")
    parser.add_argument("--change", choices=CHANGES, help="clocks that change in this way alone")
    given = parser.parse_args()
    first, last = (int(part) for part in given.seeds.split(":"))
    for number, kind in enumerate(KINDS):
        for change, size in (("none", 1.0), *((change, size) for change in CHANGES[1:] for size in SIZES)):
            if given.change not in (None, change):
                continue
            found = [
                (clocks, said_of(clocks))
                for clocks in (drawn(seed, number, change, size, given.longest) for seed in range(first, last))
            ]
            cells: dict[str, list[Any]] = {
                "changed": [said.changed for _, said in found],
                "live": [said.changed_live for _, said in found],
            }
            if change == "none":
                cells["drift of none"] = [said.drifts for clocks, said in found if clocks.drift == 0.0]
            texts = []
            for what, values in cells.items():
                low, high = wilson(sum(values), len(values))
                texts.append(f"{what} {sum(values)}/{len(values)} ({low:.0%} to {high:.0%})")
            name = change if change == "none" else f"{change} by {size:g}"
            sys.stdout.write(f"{kind.__name__:12} {name:12} " + ", ".join(texts) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
