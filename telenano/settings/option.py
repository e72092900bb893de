"""The form of a settings field as a command-line option, where its name, type and unit do not determine it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Option:
    """Part of the annotation of a field.

    Attributes:
        flags: Names of the option, the first of which is used in messages.
        metavar: The placeholder of its value in the help.
        read: Converts the text of the command line to the value; raises ConfigError naming the option.
        many: Whether the option may be repeated; `read` then receives all texts.
        written: The default as a person would write it.
    """

    flags: tuple[str, ...]
    metavar: str | None = None
    read: Callable[[Any], Any] | None = None
    many: bool = False
    written: str = ""
