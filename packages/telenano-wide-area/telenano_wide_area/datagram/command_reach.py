"""Watch whether commands, above all an emergency stop, can reach the other machine: if not, no sample counts."""

from collections.abc import Callable

# A lost connection is made again within this time; after it, samples are neither sent nor accepted.
OUT_OF_TOUCH_NS = 1_000_000_000
# The same time for a network that loses more than LOSSY_SHARE of the datagrams: TCP loses connections there as well,
# and takes longer for a new one. Over 100 ms and 10 % loss it lost five in 75 s, for 1.1 to 3.0 s each.
LOSSY_NS = 4_000_000_000
LOSSY_SHARE = 0.01


class ConnectionWatch:
    """Watches the TCP connections of an end; `is_kept` is true while there is one, and for a moment after the last."""

    def __init__(self, is_connected: Callable[[], bool], machine: str, now_ns: int) -> None:
        self.is_kept = True
        self._is_connected, self._machine = is_connected, machine
        self._connected_ns = now_ns
        self._is_reported = False

    def look(self, now_ns: int, *, arriving: bool, loss_share: float) -> tuple[str, str] | None:
        """Look at the connections; return level and text of an event if datagrams can cross and commands cannot.

        Args:
            now_ns: The time now [ns].
            arriving: Whether datagrams arrive; if nothing crosses, other events report it.
            loss_share: The share of the datagrams that the network loses, in the worse direction.
        """
        if self._is_connected():
            self._connected_ns = now_ns
        self.is_kept = now_ns - self._connected_ns < (LOSSY_NS if loss_share > LOSSY_SHARE else OUT_OF_TOUCH_NS)
        if self._is_reported and self.is_kept:
            self._is_reported = False
            return "info", f"{self._machine} is connected again: the link's datagrams continue"
        if not self._is_reported and not self.is_kept and arriving:
            self._is_reported = True
            text = "no command can cross, and the link's datagrams wait"
            return "warning", f"{self._machine} is no longer connected over TCP: {text}"
        return None
