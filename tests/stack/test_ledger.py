"""The table of faults: a run replaces what it measured, and enters no fault that nothing is promised for."""

import json
from datetime import date
from pathlib import Path

import pytest
from ledger import FAULTS, VARIABLE, main, record, table


def test_a_run_replaces_what_it_entered_and_keeps_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entered, page = tmp_path / "faults.jsonl", tmp_path / "page.md"
    first, second, *_ = FAULTS
    before = table({first: ("old", "2026-01-02"), second: ("kept", "2026-01-02")})
    page.write_text(f"before\n<!-- faults begin -->\n{before}\n<!-- faults end -->\nafter\n")
    # `make reliability` sets it: this test must not write into the table of that run
    monkeypatch.delenv(VARIABLE, raising=False)
    record(first, "nobody asked for a table")
    assert not entered.exists()
    monkeypatch.setenv(VARIABLE, str(entered))
    record(first, "new")
    main(entered, page)
    text = page.read_text()
    assert f"| {first} | {FAULTS[first]} | new | {date.today()} |" in text
    assert f"| {second} | {FAULTS[second]} | kept | 2026-01-02 |" in text
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert json.loads(entered.read_text()) == {"fault": first, "happened": "new", "day": f"{date.today()}"}


def test_a_fault_without_a_promise_is_refused() -> None:
    with pytest.raises(KeyError, match="a meteorite is not among"):
        record("a meteorite", "crater")
