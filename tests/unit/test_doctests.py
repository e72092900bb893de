"""The examples in docstrings give what stands below them."""

import doctest
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def modules() -> list[str]:
    """Return the names of the modules with an example, packages included."""
    homes = [(ROOT, "telenano"), (ROOT, "services"), *((path, "telenano_*") for path in ROOT.glob("packages/*"))]
    paths = [(home, path) for home, name in homes for top in home.glob(name) for path in top.rglob("*.py")]
    return sorted(
        ".".join(path.relative_to(home).with_suffix("").parts) for home, path in paths if ">>> " in path.read_text()
    )


@pytest.mark.parametrize("name", modules())
def test_examples_of_a_module_give_what_they_state(name: str) -> None:
    found = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert found.attempted > 0 == found.failed
