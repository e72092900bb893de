"""How often the interval of a mean covers, and how often there is none: `python -m benchmarks.mean_intervals`."""

import argparse
import json
import sys

import numpy as np

from benchmarks.made_records import RATE_HZ, RECORDS
from telenano.analysis.mean_interval import mean_half_width

WINDOWS_S = (0.3, 1.0, 3.0, 10.0)


def covered(name: str, window_s: float, count: int, seed: int) -> tuple[int, int]:
    """Return of how many of `count` windows there is an interval, and how many of those have the true mean in it."""
    rows = RECORDS[name](np.random.default_rng(seed), count, round(window_s * RATE_HZ))
    halves = [mean_half_width(row) for row in rows]
    known = [(row.mean(), half) for row, half in zip(rows, halves, strict=True) if half is not None]
    return len(known), sum(abs(mean) <= half for mean, half in known)


def shares(name: str, window_s: float, count: int, seed: int) -> dict[str, float]:
    """Return the share of windows with an interval, and the share of those that has the true mean in it."""
    known, inside = covered(name, window_s, count, seed)
    return {"known": known / count, "covered": inside / known if known else 0.0}


def main() -> None:
    """Print a table: the share of windows with an interval, and the share of those that cover."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mean_intervals", description=__doc__)
    parser.add_argument("--count", type=int, default=400, help="windows of each kind (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the records (default: %(default)s)")
    parser.add_argument("--smoke", action="store_true", help="20 windows of white noise alone")
    parser.add_argument("--json", action="store_true", help="print the shares as JSON")
    given = parser.parse_args()
    count, names = (20, ["white"]) if given.smoke else (given.count, list(RECORDS))
    if given.json:
        rows = {
            name: {f"{window_s:g} s": shares(name, window_s, count, given.seed) for window_s in WINDOWS_S}
            for name in names
        }
        sys.stdout.write(f"{json.dumps(rows)}\n")
        return
    sys.stdout.write("| record | " + " | ".join(f"{window_s:g} s" for window_s in WINDOWS_S) + " |\n")
    sys.stdout.write("|---" * (1 + len(WINDOWS_S)) + "|\n")
    for name in names:
        cells = []
        for window_s in WINDOWS_S:
            found = shares(name, window_s, count, given.seed)
            share = f"{100.0 * found['covered']:.0f} %" if found["known"] else "–"
            cells.append(f"{share} of {100.0 * found['known']:.0f} %")
        sys.stdout.write(f"| {name} | " + " | ".join(cells) + " |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
