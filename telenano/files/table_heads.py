"""Parsing of the head of a text table: title, name and unit of each column, from the lines above the numbers."""

import csv
import re
from collections.abc import Sequence

from telenano.files.units import unit_of

COMMENT = re.compile(r"\s*(?:#|%|//|\*|!)+\s*")
_ROW_NAMES = re.compile(r"(?i)\s*(?:columns?|fields?|names?|units?|headers?)\s*[:=]\s*")
# Words in the brackets of a column's name that are no unit.
_DIRECTIONS = re.compile(
    r"(?i)(?:fwd|bwd|forward|backward|avg|filt|raw|trace|retrace|approach|retract|extend|rel|abs(?:olute)?|"
    r"meas(?:ured)?|piezo|sensor|\d+)"
)
# A unit after an underscore at the end of a name, often in lower case, before a word for the branch: z_nm, Defl_pN_Ex.
_SUFFIX = re.compile(r"(.+)_([munpkMµ]?(?:s|m|[Vv]|[Hh]z|N)|[nup]n|percent)(_(?i:ex|rt|extend|re\w+|approach|trace))?")
# Longer lines of a head are not searched for units, because the search takes the square of their length.
LONGEST_LINE = 4000


def split(row: str, separator: str) -> list[str]:
    """Return the cells of a line without surrounding quotes and blanks; an empty separator means any whitespace."""
    if not separator:
        return row.split()
    if '"' in row and row.count('"') % 2 == 0 and len(row) < csv.field_size_limit():
        cells = next(csv.reader([row.strip("\r\n")], delimiter=separator))
    else:
        cells = row.strip("\r\n ").split(separator)
    return [cell.strip() for cell in cells]


def _bare(row: str) -> str:
    """Return a line of a head without a leading comment mark and a leading word such as `units:`."""
    comment = COMMENT.match(row)
    row = row[comment.end() :] if comment else row
    word = _ROW_NAMES.match(row)
    return row[word.end() :] if word else row


def split_head(row: str, separator: str) -> list[str]:
    """Return the titles in a line of a head; a unit in brackets or after a slash stays with the word before it."""
    row = _bare(row)
    if separator:
        return split(row, separator)
    joined = re.sub(r"\s+(?=[\[(])", "\x00", row)
    return [word.replace("\x00", " ") for word in re.sub(r"\s+/\s+", "\x01", joined).split()]


def titles_of(rows: Sequence[str], width: int, separator: str) -> tuple[list[str], list[tuple[str, str, int]]]:
    """Return the lines of the head, and for each of `width` columns its title, its unit and its line number.

    The unit comes from a separate row of units and is empty without one. Line numbers count from 1; 0 means that the
    head names no columns.
    """
    head = [row.strip() for row in rows if row.strip()]
    numbered = [(number, row) for number, row in enumerate(rows, start=1) if row.strip()]
    fitting = []
    for number, row in numbered[-1:-6:-1]:
        if len(row) > LONGEST_LINE * width:
            break
        plain = _bare(row)
        ways = (
            split_head(row, separator),
            *(split(plain, mark) for mark in "\t;,"),
            re.split(r"\s{2,}", plain.strip()),
        )
        fits = [way for way in ways if len(way) == width] or [
            full for way in ways if len(full := list(filter(None, way))) == width
        ]
        if not fits:
            break
        fitting.append((number, [cell.strip().strip("\"'").replace("\x01", " / ") for cell in fits[0]]))
    if not fitting:
        return head, [("", "", 0)] * width
    line, titles = fitting[0]
    units = [title.strip("[](){} ") for title in titles]
    if len(fitting) > 1 and any(map(unit_of, units)) and all(unit_of(word) or word in ("", "-", "#") for word in units):
        return head, [(title, unit, line) for title, unit in zip(fitting[1][1], units, strict=True)]
    return head, [(title, "", line) for title in titles]


def named(title: str, unit: str) -> tuple[str, str]:
    """Return the name of a column without its unit, and the unit as written; empty if there is none."""
    if unit:
        return title, unit
    if unit_of(title):
        return "", title
    for mark in (r"\s+in\s+", r",\s*", r"\s+/\s+", r":\s*"):
        parts = re.split(mark, title, maxsplit=1)
        if len(parts) == 2 and parts[0] and unit_of(parts[1]):
            return parts[0], parts[1]
    rest, bracketed = _bracketed(title)
    while bracketed and _DIRECTIONS.fullmatch(bracketed):
        rest, bracketed = _bracketed(rest)
    if bracketed:
        return rest, bracketed
    for parts in (title.split("/", 1), title.rsplit(None, 1)):
        if len(parts) == 2 and parts[0] and unit_of(parts[1]) and not parts[1].isdigit():
            return parts[0], parts[1]
    if by := _SUFFIX.fullmatch(title):
        return by[1] + (by[3] or ""), re.sub("n$", "N", by[2].replace("percent", "%"))
    if title.endswith("_n") and re.match(r"(?i)f(orce)?_|load", title):
        return title[:-2], "N"
    return title, ""


def _bracketed(title: str) -> tuple[str, str]:
    """Return the text before the brackets at the end of a title, and the text in them; empty without such brackets."""
    title, depth = title.strip(), 0
    for place in range(len(title) - 1, -1, -1):
        depth += (title[place] in ")]}") - (title[place] in "([{")
        if depth == 0:
            inner = title[place + 1 : -1].strip()
            return (title[:place].strip(), inner) if inner else (title, "")
    return title, ""
