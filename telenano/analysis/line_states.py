"""Least round trip of the line between two sites in a session, before and after each lasting change."""

import statistics
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

from telenano.recording.messages import readable
from telenano.recording.multi_file import RecordingSource
from telenano.recording.site_clock import Timeline

# shortest duration of a lasting change [s]
_LASTS_S = 0.2
# least change of the round trip, absolute [ms] and as a share [1]; the larger one applies
_LEAST_MS, _LEAST_SHARE = 5.0, 0.1


class LineReport(NamedTuple):
    """A report on the line: time [s], least round trip with its interval [ms], and time since when it is so [s]."""

    at_s: float
    round_trip_ms: float
    low_ms: float
    high_ms: float
    since_s: float


def line_states(recording: RecordingSource, timeline: Timeline, start_ns: int, end_ns: int) -> list[dict[str, float]]:
    """Return each lasting state of the line in a session; none if the link does not connect two machines.

    Args:
        recording: The recording.
        timeline: Its clocks.
        start_ns: The start of the session by the master's clock [ns].
        end_ns: The end of the session by the master's clock [ns].
    """
    reports: dict[int, LineReport] = {}
    channels = recording.select(lambda channel: channel.topic == "link/status" and channel.via == "direct")
    for message, fields in readable(channels, recording.left_out):
        clock = fields.get("clock") or {}
        at_ns = message.publish_ns
        first_ns, last_ns = (timeline.stamp_ns(message.src, end) for end in (start_ns, end_ns))
        if first_ns <= at_ns <= last_ns and clock.get("valid") and clock.get("round_trip_high_s") is not None:
            said = _said(clock, at_ns, first_ns)
            if said.low_ms <= said.round_trip_ms <= said.high_ms:
                reports[message.seq] = said
    return states_of(sorted(reports.values()), (end_ns - start_ns) * 1e-9)


def _said(clock: Mapping[str, Any], at_ns: int, start_ns: int) -> LineReport:
    since_ns = clock.get("round_trip_since_ns") or at_ns
    round_trip_ms, low_ms, high_ms = (
        1e3 * clock[key] for key in ("round_trip_s", "round_trip_low_s", "round_trip_high_s")
    )
    since_s = max(0.0, (min(since_ns, at_ns) - start_ns) * 1e-9)
    return LineReport((at_ns - start_ns) * 1e-9, round_trip_ms, low_ms, high_ms, since_s)


def states_of(reports: Iterable[LineReport], end_s: float) -> list[dict[str, float]]:
    """Return the lasting states of the line from reports in the order of time; end_s: the end of the session [s].

    A report belongs to another state if its interval does not overlap that of the state, and their round trips differ
    by more than the least change. The state has changed once all reports for _LASTS_S belong to the other one.
    """
    states: list[list[LineReport]] = []
    others: list[LineReport] = []
    for one in reports:
        if states and not _differ(states[-1], one):
            states[-1].append(one)
            others = []
            continue
        # Reports that also differ from each other, as while a queue fills, belong to no state yet.
        others = [*others, one] if others and not _differ(others, one) else [one]
        if not states or one.at_s - others[0].at_s >= _LASTS_S:
            states.append(others)
            others = []
    if not states:
        return []
    # A change is reported with a delay, so a state starts at the stated time of the change.
    begins_s = [0.0, *(max(state[0].since_s, before[0].at_s) for before, state in pairwise(states))]
    ends_s = [*begins_s[1:], end_s]
    return [
        {"from_s": round(begin_s, 3), "to_s": round(end_s, 3), **_figures(state)}
        for begin_s, end_s, state in zip(begins_s, ends_s, states, strict=True)
    ]


def _differ(state: list[LineReport], one: LineReport) -> bool:
    before_ms, low_ms, high_ms = _middle(state)
    apart = one.low_ms > high_ms or one.high_ms < low_ms
    return apart and abs(one.round_trip_ms - before_ms) >= max(_LEAST_MS, _LEAST_SHARE * before_ms)


def _middle(state: list[LineReport]) -> tuple[float, float, float]:
    """Return the medians of the round trip and of both ends of its interval over the newest reports of a state [ms]."""
    newest = state[-50:]
    return (
        statistics.median(one.round_trip_ms for one in newest),
        statistics.median(one.low_ms for one in newest),
        statistics.median(one.high_ms for one in newest),
    )


def _figures(state: list[LineReport]) -> dict[str, float]:
    names = ("round_trip_ms", "low_ms", "high_ms")
    return {name: round(value, 3) for name, value in zip(names, _middle(state), strict=True)}
