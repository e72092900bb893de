"""The exceptions: whatever a user can cause raises one of these; the text names what would be right."""

import re
from collections.abc import Iterable, Mapping
from typing import Any

from telenano.wire.printable import shown


def known_names(name: str, choices: Iterable[str]) -> str:
    """Return the names that there are, for an error, after the one that was probably meant: `known are a, b`."""
    names = [str(choice) for choice in choices]
    meant = probably_meant(name, names).removeprefix("; ")
    return f"{meant} Known are {', '.join(names)}" if meant else f"known are {', '.join(names)}"


# The least shares of letters in common, as `difflib` counts them, of a name that is meant by another one.
_NEAR = 0.78
_NEAR_OF_LENGTH = 0.7


def probably_meant(name: str, choices: Iterable[str]) -> str:
    """Return `; did you mean NAME?` with the nearest of some names, empty where none is near.

    Of a name that is the first part of others, as `afm` is of `afm/state`, all of them are meant. Capitals do not
    matter, nor do the dashes before an option. A short name has many others that share letters with it, so that
    one of another length has to share more.
    """
    from difflib import get_close_matches

    others = [choice for choice in choices if choice != name]
    typed = name.lower().lstrip("-")
    if parts := [choice for choice in others if typed and choice.lower().startswith((f"{typed}.", f"{typed}/"))]:
        return f"; did you mean {' or '.join(parts)}?"
    lowered = {choice.lower().lstrip("-"): choice for choice in reversed(others)}
    near = get_close_matches(typed, list(lowered), n=1, cutoff=_NEAR) or get_close_matches(
        typed, [each for each in lowered if len(each) == len(typed)], n=1, cutoff=_NEAR_OF_LENGTH
    )
    return f"; did you mean {lowered[near[0]]}?" if near else ""


def named_by(word: str, abouts: Mapping[str, str]) -> list[str]:
    """Return the names that a word means which is none of them: it is a word of the name, or of what is said of it.

    Args:
        word: What was typed, such as `delay_ms`; the whole of it comes before its first word.
        abouts: What is said of each name.
    """
    whole = re.sub(r"[^a-z0-9]+", " ", word.lower()).strip()
    for typed in dict.fromkeys([whole, *whole.split()[:1]]):
        for texts in ({name: name for name in abouts}, abouts):
            found = [
                name for name, text in texts.items() if f" {typed} " in f" {re.sub('[^a-z0-9]+', ' ', text.lower())} "
            ]
            if typed and found:
                return found
    return []


class TelenanoError(Exception):
    """Base of every error that the project raises on purpose; of a text of several lines each is an argument."""

    def __str__(self) -> str:
        return "\n".join(self.lines)

    @property
    def lines(self) -> tuple[str, ...]:
        """Return the text as it is printed: each is one line, whatever the names in it are."""
        return tuple(map(str, self.args))


def described(error: BaseException) -> str:
    """Return class and text of an error, of which the text may be a stranger's: the class alone where it has none.

    A group of errors has the text of each as well, which its own does not say.
    """
    name = shown(type(error).__name__)
    try:
        text = shown(error)
        inner = [described(each) for each in error.exceptions] if isinstance(error, BaseExceptionGroup) else []
    # The code of a stranger makes this text, and may raise anything.
    except BaseException:  # noqa: BLE001
        return f"{name}, whose text cannot be made"
    whole = f"{name}: {text}" if text else name
    return shown(f"{whole}: {'; '.join(inner)}", 3 * len(whole) + 1000) if inner else whole


def cause(error: BaseException) -> str:
    """Return why something failed, for a person: a text that was written for one, or class and text of the surprise."""
    if isinstance(error, TelenanoError):
        return str(error)
    if isinstance(error, OSError):
        return f"the connection is gone: {error.strerror or error}"
    return f"an unexpected answer: {described(error)}"[:200]


class ConfigError(TelenanoError):
    """A configuration, scenario or site file is missing or wrong; the text names file and key."""


class EndpointError(TelenanoError):
    """A socket cannot be bound or connected; the text names the endpoint and who holds it, where that is known."""


class RefusedError(TelenanoError):
    """A session/control command was refused by a node; the text goes into the session/event."""


class PackageError(TelenanoError):
    """The code of an installed package failed; the text names the package and the place in it."""


class RecordingError(TelenanoError):
    """A recording cannot be written or read; the text names the file."""


class NoRecordingError(RecordingError):
    """A recording that was named is not there."""


class ExistsError(RecordingError):
    """The result that was named is there already, and is not overwritten."""


class ReportError(RecordingError):
    """The files of a report cannot be written; `summary` is their content, as plain values."""

    def __init__(self, text: str, summary: dict[str, Any]) -> None:
        super().__init__(text)
        self.summary = summary


class RigError(TelenanoError):
    """The rig could not be started, kept running or reached; the text names the node and its last message."""
