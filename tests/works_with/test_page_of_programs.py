"""The page of programs states the versions that its rows install."""

import re
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "packages" / "telenano-bridges" / "docs" / "works-with.md"


def test_the_page_states_each_version_that_a_row_installs() -> None:
    page = PAGE.read_text(encoding="utf-8")
    sources = "\n".join(path.read_text(encoding="utf-8") for path in HERE.glob("test_*.py"))
    versions = set(re.findall(r'"[@\w/.-]+?(?:==|@)(\d[\w.]*)"', sources))
    assert versions
    assert {version for version in versions if f"| {version} |" not in page} == set()
