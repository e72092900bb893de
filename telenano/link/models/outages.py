"""Outages of the connection, by schedule, at random, or both."""

import math
from bisect import bisect_right
from typing import NamedTuple

from telenano.link.models.jitter import normal_quantile
from telenano.link.random_streams import SMALLEST, Draw
from telenano.settings.link_settings import Outage

# Most cycles that are drawn one by one for a message; a longer pause is skipped, because it would block the link.
_LONGEST_WALK = 10_000
# Represents the start of a session that has not begun.
NO_SESSION_NS = 2**62


class OutageState(NamedTuple):
    """Origin of the schedule [ns], and begin and end [ns] of the random outages that are drawn and not over yet.

    The time up before the next random outage counts from the end of the last one.
    """

    origin_ns: int
    random: list[tuple[int, int]]


class Outages:
    """Times at which the connection is down.

    `origin_ns` is the time at which the settings came into force; a schedule in session time counts from `session_ns`
    instead, and does not apply before. Random outages alternate exponential times up with exponential or log-normal
    times down, starting up. They are drawn in order of time, so the same seed gives the same outages whatever messages
    pass.
    """

    __slots__ = ("_down_ns", "_draw", "_is_of_session", "_period_ns", "_schedule", "_spread", "_up_ns", "state")

    def __init__(self, settings: Outage, origin_ns: int, draw: Draw, session_ns: int = NO_SESSION_NS) -> None:
        self._draw = draw
        self._is_of_session = settings.origin == "session"
        self._schedule = [(round(start * 1e9), round((start + length) * 1e9)) for start, length in settings.schedule]
        self._period_ns = None if settings.period_s is None else round(settings.period_s * 1e9)
        self._up_ns = None if settings.mean_up_s is None else settings.mean_up_s * 1e9
        self._down_ns = 0.0 if settings.mean_down_s is None else settings.mean_down_s * 1e9
        self._spread = settings.down_spread
        self.state = OutageState(session_ns if self._is_of_session else origin_ns, [(origin_ns, origin_ns)])

    def begin_session(self, session_ns: int) -> None:
        """Set the origin of a schedule in session time to `session_ns` [ns]."""
        if self._is_of_session:
            self.state = self.state._replace(origin_ns=session_ns)

    def end_ns(self, now_ns: int) -> int | None:
        """Return the end of the outage at `now_ns` [ns], None while connected; `now_ns` must not decrease."""
        while len(self.state.random) > 1 and self.state.random[0][1] <= now_ns:
            del self.state.random[0]
        # The end of one outage may lie within another one.
        at_ns = now_ns
        while (later_ns := max(self._scheduled_end(at_ns), self._random_end(at_ns))) > at_ns:
            at_ns = later_ns
        return at_ns if at_ns > now_ns else None

    def _scheduled_end(self, at_ns: int) -> int:
        elapsed = at_ns - self.state.origin_ns
        if self._period_ns is not None and elapsed >= 0:
            elapsed %= self._period_ns
        index = bisect_right(self._schedule, (elapsed, math.inf)) - 1
        return at_ns + max(0, self._schedule[index][1] - elapsed) if index >= 0 else at_ns

    def _random_end(self, at_ns: int) -> int:
        if self._up_ns is None:
            return at_ns
        cycle_ns = self._up_ns + self._down_ns
        if at_ns - self.state.random[-1][1] > _LONGEST_WALK * cycle_ns:
            # Draw the present state from the shares of time up and down, and the rest of the interval like a whole one:
            # exponential times have no memory, and that of log-normal times is negligible after so long a pause.
            start_ns = at_ns
            if self._draw() * cycle_ns >= self._down_ns:
                start_ns += self._exponential(self._up_ns)
            self.state.random.append((start_ns, start_ns + self._length_ns()))
        while (last_ns := self.state.random[-1][1]) <= at_ns:
            start_ns = last_ns + self._exponential(self._up_ns)
            self.state.random.append((start_ns, start_ns + self._length_ns()))
        return next((end_ns for start_ns, end_ns in self.state.random if start_ns <= at_ns < end_ns), at_ns)

    def _length_ns(self) -> int:
        if self._spread is None:
            return self._exponential(self._down_ns)
        score = normal_quantile(self._draw() or SMALLEST)
        return max(1, round(self._down_ns * math.exp(self._spread * (score - 0.5 * self._spread))))

    def _exponential(self, mean_ns: float) -> int:
        # At least one nanosecond, so that the loop over the intervals always advances.
        return max(1, round(-mean_ns * math.log(1.0 - self._draw() or SMALLEST)))
