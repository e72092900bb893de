"""Number of periods of the hand between its samples, from their time stamps."""

from typing import NamedTuple

from telenano.numerics.compiler import inlined

# Returned by `periods_to` if the sequence of samples begins, or begins again.
RESTARTED = -1
# A sample moves the grid by 1/_SHARE of its deviation, because even the sample that set the grid may have been late.
_SHARE = 64


class HandClock(NamedTuple):
    """Time stamp of the newest sample [ns], -1 before the first, and the newest point of the hand's time grid [ns]."""

    sampled_ns: int
    grid_ns: int


@inlined
def no_sample() -> HandClock:
    """Return the clock of a hand that has not been sampled yet."""
    return HandClock(-1, 0)


@inlined
def periods_to(clock: HandClock, sampled_ns: int, period_ns: int, longest: int) -> tuple[HandClock, int]:
    """Return the clock at a sample, and the periods since the previous sample; RESTARTED past the longest pause.

    The hand samples on an absolute grid, so the stamps deviate from it only by their lateness, and no period is counted
    twice. Rounding each difference of two stamps instead would count 2, 1 and 1 periods between stamps at 0, 1.6, 2.4
    and 3.0 ms. If a sample was late by more than half a period, the next one is 0 periods later.

    Args:
        clock: The clock at the previous sample.
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
