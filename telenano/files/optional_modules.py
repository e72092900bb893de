"""Modules of Python that not every system has, for what also works without them, such as reading a recording."""

import importlib
from typing import Any


def optional_module(name: str) -> Any:
    """Return a module, None where this system has none of that name."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None
