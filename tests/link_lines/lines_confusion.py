"""What is said of lines whose truth is known, by kind: `python tests/link_lines/lines_confusion.py --seeds 0:400`.

It prints how many round trips, queues and capacities are right, wrong or not known, and for how long the hand is off.
"""

import argparse
import math
import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2] / "packages/telenano-wide-area/tests")]

from line_judge import OFF_MS, Verdict, judge  # noqa: E402
from lines import draw_line, run  # noqa: E402


class Counted(NamedTuple):
    """How many of how many, with the Wilson interval at 95 %."""

    count: int
    of: int

    @property
    def share(self) -> float:
        return self.count / self.of if self.of else 0.0

    def interval(self) -> tuple[float, float]:
        """Return the interval of the share."""
        if not self.of:
            return 0.0, 1.0
        z, n = 1.96, self.of
        middle = (self.share + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * math.sqrt(self.share * (1 - self.share) / n + z * z / (4 * n * n))
        return max(0.0, middle - half), min(1.0, middle + half)

    def __str__(self) -> str:
        low, high = self.interval()
        return f"{self.count}/{self.of} ({100 * self.share:.1f} %, {100 * low:.1f} to {100 * high:.1f})"


class Figures(NamedTuple):
    """Of some lines: those whose capacity is wrong, that a queue limits and have none, wrong round trips and queues.

    late: lines with a step that is borne after which the hand was off for too long.
    """

    wrong: Counted
    null_of_limited: Counted
    round_trip_wrong: Counted
    queue_wrong: Counted
    late: Counted


def figures(lines: Iterable[list[Verdict]]) -> Figures:
    """Count the verdicts of lines."""
    kept = list(lines)
    ways = [way for line in kept for way in line]
    limited = [way for way in ways if way.limited]
    steps = [line[0] for line in kept if line[0].off_ms is not None]
    return Figures(
        Counted(sum(any(way.capacity == "wrong" for way in line) for line in kept), len(kept)),
        Counted(sum(way.capacity == "null" for way in limited), len(limited)),
        Counted(sum(not line[0].round_trip for line in kept), len(kept)),
        Counted(sum(not line[0].queue for line in kept), len(kept)),
        Counted(sum((one.off_ms or 0) > OFF_MS for one in steps), len(steps)),
    )


def write(text: str) -> None:
    """Write a line of the table."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0:400", help="first and last seed, A:B, the last left out")
    parser.add_argument("--bad", action="store_true", help="print each line that is not right")
    options = parser.parse_args()
    first, last = map(int, options.seeds.split(":"))
    found: dict[str, list[list[Verdict]]] = defaultdict(list)
    for seed in range(first, last):
        line = draw_line(seed)
        verdicts = judge(run(line, str(seed)))
        found[line.kind].append(verdicts)
        whole = verdicts[0]
        bad = not whole.round_trip or not whole.queue or (whole.off_ms or 0) > OFF_MS
        if options.bad and (bad or any(way.capacity == "wrong" for way in verdicts)):
            write(f"{seed} {line.kind} {[way.capacity for way in verdicts]} {whole}")
    write(
        f"{'kind':18} {'lines':>5} {'round trip':>10} {'queue':>6} {'capacity wrong':>14} {'null':>5} {'off [ms]':>9}"
    )
    for kind, lines in sorted(found.items()):
        own, ways = figures(lines), [way for line in lines for way in line]
        off = max((line[0].off_ms or 0 for line in lines), default=0)
        write(
            f"{kind:18} {len(lines):5} {own.round_trip_wrong.count:10} {own.queue_wrong.count:6} {own.wrong.count:14}"
            f" {sum(way.capacity == 'null' for way in ways):5} {off:9}"
        )
    whole = figures(line for lines in found.values() for line in lines)
    inside = [line[0].in_interval for lines in found.values() for line in lines if line[0].off_ms is not None]
    write(f"capacity wrong: {whole.wrong}; none of those that a queue limits: {whole.null_of_limited}")
    write(
        f"round trip wrong: {whole.round_trip_wrong}; queue wrong: {whole.queue_wrong}; hand off too long: {whole.late}"
    )
    write(f"the round trip in its interval, after steps: {100 * sum(inside) / max(1, len(inside)):.1f} %")
    ways = [way for lines in found.values() for line in lines for way in line]
    for what in ("queue", "capacity"):
        shares = [share for way in ways if (share := getattr(way, f"{what}_in_interval")) is not None]
        write(f"the {what} in its interval: {100 * sum(shares) / max(1, len(shares)):.1f} % of what was said")
    return 0


if __name__ == "__main__":
    sys.exit(main())
