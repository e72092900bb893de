"""The tidy table of an experiment, with a row per attempt at a trial and a data dictionary, made from its journal.

Every table is made anew from the journal, so an erased participant appears in none.
"""

import csv
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from telenano.files import atomic_file
from telenano.wire import ConfigError

Row = dict[str, Any]
Describe = Callable[[str], Mapping[str, tuple[str, str]]]

# Prefixes of the columns of factors and of answers.
CONDITION = "condition."
ANSWER = "answer."
# Names of the tables.
TRIALS = "trials"
QUESTIONNAIRES = "questionnaires"
# Columns of every table of trials: unit and description.
FIXED = {
    "participant": ("", "Pseudonym of the participant"),
    "session": ("", "Visit of the participant, from 1"),
    "block": ("", "Block in the session, from 0; practice is a block of its own"),
    "trial": ("", "Number of the trial over all of the participant's sessions, from 0"),
    "attempt": ("", "Attempt at this trial, from 0; a disturbed one is repeated by the rule of the experiment"),
    "phase": ("", "Whether the trial was practice or counts"),
    "task": ("", "Task"),
    "seed": ("", "Seed of the trial"),
    "status": ("", "What became of the attempt; only what is done counts"),
    "disturbance": ("", "What the truth of the link cannot explain; empty where nothing disturbed the attempt"),
    "excluded": ("", "Why the participant does not count; empty for one who does"),
    "started_utc": ("", "Beginning of the attempt, ISO 8601, UTC"),
    "duration_s": ("s", "Duration of the attempt"),
    "recording": ("", "Recording of the attempt, from the folder of the experiment; empty without one"),
}
_ASKED = {
    "participant": ("", "Pseudonym of the participant"),
    "block": ("", "Block after which it was asked"),
    "trial": ("", "Trial after which it was asked; -1 after a block"),
    "instrument": ("", "Questionnaire, such as nasa_tlx"),
    "item": ("", "Item of the questionnaire"),
    "value": ("", "Answer"),
}
_UNITS = (
    ("_n_per_m", "N/m"), ("_m_per_s", "m/s"), ("_n_s_per_m", "N s/m"), ("_percent", "%"), ("_ms", "ms"), ("_hz", "Hz"),
    ("_kg", "kg"), ("_j", "J"), ("_s", "s"), ("_n", "N"), ("_m", "m"),
)  # fmt: skip
# Levels of a column are listed if there are at most this many.
_MOST_LEVELS = 50


class DictionaryRow(NamedTuple):
    """A row of the data dictionary.

    Args:
        table: The table that the column is in.
        name: The name of the column.
        unit: Its unit, or an empty string.
        type: One of text, boolean, integer and number.
        description: Its meaning.
        levels: The values of a factor or of a categorical column; empty for others.
    """

    table: str
    name: str
    unit: str
    type: str
    description: str
    levels: tuple[Any, ...]


class Tables(NamedTuple):
    """The tables of an experiment; all rows of a table have the same columns."""

    trials: list[Row]
    questionnaires: list[Row]
    dictionary: tuple[DictionaryRow, ...]

    def unit(self, column: str) -> str:
        """Return the unit of a column of the trials, or an empty string."""
        return next((row.unit for row in self.dictionary if (row.table, row.name) == (TRIALS, column)), "")


def tidy(records: Iterable[Mapping[str, Any]], describe: Describe = lambda task: {}) -> Tables:
    """Return the tables of a journal.

    Args:
        records: The records of the journal.
        describe: Returns unit and description of each measure of a task, by its name.
    """
    kept = list(records)
    gone = {record["participant"] for record in kept if record["record"] == "erased"}
    kept = [record for record in kept if record.get("participant") not in gone]
    excluded = _excluded(kept)
    trials = [_trial(record, excluded) for record in kept if record["record"] == "trial"]
    asked = [row for record in kept if record["record"] == "asked" for row in _asked(record)]
    columns = dict(FIXED)
    for task in dict.fromkeys(row["task"] for row in trials):
        columns |= {_measure(name): about for name, about in describe(task).items()}
    dictionary = (*_dictionary(TRIALS, trials, columns), *_dictionary(QUESTIONNAIRES, asked, _ASKED))
    return Tables(_even(trials), _even(asked), dictionary)


def write_tables(tables: Tables, folder: Path) -> list[Path]:
    """Write each table as Parquet and CSV, and the dictionary as JSON and Markdown; return the paths.

    Raises:
        OSError: A file cannot be written.
    """
    written = []
    for name, rows in ((TRIALS, tables.trials), (QUESTIONNAIRES, tables.questionnaires)):
        if rows or name == TRIALS:
            described = {row.name: row for row in tables.dictionary if row.table == name}
            for write, suffix in ((_write_parquet, "parquet"), (_write_csv, "csv")):
                written.append(folder / f"{name}.{suffix}")
                with atomic_file(written[-1]) as part:
                    write(part, rows, described)
    document = [row._asdict() for row in tables.dictionary]
    for name, text in (
        ("dictionary.json", json.dumps(document, indent=2) + "\n"),
        ("dictionary.md", dictionary_page(tables)),
    ):
        written.append(folder / name)
        with atomic_file(written[-1]) as part:
            part.write_text(text, encoding="utf-8")
    return written


def read_tables(folder: Path) -> Tables:
    """Return tables that `write_tables` wrote.

    Raises:
        ConfigError: A file is missing or not of this kind; the message names the folder.
    """
    import pyarrow.parquet as pq

    try:
        document = json.loads((folder / "dictionary.json").read_text(encoding="utf-8"))
        dictionary = tuple(DictionaryRow(**{**row, "levels": tuple(row["levels"])}) for row in document)
        asked = folder / f"{QUESTIONNAIRES}.parquet"
        trials = pq.read_table(folder / f"{TRIALS}.parquet").to_pylist()
        return Tables(trials, pq.read_table(asked).to_pylist() if asked.exists() else [], dictionary)
    except (OSError, ValueError, TypeError, KeyError) as error:
        text = f"{folder}: has no tables of an experiment that can be read: {error}"
        raise ConfigError(f"{text}; `telenano experiment analyse` writes them") from error


def dictionary_page(tables: Tables) -> str:
    """Return the data dictionary as Markdown."""
    lines = ["# Data dictionary", ""]
    for table in (TRIALS, QUESTIONNAIRES):
        rows = [row for row in tables.dictionary if row.table == table]
        if not rows:
            continue
        lines += [f"## {table}", "", "| column | unit | type | description | levels |", "|---|---|---|---|---|"]
        for row in rows:
            levels = ", ".join(f"`{level}`" for level in row.levels)
            cells = (f"`{row.name}`", row.unit, row.type, row.description, levels)
            lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
        lines.append("")
    return "\n".join(lines)


def _excluded(records: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    reasons: dict[str, str] = {}
    for record in records:
        if record["record"] == "excluded":
            reasons[record["participant"]] = record.get("reason") or "no reason given"
        elif record["record"] == "included":
            reasons.pop(record["participant"], None)
    return reasons


def _trial(record: Mapping[str, Any], excluded: Mapping[str, str]) -> Row:
    row = {name: record.get("index" if name == "trial" else name) for name in FIXED}
    row["excluded"] = excluded.get(record["participant"], "")
    row |= {CONDITION + factor: _cell(level) for factor, level in record["condition"].items()}
    # A measure must not take the name of a fixed column.
    row |= {_measure(name): _cell(value) for name, value in record["measures"].items()}
    return row | {ANSWER + answer["name"]: _cell(answer["value"]) for answer in record.get("answers") or ()}


def _measure(name: str) -> str:
    return f"measure.{name}" if name in FIXED else name


def _asked(record: Mapping[str, Any]) -> list[Row]:
    shared = {"participant": record["participant"], "block": record.get("block"), "trial": record.get("trial", -1)}
    return [
        {**shared, "instrument": record["instrument"], "item": item, "value": _cell(value)}
        for item, value in record["items"].items()
    ]


def _cell(value: Any) -> Any:
    """Return a value of one cell: a sequence or a dict becomes JSON."""
    return json.dumps(value) if isinstance(value, list | tuple | dict) else value


def _even(rows: list[Row]) -> list[Row]:
    """Give all rows the same columns, with one type each: mixed values become text."""
    types = {name: _type(row.get(name) for row in rows) for name in dict.fromkeys(name for row in rows for name in row)}
    return [{name: _as(kind, row.get(name)) for name, kind in types.items()} for row in rows]


def _type(values: Iterable[Any]) -> str:
    kinds = {type(value) for value in values if value is not None}
    if kinds == {bool}:
        return "boolean"
    if kinds == {int}:
        return "integer"
    return "number" if kinds and kinds <= {int, float} else "text"


def _as(kind: str, value: Any) -> Any:
    if value is None:
        return None
    return float(value) if kind == "number" else str(value) if kind == "text" else value


def _dictionary(table: str, rows: Sequence[Row], meanings: Mapping[str, tuple[str, str]]) -> list[DictionaryRow]:
    names = dict.fromkeys(name for row in rows for name in row)
    return [_described(table, name, [row.get(name) for row in rows], meanings) for name in names]


def _described(table: str, name: str, values: Sequence[Any], meanings: Mapping[str, tuple[str, str]]) -> DictionaryRow:
    kind = _type(values)
    if name.startswith(CONDITION):
        about = _unit_of(name), f"Level of the factor {name.removeprefix(CONDITION)}"
    elif name.startswith(ANSWER):
        about = "", f"Answer to {name.removeprefix(ANSWER)}, given during the trial"
    else:
        about = meanings.get(name, (_unit_of(name), ""))
    listed = name.startswith(CONDITION) or name in ("phase", "task", "status", "instrument", "item")
    levels = sorted({_as(kind, value) for value in values if value is not None}) if listed else []
    if len(levels) > _MOST_LEVELS:
        levels = []
    return DictionaryRow(table, name, about[0], kind, about[1], tuple(levels))


def _unit_of(name: str) -> str:
    return next((unit for suffix, unit in _UNITS if name.endswith(suffix)), "")


def _write_parquet(path: Path, rows: Sequence[Row], described: Mapping[str, DictionaryRow]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    types = {"boolean": pa.bool_(), "integer": pa.int64(), "number": pa.float64(), "text": pa.string()}
    fields = [
        pa.field(name, types[row.type], metadata={"unit": row.unit, "description": row.description})
        for name, row in described.items()
    ]
    pq.write_table(pa.Table.from_pylist(list(rows), pa.schema(fields)), path)


def _write_csv(path: Path, rows: Sequence[Row], described: Mapping[str, DictionaryRow]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(described))
        writer.writeheader()
        # R and pandas both read these as truth values.
        words = {True: "TRUE", False: "FALSE"}
        writer.writerows({name: words[v] if isinstance(v, bool) else v for name, v in row.items()} for row in rows)
