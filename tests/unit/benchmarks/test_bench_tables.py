"""The tables of `make bench`: what is between the marks is replaced, and nothing else."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "benchmarks"))
import tables  # noqa: E402

PAGE = "before\n<!-- loop begins -->\nold\n<!-- loop ends -->\nafter\n"


def test_what_is_between_the_marks_is_replaced() -> None:
    page = tables.replaced(PAGE, "loop", ["| new |"])
    assert page == "before\n<!-- loop begins -->\n\n| new |\n\n<!-- loop ends -->\nafter\n"
    assert tables.replaced(page, "loop", ["| new |"]) == page
    assert tables.replaced(PAGE, "peers", ["| new |"]) == PAGE


@pytest.mark.parametrize("name", tables.TABLES)
def test_each_table_has_its_place_and_its_script(name: str) -> None:
    assert sum(page.read_text().count(f"<!-- {name} begins -->") for page in tables.PAGES) == 1
    assert (ROOT / "benchmarks" / tables.TABLES[name].script).is_file()


def test_tables_have_a_row_for_each_figure() -> None:
    rows = [{"law": "wave", "environment": place, "ratio": 2000.0} for place in ("wall", "spring")]
    assert tables.lockstep_lines({"rows": rows})[2:] == ["| wave | 2000 | 2000 |"]
    age = {"p50": 0.5, "p99": 1.0}
    both = {"zenoh": age, "rig": age}
    assert tables.peers_lines({"age_ms": both, "rig_ratio": both, "missing": ["x"]})[2:] == [
        "| zenoh | 0.50 | 1.00 | 0.5 | 1.0 |", "| the whole rig | 0.50 | 1.00 | 0.5 | 1.0 |", "Not installed: x."
    ]  # fmt: skip


def test_a_script_that_fails_is_named() -> None:
    found = tables.figures_of("empty_loop.py", ("--no-such-option",))
    assert isinstance(found, str)
    assert "--no-such-option" in found
