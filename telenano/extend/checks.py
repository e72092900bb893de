"""A check in `telenano doctor`: a function without arguments that returns findings."""

from typing import Literal, NamedTuple

Level = Literal["ok", "warning", "problem"]


class Finding(NamedTuple):
    """The result of a check; `advice` is empty if nothing has to be done."""

    name: str
    level: Level
    found: str
    advice: str = ""
