"""Escaping of untrusted text for a terminal: names, titles and errors of files, packages and messages.

A terminal interprets some characters as commands: to set colours, to erase or overwrite a line, to set its title, to
send an answer. Characters of writing direction show a text in another order than it has. A lone surrogate, which a file
name or a message may contain, cannot be written at all.

    printable(text)     # for a terminal: each such character is replaced by its escape
    one_line(text)      # a sentence: its line breaks are escaped, too
    shown(name)         # an untrusted text within a sentence: shortened, and without backticks
    quoted(path)        # a path within a command that a person can paste
"""

import os
import re
import shlex

# C0 except tab and line feed, DEL and C1; marks of direction; line separators other than line feed; surrogates.
_ORDERS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
_BREAKS = re.compile(f"{_ORDERS.pattern[:-1]}\t\n]")
_MARKS = re.compile(f"{_ORDERS.pattern[:-1]}\t\n`]")
# Most characters of an untrusted text in a sentence.
_LONGEST = 200


def printable(text: str) -> str:
    """Return a text in which each character that a terminal would interpret is escaped."""
    return _ORDERS.sub(_number, text)


def one_line(text: str) -> str:
    """Return a text as one line: as `printable`, with tabs and line breaks escaped as well."""
    return _BREAKS.sub(_number, text)


def shown(text: object, most: int = _LONGEST) -> str:
    """Return an untrusted text for use in a sentence: one line of at most `most` characters, without backticks.

    Our sentences put commands that can be pasted between backticks; foreign backticks are escaped.
    """
    whole = str(text)
    part = _MARKS.sub(_number, whole[:most])
    return part if len(whole) <= most else f"{part}... ({len(whole)} characters)"


def quoted(path: str | os.PathLike[str]) -> str:
    """Return a path for a shell command: quoted, and with `./` before a leading dash so that it is no option."""
    text = os.fspath(path)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def _number(found: "re.Match[str]") -> str:
    letter = found[0]
    return "\\x60" if letter == "`" else letter.encode("unicode_escape").decode()
