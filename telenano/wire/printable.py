"""Text of others on a terminal: titles, names and errors of files, packages and messages are shown, never obeyed.

A terminal takes some characters for orders: to colour, to erase or overwrite a line, to set its title, to answer with
what it is sent. Characters that turn the direction of writing show a text in another order than it has. Half of a
character, which a file name or a message may have, cannot be written at all.

    printable(text)     # what is written to a terminal: each such character is its number
    one_line(text)      # a sentence: no part of it begins a line of its own
    shown(name)         # the text of a stranger inside a sentence: no quotation mark of ours ends or begins in it
    quoted(path)        # a path within a command that a person pastes
"""

import os
import re
import shlex

# C0 but tabulator and line feed, DEL and C1; marks of direction; what separates lines besides a line feed; surrogates
_ORDERS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
_BREAKS = re.compile(f"{_ORDERS.pattern[:-1]}\t\n]")
_MARKS = re.compile(f"{_ORDERS.pattern[:-1]}\t\n`]")
# A sentence has at most this many characters of a text that a stranger wrote.
_LONGEST = 200


def printable(text: str) -> str:
    """Return a text with each character that a terminal would obey written out as its number."""
    return _ORDERS.sub(_number, text)


def one_line(text: str) -> str:
    """Return a text with its line breaks written out as well, so that it is one line."""
    return _BREAKS.sub(_number, text)


def shown(text: object, most: int = _LONGEST) -> str:
    """Return the text of a stranger for a sentence: one line of bounded length that ends no quotation of ours.

    A sentence puts a command that can be pasted between backticks; those of a stranger are written out.
    """
    whole = str(text)
    part = _MARKS.sub(_number, whole[:most])
    return part if len(whole) <= most else f"{part}... ({len(whole)} characters)"


def quoted(path: str | os.PathLike[str]) -> str:
    """Return a path as it is pasted into a command: quoted, and never read as an option."""
    text = os.fspath(path)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def _number(found: "re.Match[str]") -> str:
    letter = found[0]
    return "\\x60" if letter == "`" else letter.encode("unicode_escape").decode()
