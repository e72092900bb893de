"""How a field of a settings model is asked for on a command line, where its name, type and unit do not say it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Option:
    """Part of the annotation of a field.

    Attributes:
        flags: Names of the option, the first of which is used in messages.
        metavar: What represents its value in the help.
        read: What makes the value of the text that was given. Raises ConfigError naming the option.
        many: Whether the option may be repeated; `read` is given all texts then.
        written: The default as a person would write it.
    """

    flags: tuple[str, ...]
    metavar: str | None = None
    read: Callable[[Any], Any] | None = None
    many: bool = False
    written: str = ""
