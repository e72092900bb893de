"""Cycles later than 1 ms in a million, beside a process that allocates memory and burns a core, and without it.

    python benchmarks/late_cycles.py [--rounds N] [--duration S] [--quick] [--json]

Three loops at 1 kHz under the scheduling of the hand's node take turns, first undisturbed, then beside the process: one
thread that only waits for its deadlines, the eight hops over bare ZeroMQ (`chains.py`), and the whole rig.

A cycle begins at its deadline, on an absolute grid. It ends when its answer arrives at the hand, or the answer of a
later cycle, which then takes its place; for the thread, when it runs. Deadlines that a loop skipped count as cycles
like the others. A cycle is late if it ends more than 1 ms after the median cycle of the same loop, undisturbed in the
same round: so the three are compared by the time that the machine adds, and not by their own work. `after the next
tick` counts the cycles of more than a period, which matter to a controller that expects each answer before its next
sample.

Late cycles come in runs, one for each time that a loop stood still. The runs are counted as well, because they, and not
their cycles, come by chance: the interval (95 %) is the exact one of their count, and a ratio is one of runs. If a
baseline had no run, the ratio to it is a lower bound (>).
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

from burner import burning
from chains import PERIOD_NS, measure_waiting, measure_zeromq
from cycles import LATE_MS, Cycle, Interval, Late, later_than, responses_ms, runs_in_million
from loop import measure_rig

from telenano.runtime.loop.realtime import shallow_idle

PERIOD_MS = PERIOD_NS * 1e-6
LOOPS: dict[str, tuple[str, Callable[[float], list[Cycle]]]] = {
    "waiting": ("one thread that only waits", lambda duration_s: measure_waiting(round(duration_s * 1000))),
    "zeromq": ("eight hops over ZeroMQ", lambda duration_s: measure_zeromq(round(duration_s * 1000), placed=True)),
    "rig": ("the whole rig", lambda duration_s: measure_rig(duration_s, trace=False).cycles),
}
BESIDE = {"nothing": "nothing", "burner": "a burning process"}


def ratio(found: Interval, base: Interval) -> tuple[float, bool]:
    """Return the ratio of a rate of late runs to a baseline, and whether that is only a lower bound."""
    return (found.rate / base.rate, False) if base.rate else (found.low / base.high, True)


def measure(rounds: int, duration_s: float) -> dict[str, Any]:
    """Return the results of each loop, beside nothing and beside the process.

    Raises SystemExit if a loop answers no cycle.
    """
    kinds = [(beside, name) for beside in BESIDE for name in LOOPS]
    late = {kind: Late((), 0) for kind in kinds}
    missed = {kind: Late((), 0) for kind in kinds}
    medians: dict[tuple[str, str], list[float]] = {kind: [] for kind in kinds}
    longest = dict.fromkeys(kinds, 0.0)
    burned: dict[tuple[str, str], list[float]] = {kind: [] for kind in kinds}
    for _ in range(rounds):
        usual_ms: dict[str, float] = {}
        for beside in BESIDE:
            with burning(beside == "burner") as burned_s:
                for name, (_, run) in LOOPS.items():
                    begun, used_s = time.monotonic(), burned_s()
                    # A rig asks for shallow idle states itself.
                    with shallow_idle():
                        found_ms = responses_ms(run(duration_s), PERIOD_NS)
                    if not found_ms.size:
                        raise SystemExit(f"{LOOPS[name][0]} answered no cycle")
                    kind = beside, name
                    burned[kind].append(100.0 * (burned_s() - used_s) / (time.monotonic() - begun))
                    medians[kind].append(float(statistics.median(found_ms)))
                    longest[kind] = max(longest[kind], float(found_ms.max()))
                    late[kind] += later_than(found_ms, usual_ms.setdefault(name, medians[kind][-1]) + LATE_MS)
                    missed[kind] += later_than(found_ms, PERIOD_MS)
    runs = {kind: runs_in_million(late[kind]) for kind in kinds}
    rows = []
    for beside, name in kinds:
        kind = beside, name
        value, is_bound = ratio(runs[kind], runs[beside, "waiting"])
        rows.append(
            {
                "beside": beside,
                "loop": name,
                "cycles": late[kind].cycles,
                "late_in_million": late[kind].in_million,
                "runs_in_million": runs[kind]._asdict(),
                "runs": len(late[kind].runs),
                "ratio": value,
                "ratio_is_bound": is_bound,
                "after_next_tick_in_million": missed[kind].in_million,
                "median_ms": statistics.median(medians[kind]),
                "longest_ms": longest[kind],
                "burner_percent": statistics.median(burned[kind]),
            }
        )
    return {"rounds": rounds, "duration_s": duration_s, "rows": rows}


HEAD = (
    "| beside | loop | cycles | late in 10^6 | runs of them in 10^6 (95 %) | runs to the thread's"
    " | after the next tick in 10^6 | median [ms] | longest [ms] | the process had [%] |"
)


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells of a row of the table, in the order of `HEAD`."""
    runs = Interval(**row["runs_in_million"])
    # A bound without any late run carries no information.
    has_ratio = row["loop"] != "waiting" and not (row["ratio_is_bound"] and not row["runs"])
    return (
        BESIDE[row["beside"]],
        LOOPS[row["loop"]][0],
        f"{row['cycles']}",
        f"{row['late_in_million']:.0f}",
        f"{runs.rate:.0f} ({runs.low:.0f} to {runs.high:.0f})",
        f"{'> ' * row['ratio_is_bound']}{row['ratio']:.1f}" if has_ratio else "",
        f"{row['after_next_tick_in_million']:.0f}",
        f"{row['median_ms']:.3f}",
        f"{row['longest_ms']:.1f}",
        f"{row['burner_percent']:.0f}" if row["beside"] == "burner" else "",
    )


def print_table(rows: Sequence[dict[str, Any]]) -> None:
    """Print the rows in columns."""
    table = [tuple(cell.strip() for cell in HEAD.strip("| ").split("|")), *map(cells, rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for line in table:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=6, help="turns of all, undisturbed and beside the process")
    parser.add_argument("--duration", type=float, default=10.0, help="length of each turn [s]: 1000 cycles a second")
    parser.add_argument("--quick", action="store_true", help="two rounds of 5 s, in about two minutes")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    if given.quick:
        given.rounds, given.duration = 2, 5.0
    if given.smoke:
        given.rounds, given.duration = 1, 1.5
    found = measure(given.rounds, given.duration)
    if given.json:
        print(json.dumps(found))
        return
    print_table(found["rows"])


if __name__ == "__main__":
    main()
