"""The function `telenano.simulate_all`: many sessions side by side, and one table of their holds.

frame = simulate_all(law=["wave", "passivity"], round_trip_ms=[0.0, 20.0, 40.0], seed=range(5))
frame.groupby(["law", "round_trip_ms"])["hold_ratio"].describe()
"""

import itertools
import os
from collections.abc import Iterable, Mapping
from contextlib import closing
from typing import TYPE_CHECKING, Any, NamedTuple

from telenano.api import frame_of, rows_of_session, show_progress
from telenano.signals import in_processes
from telenano.virtual.simulate import check_arguments, simulate
from telenano.wire.errors import ConfigError, TelenanoError

if TYPE_CHECKING:
    import pandas


class _Rows(NamedTuple):
    """The rows of a session, and the error of one that could not be simulated."""

    rows: list[dict[str, Any]]
    error: TelenanoError | None


def simulate_all(
    scenario: Any = "fig12",
    *,
    jobs: int | None = None,
    progress: bool = True,
    **arguments: Any,
) -> "pandas.DataFrame":
    """Simulate a session for each combination of arguments, some at a time, and return a table as `open_all` does.

    An argument that is a list, a tuple, a range or an array stands for its values, one in each session; others hold for
    all. A session that cannot be simulated has a row with the reason in `session_reason`; if that is every one, the
    error of the first is raised. Nothing is recorded: `telenano simulate --sweep` records many sessions.

    Args:
        scenario: As for `simulate`, or several.
        jobs: The number of sessions at a time; None for the number of processors.
        progress: Whether to show a progress bar on a terminal or in a notebook.
        **arguments: Arguments of `simulate`: law, round_trip_ms, environment, instrument, operator, duration_s,
            settings and seed.

    Returns:
        A row for each hold, in the order of the combinations, with a column for each argument that varies.

    Raises:
        ConfigError: No session can be simulated, or pandas is not installed; the message names what is wrong.
        TypeError: `simulate` has no such argument; the message names the one that was probably meant.
    """
    frame_of([])
    check_arguments(arguments)
    axes = {name: _values(value) for name, value in {"scenario": scenario, **arguments}.items()}
    varied = [name for name, values in axes.items() if len(values) > 1]
    if not all(axes.values()):
        empty = next(name for name, values in axes.items() if not values)
        raise ConfigError(f"{empty}: is an empty list: give one value, or several")
    points = [dict(zip(axes, chosen, strict=True)) for chosen in itertools.product(*axes.values())]
    found: dict[int, _Rows] = {}
    show_progress("sessions simulated", 0, len(points), progress)
    with closing(in_processes(jobs, _run, points)) as done:
        for place, rows in done:
            found[place] = rows
            show_progress("sessions simulated", len(found), len(points), progress)
    errors = [found[place].error for place in sorted(found)]
    if (first := errors[0]) is not None and all(errors):
        raise first
    return frame_of([{**_shown(points[place], varied), **row} for place in sorted(found) for row in found[place].rows])


def _values(value: Any) -> list[Any]:
    is_one = isinstance(value, (str, bytes, Mapping, os.PathLike)) or not isinstance(value, Iterable)
    return [value] if is_one else [each.item() if hasattr(each, "item") else each for each in value]


def _shown(point: Mapping[str, Any], varied: Iterable[str]) -> dict[str, Any]:
    """Return the varied arguments as columns; those of a mapping each have their own."""
    columns: dict[str, Any] = {}
    for name in varied:
        columns |= dict(point[name]) if isinstance(point[name], Mapping) else {name: point[name]}
    return columns


def _run(arguments: dict[str, Any]) -> _Rows:
    """Simulate one session in a process of the pool."""
    try:
        session = simulate(**arguments)
        return _Rows(rows_of_session(session, getattr(session, "file", "")), None)
    except TelenanoError as error:
        return _Rows([{"session_reason": str(error)}], error)
