"""A time in a recording, in each of the forms in which an output prints one.

recorded_time("2.5").at(first_ns)                    # seconds from the start, as figures and tables have them
recorded_time("1:02.5")                              # minutes and seconds from the start
recorded_time("12:58:02.4")                          # a time of day, as the page and the logs print it
recorded_time("2026-01-31T12:58:02Z")                # a date with a time
recorded_time("1764000000123456789")                 # nanoseconds of the epoch, as `bag cat` prints `log_ns`
recorded_time("1764000000.1")                        # seconds of the epoch
"""

import re
from datetime import datetime, timedelta
from decimal import Decimal
from typing import Literal, NamedTuple

from telenano.wire.errors import ConfigError

_NUMBER = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*(ns|us|ms|s|min|h)?")
_MINUTES = re.compile(r"(\d+):(\d\d(?:\.\d*)?)")
_DAY = re.compile(r"(\d\d?):(\d\d):(\d\d(?:\.\d*)?)")
_UNITS_NS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9, "min": 60 * 10**9, "h": 3600 * 10**9}
# No recording is as long as this, so that what is greater counts from the epoch: seconds, and nanoseconds.
_EPOCH_S, _EPOCH_NS = 10**9, 10**15
_DAY_NS = 86_400 * 10**9
_FORMS = (
    "give seconds from the start such as 2.5, minutes such as 1:02.5, a time of day such as 12:58:02, or one as `bag "
    "cat` prints it, such as 1764000000123456789"
)


class RecordedTime(NamedTuple):
    """A time: nanoseconds from the start of the recording, from the epoch, or from midnight here, and its text."""

    ns: int
    since: Literal["start", "epoch", "midnight"]
    text: str

    def at(self, first_ns: int) -> int:
        """Return the time in a recording that begins at `first_ns`, of the same clock [ns]."""
        if self.since == "epoch":
            return self.ns
        if self.since == "start":
            return first_ns + self.ns
        first = datetime.fromtimestamp(first_ns // 10**9).astimezone()
        midnight = first.replace(hour=0, minute=0, second=0, microsecond=0)
        at_ns = round(midnight.timestamp()) * 10**9 + self.ns
        # A recording may go on beyond midnight.
        return at_ns if at_ns >= first_ns - _DAY_NS // 2 else at_ns + _DAY_NS

    def later(self, duration_s: float) -> "RecordedTime":
        """Return a time that is later by a duration [s]."""
        return self._replace(ns=self.ns + round(duration_s * 1e9), text=f"{duration_s:g} s after {self}")

    def __str__(self) -> str:
        return f"{self.text} s" if self.since == "start" and self.text.replace(".", "").isdigit() else self.text


# The start of a recording.
START = RecordedTime(0, "start", "0")


def recorded_time(text: str) -> RecordedTime:
    """Return the time that a text names; ConfigError lists the forms for a text that names none."""
    text = text.strip()
    if number := _NUMBER.fullmatch(text):
        value, unit = Decimal(number[1]), number[2]
        if value >= _EPOCH_NS and unit in (None, "ns"):
            return RecordedTime(int(value), "epoch", text)
        ns = int(value * _UNITS_NS[unit or "s"])
        return RecordedTime(ns, "epoch" if ns >= _EPOCH_S * 10**9 else "start", text)
    if minutes := _MINUTES.fullmatch(text):
        return RecordedTime(int(minutes[1]) * _UNITS_NS["min"] + int(Decimal(minutes[2]) * 10**9), "start", text)
    if day := _DAY.fullmatch(text):
        whole_s = timedelta(hours=int(day[1]), minutes=int(day[2])).total_seconds()
        return RecordedTime(round(whole_s) * 10**9 + int(Decimal(day[3]) * 10**9), "midnight", text)
    try:
        date = datetime.fromisoformat(text)
    except ValueError:
        raise ConfigError(f"{text!r} is no time of a recording: {_FORMS}") from None
    whole = date.astimezone().replace(microsecond=0)
    return RecordedTime(round(whole.timestamp()) * 10**9 + date.microsecond * 10**3, "epoch", text)


def time_in(first_ns: int, time: float | RecordedTime) -> int:
    """Return a time of a recording that begins at `first_ns` [ns]; a number is one from its start [s]."""
    return time.at(first_ns) if isinstance(time, RecordedTime) else first_ns + round(time * 1e9)


def span_of(
    first_ns: int, start: float | RecordedTime | None, end: float | RecordedTime | None
) -> tuple[int, int | None]:
    """Return the times [ns] of a choice in a recording that begins at `first_ns`: its start, and its end or None."""
    return first_ns if start is None else time_in(first_ns, start), None if end is None else time_in(first_ns, end)
