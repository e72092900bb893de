"""Exceptions of the project: every error that a user can cause is one of these, and its text names a remedy."""

import re
from collections.abc import Iterable, Mapping
from typing import Any

from telenano.wire.printable import shown


def known_names(name: str, choices: Iterable[str]) -> str:
    """Return the valid names for an error text, `known are a, b`, after the one that was probably meant."""
    names = [str(choice) for choice in choices]
    meant = probably_meant(name, names).removeprefix("; ")
    return f"{meant} Known are {', '.join(names)}" if meant else f"known are {', '.join(names)}"


# Least similarity (ratio of `difflib`) of a typed name to the one meant; the second is for names of equal length.
_NEAR = 0.78
_NEAR_OF_LENGTH = 0.7


def probably_meant(name: str, choices: Iterable[str]) -> str:
    """Return `; did you mean NAME?` with the nearest of the choices; empty if none is near.

    If the name is the first part of others, as `afm` of `afm/state`, all of those are named. Case and the dashes of an
    option are ignored. A choice of another length must be more similar, because short names share letters by chance.
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
    """Return the names that contain a word, or else those whose description does.

    Args:
        word: The typed text, such as `delay_ms`; searched as a whole first, then its first word.
        abouts: The description of each name.
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
    """Base of every error that the project raises on purpose; each argument is one line of its text."""

    def __str__(self) -> str:
        return "\n".join(self.lines)

    def __reduce__(self) -> tuple[Any, ...]:
        # An error crosses from the processes of a pool, whatever the arguments of its class are.
        return _again, (type(self), self.args, self.__dict__)

    @property
    def lines(self) -> tuple[str, ...]:
        """The lines of the text as they are printed."""
        return tuple(map(str, self.args))

    @property
    def facts(self) -> dict[str, Any]:
        """What a program reads beside the text, as plain data by key."""
        return {}


def _again(kind: type[TelenanoError], lines: tuple[Any, ...], facts: dict[str, Any]) -> TelenanoError:
    error = kind.__new__(kind, *lines)
    error.__dict__.update(facts)
    return error


def described(error: BaseException) -> str:
    """Return class and text of an error, made safe to print because foreign code may have written the text.

    An error without text is described by its class alone, and an exception group with the errors in it.
    """
    name = shown(type(error).__name__)
    try:
        text = shown(error)
        inner = [described(each) for each in error.exceptions] if isinstance(error, BaseExceptionGroup) else []
    # Foreign code makes this text and may raise anything.
    except BaseException:  # noqa: BLE001
        return f"{name}, whose text cannot be made"
    whole = f"{name}: {text}" if text else name
    return shown(f"{whole}: {'; '.join(inner)}", 3 * len(whole) + 1000) if inner else whole


def cause(error: BaseException) -> str:
    """Return the reason of a failure for a person: the text of a project's error, or class and text of another one."""
    if isinstance(error, TelenanoError):
        return str(error)
    if isinstance(error, OSError):
        return f"the connection is gone: {error.strerror or error}"
    return f"an unexpected answer: {described(error)}"[:200]


class ConfigError(TelenanoError):
    """A configuration, scenario or site file is missing or wrong; the text names file and key."""


class LockstepError(ConfigError):
    """A scenario has a part of which a session in lockstep has no model; the nodes can run it."""


class NoEstimateError(ConfigError):
    """A measurement does not tell the value that was asked for; the text says why, and what would tell it."""


class EndpointError(TelenanoError):
    """A socket cannot be bound or connected; the text names the endpoint and, if known, the process that holds it."""


class RefusedError(TelenanoError):
    """A session/control command was refused by a node; the text goes into the session/event."""


class LaterError(TelenanoError):
    """A node prepares a session/control command in another process; it executes and answers a later copy of it."""


class PackageError(TelenanoError):
    """The code of an installed package failed; the text names the package and the place in it."""


class RecordingError(TelenanoError):
    """A recording cannot be written or read; the text names the file."""


class NoRecordingError(RecordingError):
    """The named recording does not exist."""


class ExistsError(RecordingError):
    """The named result exists already and is not overwritten."""


class ReportError(RecordingError):
    """The files of a report cannot be written; `summary` is their content, as plain values."""

    def __init__(self, text: str, summary: dict[str, Any]) -> None:
        super().__init__(text)
        self.summary = summary


class RigError(TelenanoError):
    """The rig could not be started, kept running or reached; the text names the node and its last message."""
