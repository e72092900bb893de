"""The conditions that each law was shown to hold, computed from the benchmark: the table by which a running rig warns.

    python -m telenano_lab.experiments.benchmark.shown out/benchmark/runs.csv \
        packages/telenano-lab/telenano_lab/experiments/benchmark/shown.json

A cell is a law over a network on a sample with an instrument; its runs are those of all hands. A run that the
instrument's guard ended before its judged part was not held; how many these are is counted as well.

The loop is closed by the newest message, so a line is described by its effect on a law: by the age of the hand's sample
to which the newest answer responds, which `law/status` of a running rig reports by the same definition. A sample is
described by the slope of force over base, which is less than the cantilever's stiffness if a soft contact is in series.
"""

import csv
import io
import json
import statistics
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from telenano.lockstep import Schedule
from telenano.settings import LinkSettings
from telenano_lab.experiments.benchmark.plan import SEEDS, TASKS, VERSION, Run, is_random
from telenano_lab.experiments.benchmark.results import digest_of
from telenano_lab.experiments.benchmark.run import course_of
from telenano_lab.studies.option_values import disturbances_of
from telenano_lab.studies.repetitions import HELD, held_of

# Duration of a line's simulation for each seed of the benchmark [s].
_LINE_S = 20.0
# Ages within this time after the beginning are ignored [s].
_BEGINNING_S = 3.0
# The period of the loop.
_PERIOD_S = 1e-3
# Unevenness is the distance of this quantile of the ages from their median.
UNEVEN_SHARE = 0.95
_GUARDED = "guarded"
_COLUMNS = ("network", "stiffness_n_per_m", "drift_pm_per_s", "runs", "held", "low", "high", "guarded")
_ABOUT = (
    "Made by `python -m telenano_lab.experiments.benchmark.shown RUNS.CSV SHOWN.JSON`; digest is that of runs.csv. "
    "A line has the mean age of the sample that the newest answer descends from, and by how much 95 % of these "
    "ages are at most above their median [ms]. The stiffness is the slope of force over base. low and high are the "
    "95 % interval of the share held (Wilson); guarded runs are those of them that the instrument's guard ended before "
    "the law was judged."
)


class _Row(NamedTuple):
    network: str
    stiffness_n_per_m: float
    drift_pm_per_s: float
    runs: int
    held: int
    low: float
    high: float
    guarded: int


def shown_of(runs_csv: str) -> dict[str, Any]:
    """Compute the table from the text of `runs.csv`.

    Raises:
        ValueError: The text is not that of this version of the benchmark, or the settings of a law were changed.
    """
    rows = list(csv.DictReader(io.StringIO(runs_csv)))
    wanted = {"benchmark", "instrument", "network", "task", "law", "settings", "verdict", "tracking_error"}
    if not rows or not wanted <= rows[0].keys():
        raise ValueError(f"not the runs of a benchmark: the first line must name {', '.join(sorted(wanted))}")
    if {row["benchmark"] for row in rows} != {str(VERSION)}:
        raise ValueError(f"runs of benchmark {rows[0]['benchmark']}, and this is benchmark {VERSION}")
    if any(row["settings"] for row in rows):
        raise ValueError("runs with changed settings of a law: what is shown is that of the laws as they come")
    laws = list(dict.fromkeys(sorted(row["law"] for row in rows)))
    return {
        "about": _ABOUT,
        "benchmark": VERSION,
        "digest": digest_of(runs_csv),
        "lines": {name: line_of(name) for name in sorted({row["network"] for row in rows})},
        "columns": list(_COLUMNS),
        "laws": {law: _law_of([row for row in rows if row["law"] == law]) for law in laws},
    }


def text_of(shown: Mapping[str, Any]) -> str:
    """Return the table as JSON with a line per cell."""
    laws = [
        f"    {json.dumps(law)}: {{\n"
        f'      "tracking_error": {json.dumps(places["tracking_error"])},\n      "cells": [\n'
        + ",\n".join(f"        {json.dumps(cell)}" for cell in places["cells"])
        + "\n      ]\n    }"
        for law, places in shown["laws"].items()
    ]
    head = {key: value for key, value in shown.items() if key != "laws"}
    return json.dumps(head, indent=1)[:-2] + ',\n "laws": {\n' + ",\n".join(laws) + "\n }\n}\n"


@cache
def line_of(network: str) -> dict[str, float]:
    """Return mean age and unevenness [ms] of a loop over a network, over the benchmark's seeds."""
    pooled = np.concatenate([_ages(network, seed) for seed in range(SEEDS if is_random(network) else 1)])
    high, middle = np.quantile(pooled, (UNEVEN_SHARE, 0.5))
    return {"round_trip_ms": round(float(pooled.mean()), 1), "unevenness_ms": round(float(high - middle), 1)}


def _ages(network: str, seed: int) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the age [ms] of the hand's sample to which the newest answer responds, at each period with an answer."""
    ticks = round(_LINE_S / _PERIOD_S)
    settings = LinkSettings.of({"profile": network, "seed": seed}, f"network {network}")
    schedule = Schedule.of(settings, ticks, _PERIOD_S)
    now = np.arange(round(_BEGINNING_S / _PERIOD_S), ticks)
    newest = np.searchsorted(schedule.backward_ns, now * round(1e9 * _PERIOD_S), side="right") - 1
    return now[newest >= 0] - schedule.forward_of[schedule.backward_of[newest[newest >= 0]]]


@cache
def stiffness_of(name: str) -> float:
    """Return the slope of force over base [N/m] of a task's sample; for a contact, between its two holds."""
    task = TASKS[name]  # type: ignore[index]
    if task.environment != "tip_sample":
        return task.stiffness_n_per_m
    run = Run(task=name, network="clean", law="position_force", hand="force", seed=0)  # type: ignore[arg-type]
    points, held_s, _, end_s = run.force_profile()
    course = course_of(run, points, end_s)
    # The last corner but one ends the hold at the smaller force.
    first, last = np.searchsorted(course.time_s, (points[-2][0] - _PERIOD_S, held_s - _PERIOD_S))
    force_n, base_m = course.tip_force_n, course.base_position_m
    return round(float((force_n[last] - force_n[first]) / (base_m[last] - base_m[first])), 1)


def _law_of(rows: Sequence[Mapping[str, str]]) -> dict[str, Any]:
    grouped: dict[tuple[str, float, float], list[Mapping[str, str]]] = {}
    for row in rows:
        place = row["network"], stiffness_of(row["task"]), _drift_of(row["instrument"])
        grouped.setdefault(place, []).append(row)
    errors = [float(row["tracking_error"]) for row in rows if row["verdict"] == HELD and row["tracking_error"]]
    return {
        "tracking_error": round(statistics.median(errors), 4) if errors else None,
        "cells": [list(_row(place, some)) for place, some in sorted(grouped.items())],
    }


def _row(place: tuple[str, float, float], some: Sequence[Mapping[str, str]]) -> _Row:
    guarded = sum(row["verdict"] == _GUARDED for row in some)
    runs, held, low, high = held_of(row["verdict"] for row in some)
    return _Row(*place, runs, held, round(low, 3), round(high, 3), guarded)


@cache
def _drift_of(instrument: str) -> float:
    """Return the drift speed of a named instrument's sample [pm/s]."""
    keys = dict(disturbances_of(instrument))
    return round(1e12 * float(keys["drift.speed_m_per_s"]), 3) if keys.get("drift.enabled") else 0.0


def main(arguments: Sequence[str]) -> None:
    """Write the table of the first file to the second."""
    if len(arguments) != 2:
        raise SystemExit("usage: python -m telenano_lab.experiments.benchmark.shown RUNS.CSV SHOWN.JSON")
    source, target = map(Path, arguments)
    try:
        text = text_of(shown_of(source.read_bytes().decode()))
    except (OSError, ValueError) as error:
        raise SystemExit(f"{source}: {error}") from error
    target.write_text(text, encoding="utf-8", newline="")


if __name__ == "__main__":
    main(sys.argv[1:])
