"""`telenano experiment` as a person types it, on an apparatus that takes no time."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from experiment_bench import DOCUMENT, TASKS, Bench
from telenano_lab.experiments import journal
from telenano_lab.experiments.experiment_command import app
from typer.testing import CliRunner


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("telenano_lab.experiments.plan.TASKS", TASKS)
    monkeypatch.setattr("telenano_lab.experiments.apparatus.lockstep.Lockstep", Bench)
    path = tmp_path / "tiny.yaml"
    document = {**DOCUMENT, "apparatus": "lockstep", "tasks": ["tiny"]}
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return path


def telenano(*arguments: object, code: int = 0) -> Any:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == code, (done.output, done.exception)
    return done


def test_from_a_file_to_an_erased_participant(file: Path, tmp_path: Path) -> None:
    found = json.loads(telenano("check", file, "--json").stdout)
    assert (found["trials"], found["conditions"], found["factors_of_trials"]) == (12, 6, ["law", "round_trip_ms"])
    out = tmp_path / "study"
    state = json.loads(telenano("run", file, "--out", out, "--participant", "P01", "--json").stdout)
    assert (state["trials_done"], state["trials_left"]) == (6, 6)
    telenano("run", file, "--out", out, code=2)
    assert "12 trials done, 0 left" in telenano("resume", out).stdout
    rows = json.loads(telenano("status", out, "--json").stdout)["participants"]
    assert [(row["participant"], row["done"], row["state"]) for row in rows] == [("P01", 6, "done"), ("P02", 6, "done")]
    telenano("people", "exclude", out, "P02", "--reason", "fell ill")
    people = json.loads(telenano("people", "list", out, "--json").stdout)["participants"]
    assert {row["participant"]: row["excluded"] for row in people} == {"P01": "", "P02": "fell ill"}
    gone = json.loads(telenano("erase", out, "P01", "--yes", "--json").stdout)
    assert gone["records"] > 6
    assert {r["participant"] for r in journal.read(out / "journal.jsonl") if r["record"] == "trial"} == {"P02"}


def test_a_journal_whose_trials_do_not_say_whether_they_are_over_is_refused(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "study"
    telenano("run", file, "--out", out, "--participant", "P01")
    path = out / "journal.jsonl"
    records = journal.read(path)
    for record in records:
        record.pop("final", None)
    path.write_text("".join(json.dumps(record) + "\n" for record in records))
    begun = next(record["utc"] for record in records if record["record"] == "trial")
    said = f"journal.jsonl: a trial of P01 at {begun} has no `final`"
    assert said in " ".join(telenano("status", out, code=2).output.split())
    before = path.read_bytes()
    assert said in " ".join(telenano("resume", out, code=2).output.split())
    assert path.read_bytes() == before


def test_what_runs_is_the_copy_in_the_folder(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "study"
    telenano("run", file, "--out", out, "--participant", "P01")
    assert (out / "experiment.yaml").read_text() == file.read_text()
    file.write_text("name: gone")
    telenano("resume", out)


def test_a_scenario_of_ones_own_is_copied_with_its_files_where_they_are(file: Path, tmp_path: Path) -> None:
    scenario = {"name": "own", "description": "own", "duration_s": 3.0, "controller": {"law": "wave"}}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(scenario))
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), "scenario": "own.yaml"}, sort_keys=False))
    out = tmp_path / "study"
    telenano("run", file, "--out", out)
    assert yaml.safe_load((out / "experiment.yaml").read_text())["scenario"] == "scenario.yaml"
    assert yaml.safe_load((out / "scenario.yaml").read_text())["name"] == "own"


def test_of_an_experiment_that_nobody_is_known_of_it_is_said(file: Path, tmp_path: Path) -> None:
    telenano("run", file, "--out", tmp_path / "study", "--participant", "P01")
    (tmp_path / "study" / "people.json").unlink(missing_ok=True)
    assert "nobody is known yet" in telenano("people", "list", tmp_path / "study").stdout
    assert json.loads(telenano("people", "list", tmp_path / "study", "--json").stdout) == {"participants": []}


def test_a_file_or_a_missing_folder_has_no_participants(file: Path, tmp_path: Path) -> None:
    for folder, told in ((file, "is a file"), (tmp_path / "nowhere", "there is no such folder")):
        found = telenano("people", "list", folder, code=2)
        assert told in found.stderr


def test_a_torn_journal_is_told(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "study"
    telenano("run", file, "--out", out, "--participant", "P01")
    path = out / "journal.jsonl"
    path.write_bytes(path.read_bytes() + b'{"record": "tri')
    assert 'the last record was not whole and is dropped: {"record": "tri' in telenano("resume", out).stdout


def test_a_person_does_not_take_part_in_simulated_time(file: Path, tmp_path: Path) -> None:
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), "operator": {"kind": "person"}}))
    done = telenano("run", file, "--out", tmp_path / "study", code=2)
    assert "apparatus: a person cannot take part in simulated time" in done.output


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("status", "nowhere"), "has no experiment.yaml"),
        (("check", "nothing"), "unknown experiment 'nothing'"),
        (("people", "add", "{folder}", "Anna"), "'Anna' is not a pseudonym"),
        (("erase", "{folder}", "P07", "--yes"), "has no data of P07"),
    ],
)
def test_mistakes_end_in_a_sentence(tmp_path: Path, arguments: tuple[str, ...], sentence: str) -> None:
    given = [argument.format(folder=tmp_path) for argument in arguments]
    assert sentence in telenano(*given, code=2).output


def test_an_experiment_of_ones_own_begins_with_the_template(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    telenano("new", "mine", "--out", path)
    assert yaml.safe_load(path.read_text())["name"] == "mine"
    assert json.loads(telenano("check", path, "--json").stdout)["name"] == "mine"
    telenano("new", "mine", "--out", path, code=2)


def test_a_plan_whose_trials_would_read_a_file_that_is_not_there_does_not_begin(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "study"
    telenano("run", file, "--out", out, "--participant", "P01")
    for path in (file, out / "experiment.yaml"):
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
        document["settings"] = {"afm_node.sample.name": "nosuch.gwy"}
        path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    for words in (("check", file), ("run", file, "--out", tmp_path / "other"), ("resume", out)):
        said = telenano(*words, code=2).stderr
        assert "(law = " in said and "afm_node.sample.name: nosuch.gwy is neither a file nor a known shape" in said
    assert not (tmp_path / "other").exists()
    # What was done is shown on a machine that does not have the file.
    telenano("status", out)
