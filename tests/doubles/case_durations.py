"""What each case takes of the processors, children included: every run writes it, and a slow one has to be marked.

    python tests/doubles/case_durations.py out/durations/RUN.tsv

writes the cases of a run that took more than LISTED_ABOVE_S into `tests/slow_cases.txt`, which leaves them to `make
check`: so what every commit waits for is bounded, and no case has to be marked by hand for it.

A case is judged by processor time, because time on the clock depends on what else the machine does. What it may take
grows with the time of `yardstick_s`, by which a slower machine, or one whose caches others use, is slower.
"""

import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import pytest

# CPython 3.11 takes so long on the machine of docs/performance.md [s].
YARDSTICK_S = 0.015
MARKED_ABOVE_S = 5.0
LISTED_ABOVE_S = 0.5
LIST = Path(__file__).parents[1] / "slow_cases.txt"
# Between the two a case is named at the end of the run. It fails only beyond what noise makes of a case that is just
# below the first: a shared processor doubles its time at most, and an empty cache of compiled steps adds up to 20 s.
REFUSED_ABOVE_S = 40.0
MARKS = {"stack", "check", "slow", "endurance"}
KEPT_RUNS = 40


@cache
def listed() -> dict[str, str]:
    """Return the processor time [s] of each case of the list."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return {case: spent_s for spent_s, case in (line.split(" ", 1) for line in lines if not line.startswith("#"))}


def list_of(table: str) -> str:
    """Return the list that follows from the table of a run: what is listed stays, and what has a mark needs no line."""
    found = dict(listed())
    for row in table.splitlines()[3:]:
        _, call_s, _, marks, case = row.split("\t")
        if float(call_s) > LISTED_ABOVE_S and not MARKS & set(marks.split(",")):
            found[case] = call_s
    head = (
        f"# cases above {LISTED_ABOVE_S} s of processor time, left to `make check` (tests/doubles/case_durations.py)\n"
    )
    return head + "".join(f"{spent_s} {case}\n" for case, spent_s in sorted(found.items()))


def yardstick_s() -> float:
    """Return the processor time of a fixed piece of plain Python, the least of seven turns."""

    def turn() -> float:
        began = time.process_time()
        total = 0.0
        for value in range(400_000):
            total += value * 0.5
        return time.process_time() - began

    return min(turn() for _ in range(7))


def processor_s() -> float:
    """Return the processor time of this process and of all its children that have ended."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


@dataclass
class Case:
    """What the phases of one case took together; `call_s` is that of its body alone, without its fixtures."""

    processor_s: float = 0.0
    call_s: float = 0.0
    wall_s: float = 0.0
    marks: str = ""


@dataclass(eq=False)
class CaseDurations:
    """A plugin of pytest that measures in every process of a run and writes in the one that reports."""

    config: pytest.Config
    cases: dict[str, Case] = field(default_factory=dict)
    yardstick_s: float = YARDSTICK_S
    _last_s: float = field(default_factory=processor_s)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self) -> None:
        self._last_s = processor_s()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Iterator[None]:
        report = yield
        now_s = processor_s()
        report.processor_s, self._last_s = now_s - self._last_s, now_s
        report.case_marks = sorted({mark.name for mark in item.iter_markers()} - {"parametrize", "usefixtures"})
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        case = self.cases.setdefault(report.nodeid, Case())
        spent_s = getattr(report, "processor_s", 0.0)
        case.processor_s += spent_s
        case.wall_s += report.duration
        case.marks = ",".join(getattr(report, "case_marks", ()))
        if report.when == "call":
            case.call_s = spent_s

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        mute = [
            item.nodeid
            for item in items
            for name in ("check", "slow")
            if (mark := item.get_closest_marker(name)) and not mark.args and "stack" not in item.path.parts
        ]
        if mute:
            raise pytest.UsageError(f"a slow case needs its reason, as in mark.check('compiles every law'): {mute[0]}")

    def unmarked_above(self, bound_s: float) -> list[str]:
        """Return the cases without a mark that took more than a time, that of another machine by the yardstick."""
        bound_s *= max(1.0, self.yardstick_s / YARDSTICK_S)
        return [
            f"{name}: {case.call_s:.1f} s"
            for name, case in self.cases.items()
            if case.call_s > bound_s and not MARKS & set(case.marks.split(","))
        ]

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if slow := self.unmarked_above(MARKED_ABOVE_S):
            terminalreporter.section(f"more than {MARKED_ABOVE_S:.0f} s of processor time: to be marked")
            for line in slow:
                terminalreporter.line(line)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if "PYTEST_XDIST_WORKER" in os.environ or not self.cases:
            return
        self.yardstick_s = yardstick_s()
        if self.unmarked_above(REFUSED_ABOVE_S) and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
        folder = self.config.rootpath / "out/durations"
        folder.mkdir(parents=True, exist_ok=True)
        name = time.strftime("%Y%m%dT%H%M%S") + f"_{os.getpid()}.tsv"
        (folder / name).write_text(self.table())
        for old in sorted(folder.glob("*.tsv"))[:-KEPT_RUNS]:
            old.unlink(missing_ok=True)

    def table(self) -> str:
        """Return the run as tab-separated lines, the slowest case first."""
        total_s = sum(case.processor_s for case in self.cases.values())
        lines = [
            f"# pytest {' '.join(map(str, self.config.invocation_params.args))}",
            f"# {len(self.cases)} cases, {total_s:.1f} s of processor time; yardstick {self.yardstick_s:.4f} s",
            "processor_s\tcall_s\twall_s\tmarks\tcase",
        ]
        slowest_first = sorted(self.cases.items(), key=lambda pair: -pair[1].processor_s)
        for name, case in slowest_first:
            lines.append(f"{case.processor_s:.2f}\t{case.call_s:.2f}\t{case.wall_s:.2f}\t{case.marks}\t{name}")
        return "\n".join(lines) + "\n"


if __name__ == "__main__":
    LIST.write_text(list_of(Path(sys.argv[1]).read_text(encoding="utf-8")), encoding="utf-8")
