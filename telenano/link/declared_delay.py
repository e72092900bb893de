"""Announcement of the link's delay on link/delay, before the first message to which a changed delay applies."""

from typing import NamedTuple

import msgspec

from telenano.link.fate import Release
from telenano.timing.clock_offset import OffsetFilter
from telenano.wire.codec import WireError, decode_header
from telenano.wire.messages import LinkDelay

# Topics whose messages descend from a sample of the hand, so that the receiver checks the age of that sample.
DECLARED = {"forward": "teleop/forward", "backward": "teleop/backward"}


class Declaration(NamedTuple):
    """Stamp of the first sample of the hand to which a delay applies [ns], and the delay in whole steps [ns]."""

    hand_t_ns: int
    delay_ns: int


class DeclaredDelay(msgspec.Struct, array_like=True):
    """The delay of one direction known to its readers; `topic` is the one that descends from samples of the hand."""

    topic: str
    current: Declaration = Declaration(0, 0)
    newest_arrival_ns: int = -1

    def changed_by(self, release: Release) -> bool:
        """Return whether a message about to be sent has a delay that readers do not know yet, and set `current` to it.

        A message that was overtaken, or the later of two copies, is useless to a reader and changes nothing.
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
            # The message was corrupted in transit, so its readers reject it.
            return False
        if type(hand_t_ns) is not int or hand_t_ns < 0:
            return False
        self.current = Declaration(hand_t_ns, delay_ns)
        return True


class BetweenSites(NamedTuple):
    """Present state of the line between two machines, apart from the emulated delay [ns].

    transit_ns: half the least round trip; clock_ahead_ns: lead of the slave's clock; there_ns: least transit of a
    sample to the slave, computed with this lead.
    """

    transit_ns: int
    clock_ahead_ns: int
    there_ns: int = 0

    def at_slave(self) -> dict[str, int]:
        """Return the fields of link/delay that a reader at the slave subtracts from the age of a sample."""
        return {"transit_ns": self.there_ns, "clock_ahead_ns": self.clock_ahead_ns}

    def at_master(self) -> dict[str, int]:
        """Return the fields for a reader at the master, which subtracts the transit twice, once for each direction."""
        return {"transit_ns": self.transit_ns, "clock_ahead_ns": self.clock_ahead_ns}


ONE_MACHINE = BetweenSites(0, 0)


def between_sites(offset: OffsetFilter) -> BetweenSites:
    """Return the state of the line between two machines, from the exchanges of time stamps.

    The apparent delay of the fastest question is the lead of the slave's clock plus the least transit. Whatever lead is
    assumed, the rest counts as transit, so that an error of the offset does not change the age of samples. If the
    offset is within its uncertainty, both machines may share a clock, and the lead is 0.
    """
    estimate, there_ns = offset.estimate(), offset.there_ns()
    if estimate is None or there_ns is None:
        return ONE_MACHINE
    ahead_s = estimate.offset_s if abs(estimate.offset_s) > estimate.uncertainty_s else 0.0
    # A transit is never negative.
    ahead_ns = min(round(1e9 * ahead_s), there_ns)
    return BetweenSites(round(0.5e9 * estimate.round_trip_s), ahead_ns, there_ns - ahead_ns)
