"""Participants: no name comes in, and an erasure leaves nothing of a person."""

from pathlib import Path

import pytest
from experiment_bench import Bench, plan_of
from telenano_lab.experiments import journal
from telenano_lab.experiments.journal import Journal
from telenano_lab.experiments.people import People, checked_pseudonym, erase
from telenano_lab.experiments.runner import remaining
from test_experiment_runner import run

from telenano.wire import ConfigError, RigError


@pytest.mark.parametrize(
    "name", ["Anna", "P", "anna.miller@lab.org", "Miller1", "P01 Anna", "01", "", "P1234567", "P01\n"]
)
def test_what_could_be_a_name_is_no_pseudonym(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="is not a pseudonym"):
        checked_pseudonym(name)
    with pytest.raises(ConfigError):
        People(tmp_path).change(name, consent=True)
    assert not (tmp_path / "people.json").exists()


@pytest.mark.parametrize("name", ["P01", "S-7", "sub_003", "VR12"])
def test_schemes_of_laboratories_are_pseudonyms(name: str) -> None:
    assert checked_pseudonym(name) == name


def test_what_is_known_of_a_participant_stays(tmp_path: Path) -> None:
    People(tmp_path).change("P01", handedness="left")
    People(tmp_path).change("P01", consent=True)
    assert People(tmp_path).known["P01"].model_dump() == {
        "handedness": "left",
        "consent": True,
        "simulated": False,
        "excluded": "",
    }
    with pytest.raises(ConfigError, match=r"P01\.handedness"):
        People(tmp_path).change("P01", handedness="wrong")
    (tmp_path / "people.json").write_text('{"P01": {"name": "Anna"}}')
    with pytest.raises(ConfigError, match=r"people\.P01\.name: unknown key"):
        People(tmp_path)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An experiment that two participants have done, with what a rig leaves of each."""
    plan = plan_of(tmp_path)
    run(plan, Bench(plan))
    for name in ("P01", "P02"):
        People(tmp_path).change(name, handedness="left")
        for place in (f"recordings/{name}/t0000-0.mcap", f"rig/{name}-1/session/session.mcap", f"rig/{name}-1/up.log"):
            path = tmp_path / place
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(f"{name} {place}".encode())
    (tmp_path / "analysis").mkdir()
    (tmp_path / "analysis" / "trials.csv").write_text("participant\nP01\nP02\n")
    return tmp_path


def test_an_erasure_removes_everything_of_one_and_nothing_of_another(folder: Path) -> None:
    gone = erase(folder, "P01")
    left = [found for found in folder.rglob("*") if found.is_file()]
    assert not [found for found in left if "P01" in str(found.relative_to(folder))]
    named = [found.name for found in left if "P01" in found.read_text(errors="replace")]
    assert named == ["journal.jsonl"]
    mine = [record for record in journal.read(folder / "journal.jsonl") if record.get("participant") == "P01"]
    assert [record["record"] for record in mine] == ["erased"]
    assert list(People(folder).known) == ["P02"]
    others = [record for record in journal.read(folder / "journal.jsonl") if record["record"] == "trial"]
    assert len(others) == 6 and (folder / "recordings/P02/t0000-0.mcap").exists()
    # its recording, two files of its rig, and the table that was made of all
    assert gone.files == 4 and gone.records > 6 and gone.published_before == 0


def test_an_erased_participant_is_not_asked_again(folder: Path) -> None:
    erase(folder, "P02")
    plan = plan_of(folder)
    assert remaining(plan, journal.read(folder / "journal.jsonl")) == {}
    assert run(plan, Bench(plan), participants=["P02"]) == ""
    assert not [
        r for r in journal.read(folder / "journal.jsonl") if r["record"] == "trial" and r["participant"] == "P02"
    ]


def test_an_erasure_of_nobody_and_one_during_a_run_are_refused(folder: Path) -> None:
    with pytest.raises(ConfigError, match="has no data of P09"):
        erase(folder, "P09")
    with Journal(folder / "journal.jsonl"), pytest.raises(RigError, match="another `telenano experiment` is at work"):
        erase(folder, "P01")
    erase(folder, "P01")
    with pytest.raises(ConfigError, match="has no data of P01"):
        erase(folder, "P01")


def test_what_names_the_participant_elsewhere_is_told(folder: Path) -> None:
    (folder / "notes.txt").write_text("P01 was tired")
    with pytest.raises(RigError, match=r"P01 is still named in notes.txt; remove it there"):
        erase(folder, "P01")
    assert not (folder / "recordings/P01").exists()


def test_a_participant_of_a_longer_number_is_another_one(folder: Path) -> None:
    (folder / "recordings" / "P010").mkdir()
    (folder / "recordings" / "P010" / "t0.mcap").write_bytes(b"x")
    erase(folder, "P01")
    assert (folder / "recordings" / "P010" / "t0.mcap").exists()
