"""Import of modules that not every system has, for code that also works without them or names the missing extra."""

import importlib
from typing import Any

from telenano.wire.errors import ConfigError
from telenano.wire.extras import how_to_install


def optional_module(name: str) -> Any:
    """Return a module; None if this system lacks it."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def required_module(name: str, absent: str, extra: str) -> Any:
    """Return a module of an extra; if it is missing, raise ConfigError with the text `absent` and how to install it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(f"{absent}: {how_to_install(extra)}") from error
