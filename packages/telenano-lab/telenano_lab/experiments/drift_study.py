"""The effect of a drift in z on the laws: a constant drift, and one that wanders with a time constant, as from heat.

Each run is the task `track` of the benchmark (press a spring of 20 N/m with 1 N, hold, follow 0.3 N at 0.5 Hz) on an
instrument that is ideal except for its drift, so that differences are due to the drift.
"""

import hashlib
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from pydantic import Field

from telenano_lab.experiments.benchmark.plan import Run
from telenano_lab.experiments.benchmark.run import Outcome
from telenano_lab.experiments.benchmark.run import run as run_of_benchmark
from telenano_lab.studies.loops.cells import Cell
from telenano_lab.studies.loops.sweep import Kind

TASK = "track"


class DriftRun(Run):
    """A run of the task on an instrument that drifts: its speed, and the speed and time constant of its wander."""

    speed_m_per_s: float = Field(0.0, ge=-1e-6, le=1e-6)
    wander_m_per_s: float = Field(0.0, ge=0.0, le=1e-6)
    wander_s: float = Field(60.0, gt=0.0)

    @property
    def key(self) -> str:
        """A digest of the run and of every source that its outcome depends on."""
        return hashlib.sha256(f"drift {super().key}".encode()).hexdigest()[:24]

    @property
    def cell(self) -> Cell:
        """The cell of the loop, with the drift."""
        drifts = self.speed_m_per_s != 0.0 or self.wander_m_per_s > 0.0
        disturbances: tuple[tuple[str, Any], ...] = (
            ("drift.enabled", True),
            ("drift.speed_m_per_s", self.speed_m_per_s),
            ("drift.wander_m_per_s", self.wander_m_per_s),
            ("drift.wander_s", self.wander_s),
        )
        return super().cell.model_copy(update={"disturbances": disturbances if drifts else ()})


class DriftRow(NamedTuple):
    """A law under a drift: runs, stable runs, ratio of felt to true stiffness, and the parting of hand and tip.

    felt, felt_least, felt_most: median, least and greatest ratio of the stable runs, None without one. parted_mm:
    median of the absolute change of the distance of hand and tip from mid-hold to the end; parted_most_mm: the
    greatest.
    """

    law: str
    drift: str
    speed_pm_per_s: float
    wander_s: float | None
    runs: int
    stable: int
    felt: float | None
    felt_least: float | None
    felt_most: float | None
    parted_mm: float | None
    parted_most_mm: float | None


def runs_of(
    laws: Sequence[str], network: str, speeds_pm_per_s: Sequence[float], times_s: Sequence[float], seeds: int
) -> list[DriftRun]:
    """Return the runs: without drift, with a constant one to and from the sample, and with a wandering one."""
    made = []
    for law in laws:
        same: dict[str, Any] = {"task": TASK, "network": network, "law": law, "hand": "force"}
        made.append(DriftRun(**same, seed=0))
        for speed in speeds_pm_per_s:
            made += [DriftRun(**same, seed=0, speed_m_per_s=sign * 1e-12 * speed) for sign in (1.0, -1.0)]
            made += [
                DriftRun(**same, seed=seed, wander_m_per_s=1e-12 * speed, wander_s=time)
                for time in times_s
                for seed in range(seeds)
            ]
    return made


def rows_of(outcomes: Sequence[Outcome]) -> list[DriftRow]:
    """Return a row for each law and drift, in the order of the runs."""
    groups: dict[tuple[str, str, float, float | None], list[Outcome]] = {}
    for one in outcomes:
        run = one.cell
        assert isinstance(run, DriftRun)
        drift: tuple[str, float, float | None]
        if run.wander_m_per_s:
            drift = "wanders", 1e12 * run.wander_m_per_s, run.wander_s
        elif run.speed_m_per_s:
            drift = ("to the sample" if run.speed_m_per_s > 0.0 else "from it"), 1e12 * abs(run.speed_m_per_s), None
        else:
            drift = "none", 0.0, None
        groups.setdefault((run.law, *drift), []).append(one)
    return [_row(key, group) for key, group in groups.items()]


def _row(key: tuple[str, str, float, float | None], group: Sequence[Outcome]) -> DriftRow:
    stable = [one for one in group if one.verdict == "stable"]
    felt = sorted(value for one in stable if (value := one.measures["stiffness_ratio"]) is not None)
    parted = sorted(abs(value) for one in stable if (value := one.measures["parted_mm"]) is not None)
    law, drift, speed, time = key
    return DriftRow(
        law, drift, round(speed, 9), time, len(group), len(stable), _median(felt), felt[0] if felt else None,
        felt[-1] if felt else None, _median(parted), parted[-1] if parted else None,
    )  # fmt: skip


def _median(ordered: Sequence[float]) -> float | None:
    if not ordered:
        return None
    middle = len(ordered) // 2
    return ordered[middle] if len(ordered) % 2 else math.fsum(ordered[middle - 1 : middle + 1]) / 2.0


def _check(run: DriftRun) -> None:
    run.cell.controller()
    run.link.model_dump()


def _doubts(run: DriftRun) -> str:
    return ""


def _outcome_from(data: dict[str, Any]) -> Outcome:
    cell = data["cell"]
    settings = tuple((key, value) for key, value in cell["settings"])
    return Outcome(DriftRun(**{**cell, "settings": settings}), data["verdict"], data["reason"], dict(data["measures"]))


DRIFT_RUNS = Kind(_check, run_of_benchmark, _outcome_from, _doubts, batch=12)
