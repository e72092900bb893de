"""Patterns of names as a person writes them, such as `teleop/*`, with the wildcards of file names: `*`, `?`, `[...]`.

    if fault := fault_of_pattern(text):     # where a pattern is read
        raise ConfigError(fault)
    matches("teleop/forward", text)

Comparing a name with a pattern takes the square of the length of the pattern, and for some the cube, so that a long one
would keep a node for minutes.
"""

from fnmatch import fnmatchcase

# The longest name of a topic, node or field has half of this.
MOST_LETTERS = 128


def fault_of_pattern(text: str) -> str:
    """Return why a text is not taken for a pattern, empty where it is."""
    if len(text) <= MOST_LETTERS:
        return ""
    return f"the pattern {text[:20]!r}... has {len(text)} letters, and at most {MOST_LETTERS} are read"


def matches(name: str, pattern: str) -> bool:
    """Return whether a pattern means a name; one that is too long means none."""
    return len(pattern) <= MOST_LETTERS and fnmatchcase(name, pattern)
