"""Repeat kept runs of the benchmark, and compare their outcomes with the kept ones."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from telenano.wire import ConfigError, known_names
from telenano_lab.experiments.benchmark.kept import Kept, chosen, differences
from telenano_lab.experiments.benchmark.run import Outcome
from telenano_lab.studies.repetitions import held_of

CELL_HEAD = ("run", "verdict kept", "verdict now", "tracking error kept", "now", "least energy kept [mJ]", "now [mJ]",
             "differs in")  # fmt: skip
# More runs than this amount to the whole benchmark rather than a cell.
_MOST_RUNS = 2000


def named_runs(
    table: Kept, wanted: Mapping[str, Sequence[Any]], options: Mapping[str, str], draw: int | None, draw_seed: int
) -> list[Outcome]:
    """Return the selected kept runs, in the order of the table.

    Args:
        table: The kept runs.
        wanted: Allowed values by field of a run; an empty list allows any.
        options: The command-line option of each field, for errors.
        draw: Number of runs to draw from them; None for all.
        draw_seed: The seed of the draw.

    Raises:
        ConfigError: Nothing is selected, a value is in no kept run, no kept run has all of them, or they are too many.
    """
    outcomes = list(table.outcomes.values())
    if draw is None and not any(wanted.values()):
        raise ConfigError(f"name a cell by {', '.join(options.values())}, or draw runs by --draw N")
    for name, some in wanted.items():
        known = sorted({getattr(outcome.cell, name) for outcome in outcomes})
        for value in some:
            if value not in known:
                names = known_names(str(value), map(str, known))
                raise ConfigError(f"{options[name]} {value}: no kept run of the benchmark has it; {names}")
    found = chosen(outcomes, **wanted)
    if not found:
        raise ConfigError("no kept run of the benchmark matches all options: leave one out")
    if draw is not None and draw < len(found):
        taken = np.random.default_rng(draw_seed).choice(len(found), draw, replace=False)
        found = [found[number] for number in sorted(taken.tolist())]
    if len(found) > _MOST_RUNS:
        raise ConfigError(f"these are {len(found)} runs: name a smaller cell, draw some by --draw N, or run all of them"
                          " by `telenano benchmark`")  # fmt: skip
    return found


def compared(before: Sequence[Outcome], again: Sequence[Outcome], digest: str) -> tuple[dict[str, Any], list[Any]]:
    """Return the comparison of repeated with kept runs, as JSON and as the rows of a table.

    Args:
        before: The kept runs.
        again: The same runs, repeated.
        digest: The digest of the kept runs.
    """
    records, rows = [], []
    for kept, now in zip(before, again, strict=True):
        differing = differences(kept, now)
        cell = kept.cell
        names = (cell.instrument, cell.steadiness, cell.network, cell.task, cell.law, cell.hand, str(cell.seed))
        records.append({
            "run": cell.model_dump(mode="json"),
            "kept": {"verdict": kept.verdict, **kept.measures},
            "now": {"verdict": now.verdict, "reason": now.reason, **now.measures},
            "differs_in": [one.what for one in differing],
        })  # fmt: skip
        figures = (one.measures[name] for name in ("tracking_error", "least_energy_mj") for one in (kept, now))
        rows.append((
            " ".join(names), kept.verdict, now.verdict, *figures, ", ".join(one.what for one in differing) or "nothing"
        ))  # fmt: skip
    different = sum(bool(record["differs_in"]) for record in records)
    summary = {
        "study": "benchmark cell",
        "digest": digest,
        "runs": len(before),
        "different": different,
        "held_kept": held_of(one.verdict for one in before).held,
        "held_now": held_of(one.verdict for one in again).held,
        "rows": records,
    }
    return summary, rows
