"""What the link tells its readers of the delay: link/delay, before the first message that a changed one applies to."""

from typing import NamedTuple

import msgspec

from telenano.link.fate import Release
from telenano.timing.clock_offset import OffsetFilter
from telenano.wire.codec import WireError, decode_header
from telenano.wire.messages import LinkDelay

# the messages that descend from a sample of the hand, and whose age is therefore judged at the other side
DECLARED = {"forward": "teleop/forward", "backward": "teleop/backward"}


class Declaration(NamedTuple):
    """From which sample of the hand on a delay applies [ns], and the delay in whole steps [ns]."""

    hand_t_ns: int
    delay_ns: int


class DeclaredDelay(msgspec.Struct, array_like=True):
    """The delay of one direction as its readers know it; topic, of what descends from a sample of the hand."""

    topic: str
    current: Declaration = Declaration(0, 0)
    newest_arrival_ns: int = -1

    def changed_by(self, release: Release) -> bool:
        """Return whether a message about to be sent has another delay than readers know; it is `current` after that.

        One that was overtaken, or the later of two copies, is of no use to a reader and changes nothing.
        """
        fate = release.fate
        if release.topic != self.topic or fate.arrived_ns <= self.newest_arrival_ns:
            return False
        self.newest_arrival_ns = fate.arrived_ns
        delay_ns = LinkDelay.reported_ns(fate.delay_ns)
        if delay_ns == self.current.delay_ns:
            return False
        try:
            hand_t_ns = decode_header(release.topic, release.payload)[1].get("hand_t_ns")
        except WireError:
            # The message was corrupted in transit, and its readers reject it.
            return False
        if type(hand_t_ns) is not int or hand_t_ns < 0:
            return False
        self.current = Declaration(hand_t_ns, delay_ns)
        return True


class BetweenSites(NamedTuple):
    """What lies between two machines besides the delay, now [ns].

    transit_ns: half the least round trip; clock_ahead_ns: what the slave's clock is ahead there; there_ns: what a
    sample takes at least to the slave, with clocks that are so far apart.
    """

    transit_ns: int
    clock_ahead_ns: int
    there_ns: int = 0

    def at_slave(self) -> dict[str, int]:
        """Return what a reader at the slave takes off the age of a sample."""
        return {"transit_ns": self.there_ns, "clock_ahead_ns": self.clock_ahead_ns}

    def at_master(self) -> dict[str, int]:
        """Return what a reader at the master takes off: the transit twice, whatever each way has of it."""
        return {"transit_ns": self.transit_ns, "clock_ahead_ns": self.clock_ahead_ns}


ONE_MACHINE = BetweenSites(0, 0)


def between_sites(offset: OffsetFilter) -> BetweenSites:
    """Return what lies between two machines, from the exchanges of time stamps with the other one.

    A message to the slave took at least what the fastest question takes now, by two clocks; with any offset taken off,
    what is left is its transit, so that an error of the offset is none of the age. Where the offset is within its
    uncertainty the clocks may be one, and count as one.
    """
    estimate, there_ns = offset.estimate(), offset.there_ns()
    if estimate is None or there_ns is None:
        return ONE_MACHINE
    ahead_s = estimate.offset_s if abs(estimate.offset_s) > estimate.uncertainty_s else 0.0
    # No transit is below zero.
    ahead_ns = min(round(1e9 * ahead_s), there_ns)
    return BetweenSites(round(0.5e9 * estimate.round_trip_s), ahead_ns, there_ns - ahead_ns)
