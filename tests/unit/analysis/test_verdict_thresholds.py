"""The table of the thresholds in docs/studies.md is what its command prints."""

from pathlib import Path

import pytest
from verdict_thresholds import THRESHOLDS, table

STUDIES = Path(__file__).parents[3] / "docs" / "studies.md"


@pytest.mark.check("judges two hundred holds with each threshold halved and doubled")
def test_the_table_in_the_document_is_what_the_command_prints() -> None:
    printed = table()
    assert len(printed.splitlines()) == 2 + len(THRESHOLDS)
    assert printed in STUDIES.read_text("utf-8"), printed
