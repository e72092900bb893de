"""What a page that is open is known by: its role, the frames that wait to be sent to it, and how often it asks."""

import asyncio
import secrets
from collections import deque

from services.viz_node.hand_age import HandAge
from telenano.console.lease import Party
from telenano.serving.access import Role
from telenano.serving.people import Person

# two seconds: a page that is further behind begins again
MOST_QUEUED = 60
# The oldest answers go, where a page reads nothing.
_MOST_ANSWERS = 256
REQUESTS_PER_S = 200


class Session:
    """One page: its role and its person, and the frames that wait to be sent to it.

    `party`: what it is to the lease of control, with the letter of its window where it has one; `heard_s`: when it was
    heard last, on the monotonic clock [s].
    """

    def __init__(self, role: Role, person: Person | None = None, window: str = "") -> None:
        self.role, self.person = role, person
        self.party = Party(secrets.token_hex(8), "" if person is None else person.name, role.value, window=window)
        self.heard_s = 0.0
        # the newest ways to the page and back [s]
        self.ways_s: deque[float] = deque(maxlen=9)
        # When the newest of them was known, and how late the frames of its hand are.
        self.way_at_s = 0.0
        self.hand = HandAge()
        # When it was told last that its hand is too slow [s]; None where that is not so.
        self.slow_reported_s: float | None = None
        # An address that is revoked ends its pages, after the frame that reports it.
        self.ended = False
        self.ready = asyncio.Event()
        self._frames: deque[bytes] = deque()
        # What a page was told once is not in the snapshot with which it begins again.
        self._answers: deque[bytes] = deque(maxlen=_MOST_ANSWERS)
        self._times_s: deque[float] = deque(maxlen=REQUESTS_PER_S)

    def offer(self, frame: bytes) -> bool:
        """Queue a frame; false when the page is so far behind that it has to begin again."""
        if len(self._frames) >= MOST_QUEUED:
            return False
        self._frames.append(frame)
        self.ready.set()
        return True

    def answer(self, frame: bytes) -> None:
        """Queue an answer, which comes before what changes and is not dropped with it."""
        self._answers.append(frame)
        self.ready.set()

    def hand_late_s(self, stamp_s: float, now_s: float) -> float:
        """Take a frame of its hand with its stamp, and return how late that is [s]; 0 for one without a stamp."""
        if not stamp_s:
            return 0.0
        return self.hand.take(stamp_s, now_s, (self.way_at_s, self.ways_s[-1]) if self.ways_s else None)

    def end(self, frame: bytes) -> None:
        """Send a last frame, after which the connection of the page is closed."""
        self.answer(frame)
        self.ended = True

    def restart(self, frame: bytes) -> None:
        """Drop the changes that wait, and queue a snapshot."""
        self._frames.clear()
        self._frames.append(frame)
        self.ready.set()

    @property
    def is_over(self) -> bool:
        """Whether a page whose address was revoked has been told all that waited for it."""
        return self.ended and not self._answers

    async def next_frame(self) -> bytes:
        """Wait for the next frame."""
        while not (self._frames or self._answers):
            self.ready.clear()
            await self.ready.wait()
        return (self._answers or self._frames).popleft()

    def may_ask(self, now_s: float) -> bool:
        """Return whether a request comes within the rate that a page may have."""
        if len(self._times_s) == REQUESTS_PER_S and now_s - self._times_s[0] < 1.0:
            return False
        self._times_s.append(now_s)
        return True
