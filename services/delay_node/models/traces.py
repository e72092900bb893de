"""Files that drive the link: delay over time, delivery opportunities, jitter samples.

Text, one record a line; `#` begins a comment, empty lines are skipped. Every error names file and line.
"""

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from proto.errors import ConfigError

LARGEST_FILE_BYTES = 32_000_000


class DelayCourse(NamedTuple):
    """A delay over time: strictly increasing times_ns from the origin, delays_ns >= 0, both not empty."""

    times_ns: tuple[int, ...]
    delays_ns: tuple[int, ...]


def read_text(path: Path) -> str:
    """Return the text of a trace.

    Raises: ConfigError naming the file, if it is not a file, too large, or not UTF-8 text.
    """
    try:
        # A device or a pipe would never end, and the link would stand still while it reads.
        if not path.is_file():
            raise ConfigError(f"{path}: is not a file")
        if path.stat().st_size > LARGEST_FILE_BYTES:
            raise ConfigError(f"{path}: is larger than {LARGEST_FILE_BYTES} bytes")
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error


def parse_delay_trace(text: str, name: str) -> DelayCourse:
    """Return the course of a delay trace: lines `time_s delay_s`, times from 0 on, strictly increasing.

    Raises: ConfigError naming file and line.
    """
    times_ns: list[int] = []
    delays_ns: list[int] = []
    for number, words in _lines(text):
        place = f"{name}, line {number}"
        if len(words) != 2:
            raise ConfigError(f"{place}: {_shown(words)} is not a pair `time_s delay_s`")
        time_ns, delay_ns = (round(_not_negative(word, place) * 1e9) for word in words)
        if times_ns and time_ns <= times_ns[-1]:
            raise ConfigError(f"{place}: time {words[0]} s is not later than {times_ns[-1] / 1e9} s before it")
        times_ns.append(time_ns)
        delays_ns.append(delay_ns)
    if not times_ns:
        raise ConfigError(f"{name}: holds no line `time_s delay_s`")
    return DelayCourse(tuple(times_ns), tuple(delays_ns))


def parse_delivery_trace(text: str, name: str, unit_s: float) -> tuple[int, ...]:
    """Return the delivery opportunities [ns from the origin]: one time a line, in units of unit_s, not decreasing.

    A repeated time is one more opportunity at that time. The last time is the period of the trace, so it must
    be greater than 0.

    Raises: ConfigError naming file and line.
    """
    times_ns: list[int] = []
    for number, words in _lines(text):
        place = f"{name}, line {number}"
        if len(words) != 1:
            raise ConfigError(f"{place}: {_shown(words)} is not one time")
        time_ns = round(_not_negative(words[0], place) * unit_s * 1e9)
        if times_ns and time_ns < times_ns[-1]:
            raise ConfigError(f"{place}: time {words[0]} is earlier than the one before it")
        times_ns.append(time_ns)
    if not times_ns or times_ns[-1] == 0:
        raise ConfigError(f"{name}: the last time is the period of the trace and must be greater than 0")
    return tuple(times_ns)


def parse_jitter_table(text: str, name: str) -> tuple[float, ...]:
    """Return the samples of a jitter table: finite numbers separated by white space.

    Raises: ConfigError naming file and line.
    """
    samples = tuple(_number(word, f"{name}, line {number}") for number, words in _lines(text) for word in words)
    if not samples:
        raise ConfigError(f"{name}: holds no samples")
    return samples


def _lines(text: str) -> Iterator[tuple[int, list[str]]]:
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        if words:
            yield number, words


def _shown(words: list[str]) -> str:
    """Return a line for an error text; short, because the text goes over the bus."""
    return repr(" ".join(words)[:40])


def _number(word: str, place: str) -> float:
    try:
        value = float(word)
    except ValueError as error:
        raise ConfigError(f"{place}: {_shown([word])} is not a number") from error
    if not math.isfinite(value):
        raise ConfigError(f"{place}: {word!r} is not finite")
    return value


def _not_negative(word: str, place: str) -> float:
    value = _number(word, place)
    if value < 0.0:
        raise ConfigError(f"{place}: {word} is negative")
    return value


def delay_at(course: DelayCourse, elapsed_ns: int, *, interpolation: Literal["hold", "linear"], repeat: bool) -> int:
    """Return the delay [ns] of a course at a time since its origin.

    Before the first line its delay holds; after the last one the trace starts again (`repeat`) or its delay holds.
    """
    times, delays = course
    if repeat and times[-1] > 0:
        elapsed_ns %= times[-1]
    above = bisect_right(times, elapsed_ns)
    if above == 0:
        return delays[0]
    if above == len(times) or interpolation == "hold":
        return delays[above - 1]
    return _between(times, delays, above, elapsed_ns)


def _between(times: Sequence[int], delays: Sequence[int], above: int, elapsed_ns: int) -> int:
    width = times[above] - times[above - 1]
    rise = delays[above] - delays[above - 1]
    return delays[above - 1] + rise * (elapsed_ns - times[above - 1]) // width
