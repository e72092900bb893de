"""The tidy table: a row for each attempt, the same as Parquet and CSV, with a dictionary, and nothing of the erased."""

import csv
import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from telenano_lab.doubles.made_journals import demo, trial
from telenano_lab.experiments.table import FIXED, read_tables, tidy, write_tables

from telenano.wire import ConfigError

UNITS = {"completion_time_s": ("s", "Completion time"), "duration_s": ("s", "Duration of the touch")}
TLX = {
    "record": "asked",
    "participant": "P01",
    "block": 0,
    "instrument": "nasa_tlx",
    "items": {"effort": 55, "frustration": 20},
}


def test_every_attempt_is_a_row_with_its_conditions_measures_and_answers() -> None:
    records = [*demo(1), TLX, {"record": "break", "duration_s": 9.0}]
    again = trial("P01", 3, {"law": "wave", "delay_ms": 0.0}, completion_time_s=None)
    again |= {
        "attempt": 1,
        "status": "disturbed",
        "disturbance": "a standstill of 40 ms",
        "answers": [{"name": "stiffer", "value": "first"}],
    }
    tables = tidy([*records, again], lambda task: UNITS)
    assert len(tables.trials) == 73
    assert {tuple(row) for row in tables.trials} == {
        (
            *FIXED,
            "condition.law",
            "condition.delay_ms",
            "completion_time_s",
            "force_error_n",
            "success",
            "answer.stiffer",
        )
    }
    last = tables.trials[-1]
    assert (last["trial"], last["attempt"], last["status"], last["completion_time_s"], last["answer.stiffer"]) == (
        3,
        1,
        "disturbed",
        None,
        "first",
    )
    assert tables.questionnaires == [
        {"participant": "P01", "block": 0, "trial": -1, "instrument": "nasa_tlx", "item": "effort", "value": 55},
        {"participant": "P01", "block": 0, "trial": -1, "instrument": "nasa_tlx", "item": "frustration", "value": 20},
    ]


def test_the_dictionary_describes_every_column_of_every_table() -> None:
    tables = tidy([*demo(1), TLX], lambda task: UNITS)
    described = {(row.table, row.name): row for row in tables.dictionary}
    assert {name for table, name in described if table == "trials"} == set(tables.trials[0])
    assert {name for table, name in described if table == "questionnaires"} == set(tables.questionnaires[0])
    delay = described["trials", "condition.delay_ms"]
    assert (delay.unit, delay.type, delay.levels) == ("ms", "number", (0.0, 40.0, 80.0))
    assert described["trials", "completion_time_s"][2:5] == ("s", "number", "Completion time")
    assert described["trials", "force_error_n"].unit == "N"
    assert described["trials", "success"].type == "boolean"
    assert all(row.description or row.name in ("force_error_n", "success") for row in tables.dictionary)


def test_a_measure_named_as_a_column_of_every_table_is_kept_apart() -> None:
    tables = tidy([trial("P01", 0, {}, duration_s=3.0)], lambda task: UNITS)
    assert (tables.trials[0]["duration_s"], tables.trials[0]["measure.duration_s"]) == (9.5, 3.0)
    about = {row.name: row.description for row in tables.dictionary}
    assert about["measure.duration_s"] == "Duration of the touch" and about["duration_s"] == FIXED["duration_s"][1]


def test_parquet_and_csv_hold_the_same_and_parquet_the_units(tmp_path: Path) -> None:
    tables = tidy([*demo(1), TLX], lambda task: UNITS)
    written = {path.name for path in write_tables(tables, tmp_path)}
    assert written == {f"{name}.{kind}" for name in ("trials", "questionnaires") for kind in ("parquet", "csv")} | {
        "dictionary.json", "dictionary.md",
    }  # fmt: skip
    parquet = pq.read_table(tmp_path / "trials.parquet")
    assert parquet.to_pylist() == tables.trials
    assert parquet.schema.field("completion_time_s").metadata[b"unit"] == b"s"
    with (tmp_path / "trials.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["completion_time_s"]) for row in rows] == [row["completion_time_s"] for row in tables.trials]
    assert [row["condition.law"] for row in rows] == [row["condition.law"] for row in tables.trials]
    # R reads these words, and no others of that meaning, as truth values.
    words = {True: "TRUE", False: "FALSE", None: ""}
    assert [row["success"] for row in rows] == [words[row["success"]] for row in tables.trials]
    assert len(json.loads((tmp_path / "dictionary.json").read_text())) == len(tables.dictionary)
    assert read_tables(tmp_path) == tables
    page = (tmp_path / "dictionary.md").read_text()
    assert "| `condition.delay_ms` | ms | number | Level of the factor delay_ms | `0.0`, `40.0`, `80.0` |" in page


def test_one_who_was_erased_is_in_no_table_and_one_excluded_is_marked() -> None:
    records = [*demo(1), TLX, {"record": "erased", "participant": "P01"}]
    records += [
        {"record": "excluded", "participant": "P02", "reason": "fell asleep"},
        {"record": "excluded", "participant": "P03", "reason": "by mistake"},
        {"record": "included", "participant": "P03"},
    ]
    tables = tidy(records)
    assert {row["participant"]: row["excluded"] for row in tables.trials} == {
        "P02": "fell asleep",
        "P03": "",
        "P04": "",
    }
    assert not tables.questionnaires and "P01" not in json.dumps(tables.trials)


def test_levels_of_several_kinds_become_text() -> None:
    tables = tidy([trial("P01", 0, {"gain": 1, "axes": [1, 2]}), trial("P01", 1, {"gain": "auto", "axes": [3]})])
    assert [(row["condition.gain"], row["condition.axes"]) for row in tables.trials] == [
        ("1", "[1, 2]"),
        ("auto", "[3]"),
    ]


def test_an_experiment_without_trials_has_empty_tables(tmp_path: Path) -> None:
    write_tables(tidy([{"record": "begun"}]), tmp_path)
    assert pq.read_table(tmp_path / "trials.parquet").num_rows == 0


def test_a_folder_without_tables_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="has no tables of an experiment that can be read"):
        read_tables(tmp_path)
    (tmp_path / "dictionary.json").write_text('[{"name": "x"}]')
    with pytest.raises(ConfigError, match="`telenano experiment analyse` writes them"):
        read_tables(tmp_path)
