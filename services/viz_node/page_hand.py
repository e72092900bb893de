"""The force of the page that holds the hand: repeated while the page is heard, faded in its silence, and then let go.

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
# A page sends the force of its hand 60 times a second, from a thread of its own, but on a busy machine a browser pauses
# for a tenth of a second and more. The last force holds for this time and is repeated to the haptic node, which waits
# for less. A frame that is later than this is dropped: over a queue that grows, old forces would be those of now.
HAND_FRESH_S = 0.1
# The force then fades over this time, and rises again as slowly.
HAND_FADE_S = 0.25
# Of a standstill of this process no more counts as silence of a page: what the page sent meanwhile is read after it.
_LONGEST_LOOK_S = 3.0 * TICK_S


class HandOutlet(Protocol):
    """Where the force of an operator at a page goes."""

    def push(self, force_n: float, across_n: tuple[float, float], by: str) -> None:
        """Publish a force [N] towards the sample, and one across it; 0 when the hand lets go. `by`: whose it is."""

    def publish(self, topic: str, **fields: Any) -> object:
        """Publish on a topic of a package's panel."""

    def now_ns(self) -> int:
        """Return the time on the clock of the endpoint [ns]."""

    def close(self) -> None:
        """Let go of the endpoint."""


class PageHand:
    """The way of a page's force to the haptic node, and the page that presses.

    `holder` is the page that presses, or None; `share` is the part of its newest force that is in force.

    Args:
        open_outlet: Opens the endpoint of the page; None where there is none, as of a recording.
    """

    def __init__(self, open_outlet: Callable[[], HandOutlet] | None) -> None:
        self.holder: Session | None = None
        self.share = 1.0
        self._open_outlet = open_outlet
        self._outlet: HandOutlet | None = None
        self._force_n = 0.0
        self._across_n = (0.0, 0.0)
        # since when the hand was looked after, and how long its page has said nothing [s]
        self._looked_s = 0.0
        self._silent_s = 0.0

    @property
    def exists(self) -> bool:
        """Whether a page can press at all."""
        return self._open_outlet is not None

    def outlet(self) -> HandOutlet:
        """Return the endpoint of the page, and open it the first time.

        Raises:
            RefusedError: There is none.
            TelenanoError: It cannot be opened.
        """
        if self._open_outlet is None:
            raise RefusedError("this page shows a recording, which takes no answers")
        if self._outlet is None:
            self._outlet = self._open_outlet()
        return self._outlet

    def press(self, session: Session, force_n: float, across_n: tuple[float, float]) -> None:
        """Publish the newest force of a page [N], which holds the hand from then on; errors as of `outlet`."""
        outlet = self.outlet()
        if self.holder is not session:
            self.share, self._looked_s = 1.0, time.monotonic()
        self.holder, self._force_n, self._across_n = session, force_n, across_n
        self._fade()
        self._silent_s = 0.0
        self._push(outlet)

    def look(self) -> float | None:
        """Return how late the page is that presses [s], None where none does; its force fades with its silence."""
        if self.holder is None or self._outlet is None:
            return None
        self._fade()
        return max(self._silent_s, self.holder.hand.late_s)

    def repeat(self) -> None:
        """Publish the force of the page again, or let go for one that has said nothing for too long."""
        if self.holder is None or self._outlet is None:
            return
        if self._silent_s > HAND_FRESH_S + HAND_FADE_S:
            self.release()
            return
        with contextlib.suppress(TelenanoError):
            self._push(self._outlet)

    def release(self) -> None:
        """Let go of the hand: the force at the device is none. The endpoint stays open for the next time."""
        holder, self.holder = self.holder, None
        if holder is not None and self._outlet is not None:
            with contextlib.suppress(TelenanoError):
                self._outlet.push(0.0, (0.0, 0.0), holder.party.name)

    def close(self) -> None:
        """Let go of the hand and of the endpoint."""
        self.release()
        if self._outlet is not None:
            self._outlet.close()

    def _fade(self) -> None:
        """Continue with the share of the force that is in force: less in a silence, and more while a page is heard."""
        now_s = time.monotonic()
        passed_s = min(_LONGEST_LOOK_S, now_s - self._looked_s)
        self._silent_s, self._looked_s = self._silent_s + passed_s, now_s
        # Of what passed since the last look only what is beyond the first time is silence.
        over_s = min(passed_s, self._silent_s - HAND_FRESH_S)
        change = -over_s if over_s > 0.0 else passed_s
        self.share = min(1.0, max(0.0, self.share + change / HAND_FADE_S))

    def _push(self, outlet: HandOutlet) -> None:
        """Publish the force of the page that presses, as much of it as is in force."""
        if self.holder is not None:
            x_n, y_n = self._across_n
            outlet.push(self.share * self._force_n, (self.share * x_n, self.share * y_n), self.holder.party.name)
