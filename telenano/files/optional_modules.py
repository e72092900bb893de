"""Modules of Python that not every system has, for what also works without them, such as reading a recording."""

import importlib
from typing import Any

from telenano.wire.errors import ConfigError
from telenano.wire.extras import how_to_install


def optional_module(name: str) -> Any:
    """Return a module, None where this system has none of that name."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def required_module(name: str, absent: str, extra: str) -> Any:
    """Return a module of an extra; ConfigError says `absent` and how the extra is installed where it is not there."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(f"{absent}: {how_to_install(extra)}") from error
