"""UDP blocked between two machines, both ways or one: what becomes of the tip, cell by cell, in network namespaces.

    python tests/stack/blocked_cable.py blocked.jsonl [--pairs] [--cells N] [--only TEXT] [--times N] [--show]

runs `fig12` at both sites over the cable of tun_cable.py once for each cell of the table that is not in the file yet,
in an order drawn from a seed, so that a part of the table is a fair sample of it, and prints what is there by round
trip and loss, with `--show` session by session. `--pairs` takes cells in which every two values that can meet, such as
1 kHz and 2 % loss, meet at least twice. With `--times` each cell is run so often, each time
with another seed of its losses. A session in which the cable itself was late is no measurement, is counted, and
is run again the next time. It needs root.

The tip may stand still for a deadline of 50 ms and a round trip, and a lost packet of TCP for a round trip more.
"""

import argparse
import itertools
import json
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from two_sites import why_not
from wide_area_cable import fig12

ROUND_TRIPS_MS = (40.0, 150.0)
WAYS = {"both ways": ("there", "back"), "to the slave": ("there",), "to the master": ("back",)}
# From when on, and until when, UDP is blocked, in the time of the session [s].
TIMES: dict[str, tuple[float, float | None]] = {
    "from the start": (0.0, None),
    "at 2 s": (2.0, None),
    "for 1.6 s": (1.6, 3.2),
}
RATES_HZ = (125.0, 250.0, 500.0, 1000.0)
LOSSES = (0.0, 0.02)
# 0 is a line without a limit, of which nothing is known that would stop TCP.
CAPACITIES_MBIT = (0.0, 4.0, 2.0)
DEADLINE_MS = 50.0
_LAW = "wave"


class Cell(NamedTuple):
    """One session of the table."""

    round_trip_ms: float
    ways: str
    when: str
    rate_hz: float
    loss: float
    capacity_mbit: float

    @property
    def name(self) -> str:
        capacity = f", {self.capacity_mbit:g} Mbit/s" if self.capacity_mbit else ""
        return f"{self.round_trip_ms:g} ms, {self.ways}, {self.when}, {self.rate_hz:g} Hz, {self.loss:.0%}{capacity}"

    @property
    def most_ms(self) -> float:
        """The longest time for which the tip may stand still [ms]."""
        return 2.0 * DEADLINE_MS + self.round_trip_ms * (2.25 if self.loss else 1.0)


def cells(seed: int = 73) -> Iterator[Cell]:
    """Yield every cell, in an order that is drawn; a capacity is known only where datagrams came first."""
    found = [Cell(*each) for each in itertools.product(ROUND_TRIPS_MS, WAYS, TIMES, RATES_HZ, LOSSES, CAPACITIES_MBIT)]
    random.Random(seed).shuffle(found)
    yield from (cell for cell in found if not (cell.capacity_mbit and cell.when == "from the start"))


def pairs_of(cell: Cell) -> set[tuple[int, int, Any, Any]]:
    """Return every two values of a cell, each with its place in the cell."""
    return {(i, j, cell[i], cell[j]) for i, j in itertools.combinations(range(len(cell)), 2)}


def pairwise(times: int = 2, seed: int = 73) -> Iterator[Cell]:
    """Yield few cells in which every two values that can meet do so in `times` cells: the one with most first."""
    left = list(cells(seed))
    missing = {pair: times for cell in left for pair in pairs_of(cell)}
    while any(missing.values()):
        best = max(left, key=lambda cell: sum(missing[pair] > 0 for pair in pairs_of(cell)))
        left.remove(best)
        for pair in pairs_of(best):
            missing[pair] = max(0, missing[pair] - 1)
        yield best


def run(cell: Cell, folder: Path, law: str = _LAW, seed: int = 1) -> dict[str, Any]:
    """Run the session of a cell and give what became of it."""
    begin_s, end_s = TIMES[cell.when]
    blocked = {f"block_udp_{way}": True for way in WAYS[cell.ways]}
    rules: dict[str, float | bool] = {"rate_bit_per_s": cell.capacity_mbit * 1e6} if cell.capacity_mbit else {}
    changes = [(begin_s, blocked)] if begin_s else []
    if end_s is not None:
        changes.append((end_s, dict.fromkeys(blocked, False)))
    found = fig12(
        folder,
        cell.round_trip_ms / 2.0,
        cell.loss,
        law,
        seed=seed,
        rules={**rules, **({} if begin_s else blocked)},
        rate_hz=cell.rate_hz,
        changes=changes,
    )
    kept = ("verdict", "reason", "tip", "distorted", "lines", "events", "loop_age_ms", "deadlines_missed")
    return {"cell": cell._asdict(), **{key: found[key] for key in kept}}


def _good(path: Path) -> list[dict[str, Any]]:
    """Return the sessions over a cable that was in time, with the instrument in their recording."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return [row for row in rows if not row["distorted"] and row["tip"]["modes"]]


def each_of(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a row of Markdown for each session."""
    yield "| round trip, UDP blocked, when, rate, loss, line | tip stood still [ms], at most | withdrawn | named |"
    yield "|---|---|---|---|"
    for row in sorted(rows, key=lambda row: list(row["cell"].values())):
        cell, tip = Cell(**row["cell"]), row["tip"]
        named = ", ".join(f"{line['direction']} {span}" for line in row["lines"] for span in line["blocked_s"])
        withdrawn = "yes" if tip["withdrawn"] else "no"
        yield f"| {cell.name} | {tip['stood_ms']:g}, {cell.most_ms:g} | {withdrawn} | {named} |"


def table_of(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a row of Markdown for each round trip and loss."""
    groups: dict[tuple[float, float], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["cell"]["round_trip_ms"], row["cell"]["loss"]), []).append(row)
    yield "| round trip, loss | sessions | tip stood still, median / longest [ms] | may | withdrawn | named | verdict |"
    yield "|---|---|---|---|---|---|---|"
    for (round_trip_ms, loss), found in sorted(groups.items()):
        stood_ms = [row["tip"]["stood_ms"] for row in found]
        withdrawn = sum(row["tip"]["withdrawn"] for row in found)
        named = sum(any(line["blocked_s"] for line in row["lines"]) for row in found)
        verdicts = ", ".join(f"{count} {kind}" for kind, count in Counter(r["verdict"] for r in found).most_common())
        shown = f"{median(stood_ms):.0f} / {max(stood_ms):.0f} | {Cell(**found[0]['cell']).most_ms:g}"
        yield f"| {round_trip_ms:g} ms, {loss:.0%} | {len(found)} | {shown} | {withdrawn} | {named} | {verdicts} |"


def main() -> int:
    """Run what is wanted of the table, and print what there is."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("table", type=Path, help="file of the cells, one JSON object a line")
    parser.add_argument("--pairs", action="store_true", help="few cells in which every two values meet twice")
    parser.add_argument("--cells", type=int, default=1000, help="most sessions to run now")
    parser.add_argument("--only", default="", help="run cells whose name has this text")
    parser.add_argument("--times", type=int, default=1, help="sessions of each cell")
    parser.add_argument("--show", action="store_true", help="run nothing, and show each session")
    given = parser.parse_args()
    if (reason := why_not()) and not given.show:
        sys.stderr.write(f"{reason}\n")
        return 1
    given.table.touch()
    known = Counter(Cell(**row["cell"]) for row in _good(given.table))
    chosen = [cell for cell in (pairwise() if given.pairs else cells()) if given.only in cell.name]
    wanted = [(cell, seed) for cell in chosen for seed in range(known[cell] + 1, given.times + 1)]
    for cell, seed in [] if given.show else wanted[: given.cells]:
        with tempfile.TemporaryDirectory() as folder:
            row = run(cell, Path(folder), seed=seed)
        with given.table.open("a") as out:
            out.write(json.dumps(row) + "\n")
        sys.stderr.write(f"{cell.name}: {row['verdict']}, {row['tip']}, {row['distorted']}\n")
    good = _good(given.table)
    for line in each_of(good) if given.show else table_of(good):
        sys.stdout.write(line + "\n")
    late = len(given.table.read_text().splitlines()) - len(good)
    sys.stdout.write(f"{len(good)} cells; {late} more sessions in which the cable or the machine was late\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
