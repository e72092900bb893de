"""docs/laws.md: every promise names the tests that would break with it, and these exist."""

import re
from pathlib import Path
from typing import Any

import pytest

from services.controller.config import KNOWN_LAWS, LAWS, ControllerConfig

ROOT = Path(__file__).parents[3]
NAMED = re.compile(r"(test_\w+\.py)::(test_\w+)")
TEXT = (ROOT / "docs" / "laws.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| (`\w+`(?:, `\w+`)*) \| ([^|]+) \| (.*) \|$", re.MULTILINE)
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


def defaults_of(section: str) -> dict[str, tuple[str, str]]:
    """Give the default and the meaning of each parameter in the table of a section, as they are printed."""
    rows = ROW.findall(SECTIONS[section])
    each = [(re.findall(r"\w+", names), given.split(", "), meaning) for names, given, meaning in rows]
    return {name: (value, text) for names, given, text in each for name, value in zip(names, given, strict=True)}


def printed(value: Any) -> str:
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def agrees(given: str, value: Any) -> bool:
    return float(given) == value if isinstance(value, float) else given == printed(value)


@pytest.mark.parametrize("section", [*KNOWN_LAWS, "deadband", "The force clamp"])
def test_defaults_in_the_tables_are_those_of_the_settings(section: str) -> None:
    config = getattr(ControllerConfig(), "clamp" if section == "The force clamp" else section)
    named = defaults_of(section)
    assert [name for name, (given, _) in named.items() if not agrees(given, getattr(config, name))] == []
    if section not in KNOWN_LAWS:
        assert set(named) == set(type(config).model_fields)
        return
    # what all laws share has one table, which says where the laws around the paper's impedance differ
    for name, (given, meaning) in defaults_of("What they share").items():
        other = re.search(r"\((\d+) for", meaning)
        of_the_paper = other is not None and section in ("virtual_impedance", "smith")
        if name not in named and name in type(config).model_fields:
            assert agrees(other.group(1) if other and of_the_paper else given, getattr(config, name)), (section, name)
