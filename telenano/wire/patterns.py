"""Patterns of names, such as `teleop/*`, with the wildcards of file names: `*`, `?`, `[...]`.

    if fault := fault_of_pattern(text):     # where a pattern is read
        raise ConfigError(fault)
    matches("teleop/forward", text)

The length of patterns is limited: matching takes time of the second or even third power of it, so a long pattern would
block a node for minutes.
"""

from fnmatch import fnmatchcase

# Twice the length of the longest name of a topic, node or field.
MOST_LETTERS = 128


def fault_of_pattern(text: str) -> str:
    """Return an error text if a pattern is too long, else an empty text."""
    if len(text) <= MOST_LETTERS:
        return ""
    return f"the pattern {text[:20]!r}... has {len(text)} letters, and at most {MOST_LETTERS} are read"


def matches(name: str, pattern: str) -> bool:
    """Return whether a name matches a pattern, with case; a pattern that is too long matches none."""
    return len(pattern) <= MOST_LETTERS and fnmatchcase(name, pattern)
