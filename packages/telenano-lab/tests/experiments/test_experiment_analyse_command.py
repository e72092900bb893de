"""`telenano experiment analyse` as a user calls it, on the folder of an experiment."""

import csv
import json
import random
import shutil
from pathlib import Path
from typing import Any

import pytest
from telenano_lab.doubles.made_journals import LAWS, demo, trial
from telenano_lab.experiments.analyse import Choice, analyse
from telenano_lab.experiments.plans import find_experiment
from telenano_lab.experiments.table import tidy

from telenano.testing import invoke

pytest.importorskip("statsmodels")


BEGUN = {"record": "begun", "utc": "2026-11-22T09:00:00.000+00:00", "digest": "0123456789abcdef"}
Records = list[dict[str, Any]]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of an experiment that was run."""
    shutil.copy(find_experiment("delay_and_law"), tmp_path / "experiment.yaml")
    lines = [json.dumps(record) for record in (BEGUN, *demo(2))]
    # a record that was being written when its writer was killed
    (tmp_path / "journal.jsonl").write_text("\n".join([*lines, '{"record": "tri']))
    return tmp_path


def run(*words: str) -> Any:
    return invoke(["experiment", "analyse", *words])


def test_it_prints_the_effect_and_leaves_a_page_beside_the_journal(folder: Path) -> None:
    done = run(str(folder), "--measure", "completion_time_s")
    assert done.exit_code == 0, done.output
    assert "delay_ms" in done.stdout and "4 participants completed 72 trials" in done.stdout
    assert f"page: {folder}/analysis/experiment.html" in done.stdout.replace("\n", "")
    page = (folder / "analysis" / "experiment.html").read_text()
    assert "0123456789abcdef" in page and "latin square" in page.lower() and "trials.parquet" in page
    assert (folder / "analysis" / "touch_and_hold_completion_time_s.png").stat().st_size > 5000


def test_json_has_the_slope_that_the_experiment_was_made_with(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "elsewhere"
    done = run(str(folder), "--measure", "completion_time_s", "--out", str(out), "--json")
    assert done.exit_code == 0, done.output
    (slope,) = json.loads(done.stdout)["slopes"]
    assert slope["factor"] == "delay_ms" and slope["low"] < 0.02 < slope["high"]
    assert json.loads((out / "experiment.json").read_text())["slopes"] == [slope]
    assert not (folder / "analysis").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--measure", "completion_tine_s"), "measure completion_tine_s: did you mean completion_time_s? Known are"),
        (("--correction", "holms"), "correction holms: did you mean holm? Known are"),
        (("--format", "gif"), "--format gif"),
    ],
)
def test_what_is_wrong_is_named_and_nothing_is_written(folder: Path, words: tuple[str, ...], text: str) -> None:
    done = run(str(folder), *words)
    assert done.exit_code == 2 and text in done.output
    assert not (folder / "analysis").exists()


def test_a_folder_without_a_journal_is_named(tmp_path: Path) -> None:
    done = run(str(tmp_path))
    assert done.exit_code == 2 and "has no journal.jsonl: name the folder of an experiment that was run" in done.output


def of_the_template(participants: int) -> Records:
    """Return a journal of the template of `experiment new`: one numeric factor, and no time without a success."""
    source = random.Random(participants)
    records = []
    for number in range(participants):
        for index, round_trip_ms in enumerate((0, 50, 100) * 4):
            time_s = 1.7 + source.gauss(0.0, 0.1) if round_trip_ms == 0 else None
            measures = {
                "completion_time_s": time_s,
                "force_error_n": source.gauss(2e-9, 1e-10),
                "success": bool(time_s),
            }
            records.append(trial(f"P{number + 1:02d}", index, {"round_trip_ms": round_trip_ms}, **measures))
    return records


def without(records: Records, **level: Any) -> Records:
    """Return the records without the completion time of one level, where nobody succeeded."""
    for record in records:
        if level.items() <= record["condition"].items():
            record["measures"] |= {"completion_time_s": None, "success": False}
    return records


def of_one_trial(number: int) -> Records:
    return [trial(f"P{n + 1:02d}", 0, {"round_trip_ms": 0}, completion_time_s=1.5 + n) for n in range(number)]


ONE_LEVEL = "completion_time_s: round_trip_ms is not tested: there are values at 0 only"
FEW: dict[str, tuple[Records, str]] = {
    **{f"template, {number} people": (of_the_template(number), ONE_LEVEL) for number in (1, 2, 3, 6)},
    **{f"two factors, {number} people": (demo(3, number), "") for number in (3, 6)},
    "two factors, 2 people": (
        demo(3, 2),
        "2 participants have a value in every condition, and a test needs 3: no effect is tested",
    ),
    "one of two factors": (demo(3, 1), "one participant has values: nothing is tested"),
    "nobody succeeds at one level of three": (without(demo(4), delay_ms=80.0), ""),
    "nobody succeeds under one law": (
        without(demo(4), law=LAWS[0]),
        "law is not tested: there are values at wave only",
    ),
    "nobody succeeds in one condition": (
        without(demo(4), law="wave", delay_ms=80.0),
        "in no test (P01: law = wave, delay_ms = 80.0; P02: law = wave, delay_ms = 80.0; ",
    ),
    "nobody succeeds": (without(without(demo(4), law=LAWS[0]), law=LAWS[1]), ""),
    "one person is missing": ([row for row in demo(5, 3) if row["participant"] != "P02"], ""),
    "one person has one level": (
        [row for row in demo(5, 4) if row["participant"] != "P02" or row["index"] < 1],
        "without a value in every condition are in no test (P02: law = virtual_impedance, delay_ms = 0.0 and 4 more)",
    ),
    "one trial": (of_one_trial(1), "one participant has values: nothing is tested"),
    "one trial each": (of_one_trial(3), "no factor has values at two levels: nothing is tested"),
    "one repetition, two people": (demo(6, 2, 1), ""),
    "as many trials as effects": (demo(6, 2, 1)[:6], ""),
    "all values the same": ([{**row, "measures": {"completion_time_s": 2.0}} for row in demo(7, 3)], "the same value"),
}


@pytest.mark.parametrize("how", ["over all", "within"])
@pytest.mark.parametrize("name", FEW)
def test_what_cannot_be_tested_is_a_sentence(name: str, how: str) -> None:
    records, sentence = FEW[name]
    tables = tidy(records)
    (factor, *_) = (row.name.removeprefix("condition.") for row in reversed(tables.dictionary) if row.levels)
    # one measure alone, which exists at some levels only
    one = Choice(("completion_time_s",) if name != "nobody succeeds" else ("success",))
    found = analyse(tables, one._replace(within=factor) if how == "within" else one).as_dict()
    assert found["models"] and "NaN" not in json.dumps(found)
    for row in found["models"]:
        key = row["task"], row["measure"]
        assert row["remarks"] or key in {(term["task"], term["measure"]) for term in found["terms"]}
    remarks = " ".join(f"{row['measure']}: {remark}" for row in found["models"] for remark in row["remarks"])
    assert sentence in remarks


@pytest.mark.parametrize("name", ["template, 2 people", "nobody succeeds", "one trial"])
def test_the_table_has_every_trial_however_few_there_are(name: str, tmp_path: Path) -> None:
    records, _ = FEW[name]
    shutil.copy(find_experiment("template"), tmp_path / "experiment.yaml")
    (tmp_path / "journal.jsonl").write_text("".join(json.dumps(record) + "\n" for record in (BEGUN, *records)))
    done = run(str(tmp_path))
    assert done.exit_code == 0, done.output
    with (tmp_path / "analysis" / "trials.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(records)


@pytest.mark.parametrize("apparatus", ["live", "lockstep"])
def test_a_measure_that_is_tested_is_so_beside_one_that_is_not(apparatus: str, tmp_path: Path) -> None:
    text = find_experiment("template").read_text().replace("apparatus: live", f"apparatus: {apparatus}")
    (tmp_path / "experiment.yaml").write_text(text)
    lines = [json.dumps(record) + "\n" for record in (BEGUN, *of_the_template(3))]
    (tmp_path / "journal.jsonl").write_text("".join(lines))
    done = run(str(tmp_path))
    assert done.exit_code == 0 and ONE_LEVEL in done.stderr
    found = json.loads((tmp_path / "analysis" / "experiment.json").read_text())
    # everybody succeeds at the one level and nobody at the others, so there is no scatter to test against
    assert {row["measure"] for row in found["slopes"]} == {"force_error_n"}
    assert "success: every participant has the same difference: round_trip_ms is not tested" in done.stderr
    assert (tmp_path / "analysis" / "touch_and_hold_completion_time_s.png").exists()


def test_where_no_trial_counts_the_table_says_why(folder: Path) -> None:
    records = [{**record, "status": "disturbed", "disturbance": "a stall"} for record in demo(2)]
    (folder / "journal.jsonl").write_text("".join(json.dumps(record) + "\n" for record in (BEGUN, *records)))
    done = run(str(folder))
    assert done.exit_code == 2 and "no trial counts" in done.output
    with (folder / "analysis" / "trials.csv").open() as file:
        assert {row["disturbance"] for row in csv.DictReader(file)} == {"a stall"}
