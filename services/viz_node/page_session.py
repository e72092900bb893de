"""What a page that is open is known by: its role, the frames that wait to be sent to it, and how often it asks."""

import asyncio
from collections import deque

from services.viz_node.access import Role

# two seconds: a page that is further behind begins anew
MOST_QUEUED = 60
# The oldest answers go, where a page reads nothing.
_MOST_ANSWERS = 256
REQUESTS_PER_S = 200


class Session:
    """One page: its role, and the frames that wait to be sent to it."""

    def __init__(self, role: Role) -> None:
        self.role = role
        self.ready = asyncio.Event()
        # An answer of this page to a cue is being sent until the experiment has taken it.
        self.answering = False
        self._frames: deque[bytes] = deque()
        # What a page was told once is not in the snapshot with which it begins anew.
        self._answers: deque[bytes] = deque(maxlen=_MOST_ANSWERS)
        self._times_s: deque[float] = deque(maxlen=REQUESTS_PER_S)

    def offer(self, frame: bytes) -> bool:
        """Queue a frame; false when the page is so far behind that it has to begin anew."""
        if len(self._frames) >= MOST_QUEUED:
            return False
        self._frames.append(frame)
        self.ready.set()
        return True

    def answer(self, frame: bytes) -> None:
        """Queue an answer, which comes before what changes and is not dropped with it."""
        self._answers.append(frame)
        self.ready.set()

    def restart(self, frame: bytes) -> None:
        """Drop the changes that wait, and queue a snapshot."""
        self._frames.clear()
        self._frames.append(frame)
        self.ready.set()

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
