"""What the machine itself takes away: loops that do nothing but keep deadlines, one on each processor.

    python benchmarks/empty_loop.py [--duration S]

A rig cannot be better than these loops, so its demands on time are judged against them, at the same moments.
"""

import argparse
import contextlib
import json
import multiprocessing
import os
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from types import TracebackType
from typing import NamedTuple

PERIOD_NS = 2_000_000
# Less lateness than this is due to the scheduler, more to a processor that was taken away.
LATE_NS = 1_000_000
PRIORITY = 90


class Stall(NamedTuple):
    """A time in which a processor did not run the loop, on the clock of stamps [ns since 1970]."""

    first_ns: int
    last_ns: int


class EmptyLoops:
    """Runs a loop on each processor while the block runs; `stalls` are known once it has ended.

    Parameters: period_ns [ns]; late_ns, the lateness from which on it is a stall [ns].
    """

    def __init__(self, period_ns: int = PERIOD_NS, late_ns: int = LATE_NS) -> None:
        self.stalls: list[Stall] = []
        self._period_ns, self._late_ns = period_ns, late_ns

    def __enter__(self) -> "EmptyLoops":
        # A new interpreter would take seconds to start beside a rig.
        context = multiprocessing.get_context("fork")
        self._ends: list[Connection] = []
        self._loops = []
        for cpu in sorted(os.sched_getaffinity(0)):
            here, there = multiprocessing.Pipe()
            loop = context.Process(
                target=keep_deadlines, args=(cpu, there, self._period_ns, self._late_ns), daemon=True
            )
            loop.start()
            self._ends.append(here)
            self._loops.append(loop)
        for end in self._ends:
            end.recv()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        found: list[Stall] = []
        for end, loop in zip(self._ends, self._loops, strict=True):
            end.send("stop")
            found += end.recv()
            loop.join()
        self.stalls = merged(found)

    def share(self, first_ns: int, last_ns: int) -> float:
        """Return the share of a time in which every processor was available [1]."""
        lost = sum(max(0, min(stall.last_ns, last_ns) - max(stall.first_ns, first_ns)) for stall in self.stalls)
        return 1.0 - lost / (last_ns - first_ns)

    def longest_s(self, first_ns: int, last_ns: int) -> float:
        """Return the longest time without one of the processors [s]."""
        inside = (stall for stall in self.stalls if stall.last_ns > first_ns and stall.first_ns < last_ns)
        return max((stall.last_ns - stall.first_ns for stall in inside), default=0) * 1e-9


def keep_deadlines(cpu: int, stop: Connection, period_ns: int = PERIOD_NS, late_ns: int = LATE_NS) -> None:
    """Keep deadlines on one processor until stopped, then send the stalls."""
    os.sched_setaffinity(0, {cpu})
    # Where this is not permitted, the rig has no real-time scheduling either.
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    stop.send("running")
    stalls: list[Stall] = []
    deadline = time.monotonic_ns()
    while not stop.poll():
        deadline += period_ns
        time.sleep(max(0, deadline - time.monotonic_ns()) * 1e-9)
        now = time.monotonic_ns()
        if now - deadline > late_ns:
            wall = time.time_ns()
            stalls.append(Stall(wall - (now - deadline), wall))
            deadline = now
    stop.send(stalls)


def merged(stalls: Sequence[Stall]) -> list[Stall]:
    """Join stalls that overlap: a loop across two processors stands still if either of them does."""
    found: list[Stall] = []
    for stall in sorted(stalls):
        if found and stall.first_ns <= found[-1].last_ns:
            found[-1] = Stall(found[-1].first_ns, max(found[-1].last_ns, stall.last_ns))
        else:
            found.append(stall)
    return found


def main() -> None:
    """Watch the machine for a time and report the time that it took away."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--duration", type=float, default=10.0, help="time to watch [s]")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    duration_s = 0.3 if given.smoke else given.duration
    with EmptyLoops() as loops:
        first_ns = time.time_ns()
        time.sleep(duration_s)
        last_ns = time.time_ns()
    if given.json:
        longest_s, stalls = loops.longest_s(first_ns, last_ns), len(loops.stalls)
        share = loops.share(first_ns, last_ns)
        print(json.dumps({"available": share, "longest_s": longest_s, "stalls": stalls}))
        return
    print(f"available  {100.0 * loops.share(first_ns, last_ns):.3f} %")
    print(f"longest    {1e3 * loops.longest_s(first_ns, last_ns):.1f} ms")
    print(f"stalls     {len(loops.stalls)}")


if __name__ == "__main__":
    main()
