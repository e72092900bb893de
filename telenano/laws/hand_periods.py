"""The periods of the hand between its samples, counted by the time stamps that they carry."""

from typing import NamedTuple

from telenano.numerics.compiler import inlined

# `periods_to` returns this where the sequence of samples begins, or begins again.
RESTARTED = -1
# a sample moves the grid by this share of what it is off, because even the first one may have been late
_SHARE = 64


class HandClock(NamedTuple):
    """The time stamp of the newest sample [ns], -1 before the first one, and the place of the hand's grid [ns]."""

    sampled_ns: int
    grid_ns: int


@inlined
def no_sample() -> HandClock:
    """Return the clock of a hand that has not been sampled yet."""
    return HandClock(-1, 0)


@inlined
def periods_to(clock: HandClock, sampled_ns: int, period_ns: int, longest: int) -> tuple[HandClock, int]:
    """Return the clock at a sample, and the periods since the sample before it; ANEW past the longest pause.

    The hand's grid is absolute, so its stamps differ from whole periods by its lateness only, and no period is counted
    twice. To round each difference of two stamps by itself would count 2, 1, 1 periods for the three from 0 by 1.6 and
    2.4 to 3.0 ms. After a sample that was late by more than half a period the next one is none later: 0.

    Args:
        clock: The clock at the sample before.
        sampled_ns: The stamp of the sample [ns].
        period_ns: The period of the hand [ns].
        longest: The longest pause that is bridged [periods].
    """
    if 0 <= clock.sampled_ns < sampled_ns:
        since_ns = sampled_ns - clock.grid_ns
        # The common case comes first: in compiled code a division takes as long as all the rest.
        periods = 1 if since_ns == period_ns else max(0, (since_ns + period_ns // 2) // period_ns)
        if periods <= longest:
            off_ns = since_ns - periods * period_ns
            return HandClock(sampled_ns, clock.grid_ns + periods * period_ns + off_ns // _SHARE), periods
    return HandClock(sampled_ns, sampled_ns), RESTARTED
