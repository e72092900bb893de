"""The drawing of the rooms in docs/architecture.md is the order that import-linter holds."""

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
