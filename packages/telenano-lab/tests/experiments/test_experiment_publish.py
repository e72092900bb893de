"""What is published of an experiment: enough to analyse it again, and nothing of a person."""

import csv
import hashlib
import json
import re
import zipfile
from pathlib import Path
from typing import Any

import pytest
from experiment_bench import Bench, plan_of
from telenano_lab.experiments import journal
from telenano_lab.experiments.journal import Journal
from telenano_lab.experiments.people import People
from telenano_lab.experiments.plan import Plan
from telenano_lab.experiments.publish import public, publish
from test_experiment_runner import run

from telenano.wire import ConfigError, RigError

SECRET = "because Anna Miller had a migraine at nine"


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    """An experiment that two participants have done, with remarks in all places that take words."""
    folder = tmp_path / "study"
    folder.mkdir()
    found = plan_of(folder, operator={"kind": "person"}, participants=3)
    for name in ("P01", "P02"):
        People(folder).change(name, consent=True, handedness="left" if name == "P01" else "right")
        run(found, Bench(found), participants=[name])
        path = folder / "recordings" / name / "t0000-0.mcap"
        path.parent.mkdir(parents=True)
        path.write_bytes(name.encode())
    People(folder).change("P02", excluded=SECRET)
    with Journal(folder / journal.NAME) as records:
        records.write("excluded", participant="P02", reason=SECRET)
        records.write(
            "asked", participant="P01", session=1, block=0, trial=-1, instrument="own", items={"remark": SECRET}
        )
        last = next(record for record in records.records if record["record"] == "trial")
        outcome = {**last, "status": "aborted", "disturbance": SECRET, "attempt": 1, "final": False}
        records.write("trial", **{key: value for key, value in outcome.items() if key not in ("record", "utc")})
    return found


def text_of(folder: Path) -> str:
    return "\n".join(path.read_text(errors="replace") for path in sorted(folder.rglob("*")) if path.is_file())


def test_the_folder_has_what_others_need(plan: Plan, tmp_path: Path) -> None:
    out = tmp_path / "published"
    found = publish(plan, plan.path.parent, out)
    assert found == {"out": str(out), "trials": 13, "participants": 2, "recordings": 2}
    names = {path.name for path in out.iterdir()}
    assert {"experiment.yaml", "trials.csv", "trials.parquet", "dictionary.json", "dictionary.md", "README.md"} <= names
    assert {"versions.json", "checksums.txt", "participants.json"} <= names
    with (out / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 13
    assert {row["condition.law"] for row in rows} == {"wave", "passivity"}
    assert {row["name"] for row in json.loads((out / "dictionary.json").read_text())} >= set(rows[0])
    sums = dict(line.split()[::-1] for line in (out / "checksums.txt").read_text().splitlines())
    assert sums["recordings/P01/t0000-0.mcap"] == hashlib.sha256(b"P01").hexdigest()
    assert json.loads((out / "participants.json").read_text()) == {
        "participants": 2,
        "simulated": 0,
        "handedness": {"left": 1, "right": 1},
        "excluded": 1,
    }
    assert json.loads((out / "versions.json").read_text())["published"]["python"]


def test_nothing_personal_is_in_it(plan: Plan, tmp_path: Path) -> None:
    out = tmp_path / "published"
    publish(plan, plan.path.parent, out)
    text = text_of(out)
    assert SECRET in text_of(plan.path.parent)
    assert "Anna" not in text and "migraine" not in text
    assert "consent" not in text
    assert not re.search(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}", text), "a time of day"
    assert not (out / "recordings").exists()


def test_times_count_from_the_first_trial_of_each_participant() -> None:
    trial: dict[str, Any] = {"record": "trial", "status": "done", "disturbance": "", "answers": []}
    records = [
        {**trial, "participant": "P01", "started_utc": "2026-11-22T09:00:00.000+00:00"},
        {**trial, "participant": "P02", "started_utc": "2026-11-23T10:00:00.500+00:00"},
        {**trial, "participant": "P01", "started_utc": "2026-11-22T10:01:02.250+00:00"},
    ]
    assert [row["started_utc"] for row in public(records)] == ["00:00:00.000", "00:00:00.000", "01:01:02.250"]


def test_an_archive_has_the_same_and_recordings_on_demand(plan: Plan, tmp_path: Path) -> None:
    out = tmp_path / "published.zip"
    publish(plan, plan.path.parent, out, with_recordings=True)
    with zipfile.ZipFile(out) as archive:
        names = set(archive.namelist())
        assert archive.read("recordings/P02/t0000-0.mcap") == b"P02"
    assert {"experiment.yaml", "trials.csv", "checksums.txt"} <= names
    assert [path.name for path in tmp_path.iterdir() if ".part" in path.name] == []
    published = [record for record in journal.read(plan.path.parent / journal.NAME) if record["record"] == "published"]
    assert [record["recordings"] for record in published] == [True]


def test_what_cannot_be_published_is_refused(plan: Plan, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    with pytest.raises(ConfigError, match="there: exists already"):
        publish(plan, plan.path.parent, tmp_path / "there")
    with Journal(plan.path.parent / journal.NAME), pytest.raises(RigError, match="another `telenano experiment`"):
        publish(plan, plan.path.parent, tmp_path / "out")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ConfigError, match="has no trials to publish"):
        publish(plan_of(empty), empty, tmp_path / "out")
    assert not (tmp_path / "out").exists()
