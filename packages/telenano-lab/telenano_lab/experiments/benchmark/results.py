"""Results of the benchmark: its runs as bit-identical text, a row per case and law, and the choice of a law.

The digest is that of `runs.csv`: two results are the same if `sha256sum runs.csv` agrees. No file contains its time or
place of origin, and no figure has more than DIGITS digits.
"""

import csv
import hashlib
import io
import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

from telenano.analysis import wilson
from telenano.settings import profile_named
from telenano_lab.experiments.benchmark.plan import LINES, SAMPLES, STEADINESS, TASKS, VERSION, Plan, Run
from telenano_lab.experiments.benchmark.run import MEASURES, Outcome, rounded
from telenano_lab.studies.repetitions import HELD, held_of

# Energy below this was made by the loop, and not by rounding [mJ].
LEAST_MJ = -1e-3


class Spread(NamedTuple):
    """Median, least and greatest value of a measure over the runs that have it."""

    median: float
    least: float
    most: float


class Case(NamedTuple):
    """The common conditions of the runs of a choice: instrument, steadiness of the hand, and network."""

    instrument: str
    steadiness: str
    network: str


class Situation(NamedTuple):
    """The facts that a reader knows beforehand: kind of line, instrument and sample; it includes all hands."""

    line: str
    instrument: str
    sample: str


Of = TypeVar("Of", bound=Case | Situation)


class Row(NamedTuple, Generic[Of]):
    """The runs of a law in a case or a situation.

    held: number of runs held; low, high: interval of their share; made_energy: runs in which the loop made energy;
    sound: runs held without it; measures: over the runs held.
    """

    case: Of
    law: str
    runs: int
    held: int
    low: float
    high: float
    made_energy: int
    sound: int
    verdicts: dict[str, int]
    measures: dict[str, Spread | None]

    @property
    def share(self) -> float:
        """The share of the runs that were held."""
        return self.held / self.runs

    def price(self) -> tuple[float, float]:
        """Return the sort key of a law: greatest share of runs held first, then the least tracking error."""
        spread = self.measures["tracking_error"]
        return -self.share, math.inf if spread is None else spread.median

    def as_dict(self) -> dict[str, Any]:
        """Return the row as plain data."""
        spreads = {name: None if spread is None else spread._asdict() for name, spread in self.measures.items()}
        interval = {"low": rounded(self.low), "high": rounded(self.high)}
        own = {key: value for key, value in self._asdict().items() if key != "case"}
        return {**self.case._asdict(), **own, **interval, "share": rounded(self.share), "measures": spreads}


def rows_of(outcomes: Sequence[Outcome]) -> list[Row[Case]]:
    """Return a row for each case and law, in the order of the runs."""
    return _rows(outcomes, lambda cell: Case(cell.instrument, cell.steadiness, cell.network))


class Standing(NamedTuple):
    """A law among those of a situation.

    It is behind if its share of runs held without making energy cannot by chance be the greatest: the 95 % interval of
    that share ends below the interval that begins highest, that of the best law.
    """

    row: Row[Situation]
    best: Row[Situation]
    is_behind: bool


def standings_of(outcomes: Iterable[Outcome]) -> dict[Situation, list[Standing]]:
    """Return the laws in each situation, the recommended one first; all advice follows this rule.

    The recommended law has the least tracking error among those that are not behind; those behind follow by their
    share. Networks that represent no kind of line are left out.
    """
    lines = {network: line for line, networks in LINES.items() for network in networks}
    samples = {task: sample for sample, tasks in SAMPLES.items() for task in tasks}
    placed = [outcome for outcome in outcomes if outcome.cell.network in lines]
    rows = _rows(placed, lambda cell: Situation(lines[cell.network], cell.instrument, samples[cell.task]))
    situations: dict[Situation, list[Row[Situation]]] = {}
    for row in rows:
        situations.setdefault(row.case, []).append(row)
    return {situation: _standings(some) for situation, some in situations.items()}


def situations_of(outcomes: Iterable[Outcome]) -> dict[Situation, list[Row[Situation]]]:
    """Return the rows of the laws in each situation, in the order of `standings_of`."""
    return {situation: [one.row for one in some] for situation, some in standings_of(outcomes).items()}


def _standings(rows: Sequence[Row[Situation]]) -> list[Standing]:
    intervals = {row.law: wilson(row.sound, row.runs) for row in rows}
    best = max(rows, key=lambda row: intervals[row.law][0])
    standings = [Standing(row, best, intervals[row.law][1] < intervals[best.law][0]) for row in rows]

    def order(one: Standing) -> tuple[bool, float, float, str]:
        row = one.row
        # Laws that are behind are ordered by their share, the others by the tracking error alone.
        return one.is_behind, -row.sound / row.runs if one.is_behind else 0.0, row.price()[1], row.law

    return sorted(standings, key=order)


def _rows(outcomes: Sequence[Outcome], case_of: Callable[[Run], Of]) -> list[Row[Of]]:
    grouped: dict[tuple[Of, str], list[Outcome]] = {}
    for outcome in outcomes:
        grouped.setdefault((case_of(outcome.cell), outcome.cell.law), []).append(outcome)
    return [_row(case, law, some) for (case, law), some in grouped.items()]


def _row(case: Of, law: str, some: Sequence[Outcome]) -> Row[Of]:
    verdicts: dict[str, int] = {}
    for outcome in some:
        verdicts[outcome.verdict] = verdicts.get(outcome.verdict, 0) + 1
    held = [outcome for outcome in some if outcome.verdict == HELD]
    _, _, low, high = held_of(outcome.verdict for outcome in some)
    made = sum(map(_made_energy, some))
    sound = sum(not _made_energy(outcome) for outcome in held)
    # Measures of runs that were not held are meaningless: force and position have not settled.
    measures = {name: spread_of(held, name) for name in MEASURES}
    return Row(case, law, len(some), len(held), low, high, made, sound, dict(sorted(verdicts.items())), measures)


def _made_energy(outcome: Outcome) -> bool:
    return makes_energy(outcome.measures["least_energy_mj"])


def makes_energy(least_energy_mj: float | None) -> bool:
    """Return whether the loop of a run generated energy beyond rounding; None is a run without that measure."""
    return (least_energy_mj or 0.0) < LEAST_MJ


def spread_of(some: Sequence[Outcome], measure: str) -> Spread | None:
    """Return the spread of a measure; None if no run has it."""
    values = [value for outcome in some if (value := outcome.measures[measure]) is not None]
    return Spread(statistics.median(values), min(values), max(values)) if values else None


def choices(rows: Sequence[Row[Case]]) -> dict[Case, list[Row[Case]]]:
    """Return the laws in each case, the recommended one first."""
    by_case: dict[Case, list[Row[Case]]] = {}
    for row in rows:
        by_case.setdefault(row.case, []).append(row)
    return {case: sorted(some, key=lambda row: (row.price(), row.law)) for case, some in by_case.items()}


def runs_text(outcomes: Sequence[Outcome]) -> str:
    """Return the runs as CSV in a fixed order: a line per run, with its verdict and measures."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    condition = ("instrument", "steadiness", "network", "task", "law", "hand", "seed", "settings")
    out.writerow(("benchmark", *condition, "verdict", *MEASURES))
    for outcome in sorted(outcomes, key=lambda outcome: outcome.cell.sort_key):
        cell = outcome.cell
        changed = " ".join(f"{key}={value}" for key, value in cell.settings)
        figures = ["" if value is None else repr(value) for value in outcome.measures.values()]
        where = (cell.instrument, cell.steadiness, cell.network, cell.task, cell.law, cell.hand, cell.seed, changed)
        out.writerow((VERSION, *where, outcome.verdict, *figures))
    return text.getvalue()


def digest_of(text: str) -> str:
    """Return the SHA-256 of a text, as `sha256sum` prints it."""
    return hashlib.sha256(text.encode()).hexdigest()


def summary_of(
    plan: Plan,
    outcomes: Sequence[Outcome],
    rows: Sequence[Row[Case]],
    situations: Mapping[Situation, Sequence[Row[Situation]]],
) -> dict[str, Any]:
    """Return the contents of `benchmark.json`, which --json also prints."""
    return {
        "study": "benchmark",
        "version": VERSION,
        "digest": digest_of(runs_text(outcomes)),
        "runs": len(outcomes),
        "laws": list(plan.laws),
        "settings": {key: value for key, value in plan.settings},
        "hands": list(plan.hands),
        "instruments": list(plan.instruments),
        "steadiness": {name: STEADINESS[name] for name in plan.steadiness},
        "seeds": plan.seeds,
        "tasks": {name: TASKS[name].about for name in plan.tasks},
        "networks": {
            name: {"about": profile_named(name).about, "round_trip_ms": rounded(profile_named(name).round_trip_ms)}
            for name in plan.networks
        },
        "measures": {name: measure._asdict() for name, measure in MEASURES.items()},
        "take": [
            {**case._asdict(), "law": some[0].law if some[0].held else None} for case, some in choices(rows).items()
        ],
        "recommended": [
            {**situation._asdict(), "laws": [row.law for row in some if row.held]}
            for situation, some in situations.items()
        ],
        "rows": [row.as_dict() for row in rows],
    }
