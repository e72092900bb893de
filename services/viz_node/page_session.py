"""The session of an open page: its role, the queue of frames to send to it, and its rate of requests."""

import asyncio
import secrets
import time
from collections import deque
from collections.abc import Callable

from services.viz_node.hand_age import HandAge
from telenano.console.lease import Party
from telenano.serving.access import Role
from telenano.serving.people import Person

# Most queued frames, two seconds of them; a page that is further behind starts again from a snapshot.
MOST_QUEUED = 60
# Most queued answers; the oldest ones are dropped if a page does not read.
_MOST_ANSWERS = 256
REQUESTS_PER_S = 200


class Session:
    """One page: its role and person, and the frames that wait to be sent to it.

    `party`: the page as a party of the lease of control, with the letter of its window if it has one; `heard_s`: time
    of its last message, on the monotonic clock [s].
    """

    def __init__(self, role: Role, person: Person | None = None, window: str = "") -> None:
        self.role, self.person = role, person
        self.party = Party(secrets.token_hex(8), "" if person is None else person.name, role.value, window=window)
        self.heard_s = 0.0
        # Time of its last request other than a sign of life; at first, that of its opening [s].
        self.acted_s = time.monotonic()
        # Drops its connection.
        self.drop: Callable[[], None] = lambda: None
        # The newest round trips to the page [s].
        self.ways_s: deque[float] = deque(maxlen=9)
        # The time of the newest of them [s], and the lateness of the frames of its hand.
        self.way_at_s = 0.0
        self.hand = HandAge()
        # Time of the last report to it that its hand is too slow [s]; None if it is not slow.
        self.slow_reported_s: float | None = None
        # A revoked address ends its pages, after the frame that says so.
        self.ended = False
        self.ready = asyncio.Event()
        self._frames: deque[bytes] = deque()
        # Answers have a separate queue, because the snapshot with which a page starts again does not contain them.
        self._answers: deque[bytes] = deque(maxlen=_MOST_ANSWERS)
        self._times_s: deque[float] = deque(maxlen=REQUESTS_PER_S)

    def offer(self, frame: bytes) -> bool:
        """Queue a frame; return False if the page is so far behind that it must start again from a snapshot."""
        if len(self._frames) >= MOST_QUEUED:
            return False
        self._frames.append(frame)
        self.ready.set()
        return True

    def answer(self, frame: bytes) -> None:
        """Queue an answer, which is sent before queued changes and is not dropped with them."""
        self._answers.append(frame)
        self.ready.set()

    def hand_late_s(self, stamp_s: float, now_s: float) -> float:
        """Return the lateness of a frame of its hand with a time stamp [s]; 0 for a frame without one (0)."""
        if not stamp_s:
            return 0.0
        return self.hand.take(stamp_s, now_s, (self.way_at_s, self.ways_s[-1]) if self.ways_s else None)

    def end(self, frame: bytes) -> None:
        """Queue a last answer, after which the connection of the page is closed."""
        self.answer(frame)
        self.ended = True

    def restart(self, frame: bytes) -> None:
        """Drop the queued changes, and queue a snapshot."""
        self._frames.clear()
        self._frames.append(frame)
        self.ready.set()

    @property
    def is_over(self) -> bool:
        """Whether the session was ended and all its answers were sent."""
        return self.ended and not self._answers

    async def next_frame(self) -> bytes:
        """Wait for the next frame."""
        while not (self._frames or self._answers):
            self.ready.clear()
            await self.ready.wait()
        return (self._answers or self._frames).popleft()

    def may_ask(self, now_s: float) -> bool:
        """Return whether a request at this time [s] is within the permitted rate of a page, and count it if so."""
        if len(self._times_s) == REQUESTS_PER_S and now_s - self._times_s[0] < 1.0:
            return False
        self._times_s.append(now_s)
        return True
