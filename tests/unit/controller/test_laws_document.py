"""docs/laws.md: every promise names the tests that would break with it, and these exist."""

import re
from pathlib import Path

import pytest

from services.controller.config import LAWS

ROOT = Path(__file__).parents[3]
NAMED = re.compile(r"(test_\w+\.py)::(test_\w+)")
TEXT = (ROOT / "docs" / "laws.md").read_text(encoding="utf-8")
SECTIONS = dict(zip(*[iter(re.split(r"^## (.+)$", TEXT, flags=re.MULTILINE)[1:])] * 2, strict=True))


def functions_below(folder: Path) -> set[tuple[str, str]]:
    """Give file and name of every test function."""
    return {
        (path.name, name)
        for path in folder.rglob("test_*.py")
        for name in re.findall(r"^def (test_\w+)\(", path.read_text(encoding="utf-8"), re.MULTILINE)
    }


def test_every_test_that_is_named_exists() -> None:
    known = functions_below(ROOT / "tests")
    for document in ("docs/laws.md", "docs/studies.md", *map(str, (ROOT / "docs" / "decisions").glob("*.md"))):
        named = NAMED.findall((ROOT / document).read_text(encoding="utf-8"))
        assert [pair for pair in named if pair not in known] == [], document


@pytest.mark.parametrize("law", LAWS)
def test_every_promise_of_a_law_names_a_test(law: str) -> None:
    promises = re.findall(
        r"^- \*\*(?:Constant|Varying|Loss|No promise|Mismatch|Tuned).*?(?=^\S|\Z)", SECTIONS[law], re.M | re.S
    )
    assert len(promises) >= 2
    assert [promise.splitlines()[0] for promise in promises if not NAMED.search(promise)] == []


@pytest.mark.parametrize(
    "section", ["What they share", "The force clamp", "deadband", "Changing the law", "Energy on the bus"]
)
def test_what_the_laws_share_names_its_tests(section: str) -> None:
    assert NAMED.search(SECTIONS[section])
