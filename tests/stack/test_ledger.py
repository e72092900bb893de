"""The table of faults: every fault that is promised anything is in the page, and a run replaces what it measured."""

import json
from pathlib import Path

import pytest
from ledger import FAULTS, VARIABLE, faults_of, main, record, table

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reliability.md"


def test_the_page_has_every_fault_and_its_promise() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert faults_of(text) == list(FAULTS)
    for fault, promise in FAULTS.items():
        assert f"| {fault} | {promise} |" in text


def test_a_run_replaces_what_it_entered_and_keeps_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entered, page = tmp_path / "faults.jsonl", tmp_path / "page.md"
    first, second, *_ = FAULTS
    page.write_text(
        f"before\n<!-- faults begin -->\n{table({first: 'old', second: 'kept'})}\n<!-- faults end -->\nafter\n"
    )
    # `make reliability` sets it: this test must not write into the table of that run
    monkeypatch.delenv(VARIABLE, raising=False)
    record(first, "nobody asked for a table")
    assert not entered.exists()
    monkeypatch.setenv(VARIABLE, str(entered))
    record(first, "new")
    main(entered, page)
    text = page.read_text()
    assert f"| {first} | {FAULTS[first]} | new |" in text
    assert f"| {second} | {FAULTS[second]} | kept |" in text
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert json.loads(entered.read_text()) == {"fault": first, "happened": "new"}


def test_a_fault_without_a_promise_is_refused() -> None:
    with pytest.raises(KeyError, match="a meteorite is not among"):
        record("a meteorite", "crater")
