"""Delay and loss at a given time of a trace."""

from bisect import bisect_right
from collections.abc import Sequence
from typing import Literal

from telenano.settings.link_traces import DelayCourse, LossCourse


def delay_at(course: DelayCourse, elapsed_ns: int, *, interpolation: Literal["hold", "linear"], repeat: bool) -> int:
    """Return the delay [ns] of a trace at a time since its origin [ns].

    Before the first line its delay applies. After the last one the trace restarts (`repeat`), or its delay applies.
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


def lost_at(course: LossCourse, elapsed_ns: int, *, repeat: bool) -> bool:
    """Return whether a message that arrives at a time since the origin of a trace [ns] is lost; never before line 1."""
    times, lost = course
    if repeat and times[-1] > 0:
        elapsed_ns %= times[-1]
    above = bisect_right(times, elapsed_ns)
    return above > 0 and bool(lost[above - 1])


def _between(times: Sequence[int], delays: Sequence[int], above: int, elapsed_ns: int) -> int:
    width = times[above] - times[above - 1]
    rise = delays[above] - delays[above - 1]
    return delays[above - 1] + rise * (elapsed_ns - times[above - 1]) // width
