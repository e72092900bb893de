"""How often equal versions are said to differ in any figure, and how often a difference is found.

    python tests/unit/benchmarks/versions_confusion.py --seeds 0:400

Pairs of times are drawn: independent ones with long tails, ones of a machine that is slow for a while, whose frequency
wanders, or on which another process comes and goes. What slows the one of a pair slows the other in part.
"""

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[3]))

from benchmarks.versions import compared
from telenano.analysis import wilson

Series = NDArray[np.float64]
# Figures of a comparison, how many pairs, the difference to be found in deviations of a single ratio, and of which.
FIGURES, PAIRS, STEP, DIFFERENT = 8, (30, 400), 1.0, 3


def tails(draw: np.random.Generator, count: int) -> Series:
    return np.asarray(draw.lognormal(0.0, 0.03, count) + (draw.random(count) < 0.1) * draw.exponential(0.5, count))


def slow(draw: np.random.Generator, count: int) -> Series:
    course, at, state = np.ones(count), 0, bool(draw.integers(2))
    while at < count:
        end = at + max(1, int(draw.exponential(8.0)))
        course[at:end] += 0.3 * state
        at, state = end, not state
    return np.asarray(course * draw.lognormal(0.0, 0.02, count))


def wanders(draw: np.random.Generator, count: int) -> Series:
    rho, course = 0.8, np.empty(count)
    value = draw.standard_normal()
    for n in range(count):
        value = rho * value + math.sqrt(1.0 - rho * rho) * draw.standard_normal()
        course[n] = value
    return np.asarray(np.exp(0.05 * course))


KINDS: tuple[Callable[[np.random.Generator, int], Series], ...] = (tails, slow, wanders)


def drawn(seed: int, kind: int, *, differs: bool) -> dict[str, list[tuple[float, float]]]:
    """Draw the pairs of some figures; where the versions differ, one of them does."""
    draw = np.random.default_rng((seed, kind))
    count = round(PAIRS[0] * (PAIRS[1] / PAIRS[0]) ** draw.random())
    found: dict[str, list[tuple[float, float]]] = {}
    for number in range(FIGURES):
        scale, shared, part = 10.0 ** draw.uniform(0.0, 3.0), KINDS[kind](draw, count), draw.uniform(0.0, 1.0)
        here, other = (shared * KINDS[kind](draw, count) ** part * draw.lognormal(0.0, 0.02, count) for _ in range(2))
        if differs and number == DIFFERENT:
            here *= math.exp(STEP * float(np.std(np.log(here / other))))
        found[f"figure {number}"] = [(scale * a, scale * b) for a, b in zip(here, other, strict=True)]
    return found


class Said(NamedTuple):
    """Of a comparison whether an interval is known, and the figures that are said to differ."""

    known: bool
    differ: list[str]


def said(seed: int, kind: int, *, differs: bool) -> Said:
    """Return what is said of a comparison that is drawn."""
    found = compared(drawn(seed, kind, differs=differs))
    known = all(math.isfinite(ratio.low) for ratio in found.values())
    return Said(known, [what for what, ratio in found.items() if ratio.differs])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:200", help="first and last seed, one comparison of each kind a seed")
    first, last = (int(part) for part in parser.parse_args().seeds.split(":"))
    for kind, make in enumerate(KINDS):
        for differs in (False, True):
            found = [said(seed, kind, differs=differs) for seed in range(first, last)]
            known = [one for one in found if one.known]
            count = sum(f"figure {DIFFERENT}" in one.differ if differs else bool(one.differ) for one in known)
            low, high = wilson(count, len(known))
            state = "differing" if differs else "equal"
            sys.stdout.write(
                f"{make.__name__:8} {state:10} no interval: {len(found) - len(known)} of {len(found)}; said to differ: "
                f"{count} of {len(known)} ({low:.1%} to {high:.1%})\n"
            )


if __name__ == "__main__":
    main()
