"""Statistics of repeated sessions: mean, deviation and interval of each figure over sessions that differ by seed.

The interval of a mean is Student's, that of a share Wilson's; each should contain the true value in 95 of 100
repetitions of the whole set. Sessions are repetitions if their scenarios differ in nothing but their seeds.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from telenano.analysis import half_width, wilson
from telenano.settings import flatten

CONFIDENCE = 0.95
HELD = "stable"
_NAMES = ("name", "description")
# The storage and display of a session do not change it.
_SECTIONS = ("recorder", "viz_node")


class Statistic(NamedTuple):
    """The number of values, their mean, standard deviation (n - 1), and the interval of the mean.

    Its text is `mean ± deviation [low, high]`, for a share without the deviation.
    """

    n: int
    mean: float
    deviation: float | None
    low: float | None
    high: float | None

    def __str__(self) -> str:
        spread = "" if self.deviation is None else f" ± {self.deviation:.2g}"
        between = "" if self.low is None or self.high is None else f" [{self.low:.3g}, {self.high:.3g}]"
        return f"{self.mean:.3g}{spread}{between}"


def statistic(values: Sequence[float]) -> Statistic:
    """Return the statistic of one or more numbers; a single number has neither deviation nor interval."""
    n, mean = len(values), math.fsum(values) / len(values)
    if n < 2:
        return Statistic(n, mean, None, None, None)
    deviation = math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (n - 1))
    half = half_width(deviation, n, CONFIDENCE)
    return Statistic(n, mean, deviation, mean - half, mean + half)


def share(count: int, of: int) -> Statistic:
    """Return the statistic of a share, 0 <= count <= of, of > 0; it has no deviation."""
    return Statistic(of, count / of, None, *wilson(count, of))


class Held(NamedTuple):
    """The number of runs, of those that were held, and the interval of their share [1]."""

    runs: int
    held: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """The share of the runs that were held [1]; 0 of none."""
        return self.held / self.runs if self.runs else 0.0


def held_of(verdicts: Iterable[str]) -> Held:
    """Return how many of the runs with these verdicts were held, which is the share that every table states.

    A run is held if it came to rest at the intended force without being struck. One that no verdict describes, because
    a guard ended it or its data decide nothing, was run and not held: left out, it would make a law look safer where
    its runs end early.
    """
    known = list(verdicts)
    held = sum(verdict == HELD for verdict in known)
    return Held(len(known), held, *wilson(held, len(known)))


def conditions_of(scenario: Mapping[str, Any]) -> dict[str, Any]:
    """Return the dotted keys of a scenario in which experiments differ: without names, seeds, recorder and viewer."""
    return {
        key: value
        for key, value in flatten(scenario).items()
        if key not in _NAMES and key.partition(".")[0] not in _SECTIONS and key.rpartition(".")[2] != "seed"
    }


def repetitions(scenarios: Sequence[Mapping[str, Any]]) -> list[list[int]]:
    """Return the places of scenarios that differ only in their seeds, in groups, in the given order."""
    groups: dict[str, list[int]] = {}
    for place, scenario in enumerate(scenarios):
        groups.setdefault(json.dumps(conditions_of(scenario), sort_keys=True, default=str), []).append(place)
    return list(groups.values())


def statistics_of(rows: Sequence[Mapping[str, Any]], scenarios: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each figure of each group of repetitions; none if no session was repeated.

    Args:
        rows: The rows of the sessions: their numbers are figures, and `verdict` is counted.
        scenarios: The scenario of each session.

    Returns:
        Rows with the keys that distinguish the groups, `figure`, and the members of a `Statistic`.
    """
    groups = repetitions(scenarios)
    if all(len(group) < 2 for group in groups):
        return []
    known = [conditions_of(scenarios[group[0]]) for group in groups]
    keys = dict.fromkeys(key for conditions_of_group in known for key in conditions_of_group)
    distinct = [key for key in keys if len({str(conditions_of_group.get(key)) for conditions_of_group in known}) > 1]
    conditions_of_group = []
    for group, conditions in zip(groups, known, strict=True):
        named = {key: conditions.get(key) for key in distinct}
        members = [rows[place] for place in group]
        held = held_of(row["verdict"] for row in members)
        told = share(held.held, held.runs)._asdict()
        conditions_of_group.append({**named, "figure": "share that is stable", **told})
        for figure in members[0]:
            values = [row[figure] for row in members if _is_number(row[figure])]
            if values:
                conditions_of_group.append({**named, "figure": figure, **statistic(values)._asdict()})
    return conditions_of_group


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
