"""The files of an experiment that several commands change at the same moment, and on a disk that is full."""

from pathlib import Path

import pytest
from telenano_lab.experiments import journal
from telenano_lab.experiments.journal import Journal
from telenano_lab.experiments.people import People

from telenano.testing import Shared, SharedFiles, small_disk
from telenano.wire import RigError

ROUNDS = 40


def lost_people(folder: Path, done: list[set[int]]) -> object:
    known = People(folder).known
    consented = [n for n in done[0] if f"P{n}" not in known or not known[f"P{n}"].consent]
    excluded = [n for n in done[1] if f"P{n}" not in known or not known[f"P{n}"].excluded]
    return consented + excluded


def change_people(folder: Path, who: int, number: int) -> None:
    People(folder).change(f"P{number}", **({"consent": True} if who == 0 else {"excluded": "left"}))


def append(folder: Path, who: int, number: int) -> None:
    with Journal(folder / journal.NAME) as opened:
        opened.write("trial", who=who, number=number)


def replace(folder: Path, who: int, number: int) -> None:
    """Append by one writer, and replace all records by the other, as an erasure does."""
    with Journal(folder / journal.NAME) as opened:
        opened.write("trial", who=who, number=number)
        if who == 1:
            opened.replace(opened.records)


def lost_records(folder: Path, done: list[set[int]]) -> object:
    path = folder / journal.NAME
    kept = {(record["who"], record["number"]) for record in (journal.read(path) if path.exists() else [])}
    return {(who, number) for who in (0, 1) for number in done[who]} - kept


SHARED = (
    Shared("consent and exclusion", lambda folder: None, change_people, lost_people),
    Shared("journal", lambda folder: None, append, lost_records),
    Shared("journal that is replaced", lambda folder: None, replace, lost_records),
)


@pytest.mark.parametrize("shared", SHARED, ids=[shared.name for shared in SHARED])
class TestEachSharedFile(SharedFiles):
    rounds = ROUNDS


def test_a_journal_goes_on_when_there_is_room_again(tmp_path: Path) -> None:
    path = tmp_path / "disk" / journal.NAME
    with small_disk(path.parent) as leave, Journal(path) as opened:
        opened.write("begun")
        leave(0)
        with pytest.raises(RigError, match=r"a record could not be written: (No space|only \d+ of)"):
            opened.write("trial", notes="x" * 9000)
        with pytest.raises(RigError, match="the records cannot be replaced: No space left on device"):
            opened.replace([{"record": "begun", "notes": "x" * 9000}])
        (path.parent / "filler").unlink()
        opened.write("ended")
        assert [record["record"] for record in journal.read(path)] == ["begun", "ended"]
