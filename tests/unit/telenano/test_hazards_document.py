"""docs/hazards.md: every row has a measure and a test, and every test that is named exists."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
TEXT = (ROOT / "docs" / "hazards.md").read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in TEXT.splitlines()
    if line.startswith("| ") and not line.startswith("| hazard")
]


def test_every_hazard_has_a_cause_a_measure_and_a_test() -> None:
    assert len(ROWS) > 20
    for hazard, cause, measure, tests in ROWS:
        assert cause and measure, hazard
        assert re.fullmatch(r"`test_\w+`(, `test_\w+`)*", tests), hazard


def test_every_test_that_is_named_exists() -> None:
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")]
    named = re.findall(r"`(test_\w+)`", TEXT)
    assert [name for name in named if not any(f"def {name}(" in text for text in sources)] == []


def test_it_says_plainly_that_this_is_no_safety_rated_stop() -> None:
    assert "This is no safety-rated system." in TEXT
    assert "hardware stop" in TEXT
