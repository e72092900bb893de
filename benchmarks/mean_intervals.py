"""How often the interval of a mean covers, and how often there is none: `python -m benchmarks.mean_intervals`."""

import argparse
import json
import sys

import numpy as np

from benchmarks.made_records import HANDS, RATE_HZ, RECORDS
from telenano.analysis.intervals import wilson
from telenano.analysis.mean_interval import mean_half_width

WINDOWS_S = (0.3, 1.0, 3.0, 10.0)


def _lengths(text: str) -> tuple[float, ...]:
    """Return the lengths of windows [s] from a text in which commas separate them."""
    return tuple(float(one) for one in text.split(","))


def covered(name: str, window_s: float, count: int, seed: int) -> tuple[int, int]:
    """Return how many of `count` windows have an interval, and how many of those intervals contain the true mean."""
    rows = RECORDS[name](np.random.default_rng(seed), count, round(window_s * RATE_HZ))
    halves = [mean_half_width(row) for row in rows]
    known = [(row.mean(), half) for row, half in zip(rows, halves, strict=True) if half is not None]
    return len(known), sum(abs(mean) <= half for mean, half in known)


def shares(name: str, window_s: float, count: int, seed: int) -> dict[str, float]:
    """Return the share of windows with an interval, and the share of those intervals that contain the true mean."""
    known, inside = covered(name, window_s, count, seed)
    return {"known": known / count, "covered": inside / known if known else 0.0}


def cell(known: int, inside: int, count: int) -> str:
    """Return a cell of the table: the coverage with Wilson's interval, and the share of windows without an interval."""
    if not known:
        return "all refused"
    low, high = wilson(inside, known)
    shares_of = f"{100.0 * inside / known:.0f} % ({100.0 * low:.0f} to {100.0 * high:.0f})"
    return f"{shares_of}, {100.0 * (count - known) / count:.0f} % refused"


def main() -> None:
    """Print a table of the coverage of the intervals and of the share of windows without one."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mean_intervals", description=__doc__)
    parser.add_argument("--count", type=int, default=400, help="windows of each kind (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the records (default: %(default)s)")
    parser.add_argument("--smoke", action="store_true", help="20 windows of white noise alone")
    parser.add_argument("--hands", action="store_true", help="only the eight kinds of hands")
    parser.add_argument("--windows", default=WINDOWS_S, type=_lengths, help="their lengths, in s (default: 0.3,1,3,10)")
    parser.add_argument("--json", action="store_true", help="print the shares as JSON")
    given = parser.parse_args()
    count, names = (20, ["white"]) if given.smoke else (given.count, list(HANDS if given.hands else RECORDS))
    if given.json:
        rows = {
            name: {f"{window_s:g} s": shares(name, window_s, count, given.seed) for window_s in given.windows}
            for name in names
        }
        sys.stdout.write(f"{json.dumps(rows)}\n")
        return
    sys.stdout.write("| record | " + " | ".join(f"{window_s:g} s" for window_s in given.windows) + " |\n")
    sys.stdout.write("|---" * (1 + len(given.windows)) + "|\n")
    for name in names:
        cells = [cell(*covered(name, window_s, count, given.seed), count) for window_s in given.windows]
        sys.stdout.write(f"| {name} | " + " | ".join(cells) + " |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
