"""The copies of what a node of the loop has sent, until they go out together to a recorder."""

from collections.abc import Callable

from proto.batch import MOST_COPIES, SentCopy, pack_batch
from services.runtime.loop.clock import NEVER_NS

# age of the oldest copy at which a batch goes out in the next idle gap of the loop, and without one
DUE_NS, LATEST_NS = 5_000_000, 10_000_000
# payload bytes at which it goes out before the next message: a batch never holds more than this and one message
_MOST_BYTES = 65_536


class OutgoingBatch:
    """Collects copies, and hands their bytes to `send` once they are due."""

    def __init__(self, monotonic_ns: Callable[[], int], send: Callable[[bytes], None]) -> None:
        # when the copies go out in the next idle gap, and when at the latest, on the monotonic clock [ns]
        self.due_ns = self.latest_ns = NEVER_NS
        self._monotonic_ns = monotonic_ns
        self._send = send
        self._copies: list[SentCopy] = []
        self._bytes = 0

    def add(self, topic: bytes, payload: bytes) -> None:
        """Keep a copy of what is about to be sent.

        Copies that are overdue go out first, so that a recorder that takes single messages, because this process stood
        still, gets them before anything that was sent later.
        """
        now_ns = self._monotonic_ns()
        if now_ns >= self.latest_ns or self._bytes >= _MOST_BYTES or len(self._copies) >= MOST_COPIES:
            self.flush()
        if not self._copies:
            self.due_ns, self.latest_ns = now_ns + DUE_NS, now_ns + LATEST_NS
        self._copies.append(SentCopy(now_ns, topic, payload))
        self._bytes += len(payload)

    def flush(self, *, last: bool = False) -> None:
        """Send what there is; `last` also when there is nothing."""
        if self._copies or last:
            self._send(pack_batch(self._copies, last=last))
        self._copies = []
        self._bytes = 0
        self.due_ns = self.latest_ns = NEVER_NS
