"""Tables of results on a terminal."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from telenano.wire.nodes import counts_for_process
from telenano.wire.printable import one_line

# A value other than zero in these columns is a loss and is drawn red.
_ALARMING = ("missing", "lost", "damage", "skipped_bytes")
_SENTENCES = ("missing", "damage")
# A list with more keys than this is drawn with a column for each row: its cells would be narrower than a number.
_MOST_COLUMNS = 10
LEVEL_STYLES = {"info": "", "warning": "yellow", "error": "red"}
_STATE_STYLES = {"ready": "green", "running": "green", "safe": "yellow", "starting": "yellow"}


def counts_text(counts: Mapping[str, int]) -> str:
    """Return counts with their names in one line; 0 if there are none."""
    return ", ".join(f"{name} {count}" for name, count in counts.items()) or "0"


# Text of a cell whose figure is shown at another node of the same process.
_SHARED = "shared"


class Figure(NamedTuple):
    """A column of the tables of nodes.

    Attributes:
        cell: Function from the facts of a node, which `node_facts` returns, to its cell.
        is_live: Whether the table of `telenano up` has the column as well, and not only that of `telenano status`.
        is_text: Whether the cell is a text, which is aligned to the left.
    """

    cell: Callable[[Mapping[str, Any]], Text]
    is_live: bool = True
    is_text: bool = False


@cache
def figures() -> dict[str, Figure]:
    """Return the columns of the tables of nodes by their headings, from left to right.

    A figure of the process has a column if its field of node/health has a heading.
    """
    # Imported here, because most tables do not need it.
    from telenano.wire.messages import PROCESS_FIGURES

    return {
        "state": Figure(_state, is_text=True),
        "up": Figure(_time_up, is_live=False),
        "rate Hz": Figure(lambda facts: Text(f"{facts['rate_hz']:.1f}")),
        "late p99 ms": Figure(lambda facts: _in_ms(facts["lateness_p99_s"], 3)),
        "overruns": Figure(lambda facts: _alarming(facts["overruns"], str(facts["overruns"])), is_live=False),
        "input age ms": Figure(lambda facts: _in_ms(facts["oldest_input_s"], 1)),
        "lost": Figure(lambda facts: _alarming(facts["lost"], str(facts["lost"]))),
        "refused": Figure(_refused, is_text=True),
        **{heading: Figure(partial(_of_process, name)) for name, heading in PROCESS_FIGURES.items()},
        "granted": Figure(_granted, is_live=False, is_text=True),
    }


def _state(facts: Mapping[str, Any]) -> Text:
    state = "replay" if facts["replay"] else facts["state"]
    return Text(state, _STATE_STYLES.get(state, "red"))


def _time_up(facts: Mapping[str, Any]) -> Text:
    minutes, seconds = divmod(round(facts["uptime_s"]), 60)
    return Text(f"{minutes // 60}:{minutes % 60:02}:{seconds:02}")


def _in_ms(value_s: float | None, digits: int) -> Text:
    return Text("-" if value_s is None else f"{value_s * 1e3:.{digits}f}")


def _refused(facts: Mapping[str, Any]) -> Text:
    from telenano.wire.messages import SUPERSEDED

    return _alarming(len(facts["refused"].keys() - {SUPERSEDED}), counts_text(facts["refused"]))


def _of_process(name: str, facts: Mapping[str, Any]) -> Text:
    """Draw a figure of the process at one of its nodes, with its limit `most_NAME` if it has one; bytes are in MB."""
    if not counts_for_process(facts["node"], facts["shares_with"]):
        return Text(_SHARED, "dim")
    values = [facts[key] for key in (name, f"most_{name}") if facts.get(key) is not None]
    return Text(" of ".join(f"{value / 1e6 if name.endswith('_bytes') else value:.0f}" for value in values) or "-")


def _granted(facts: Mapping[str, Any]) -> Text:
    granted = [name for name, key in (("fifo", "realtime"), ("memory", "memory_locked")) if facts[key]]
    return Text(", ".join(granted) or "nothing")


def _alarming(count: int, text: str) -> Text:
    return Text(text, "red" if count else "")


def summary_tables(summary: Mapping[str, Any], title: str) -> Group:
    """Draw a summary: single values, then the values by topic side by side, then every list as a table."""
    by_topic = {
        key: value
        for key, value in summary.items()
        if isinstance(value, Mapping) and value and all("/" in name for name in value)
    }
    rest = {key: value for key, value in summary.items() if key not in by_topic}
    lists = dict(_take_lists(rest))
    parts: list[RenderableType] = [_values_table(rest, title)]
    if by_topic:
        topics = sorted({topic for values in by_topic.values() for topic in values})
        rows = [{"topic": topic} | {key: values.get(topic) for key, values in by_topic.items()} for topic in topics]
        parts.append(rows_table(rows))
    parts += [rows_table(_upright(rows), title=key) for key, rows in lists.items()]
    return Group(*parts)


def _upright(rows: Sequence[Mapping[str, Any]]) -> Sequence[Mapping[str, Any]]:
    """Return rows with many keys transposed, with a column for each row, if that makes the cells wider."""
    keys = rows[0].keys()
    if len(keys) <= _MOST_COLUMNS or len(rows) >= len(keys):
        return rows
    return [{"quantity": key} | {str(number): row.get(key) for number, row in enumerate(rows, 1)} for key in keys]


def _take_lists(tree: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Sequence[Mapping[str, Any]]]]:
    """Remove the lists of rows from a tree of values and yield them by dotted key."""
    for key, value in list(tree.items()):
        if isinstance(value, list | tuple) and value and all(isinstance(row, Mapping) for row in value):
            yield f"{prefix}{key}", tree.pop(key)
        elif isinstance(value, Mapping):
            tree[key] = dict(value)
            yield from _take_lists(tree[key], f"{prefix}{key}.")


def rows_table(rows: Sequence[Mapping[str, Any]], title: str | None = None) -> Table:
    """Draw rows that have the same keys; without rows, the title alone."""
    first = rows[0] if rows else {}
    # Cells are plain text, because the units in brackets would be taken for markup.
    table = Table(
        *(Column(Text(one_line(name))) for name in first), title=None if title is None else Text(one_line(title))
    )
    for column, name in zip(table.columns, first, strict=True):
        # Numbers are aligned to the right; in a column with a text as well they would be far from the text's beginning.
        column.justify = (
            "left" if any(isinstance(row.get(name), str | list | tuple | Mapping) for row in rows) else "right"
        )
        column.overflow = "fold"
    for row in rows:
        table.add_row(*(_value_text(value) for value in row.values()))
    return table


def _values_table(values: Mapping[str, Any], title: str) -> Table:
    table = Table("quantity", "value", title=Text(one_line(title)))
    for column in table.columns:
        column.overflow = "fold"
    for key, value in _leaves("", values):
        # Each sentence has a line of its own.
        text = (
            Text("\n".join(map(one_line, map(str, value))))
            if value and key.rpartition(".")[2] in _SENTENCES
            else _value_text(value)
        )
        if value and key.rpartition(".")[2] in _ALARMING:
            text.stylize("red")
        table.add_row(Text(one_line(key)), text)
    return table


def _leaves(prefix: str, tree: Mapping[str, Any]) -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in tree.items():
        name = f"{prefix}{key}"
        rows += _leaves(f"{name}.", value) if isinstance(value, Mapping) and value else [(name, value)]
    return rows


def _value_text(value: Any) -> Text:
    if value is None:
        return Text("-", "dim")
    if isinstance(value, bool):
        return Text("yes" if value else "no", "green" if value else "red")
    if isinstance(value, list | tuple):
        return Text(", ".join(map(_plain, value)) or "-")
    return Text(_plain(value))


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        # Some rows, such as those of holds, have a text for people.
        return one_line(str(value.get("text") or counts_text(value)))
    # Adding 0.0 turns -0 into 0.
    return f"{value + 0.0:.6g}" if isinstance(value, float) else one_line(str(value))
