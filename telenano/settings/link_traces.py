"""Parse the files that drive the link: delay and loss over time, delivery opportunities, jitter samples.

The files are text with one record a line; `#` begins a comment, empty lines are skipped. Every error names file and
line but quotes no content: a client that may set the link could otherwise read any file that the node can read.
"""

from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from telenano.files.held_files import standing
from telenano.wire.errors import ConfigError

T = TypeVar("T")
TraceKind = Literal["delay", "loss", "delivery", "table"]
# The columns of a file: times [ns] and values of a trace, or one of the two.
Columns = tuple["array[Any] | memoryview[Any]", ...]

LARGEST_FILE_BYTES = 32_000_000
# The longest delay in a trace [s].
_LONGEST_DELAY_S = 3600.0
# The largest sample of a jitter table, in its own unit.
_LARGEST_SAMPLE = 1e6
# The latest time in a trace [s].
_LONGEST_TRACE_S = 1e9


class DelayCourse(NamedTuple):
    """A delay over time: strictly increasing times_ns from the origin, delays_ns >= 0, both not empty."""

    times_ns: Sequence[int]
    delays_ns: Sequence[int]


class LossCourse(NamedTuple):
    """Loss over time: whether messages are lost from each of times_ns to the next; increasing, from the origin."""

    times_ns: Sequence[int]
    lost: Sequence[bool]


def read_text(path: Path) -> str:
    """Return the text of a trace.

    Raises:
        ConfigError: It is not a file, too large, or not UTF-8 text; the message names the file.
    """
    path = standing(path)
    try:
        # A device or a pipe would never end, and the link would stand still while it reads.
        if not path.is_file():
            raise ConfigError(f"{path}: is not a file")
        size = path.stat().st_size
        # A file that the kernel generates while it is read has no size, and may have no end.
        if size == 0:
            raise ConfigError(f"{path}: is empty")
        if size > LARGEST_FILE_BYTES:
            raise ConfigError(f"{path}: is larger than {LARGEST_FILE_BYTES} bytes")
        text = path.read_text(encoding="utf-8")
        if text.startswith(("PING ", "Pinging ")):
            raise ConfigError(f"{path}: is what ping printed; `telenano link fit` makes settings and traces of it")
        return text
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text") from error


def read_columns(
    path: Path, kind: TraceKind, name: str, *, by_number: bool = False, unit_s: float = 1.0
) -> tuple["array[Any]", ...]:
    """Read and parse a file; return its columns as arrays, those of a table of jitter in ascending order.

    Args:
        path: The file.
        kind: Its kind, which determines the columns.
        name: Its name in errors.
        by_number: Whether the first column of a delay or loss trace counts messages.
        unit_s: The unit of the times of a delivery trace [s].

    Raises:
        ConfigError: The file cannot be used; the message names file and line.
    """
    text = read_text(path)
    match kind:
        case "delay":
            course = parse_delay_trace(text, name, by_number=by_number)
            return array("q", course.times_ns), array("q", course.delays_ns)
        case "loss":
            losses = parse_loss_trace(text, name, by_number=by_number)
            return array("q", losses.times_ns), array("b", losses.lost)
        case "delivery":
            return (array("q", parse_delivery_trace(text, name, unit_s)),)
        case "table":
            return (array("d", sorted(parse_jitter_table(text, name))),)


def columns_in_child(
    path: str, kind: TraceKind, name: str, by_number: str, unit_s: str
) -> tuple[dict[str, str], list[npt.NDArray[Any]]]:
    """Return the type codes and the columns of `read_columns`, for `limited_child`, which passes texts.

    Raises:
        ConfigError: The file cannot be used; the message names file and line.
    """
    columns = read_columns(Path(path), kind, name, by_number=by_number == "True", unit_s=float(unit_s))
    codes = "".join(column.typecode for column in columns)
    return {"codes": codes}, [np.frombuffer(column, dtype=column.typecode) for column in columns]


def parse_delay_trace(text: str, name: str, *, by_number: bool = False) -> DelayCourse:
    """Return the course of a delay trace: lines `time_s delay_s`, times from 0 on, strictly increasing.

    With by_number the first column is the number of messages instead of the time; each counts as a second.

    Raises:
        ConfigError: A line is wrong; the message names file and line.
    """

    def delay_ns(words: Sequence[str], place: str) -> int:
        if len(words) != 1:
            raise ConfigError(f"{place}: is not a pair `time_s delay_s`")
        return round(_number(words[0], place, 0.0, _LONGEST_DELAY_S) * 1e9)

    return DelayCourse(*_course(_rows(text, name, delay_ns, by_number=by_number), name, "time_s delay_s"))


def parse_loss_trace(text: str, name: str, *, by_number: bool = False) -> LossCourse:
    """Return the course of a loss trace: lines `time_s lost`, times from 0 on, strictly increasing, lost 0 or 1.

    With by_number the first column is the number of messages instead of the time; each counts as a second.

    Raises:
        ConfigError: A line is wrong; the message names file and line.
    """

    def lost(words: Sequence[str], place: str) -> bool:
        if len(words) != 1 or words[0] not in ("0", "1"):
            raise ConfigError(f"{place}: is not a pair `time_s lost`, with 1 for lost and 0 for not")
        return words[0] == "1"

    return LossCourse(*_course(_rows(text, name, lost, by_number=by_number), name, "time_s lost"))


def parse_delivery_trace(text: str, name: str, unit_s: float) -> tuple[int, ...]:
    """Return the delivery opportunities [ns from the origin]: one time a line, in units of unit_s, not decreasing.

    A repeated time is one more opportunity at that time. The last time is the period of the trace, so it must
    be greater than 0.

    Raises:
        ConfigError: A line is wrong; the message names file and line.
    """
    times_ns: list[int] = []
    for number, words in _lines(text):
        place = f"{name}, line {number}"
        if len(words) != 1:
            raise ConfigError(f"{place}: is not one time")
        time_ns = round(_number(words[0], place, 0.0, _LONGEST_TRACE_S / unit_s) * unit_s * 1e9)
        if times_ns and time_ns < times_ns[-1]:
            raise ConfigError(f"{place}: the time is earlier than the one before it")
        times_ns.append(time_ns)
    if not times_ns or times_ns[-1] == 0:
        raise ConfigError(f"{name}: the last time is the period of the trace and must be greater than 0")
    return tuple(times_ns)


def parse_jitter_table(text: str, name: str) -> tuple[float, ...]:
    """Return the samples of a jitter table: finite numbers separated by white space.

    Raises:
        ConfigError: A line is wrong; the message names file and line.
    """
    samples = tuple(
        _number(word, f"{name}, line {number}", -_LARGEST_SAMPLE, _LARGEST_SAMPLE)
        for number, words in _lines(text)
        for word in words
    )
    if not samples:
        raise ConfigError(f"{name}: holds no samples")
    return samples


def _rows(
    text: str, name: str, value_of: Callable[[Sequence[str], str], T], *, by_number: bool
) -> Iterator[tuple[int, int, T]]:
    """Yield line number, time [ns] and value of each record; value_of converts the words after the first."""
    for number, words in _lines(text):
        place = f"{name}, line {number}"
        value = value_of(words[1:], place)
        yield number, _place_ns(words[0], place, by_number=by_number), value


def _course(rows: Iterable[tuple[int, int, T]], name: str, wanted: str) -> tuple[tuple[int, ...], tuple[T, ...]]:
    """Return times [ns] and values of rows; ConfigError names the line whose time is not later than the one before."""
    times_ns: list[int] = []
    values: list[T] = []
    for number, time_ns, value in rows:
        if times_ns and time_ns <= times_ns[-1]:
            raise ConfigError(f"{name}, line {number}: the time is not later than the one before it")
        times_ns.append(time_ns)
        values.append(value)
    if not times_ns:
        raise ConfigError(f"{name}: holds no line `{wanted}`")
    return tuple(times_ns), tuple(values)


def _lines(text: str) -> Iterator[tuple[int, list[str]]]:
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        if words:
            yield number, words


def _place_ns(word: str, place: str, *, by_number: bool) -> int:
    value = _number(word, place, 0.0, _LONGEST_TRACE_S)
    if by_number and not value.is_integer():
        raise ConfigError(f"{place}: by number, the first column counts messages and is a whole number")
    return round(value * 1e9)


def _number(word: str, place: str, low: float, high: float) -> float:
    try:
        value = float(word)
    except ValueError:
        # The cause is left out because it holds the word itself.
        raise ConfigError(f"{place}: is not a number") from None
    if not low <= value <= high:
        raise ConfigError(f"{place}: is not a number from {low:g} to {high:g}")
    return value
