"""How often the interval of a mean covers, and how often there is none: `python -m benchmarks.mean_intervals`."""

import argparse
import sys

import numpy as np

from analysis.mean_interval import mean_half_width
from benchmarks.made_records import RATE_HZ, RECORDS

WINDOWS_S = (0.3, 1.0, 3.0, 10.0)


def covered(name: str, window_s: float, count: int, seed: int) -> tuple[int, int]:
    """Return of how many of `count` windows there is an interval, and how many of those have the true mean in it."""
    rows = RECORDS[name](np.random.default_rng(seed), count, round(window_s * RATE_HZ))
    halves = [mean_half_width(row) for row in rows]
    known = [(row.mean(), half) for row, half in zip(rows, halves, strict=True) if half is not None]
    return len(known), sum(abs(mean) <= half for mean, half in known)


def main() -> None:
    """Print a table: the share of windows with an interval, and the share of those that cover."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mean_intervals", description=__doc__)
    parser.add_argument("--count", type=int, default=400, help="windows of each kind (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the records (default: %(default)s)")
    given = parser.parse_args()
    sys.stdout.write("| record | " + " | ".join(f"{window_s:g} s" for window_s in WINDOWS_S) + " |\n")
    sys.stdout.write("|---" * (1 + len(WINDOWS_S)) + "|\n")
    for name in RECORDS:
        cells = []
        for window_s in WINDOWS_S:
            known, inside = covered(name, window_s, given.count, given.seed)
            share = f"{100.0 * inside / known:.0f} %" if known else "–"
            cells.append(f"{share} of {100.0 * known / given.count:.0f} %")
        sys.stdout.write(f"| {name} | " + " | ".join(cells) + " |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
