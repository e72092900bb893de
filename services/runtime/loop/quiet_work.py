"""Work that can wait, done a piece at a time while a tick of the loop is elsewhere."""

from services.runtime.loop.clock import NEVER_NS

# a tick within this time before: the loop runs, and there will be another pause
_TICKING_NS = 5_000_000
# the most that work waits for a pause
_PATIENCE_NS = 20_000_000


class QuietWork:
    """Names of pieces of work, given out one in each pause of the loop.

    A report takes as long as a third of a tick and comes at any time. In front of a tick it makes that one late; one
    that is later than the period meets the next one, and both hold each other up, for some ticks more. A piece in a
    pause delays nobody. Without ticks everything is due at once.

    Its state is plain values, for the journal of the node that has it.
    """

    def __init__(self, pause_after_ns: int) -> None:
        """Begin without work; a pause begins pause_after_ns after a tick [ns]."""
        self._pause_after_ns = pause_after_ns
        self._waiting: list[str] = []
        self.waits_for_pauses = True
        self._tick_ns = -NEVER_NS
        # when there is something to do, and when everything has to be done, on the monotonic clock [ns]
        self.due_ns = self._latest_ns = NEVER_NS

    def do_at_once(self) -> None:
        """Have all pieces due when they are added from now on, as before there were pauses."""
        self.waits_for_pauses = False

    def note_tick(self, now_ns: int) -> None:
        """Note that a tick has gone on from here at this monotonic time [ns]."""
        self._tick_ns = now_ns
        if self._waiting:
            self.due_ns = min(now_ns + self._pause_after_ns, self._latest_ns)

    def add(self, now_ns: int, *pieces: str) -> None:
        """Add pieces, in their order; one that is waiting keeps its place."""
        if now_ns - self._tick_ns >= _TICKING_NS or not self.waits_for_pauses:
            self.due_ns = self._latest_ns = now_ns
        elif not self._waiting:
            self._latest_ns = now_ns + _PATIENCE_NS
            pause_ns = self._tick_ns + self._pause_after_ns
            self.due_ns = pause_ns if pause_ns > now_ns else self._latest_ns
        self._waiting += [piece for piece in pieces if piece not in self._waiting]

    def take(self, now_ns: int) -> list[str]:
        """Return what is to be done now: the first piece in a pause, all of them after too long a time without one."""
        if now_ns < self.due_ns:
            return []
        count = 1 if now_ns < self._latest_ns else len(self._waiting)
        due, self._waiting = self._waiting[:count], self._waiting[count:]
        self.due_ns = self._latest_ns if self._waiting else NEVER_NS
        return due
