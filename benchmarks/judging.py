"""Processor time and memory of the judge for a session of holds: `python -m benchmarks.judging`."""

import argparse
import json
import sys
import time
import tracemalloc

import numpy as np

from telenano.analysis.holds import Instrument, judge_holds

HAND_N = 1.0
# A hold and the free time after it [s].
HOLD_S, FREE_S = 6.0, 2.0


def judged(length_s: float, rate_hz: float, seed: int) -> dict[str, float]:
    """Judge a session of presses, of which one dies out, one is at rest, one goes on, and one slips, and so on.

    Returns:
        The number of holds, the processor time for a second of session [s], and the greatest size of what the judge
        allocated beside the series [MB].
    """
    dice = np.random.default_rng(seed)
    time_s = np.arange(round(length_s * rate_hz)) / rate_hz
    press, since_s = np.divmod(time_s, FREE_S + HOLD_S)
    is_pressed, held_s = since_s >= FREE_S, since_s - FREE_S
    swing = np.cos(2.0 * np.pi * 7.0 * held_s)
    slips = 0.3 * np.repeat(dice.random(len(time_s) // 100 + 1), 100)[: len(time_s)]
    motions = [0.5 * np.exp(-2.0 * np.abs(held_s)) * swing, np.zeros(len(time_s)), 0.2 * swing, slips]
    moved = np.choose(press.astype(int) % len(motions), motions)
    hand_n = np.where(is_pressed, HAND_N, 0.0)
    tip_n = np.where(is_pressed, HAND_N + moved, 0.0) + dice.normal(0.0, 0.003, len(time_s))
    tip = Instrument(np.ones(len(time_s), dtype=bool), is_pressed)
    began_s = time.process_time()
    holds = judge_holds(time_s, hand_n, time_s, tip_n, tip)
    spent_s = time.process_time() - began_s
    tracemalloc.start()
    judge_holds(time_s, hand_n, time_s, tip_n, tip)
    most_mb = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    return {"holds": len(holds), "s_per_s": spent_s / length_s, "most_mb": most_mb}


def main() -> None:
    """Print the table: a row for each length of session."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.judging", description=__doc__)
    parser.add_argument("--lengths", default="60,600,3600", help="lengths of the sessions in s (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=1000.0, help="samples a second (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the noise (default: %(default)s)")
    parser.add_argument("--smoke", action="store_true", help="a session of 16 s at 250 Hz alone")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    given = parser.parse_args()
    lengths, rate_hz = ("16", 250.0) if given.smoke else (given.lengths, given.rate)
    rows = {f"{length} s": judged(float(length), rate_hz, given.seed) for length in lengths.split(",")}
    if given.json:
        sys.stdout.write(f"{json.dumps(rows)}\n")
        return
    sys.stdout.write(f"{'session':>10}{'holds':>8}{'processor [s/s]':>18}{'memory [MB]':>14}\n")
    for name, row in rows.items():
        sys.stdout.write(f"{name:>10}{row['holds']:>8.0f}{row['s_per_s']:>18.4f}{row['most_mb']:>14.1f}\n")


if __name__ == "__main__":
    main()
