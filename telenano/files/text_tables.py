"""Reader of text tables of other programs: curves, spectra, records, delays and maps, with the units of their heads.

A table consists of rows of numbers, separated by tabs, semicolons, commas or blanks, below a head that may name the
columns and their units. If tabs or semicolons separate, a comma is a decimal comma. Comments (#, %, //, *) and a byte
order mark are skipped. Every interpretation that departs from the text is listed in the remarks.
"""

import math
import re
from array import array
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.files.regular_files import read_regular
from telenano.files.table_heads import COMMENT, LONGEST_LINE, named, split, split_head, titles_of
from telenano.files.units import Unit, unit_of
from telenano.wire.errors import ConfigError

Array = npt.NDArray[np.float64]

# Enough for a record of some seconds at some MHz, as text.
LARGEST_BYTES = 256_000_000
_MISSING = frozenset(("", "nan", "na", "n/a", "#n/a", "nat", "none", "null", "-", "--", "inf", "-inf", "+inf"))
_NUMBER = re.compile(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eEdD][-+]?\d+)?")
_SEPARATORS = ("\t", ";", "", ",")
_LONGEST_NUMBER = 64
# Most lines of a head, before the first row of numbers.
_LONGEST_HEAD = 4000
# A line after which the table begins, in files of Nanonis, NanoScope, LabVIEW, SPIP and others.
_BEGINS = re.compile(
    r"(?i)[\W_]*(?:\[data\]|file list end|end[ _]of[ _]header|end[ _]header|header[ _]end|start of data|begin of data|"
    r"begin data|daten|donn[eé]es|data)[\W_]*"
)
# Most lines of names and units below such a line.
_MOST_TITLES = 8
# A run of numeric rows in a head is shorter than `_SHORT_RUN`, and the table is `_TIMES_AS_LONG` times as long.
_SHORT_RUN = 16
_TIMES_AS_LONG = 4
# A run of this many rows must be the table.
_LONG_RUN = 400
# Most comments among the rows of a table that are kept.
_MOST_NOTES = 1000


class Column(NamedTuple):
    """A column: title as written, name without the unit, unit as written ("": none), line of the head (0: none).

    values: numbers in that unit, nan where missing, shape (n,); bad: line and text of the first cell that is no number.
    """

    title: str
    name: str
    unit: str
    line: int
    values: Array
    bad: tuple[int, str] | None = None

    @property
    def known(self) -> Unit | None:
        """The unit; None if the head names none or an unknown one."""
        return unit_of(self.unit)


class TextTable(NamedTuple):
    """A table: name of the file, columns, line number of each row, lines of the head, separator, and remarks.

    ends_whole: whether the last line has a line end; without one its last number may lack digits. notes: comments
    among the rows, each with the count of rows before it.
    """

    name: str
    columns: tuple[Column, ...]
    lines: npt.NDArray[np.int64]
    head: tuple[str, ...]
    separator: str
    decimal_comma: bool
    remarks: tuple[str, ...]
    ends_whole: bool = True
    notes: tuple[tuple[int, str], ...] = ()

    def find(self, *beginnings: str) -> Column | None:
        """Return the first column whose name begins with a word (in lower case), in order of the words, or None."""
        return next((one for word in beginnings for one in self.columns if one.name.lower().startswith(word)), None)

    def column(self, word: str) -> Column:
        """Return the column with a title, a name, or a number counted from 1.

        Raises:
            ConfigError: There is no such column; the message lists the columns.
        """
        word = word.strip()
        by_number = {str(number): one for number, one in enumerate(self.columns, start=1)}
        match = next((one for one in self.columns if word in (one.title, one.name)), by_number.get(word))
        if match is None:
            titles = ", ".join(one.title or "without a name" for one in self.columns[:20])
            raise ConfigError(f"{self.name}: has no column {word!r}; it has {len(self.columns)}, {titles}")
        return match

    def in_si(self, column: Column, wanted: Sequence[str], given: str = "", option: str = "") -> Array | None:
        """Return the values of a column in SI units, shape (n,); None if neither its head nor `given` names a unit.

        Args:
            column: A column of this table.
            wanted: The accepted units, up to a factor, such as ("m",).
            given: A unit that replaces that of the head.
            option: The command line option for `given`, for the error message.

        Raises:
            ConfigError: A cell is no number, or the unit is unknown or of another kind; the message names the line.
        """
        numbers = self.numbers(column)
        word = given or column.unit
        if not word:
            return None
        unit, kinds = unit_of(word), [unit_of(one) for one in wanted]
        in_head = f"{self.name}, line {column.line}: the unit {word!r} of {column.title!r}"
        where = f"{option} {given}" if given else in_head
        remedy = f"; {option} gives another" if option and not given else ""
        if unit is None:
            raise ConfigError(f"{where}: is not known; give one such as {', '.join(wanted)}, with a prefix{remedy}")
        if unit.powers not in [kind.powers for kind in kinds if kind]:
            raise ConfigError(f"{where}: is of another kind than {' or '.join(wanted)}, which is needed here{remedy}")
        return numbers * unit.factor

    def numbers(self, column: Column) -> Array:
        """Return the values of a column in the unit of the file, shape (n,).

        Raises:
            ConfigError: A cell is no number; the message names the line.
        """
        if column.bad:
            line, text = column.bad
            raise ConfigError(f"{self.name}, line {line}: {text[:40]!r} is not a number")
        return column.values

    def units_in_head(self, *wanted: str) -> set[str]:
        """Return the words of the head, as written, that are units of one of the wanted kinds."""
        kinds = [kind.powers for kind in map(unit_of, wanted) if kind]
        text = "\n".join(line for line in self.head if len(line) <= LONGEST_LINE)
        words = re.findall(r"\[([^\]\n]+)\]|\(([^()\n]+)\)|([^\s,;]+)", text)
        spaced = re.findall(r"\S+ ?/ ?(?:√|sqrt|root|rt) ?\(?Hz\)?|\S+ per (?:sqrt|root) ?\(?Hz\)?", text)
        words_of_head = {word.strip(" :,;'\"") for group in words for word in group if word} | set(spaced)
        words_of_head |= {
            word.removeprefix("(").removesuffix(")") for word in words_of_head if word.count("(") != word.count(")")
        }
        return {word for word in words_of_head if (unit := unit_of(word)) and unit.powers in kinds}

    @classmethod
    def read(cls, path: Path) -> "TextTable":
        """Read the table in a text file.

        Raises:
            ConfigError: The file cannot be read or has no valid table; the message names it and the line.
        """
        try:
            content = read_regular(path, LARGEST_BYTES)
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
        return cls.parse(content, str(path))

    @classmethod
    def parse(cls, content: bytes, name: str) -> "TextTable":
        """Parse the bytes of a text file, which errors call `name`; raise ConfigError as `read`."""
        text, remarks = decoded(content, name), []
        rows = text.splitlines()
        if not any(map(str.strip, rows)):
            raise ConfigError(f"{name}: is empty")
        first, separator, in_head = _first_row(rows, name)
        fold = _Folding(separator)
        ends_whole = text.endswith(("\n", "\r"))
        # The number of columns is that of most of the first rows.
        counts = [len(cells) for row in rows[first : first + 50] if row.strip() and _is_data(cells := fold.split(row))]
        width = max(set(counts), key=lambda count: (counts.count(count), count), default=0)
        # Leading rows of numbers with another width, such as a count of points, belong to the head.
        while width and len(fold.split(rows[first])) != width:
            first += 1
        width = width or len(fold.split(rows[first]))
        if in_head:
            places = ", ".join(
                f"{run.start + 1} to {run.end}" if run.end > run.start + 1 else f"{run.end}" for run in in_head[:4]
            )
            remarks.append(f"the table begins in line {first + 1}: the numbers in lines {places} are of its head")
        # Blank out rows of numbers in the head, which name no column.
        above = [
            "" if any(run.start <= place < run.end for run in in_head) else row
            for place, row in enumerate(rows[:first])
        ]
        _, titles = titles_of(above, width, separator)
        head = [row.strip() for row in rows[:first] if row.strip()]
        notes: list[tuple[int, str]] = []
        columns = [array("d") for _ in range(width)]
        lines = array("q")
        bad: dict[int, tuple[int, str]] = {}
        for number, row in enumerate(rows[first:], start=first + 1):
            if not row.strip() or (COMMENT.match(row) and not fold.is_numeric(row)):
                if row.strip() and len(notes) < _MOST_NOTES:
                    notes.append((len(lines), row.strip()))
                continue
            cells = fold.split(row)
            count, numbers = len(cells), [fold.number(cell, number) for cell in cells]
            if (count < width or None in numbers) and number == len(rows) and not ends_whole:
                remarks.append("its last line has no end and is not a complete row; it is left out")
                continue
            if all(value is None or math.isnan(value) for value in numbers) and None in numbers:
                raise ConfigError(f"{name}, line {number}: is not a line of numbers, after {len(lines)} that are")
            if count > width or (count < width and not separator):
                raise ConfigError(f"{name}, line {number}: has {count} columns, where the others have {width}")
            for place, value in enumerate([*numbers, *[math.nan] * (width - count)]):
                if value is None:
                    bad.setdefault(place, (number, cells[place]))
                    value = math.nan
                columns[place].append(value)
            lines.append(number)
        if fold.commas and fold.points:
            raise ConfigError(
                f"{name}: line {fold.commas} has a decimal comma and line {fold.points} a point; write one of them, and"
                " nothing between thousands"
            )
        # Count the names in the last line of the head; a sentence there names no column.
        last = next((row for row in reversed(head) if not fold.is_numeric(row)), "")
        names = len(split_head(last, separator)) if last and (separator in last or len(last.split()) == 1) else 0
        # No program writes 05 for an integer, so such digits follow a decimal comma.
        if (
            separator == ","
            and not fold.points
            and (0 < 2 * names == width or (not names and (fold.zeros or width == 4)))
        ):
            raise ConfigError(
                f"{name}, line {first + 1}: has {width} columns separated by commas and no decimal point: if the"
                " commas are decimal ones, separate the columns by semicolons or tabs"
            )
        if fold.commas:
            remarks.append("its commas are decimal ones")
        found = [
            Column(title, *named(title, unit), line, np.frombuffer(values, np.float64), bad.get(place))
            for place, ((title, unit, line), values) in enumerate(zip(titles, columns, strict=True))
        ]
        while len(found) > 1 and not found[-1].title and np.isnan(found[-1].values).all():
            found.pop()
        missing = sum(int(np.isnan(column.values).sum()) for column in found if not column.bad)
        if missing:
            remarks.append(f"{missing} of {len(found) * len(lines)} cells have no number")
        return TextTable(
            name, tuple(found), np.frombuffer(lines, np.int64), tuple(head), separator, bool(fold.commas),
            tuple(remarks), ends_whole, tuple(notes),
        )  # fmt: skip


# A number with marks between its thousands and another mark before its decimals, as in 1.001,74 or 1,001.74.
_GROUPED = re.compile(r"[+-]?\d{1,3}([.,])\d{3}(?:\1\d{3})*(?!\1)[.,]\d+(?:[eEdD][+-]?\d+)?")


def _ungrouped(cell: str) -> str:
    """Return a number without the marks between its thousands; another cell as it is."""
    found = _GROUPED.fullmatch(cell.strip()) if len(cell) <= _LONGEST_NUMBER else None
    return cell.replace(found[1], "") if found else cell


def as_number(cell: str) -> float | None:
    """Return the number in a cell with a decimal point or comma, nan for a word of a missing value, None for others."""
    if "_" in cell or len(cell) > _LONGEST_NUMBER:
        return None
    if not _NUMBER.fullmatch(cell):
        cell = _ungrouped(cell.strip().strip('"').replace("\u2212", "-"))
        if cell.lower() in _MISSING:
            return math.nan
        if not _NUMBER.fullmatch(cell):
            return None
    value = float(cell.replace(",", ".").replace("d", "e").replace("D", "e"))
    return value if math.isfinite(value) else math.nan


class _Run(NamedTuple):
    """A run of numeric rows [start, end), its separator, and the kind of line before it (blank, comment or text)."""

    start: int
    end: int
    separator: str
    after: str


class _Folding:
    """Splits the lines of a file by its column separator, and notes its decimal marks."""

    def __init__(self, separator: str) -> None:
        self.split = partial(split, separator=separator)
        # Number of the first line with a decimal comma, and of the first with a decimal point; 0 for none.
        self.commas, self.points = 0, 0
        # Whether an integer begins with a 0.
        self.zeros = False

    def number(self, cell: str, line: int) -> float | None:
        value = as_number(cell)
        if value is not None:
            cell = _ungrouped(cell)
            self.commas = self.commas or line * ("," in cell)
            self.points = self.points or line * ("." in cell)
            self.zeros = self.zeros or (cell[:1] == "0" and cell[1:].isdecimal())
        return value

    def is_numeric(self, row: str) -> bool:
        return all(as_number(cell) is not None for cell in self.split(row))


def decoded(content: bytes, name: str) -> str:
    """Decode a file as UTF-8, UTF-16 with byte order mark, or else Windows-1252; raise ConfigError for binary data."""
    try:
        if content.startswith((b"\xff\xfe", b"\xfe\xff")):
            return content.decode("utf-16")
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        # The encoding of older Windows programs, with their codes for µ and ².
        text = content.decode("cp1252", "replace")
    if "\0" in text:
        raise ConfigError(f"{name}: is not text: it has zero bytes")
    return text


def _is_data(cells: Sequence[str]) -> bool:
    numbers = [as_number(cell) for cell in cells]
    return None not in numbers and not all(math.isnan(value) for value in numbers if value is not None)


def _runs_of(rows: Sequence[str]) -> list[_Run]:
    """Return the runs of numeric rows among the first lines, up to the first that must be the table."""
    runs: list[_Run] = []
    after = ""
    for place, row in enumerate(rows[:_LONGEST_HEAD]):
        separator = _separator_of(row)
        if separator is None and runs and runs[-1].end == place and row.strip():
            last = runs[-1].separator
            separator = last if _is_empty(row, last) or _is_damaged(rows, place, last) else None
        if separator is None:
            after = "blank" if not row.strip() else after if after == "blank" else _break_of(row, after)
            continue
        if runs and runs[-1].end == place:
            runs[-1] = runs[-1]._replace(end=place + 1)
            if place + 1 - runs[-1].start >= _LONG_RUN:
                break
        else:
            runs.append(_Run(place, place + 1, separator, after))
        after = ""
    return runs


def _is_empty(row: str, separator: str) -> bool:
    """Return whether each cell of a row is a number or marks a missing one."""
    return all(as_number(cell) is not None for cell in split(row, separator))


def _is_damaged(rows: Sequence[str], place: int, separator: str) -> bool:
    """Return whether a row is a damaged numeric row rather than a title.

    It stands between two numeric rows, has as many cells as they, and some of them are numbers.
    """
    if place + 1 >= len(rows) or _separator_of(rows[place + 1]) != separator:
        return False
    before, here, behind = (split(rows[near], separator) for near in (place - 1, place, place + 1))
    return len(before) == len(here) == len(behind) and any(as_number(cell) is not None for cell in here)


def _break_of(row: str, before: str) -> str:
    return "comment" if COMMENT.match(row) and before in ("", "comment") else "text"


def _separator_of(row: str) -> str | None:
    """Return the separator of a numeric row; None for another row."""
    for separator in _SEPARATORS:
        cells = split(row, separator)
        # Blanks are the separator only between several cells or without a comma: 1,5 alone may be two columns.
        if separator in row and _is_data(cells) and (separator or len(cells) > 1 or "," not in row):
            return separator
    return None


def _first_row(rows: Sequence[str], name: str) -> tuple[int, str, tuple[_Run, ...]]:
    """Return the index of the first row of the table, its separator, and the runs of numeric rows in the head.

    The table begins below a line such as [DATA] or *File list end. Without one, a few numeric rows followed by a line
    of text or a blank one belong to the head if many more follow.
    """
    runs = _runs_of(rows)
    marks = [place for place, row in enumerate(rows[:_LONGEST_HEAD]) if _BEGINS.fullmatch(row.strip())]
    for mark in reversed(marks):
        below = [run for run in runs if mark < run.start <= mark + _MOST_TITLES]
        if below:
            return below[0].start, below[0].separator, tuple(run for run in runs if run.start < mark)
    for number, run in enumerate(runs):
        rest = [later for later in runs[number + 1 :] if later.after != "comment"]
        longest = max((later.end - later.start for later in rest), default=0)
        if run.end - run.start >= _SHORT_RUN or longest <= _TIMES_AS_LONG * (run.end - run.start):
            return run.start, run.separator, tuple(runs[:number])
    begin = rows[:_LONGEST_HEAD]
    # A table with a column of texts, such as machine names, beside columns of numbers, below a head without numbers.
    for place, (head, row) in enumerate(pairwise(begin), start=1):
        for separator in _SEPARATORS:
            above, numbers = split(head, separator), [as_number(cell) for cell in split(row, separator)]
            has_number = any(value is not None and not math.isnan(value) for value in numbers)
            if len(numbers) == len(above) > 1 and has_number and all(as_number(cell) is None for cell in above):
                return place, separator, ()
    raise ConfigError(f"{name}: has no line of numbers in its first {min(len(rows), _LONGEST_HEAD)} lines")
