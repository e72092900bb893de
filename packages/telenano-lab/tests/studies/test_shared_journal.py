"""The journal of a study that two studies into one folder write at the same moment, and on a full disk."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from telenano_lab.studies.loops.sweep import Journal, Kind

from telenano.testing import Shared, fill_at_each_write, race


def result_of(document: dict[str, Any]) -> Any:
    return SimpleNamespace(cell=SimpleNamespace(key=document["key"]), as_dict=lambda: document)


KIND = Kind(lambda cell: None, lambda cell: cell, result_of)


def record(folder: Path, who: int, number: int) -> None:
    Journal(folder / "journal.jsonl", KIND).record([result_of({"key": f"{who}-{number}", "text": "x" * 3000})])


def lost(folder: Path, done: list[set[int]]) -> object:
    path = folder / "journal.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    return {f"{who}-{number}" for who in (0, 1) for number in done[who]} - {json.loads(line)["key"] for line in lines}


SHARED = Shared("results of cells", lambda folder: None, record, lost)


def test_no_result_of_two_studies_is_lost(tmp_path: Path) -> None:
    done = race(SHARED, tmp_path, 12)
    assert done[0] | done[1] == set(range(12))
    assert not lost(tmp_path, done)


def test_a_full_disk_is_a_sentence_with_the_path_and_leaves_whole_lines(tmp_path: Path) -> None:
    assert fill_at_each_write(SHARED, tmp_path / "disk") > 0


def test_a_line_that_a_kill_has_cut_goes(tmp_path: Path) -> None:
    record(tmp_path, 0, 1)
    with (tmp_path / "journal.jsonl").open("ab") as file:
        file.write(b'{"key": "0-2", "resu')
    assert list(Journal(tmp_path / "journal.jsonl", KIND).results) == ["0-1"]
    record(tmp_path, 0, 3)
    assert list(Journal(tmp_path / "journal.jsonl", KIND).results) == ["0-1", "0-3"]
