"""Modules of Python that not every system has, for what also works without them, such as reading a recording."""

import importlib
from typing import Any

from telenano.wire.errors import ConfigError
from telenano.wire.extras import missing


def optional_module(name: str) -> Any:
    """Return a module, None where this system has none of that name."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def required_module(name: str, what: str) -> Any:
    """Return a module that `what` needs; ConfigError says how to install its package."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(f"{what}: {missing(name.partition('.')[0])}") from error
