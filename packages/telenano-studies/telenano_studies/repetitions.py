"""What repeated sessions have in common: the statistic of each figure over those that differ by their seeds alone.

Sessions are repetitions where their scenarios are the same but for their seeds.
"""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from analysis.statistics import share, statistic
from services.runtime.settings.config import flatten

_NAMES = ("name", "description")
# Where a session is kept and shown does not change it.
_SECTIONS = ("recorder", "viz_node")


def conditions_of(scenario: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a scenario, with dots, in which experiments differ: no names, no seeds, no place of files."""
    return {
        key: value
        for key, value in flatten(scenario).items()
        if key not in _NAMES and key.partition(".")[0] not in _SECTIONS and key.rpartition(".")[2] != "seed"
    }


def repetitions(scenarios: Sequence[Mapping[str, Any]]) -> list[list[int]]:
    """Return the places of the scenarios that are the same but for their seeds, together, in the order given."""
    groups: dict[str, list[int]] = {}
    for place, scenario in enumerate(scenarios):
        groups.setdefault(json.dumps(conditions_of(scenario), sort_keys=True, default=str), []).append(place)
    return list(groups.values())


def statistics_of(rows: Sequence[Mapping[str, Any]], scenarios: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each figure of each group of repetitions; nothing where no session was repeated.

    Args:
        rows: The rows of the sessions: numbers are figures, and `verdict` is counted.
        scenarios: The scenario of each session.

    Returns:
        Rows of what distinguishes the groups, `figure`, and the members of a `Statistic`.
    """
    groups = repetitions(scenarios)
    if all(len(group) < 2 for group in groups):
        return []
    known = [conditions_of(scenarios[group[0]]) for group in groups]
    keys = dict.fromkeys(key for found in known for key in found)
    distinct = [key for key in keys if len({str(found.get(key)) for found in known}) > 1]
    found = []
    for group, conditions in zip(groups, known, strict=True):
        named = {key: conditions.get(key) for key in distinct}
        members = [rows[place] for place in group]
        stable = sum(row["verdict"] == "stable" for row in members)
        found.append({**named, "figure": "share that is stable", **share(stable, len(members))._asdict()})
        for figure in members[0]:
            values = [row[figure] for row in members if _is_number(row[figure])]
            if values:
                found.append({**named, "figure": figure, **statistic(values)._asdict()})
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
