"""docs/laws.md: the defaults in its tables are those of the settings."""

import re
from pathlib import Path
from typing import Any

import pytest

from services.controller.config import KNOWN_LAWS, ControllerConfig

ROOT = Path(__file__).parents[3]
TEXT = (ROOT / "docs" / "laws.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| (`\w+`(?:, `\w+`)*) \| ([^|]+) \| (.*) \|$", re.MULTILINE)
SECTIONS = dict(zip(*[iter(re.split(r"^## (.+)$", TEXT, flags=re.MULTILINE)[1:])] * 2, strict=True))


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
