"""The force of the page that holds the hand: repeated while the page sends, faded when it is silent, then released.

`PageHand(open_outlet)`, then `hand.press(session, 1.5, (0.0, 0.0))` at each frame of the page, and `hand.look()` and
`hand.repeat()` at each tick.
"""

import contextlib
import time
from collections.abc import Callable
from typing import Any, Protocol

from services.viz_node.page_session import Session
from telenano.wire.errors import RefusedError, TelenanoError

TICK_S = 1.0 / 30.0
# A page sends the force of its hand 60 times a second from a separate thread, but on a busy machine a browser pauses
# for 0.1 s and more. The last force holds for this time [s], and is repeated for the haptic node, whose timeout is
# shorter. A frame later than this is dropped, because in a growing queue old forces would be used as present ones.
HAND_FRESH_S = 0.1
# The force then fades to 0 over this time, and rises again as slowly [s].
HAND_FADE_S = 0.25
# Most of a standstill of this process that counts as silence of a page [s]: its frames are read only afterwards.
_LONGEST_LOOK_S = 3.0 * TICK_S


class HandOutlet(Protocol):
    """Publishes the force of an operator at a page."""

    def push(self, force_n: float, across_n: tuple[float, float], by: str) -> None:
        """Publish a force towards the sample and one across it [N], 0 for a released hand; `by` names the person."""

    def publish(self, topic: str, **fields: Any) -> object:
        """Publish a message on a topic of a package's panel."""

    def now_ns(self) -> int:
        """Return the time on the clock of the endpoint [ns]."""

    def close(self) -> None:
        """Close the endpoint."""


class PageHand:
    """Sends the force of the page that presses to the haptic node.

    `holder` is the page that presses, or None; `share` is the factor on its newest force, from 0 to 1.

    Args:
        open_outlet: Opens the endpoint of the page; None if there is none, as for a recording.
    """

    def __init__(self, open_outlet: Callable[[], HandOutlet] | None) -> None:
        self.holder: Session | None = None
        self.share = 1.0
        self._open_outlet = open_outlet
        self._outlet: HandOutlet | None = None
        self._force_n = 0.0
        self._across_n = (0.0, 0.0)
        # Time of the last update of the share, and silence of the page until then [s].
        self._looked_s = 0.0
        self._silent_s = 0.0

    @property
    def exists(self) -> bool:
        """Whether a page can press at all."""
        return self._open_outlet is not None

    def outlet(self) -> HandOutlet:
        """Return the endpoint of the page, which the first call opens.

        Raises:
            RefusedError: There is no endpoint, because the page shows a recording.
            TelenanoError: The endpoint cannot be opened.
        """
        if self._open_outlet is None:
            raise RefusedError("this page shows a recording, which takes no answers")
        if self._outlet is None:
            self._outlet = self._open_outlet()
        return self._outlet

    def press(self, session: Session, force_n: float, across_n: tuple[float, float]) -> None:
        """Publish the newest force of a page [N], which then holds the hand; raise the errors of `outlet`."""
        outlet = self.outlet()
        if self.holder is not session:
            self.share, self._looked_s = 1.0, time.monotonic()
        self.holder, self._force_n, self._across_n = session, force_n, across_n
        self._fade()
        self._silent_s = 0.0
        self._push(outlet)

    def look(self) -> float | None:
        """Update the share, and return how late the page that presses is [s]; None if no page presses."""
        if self.holder is None or self._outlet is None:
            return None
        self._fade()
        return max(self._silent_s, self.holder.hand.late_s)

    def repeat(self) -> None:
        """Publish the force of the page again, or release the hand if the page has been silent for too long."""
        if self.holder is None or self._outlet is None:
            return
        if self._silent_s > HAND_FRESH_S + HAND_FADE_S:
            self.release()
            return
        with contextlib.suppress(TelenanoError):
            self._push(self._outlet)

    def release(self) -> None:
        """Release the hand by publishing the force 0; the endpoint stays open."""
        holder, self.holder = self.holder, None
        if holder is not None and self._outlet is not None:
            with contextlib.suppress(TelenanoError):
                self._outlet.push(0.0, (0.0, 0.0), holder.party.name)

    def close(self) -> None:
        """Release the hand and close the endpoint."""
        self.release()
        if self._outlet is not None:
            self._outlet.close()

    def _fade(self) -> None:
        """Update the share of the force: it falls while the page is silent, and rises while it sends."""
        now_s = time.monotonic()
        passed_s = min(_LONGEST_LOOK_S, now_s - self._looked_s)
        self._silent_s, self._looked_s = self._silent_s + passed_s, now_s
        # Only the time beyond `HAND_FRESH_S` counts as silence.
        over_s = min(passed_s, self._silent_s - HAND_FRESH_S)
        change = -over_s if over_s > 0.0 else passed_s
        self.share = min(1.0, max(0.0, self.share + change / HAND_FADE_S))

    def _push(self, outlet: HandOutlet) -> None:
        """Publish the force of the page that presses, multiplied by the share."""
        if self.holder is not None:
            x_n, y_n = self._across_n
            outlet.push(self.share * self._force_n, (self.share * x_n, self.share * y_n), self.holder.party.name)
