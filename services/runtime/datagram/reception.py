"""Which way an end receives the samples of the other machine: as datagrams, or over TCP while none arrives.

Who receives decides: while datagrams arrive, the topics are not subscribed over TCP; when none has come for a moment
they are again, and datagrams are tried further on. At first they are not either: the keys come over TCP, and on a
network that loses packets a thousand samples a second, which nobody needs once there are keys, would hold them up for
as long as they are sent.
"""

from collections.abc import Callable, Sequence
from typing import Literal

from services.runtime.bus.bus import Subscriber
from services.runtime.clock import NEVER_NS

# After so long a silence the other way is used, and datagrams have to come for so long before they are relied upon.
SILENCE_NS = 300_000_000
TRIED_NS = 500_000_000
# TCP is subscribed to after a silence of the first, where samples come as often as the second says, and the line is not
# known to carry less than the third [bit/s], which would have no room for it.
MISSED_NS, _CLOSE_NS, _ROOM = 35_000_000, 4_000_000, 8_000_000
# A mean follows some twenty datagrams.
_NEWEST_SHARE = 0.05
# The first datagrams may take so long from the first word of the other machine, or from the last change of keys.
FIRST_NS = 3_000_000_000
_UNOFFERED_NS = 5_000_000_000
_REMIND_NS = 60_000_000_000
# Datagrams are there again if the newest came within this time.
_LATELY_NS = 50_000_000

Way = Literal["datagram", "stream"]


class Reception:
    """The way to receive by, and the topics that are subscribed over TCP for it."""

    def __init__(
        self,
        subscriber: Subscriber,
        topics: Sequence[str],
        peer: tuple[str, int],
        tell: Callable[[str, str], None],
        *,
        falls_back: bool,
        now_ns: int,
    ) -> None:
        """Begin without a subscription over TCP.

        Args:
            subscriber: Receives the topics over TCP.
            topics: What crosses as datagrams to this end.
            peer: The other machine, and the UDP port between here and there.
            tell: Takes level and text of an event.
            falls_back: Whether TCP may carry the samples at all.
            now_ns: The time now [ns].
        """
        self.way: Way = "stream"
        # When the newest datagram arrived, and when a silence is long enough to subscribe over TCP.
        self.arrived_ns = now_ns
        self.missed_ns = NEVER_NS
        self._subscriber, self._topics = subscriber, topics
        self._machine, self._port = peer
        self._tell = tell
        self._falls_back = falls_back
        # It is true while the topics are subscribed over TCP, as they are when a subscriber is made.
        self._streaming = True
        # The topics are subscribed over TCP at this time if no datagram has come by then; None until something of the
        # other machine was received.
        self._stream_at_ns: int | None = None
        self._tried_since_ns: int | None = None
        # When TCP was subscribed to early last, and the mean time between datagrams.
        self._early_ns, self._gap_ns = now_ns, 0.0
        self._next_reminder_ns = now_ns + _UNOFFERED_NS
        self._subscribe(streaming=False)

    def silence_ns(self, now_ns: int) -> int:
        """Return the time since the newest datagram [ns]."""
        return now_ns - self.arrived_ns

    def is_silent(self, now_ns: int) -> bool:
        """Return whether no datagram has come for so long that the other way is used."""
        return now_ns - self.arrived_ns > SILENCE_NS

    def record(self, now_ns: int, capacity: int) -> None:
        """Record a datagram that arrived over a line of a capacity [bit/s], 0 where that is not known."""
        if self._tried_since_ns is None or self.is_silent(now_ns):
            self._tried_since_ns = now_ns
        self._gap_ns += _NEWEST_SHARE * (now_ns - self.arrived_ns - self._gap_ns)
        self.arrived_ns = now_ns
        if self.way == "datagram" and not self._streaming and self._falls_back:
            # A line without room for TCP's thousand samples a second would only be filled by them.
            roomy = self._gap_ns < _CLOSE_NS and not 0 < capacity < _ROOM
            self.missed_ns = now_ns + MISSED_NS if roomy else NEVER_NS

    def begin_keys(self, now_ns: int) -> None:
        """Give the datagrams under new keys their time."""
        self._stream_at_ns = now_ns + FIRST_NS

    def forget(self) -> None:
        """Rely on datagrams only when they have come anew."""
        self._tried_since_ns = None

    def subscribe_early(self, now_ns: int) -> None:
        """Subscribe over TCP at a short silence, before it is known what it means: the first sample takes a while."""
        self.missed_ns, self._early_ns = NEVER_NS, now_ns
        self._subscribe(streaming=True)

    def choose(self, now_ns: int, *, has_peer_key: bool) -> None:
        """Choose the way to receive by, some twenty times a second.

        Args:
            now_ns: The time now [ns].
            has_peer_key: Whether the other end has offered a key.
        """
        silence_ns = self.silence_ns(now_ns)
        if self.is_silent(now_ns):
            self._tried_since_ns = None
        tried_ns = 0 if self._tried_since_ns is None else now_ns - self._tried_since_ns
        if not self._streaming and self.way == "stream" and self._tried_since_ns is None:
            if self._stream_at_ns is None and self._subscriber.trackers:
                self._stream_at_ns = now_ns + FIRST_NS
            if self._stream_at_ns is not None and now_ns >= self._stream_at_ns:
                self._subscribe(streaming=True)
        if self.way == "stream" and tried_ns >= TRIED_NS:
            self.way = "datagram"
            self._subscribe(streaming=False)
            self._tell("info", f"the link receives from {self._machine} as datagrams (UDP port {self._port})")
            self._next_reminder_ns = now_ns
        elif self.way == "datagram" and self._tried_since_ns is None:
            self.way, self.missed_ns = "stream", NEVER_NS
            self._subscribe(streaming=True)
            self._warn(now_ns, f"no datagram has come from {self._machine} for {silence_ns * 1e-9:.1f} s")
        elif self.way == "datagram" and now_ns - self._early_ns >= TRIED_NS and silence_ns < _LATELY_NS:
            self._subscribe(streaming=False)
        # Nothing is wrong yet before TCP replaces the datagrams.
        elif self.way == "stream" and now_ns >= self._next_reminder_ns and self._streaming == self._falls_back:
            what = "is blocked on the way" if has_peer_key else "may be in use by no link there: it has offered no key"
            self._warn(now_ns, f"UDP port {self._port} between here and {self._machine} {what}")

    def _warn(self, now_ns: int, what: str) -> None:
        self._next_reminder_ns = now_ns + _REMIND_NS
        goes_on = "the link goes on over TCP, and tries again" if self._falls_back else "link.transport allows no TCP"
        self._tell("warning", f"{what}: {goes_on}")

    def _subscribe(self, *, streaming: bool) -> None:
        if streaming == self._streaming or (streaming and not self._falls_back):
            return
        self._streaming = streaming
        change = self._subscriber.socket.subscribe if streaming else self._subscriber.socket.unsubscribe
        for topic in self._topics:
            change(topic.encode())
