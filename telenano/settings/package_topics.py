"""The topics of installed packages: entry points of `telenano.topics`, named like the topic with `_` instead of `/`.

    [project.entry-points."telenano.topics"]
    wind_speed = "my_package.messages:WIND_SPEED"

The entry is a `Topic`, like the rows of the core. A process imports the package only if a command, a recording or a
message names the topic to it.
"""

from functools import cache
from typing import Any

from telenano.wire.topics import NAME, TOPICS, Topic, find_with, register_topic

# Import `row_of` from here, so that it finds the topics of packages too.
from telenano.wire.topics import row_of as row_of


def installed_topics() -> list[str]:
    """Return the names of the topics that installed packages declare, without importing one."""
    from telenano.settings.plugins import installed

    return [name for entry in installed("topics") if NAME.fullmatch(name := entry.replace("_", "/"))]


def topics_by_name() -> list[str]:
    """Return the topics that an observer may receive besides those of the table."""
    return [name for name in installed_topics() if name not in TOPICS]


def problem_with(name: str) -> str:
    """Return a sentence on why the topic of an installed package cannot be used; empty for any other name."""
    return _loaded(name)[1] if name in installed_topics() else ""


def _find(name: str) -> Topic | None:
    row = _loaded(name)[0] if name in installed_topics() else None
    return register_topic(row) if row else None


@cache
def _loaded(name: str) -> tuple[Topic | None, str]:
    from telenano.settings.plugins import load

    def checked(entry: str, value: Any) -> Topic:
        if not isinstance(value, Topic):
            raise TypeError(f"is a {type(value).__name__}, must be a Topic of telenano.wire")
        if value.name != name:
            wanted = value.name.replace("/", "_")
            raise ValueError(f"declares {value.name}, whose entry must be called {wanted}")
        return register_topic(value)

    entry = name.replace("/", "_")
    loaded = load("topics", checked, only=entry)
    return loaded.found.get(entry), loaded.problems.get(entry, "")


find_with(_find)
