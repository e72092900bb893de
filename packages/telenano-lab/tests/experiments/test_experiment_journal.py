"""The journal of an experiment: whole records, one writer, and the words for what a kill left behind."""

import json
import os
from pathlib import Path
from typing import Any

import pytest
from telenano_lab.experiments import journal
from telenano_lab.experiments.journal import Journal

from telenano.wire import ConfigError, RigError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "journal.jsonl"


def test_records_come_back_as_they_were_written(path: Path) -> None:
    with Journal(path) as first:
        first.write("begun", seed=3)
        first.write("trial", participant="P01", measures={"a": 1.5, "b": None, "c": True})
    with Journal(path) as again:
        assert [record["record"] for record in again.records] == ["begun", "trial"]
        assert again.records[1]["measures"] == {"a": 1.5, "b": None, "c": True}
    assert journal.read(path) == again.records


@pytest.mark.parametrize("cut", [1, 5, 40])
def test_a_record_that_was_cut_by_a_kill_is_dropped_with_a_word(path: Path, cut: int) -> None:
    with Journal(path) as first:
        first.write("begun", seed=3)
        first.write("trial", participant="P01", index=7)
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    assert [record["record"] for record in journal.read(path)] == ["begun"]
    assert journal.torn(path).startswith('{"record": "trial"'[: len(whole) - cut])
    with Journal(path) as again:
        assert again.torn
        again.write("resumed")
    assert [record["record"] for record in journal.read(path)] == ["begun", "resumed"]


def test_a_damaged_line_before_the_end_is_named(path: Path) -> None:
    path.write_text('{"record": "begun"}\n{oops\n{"record": "ended"}\n')
    with pytest.raises(ConfigError, match=r"journal.jsonl: line 2 is not JSON"):
        journal.read(path)
    path.write_text('{"record": "begun"}\n[1]\n')
    with pytest.raises(ConfigError, match="line 2 is not a record of an experiment"):
        Journal(path)


def test_two_runners_cannot_have_it_at_once(path: Path) -> None:
    with Journal(path), pytest.raises(RigError, match="another `telenano experiment` is at work"):
        Journal(path)
    with Journal(path) as later:
        later.write("begun")


def test_a_full_disk_leaves_no_half_record(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Journal(path) as found:
        found.write("begun")
        before = path.read_bytes()
        write = os.write
        monkeypatch.setattr(os, "write", lambda descriptor, data: write(descriptor, data[:10]))
        with pytest.raises(RigError, match="a record could not be written: only 10 of"):
            found.write("trial", index=1)
        monkeypatch.undo()
        assert path.read_bytes() == before
        found.write("trial", index=1)
    assert [record["record"] for record in journal.read(path)] == ["begun", "trial"]


def test_a_number_that_json_does_not_have_is_refused_and_nothing_is_written(path: Path) -> None:
    with Journal(path) as found:
        with pytest.raises(ValueError, match="Out of range float values"):
            found.write("trial", measures={"a": float("nan")})
        assert path.read_bytes() == b""


def test_replaced_records_keep_the_lock(path: Path) -> None:
    with Journal(path) as found:
        found.write("begun")
        found.write("trial", participant="P01")
        kept: list[dict[str, Any]] = [record for record in found.records if record["record"] == "begun"]
        found.replace(kept)
        with pytest.raises(RigError):
            Journal(path)
        found.write("ended")
    assert [json.loads(line)["record"] for line in path.read_text().splitlines()] == ["begun", "ended"]
