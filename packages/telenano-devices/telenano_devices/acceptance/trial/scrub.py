"""Removes names, paths, hosts and addresses from every text of a trial before it is written."""

import getpass
import os
import re
import socket
from collections.abc import Iterable
from pathlib import Path
from typing import Any

_LEAST_LETTERS = 2
_GENERAL: tuple[tuple[str, str], ...] = (
    (r"\b\w+://[^\s,;'\"]+", "(address)"),
    (r"[\w.+-]+@[\w.-]+", "(address)"),
    (r"\b\d{1,3}(?:\.\d{1,3}){3}(?::\d+)?\b", "(address)"),
    (r"(?<![\w:])(?:[0-9A-Fa-f]{0,4}:){3,7}[0-9A-Fa-f]{0,4}(?![\w:])", "(address)"),
    (r"\blocalhost(?::\d+)?\b", "(address)"),
    # Absolute paths of any system; units like N/m and 1/s have a letter or digit before the slash.
    (r"(?<![\w/.)])~?(?:/[\w.@+\-]+)+/?", "(path)"),
    (r"\b[A-Za-z]:\\[^\s,;'\"]+", "(path)"),
)


def _known() -> dict[str, str]:
    """Return the texts that name this person, machine or folder, with the replacement of each."""
    places = {str(Path.cwd()): "(folder)", str(Path.home()): "(home)"}
    for name in (os.environ.get("HOME", ""), os.environ.get("PWD", "")):
        places.setdefault(name, "(folder)")
    try:
        users = {getpass.getuser(), *(os.environ.get(name, "") for name in ("USER", "LOGNAME", "USERNAME"))}
    except (OSError, KeyError, ImportError):
        users = set()
    hosts = {socket.gethostname(), socket.gethostname().partition(".")[0], os.environ.get("HOSTNAME", "")}
    folders = {part for path in tuple(places) for part in Path(path).parts[1:] if len(part) > _LEAST_LETTERS}
    places |= dict.fromkeys(folders, "(folder)") | dict.fromkeys(hosts, "(host)") | dict.fromkeys(users, "(user)")
    return places


class Scrubber:
    """Removes names, paths, hosts and addresses from texts.

    Args:
        given: Names from the command line, such as files, ports and hosts.
        kept: Words that stay, such as the name of the driver, even if a user or a host has the same name.
    """

    def __init__(self, given: Iterable[str] = (), kept: Iterable[str] = ()) -> None:
        keep = {word.lower() for word in kept}
        replacements = _known() | dict.fromkeys(given, "(given)")
        replacements = {
            text: stand
            for text, stand in replacements.items()
            if len(text) >= _LEAST_LETTERS and text.lower() not in keep
        }
        # The longest come first, so that no part of a path is left.
        ordered = sorted(replacements, key=len, reverse=True)
        self._stands = {text.lower(): stand for text, stand in replacements.items()}
        self._pattern = re.compile("|".join(rf"(?<!\w){re.escape(text)}(?!\w)" for text in ordered) or "(?!)", re.I)

    def text(self, value: str) -> str:
        """Return a text with every name, path, host and address replaced."""
        for pattern, stand in _GENERAL[:5]:
            value = re.sub(pattern, stand, value)
        value = self._pattern.sub(lambda match: self._stands[match[0].lower()], value)
        for pattern, stand in _GENERAL[5:]:
            value = re.sub(pattern, stand, value)
        return re.sub(r"\((home|folder|given)\)(?:/[\w.@+\-]+)+/?", "(path)", value)

    def all(self, value: Any) -> Any:
        """Return a nested value of tuples, lists, dicts and plain values with every text scrubbed; keys stay."""
        if isinstance(value, str):
            return self.text(value)
        if isinstance(value, dict):
            return {key: self.all(one) for key, one in value.items()}
        if isinstance(value, tuple) and hasattr(value, "_fields"):
            return type(value)(*map(self.all, value))
        if isinstance(value, list | tuple):
            return type(value)(map(self.all, value))
        return value
