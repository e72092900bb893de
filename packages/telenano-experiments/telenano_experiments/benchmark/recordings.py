"""The reference set of recordings: the courses of one run of each task for each law and network, as CSV with checksums.

It is made again by a command, and its checksums are the same everywhere, so that nobody has to trust a copy. A course
has a line every STEP_S, which is 40 in a period of the swing, and figures of DIGITS digits.
"""

import hashlib
import json
from pathlib import Path

from telenano_studies.loops.cells import scales_of

from telenano_experiments.benchmark.plan import VERSION, Plan, Run
from telenano_experiments.benchmark.run import course_of, rounded

STEP_S = 0.05
_COLUMNS = (
    ("time_s", "s", "Time since the start of the hand's programme"),
    ("hand_force_n", "N", "Force of the hand on the device, F_m, towards the sample"),
    ("hand_position_m", "m", "Position of the device, x_m, towards the sample"),
    ("reference_m", "m", "Reference of the device, x_mr"),
    ("rendered_force_n", "N", "Force that the law ascribes to the environment, at the hand's scale"),
    ("base_position_m", "m", "Position of the base, x_s, towards the sample"),
    ("tip_force_n", "N", "Force on the tip, F_s, repulsive positive"),
    ("hand_energy_j", "J", "What the hand has put into its device"),
    ("tip_energy_j", "J", "What the base has put into cantilever and sample"),
)


def reference_runs(plan: Plan) -> list[Run]:
    """Return the runs that are recorded: a constant force, the first seed."""
    return [
        Run(task=task, network=network, law=law, hand="force", seed=0, settings=plan.settings)
        for network in plan.networks
        for task in plan.tasks
        for law in plan.laws
    ]


def write_recordings(plan: Plan, folder: Path) -> None:
    """Write the set: a CSV a run, `columns.json` with units and scales, `SHA256SUMS` for `sha256sum -c`."""
    sums = []
    scales = {}
    for run in reference_runs(plan):
        name = f"{run.network}-{run.task}-{run.law}.csv"
        sums.append(_written(folder / name, course_text(run)))
        scales[run.law] = scales_of(run.cell.controller())._asdict()
    about = {
        "benchmark": VERSION,
        "step_s": STEP_S,
        "columns": {column: {"unit": unit, "about": text} for column, unit, text in _COLUMNS},
        "scales": scales,
    }
    sums.append(_written(folder / "columns.json", json.dumps(about, indent=2, sort_keys=True) + "\n"))
    (folder / "SHA256SUMS").write_text("".join(sums), encoding="utf-8")


def course_text(run: Run) -> str:
    """Return the course of a run as CSV, a line every STEP_S."""
    points, *_, end_s = run.programme()
    course = course_of(run, points, end_s)
    step = round(STEP_S / float(course.time_s[1] - course.time_s[0]))
    columns = [getattr(course, name)[::step].tolist() for name, _, _ in _COLUMNS]
    lines = [",".join(repr(rounded(value)) for value in row) for row in zip(*columns, strict=True)]
    return "\n".join([",".join(name for name, _, _ in _COLUMNS), *lines]) + "\n"


def _written(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8", newline="")
    return f"{hashlib.sha256(text.encode()).hexdigest()}  {path.name}\n"
