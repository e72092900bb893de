"""A way that has become longer, found from the arrivals of the loop's own messages before the link reports it.

The link proves a longer route by exchanges with the other site, and its report needs a round trip of that route. A
reader at the far end sees every message of the loop arrive with the stamp of the hand's sample behind it. To these
arrivals it applies the same proof (`line_present.Way`): after a jump, at least 40 ms of delays that stay the same. A
queue, a stall, or messages held up together are none. What the reader has found counts for a second, and at most for
`MOST_NS`: by then the link has reported the way, or the samples count as old again.
"""

import msgspec

from telenano.timing.line_present import Way

# Greatest increase of a delay that a reader believes without the link [ns].
MOST_NS = 250_000_000
# Time for which it does [ns].
_LASTS_NS = 1_000_000_000


class LongerWay(msgspec.Struct, array_like=True):
    """The delay that a reader has found beyond what the link has reported.

    way: delays of the arrivals, None before the first one; more_ns: the delay found [ns]; until_ns: time until which it
    counts, by the clock of the arrivals [ns]; between: most messages between the two sides of a jump.
    """

    way: Way | None = None
    more_ns: int = 0
    until_ns: int = 0
    between: int = 2

    def arrived(self, stamp_ns: int, received_ns: int, added_ns: int, between_ns: int) -> bool:
        """Record the arrival of a message; return whether what is found has changed.

        Args:
            stamp_ns: The stamp of the hand's sample behind it [ns].
            received_ns: The time of its reception [ns].
            added_ns: The delay that the link adds on purpose, and announces before it does [ns].
            between_ns: The delay of the line, with the lead of a clock, as the link has reported it [ns].
        """
        took_ns = received_ns - stamp_ns - added_ns
        if self.way is None:
            self.way = Way(took_ns, stamp_ns, stamp_ns, between=self.between)
        found_ns, over_ns = self.more_ns, max(took_ns - between_ns, 0)
        if (longer_ns := self.way.record(stamp_ns, took_ns)) > 0 and self.way.is_jump:
            self.more_ns, self.until_ns = min(self.more_ns + longer_ns, MOST_NS), received_ns + _LASTS_NS
        # What the newest message took beyond the report is the most: the link may know by now, or the way be shorter.
        self.more_ns = min(self.more_ns, over_ns)
        return self.more_ns != found_ns

    def reported(self, more_ns: int) -> None:
        """Take off what the link has reported by now: an increase of the way [ns]."""
        self.more_ns = max(self.more_ns - max(more_ns, 0), 0)

    def ends(self, now_ns: int) -> bool:
        """Return whether what was found has ended without a report, and forget it."""
        if not self.more_ns or now_ns <= self.until_ns:
            return False
        self.more_ns = 0
        return True
