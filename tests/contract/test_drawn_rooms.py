"""The rooms in docs/architecture.md are in the order of import-linter, its twelve files in that of a sample."""

import ast
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_drawing_has_every_room_in_the_order_of_imports() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    drawing = page.partition("holds the order.")[2].split("```")[1]
    drawn = [line.split("  ")[0].split(" · ") for line in drawing.strip().splitlines()]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    (held,) = (contract["layers"] for contract in contracts if contract.get("containers") == ["telenano"])
    assert drawn == [line.split(" | ") for line in held if line != "__main__"]


def test_the_head_of_each_of_the_twelve_files_names_the_next_one() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    files = re.findall(r"^\| \d+ \| `([^`]+)` \|", page.partition("## Twelve files")[2], re.MULTILINE)
    assert len(files) == 12
    for this, following in zip(files, [*files[1:], files[0]], strict=True):
        head = ast.get_docstring(ast.parse((ROOT / this).read_text(encoding="utf-8"))) or ""
        assert f"`{following}`" in head, (this, following)
