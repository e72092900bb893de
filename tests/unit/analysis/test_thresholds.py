"""The thresholds of the verdicts are those of the table in docs/studies.md, and no more than twelve."""

import re
from pathlib import Path

from analysis import holds, modes, verdict

STUDIES = Path(__file__).parents[3] / "docs" / "studies.md"
ROW = re.compile(r"^\| `([A-Z_]+)` \| ([0-9.]+) \| ([^|]+) \| ([^|]+) \|$", re.MULTILINE)
# settings of the fit and names, which decide about no motion
NO_THRESHOLDS = {"LEAST_SAMPLES", "LONGEST_STEP_S", "REPORTED_WITHIN_S"}


def test_the_table_in_the_document_is_that_of_the_code() -> None:
    rows = {name: float(value) for name, value, _, _ in ROW.findall(STUDIES.read_text("utf-8"))}
    code = {
        name: float(value)
        for module in (modes, verdict, holds)
        for name, value in vars(module).items()
        if name.isupper() and not name.startswith("_") and isinstance(value, int | float)
    }
    assert {name: value for name, value in code.items() if name not in NO_THRESHOLDS} == rows
    assert len(rows) <= 12


def test_every_threshold_has_a_reason_above_it_in_the_code() -> None:
    for module in (modes, verdict, holds):
        lines = Path(str(module.__file__)).read_text("utf-8").splitlines()
        for number, line in enumerate(lines):
            if re.match(r"[A-Z][A-Z_]+ = [0-9.]+$", line):
                assert lines[number - 1].startswith("#"), line
