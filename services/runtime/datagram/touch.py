"""Whether commands could cross to the other machine, an emergency stop above all: without that no sample counts."""

from collections.abc import Callable

# A connection that was lost is made again within so long; after that samples are neither sent nor taken [ns].
OUT_OF_TOUCH_NS = 1_000_000_000


class Touch:
    """Watches the connections over TCP of an end; `is_kept` while one is there, and for a second after the last."""

    def __init__(self, is_connected: Callable[[], bool], machine: str, now_ns: int) -> None:
        self.is_kept = True
        self._is_connected, self._machine = is_connected, machine
        self._connected_ns = now_ns
        self._is_told = False

    def look(self, now_ns: int, *, arriving: bool) -> tuple[str, str] | None:
        """Look at the connections; return level and text of an event where datagrams cross and commands cannot.

        Args:
            now_ns: The time now [ns].
            arriving: Whether datagrams arrive; where nothing crosses, other events say so.
        """
        if self._is_connected():
            self._connected_ns = now_ns
        self.is_kept = now_ns - self._connected_ns < OUT_OF_TOUCH_NS
        if self._is_told and self.is_kept:
            self._is_told = False
            return "info", f"{self._machine} is connected again: the link's datagrams go on"
        if not self._is_told and not self.is_kept and arriving:
            self._is_told = True
            text = "no command can cross, and the link's datagrams wait"
            return "warning", f"{self._machine} is no longer connected over TCP: {text}"
        return None
