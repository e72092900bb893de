"""Campaigns of schedules: each is run, reported, judged and counted.

result = tried(Schedule.drawn(7))
result.breaks
"""

import itertools
import json
import math
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import outside_judge
import reached
import told_and_counted
from fault_schedule import RATES_HZ, Schedule
from faulty_rig import run
from outside_judge import Break
from processor_time import without_collector

from telenano.api import RecordedSession
from telenano.recording.session_folder import SessionFolder
from telenano.wire.errors import TelenanoError

# The report is made for one schedule in so many, because it takes nearly half as long as the simulation.
REPORTED_EACH = 2
# Processor time of a night of twelve hours on two processors [h].
NIGHT_H = 24.0
# Number of times that a night has to reach each situation.
OFTEN = 100


# Invariants that the judge checks; each is a row of README.md in this folder.
INVARIANTS = (
    "nothing_late", "stop_is_last", "safe_in_time", "felt_hand", "recorded_as_sent", "law_not_blamed",
    "praised_was_held", "energy_granted", "delivered_was_sent", "counters_agree", "stop_kept", "goes_on",
    "within_bounds", "states_are_true", "place_of_mode", "force_limited", "as_commanded",
)  # fmt: skip


class Tried(NamedTuple):
    """Result of a schedule: broken invariants, situations reached, simulated and processor time [s], if reported."""

    schedule: Schedule
    breaks: tuple[Break, ...]
    situations: frozenset[str]
    simulated_s: float
    processor_s: float
    reported: bool


@contextmanager
def session_folder() -> Iterator[Path]:
    """Yield a folder for the files of a session, in memory if the machine has /dev/shm."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(prefix="simulation-", dir=memory if memory.is_dir() else None) as folder:
        yield Path(folder) / "session"


def tried(schedule: Schedule, *, reports: bool = True) -> Tried:
    """Run a schedule and judge its files; with `reports`, also the report on it."""
    begun_s, failing = time.process_time(), ("goes_on", "the launcher")
    with session_folder() as folder:
        try:
            run(schedule, folder)
            failing = "judged", "the report or the judge"
            report(folder, is_made=reports)
            # Tens of thousands of records are made here that are kept, so a collection finds nothing.
            with without_collector():
                session = outside_judge.Session(folder)
                breaks = outside_judge.judged(session)
                # For half of the schedules as well, because it takes as long as reading the files once more.
                breaks += [Break("recorded_as_sent", 0.0, text) for text in untold(folder)] if reports else []
                situations = reached.situations(session)
        except Exception as error:  # noqa: BLE001
            # A failed launcher means that the rig does not go on, whatever the error. A failed judge finds no fault.
            found = (Break(failing[0], 0.0, f"{failing[1]} has failed: {type(error).__name__}: {error}"),)
            return Tried(schedule, found, frozenset(), 0.0, time.process_time() - begun_s, reported=False)
    return Tried(schedule, tuple(breaks), situations, session.end_s, time.process_time() - begun_s, reports)


def untold(folder: Path) -> list[str]:
    """Return what the plain libraries count otherwise than the recordings of both sites tell."""
    paths = sorted([*folder.glob("session*.mcap"), *folder.glob("far/session*.mcap")])
    return [text for path in paths for text in told_and_counted.check(path)]


def report(folder: Path, *, is_made: bool = True) -> None:
    """Write the statements of the report into verdict.json of a session; without a report, the reason for that."""
    said: dict[str, Any] = dict(kind="", reason="", start_ns=0, missing=[], holds=[], failure="no report was made")
    if is_made:
        try:
            said |= {**_report_of(folder), "failure": ""}
        except TelenanoError as error:
            said["failure"] = str(error)
    (folder / "verdict.json").write_text(json.dumps(said), encoding="utf-8")


def _report_of(folder: Path) -> dict[str, Any]:
    parts = sorted((folder / "far").glob("*.mcap"))
    files = SessionFolder(folder)
    files.note_far([path.name for path in parts])
    session = RecordedSession([files.merge(parts)] if parts else list(files.own()[0]))
    summary = session.summary
    said = {
        "kind": summary["verdict"],
        "reason": summary["reason"],
        "start_ns": session.start_ns,
        "holds": summary["holds"],
    }
    return {**said, "missing": summary["recording"]["missing"]}


class Tally(NamedTuple):
    """Counts over many schedules."""

    schedules: list[Tried]

    @property
    def simulated_h(self) -> float:
        return sum(one.simulated_s for one in self.schedules) / 3600.0

    @property
    def processor_h(self) -> float:
        return sum(one.processor_s for one in self.schedules) / 3600.0

    def broken(self) -> Counter[str]:
        return Counter(found.invariant for one in self.schedules for found in one.breaks)

    def reached(self) -> Counter[str]:
        return Counter(name for one in self.schedules for name in one.situations)

    def nightly(self, count: int) -> float:
        """Return the count that a night would have at this rate."""
        return count * NIGHT_H / max(self.processor_h, 1e-9)

    def rare(self) -> list[str]:
        """Return the situations that a night would reach less than `OFTEN` times."""
        counts = self.reached()
        return [name for name in reached.SITUATIONS if self.nightly(counts[name]) < OFTEN]


def campaign(
    first_seed: int,
    hours: float,
    *,
    processor_s: float = math.inf,
    processes: str | None = None,
) -> Iterator[Tried]:
    """Yield the results of successive seeds until a number of simulated hours, or a processor time [s] if given.

    processes: those of the loop; those that each seed draws if none are given.
    """
    simulated_s, begun_s = 0.0, time.process_time()
    for seed in itertools.count(first_seed):
        if simulated_s >= 3600.0 * hours or time.process_time() - begun_s >= processor_s:
            return
        one = tried(Schedule.drawn(seed, processes), reports=seed % REPORTED_EACH == 0)
        simulated_s += one.simulated_s
        yield one


def speed(tally: Tally) -> str:
    """Return a sentence on the speed of a campaign."""
    rate = tally.simulated_h / max(tally.processor_h, 1e-9)
    return (
        f"{len(tally.schedules)} schedules, {tally.simulated_h:.3f} simulated hours at {min(RATES_HZ):g} to "
        f"{max(RATES_HZ):g} Hz in {tally.processor_h:.3f} hours of one processor: {rate:.2f} simulated hours an hour"
    )


def keep(schedule: Schedule, folder: Path) -> None:
    """Run a schedule again, and leave its files in a folder, which is replaced."""
    shutil.rmtree(folder, ignore_errors=True)
    run(schedule, folder)
    report(folder)
