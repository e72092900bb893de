"""Choose how an end receives samples: as datagrams, or over TCP while no datagram arrives.

The receiver decides. While datagrams arrive, it subscribes only to the sparse samples of the topics over TCP. If none
has arrived for a moment, it subscribes to all samples, if TCP can carry them, while datagrams are still tried. At the
start it subscribes to none: the keys come over TCP, and on a network that loses packets a thousand samples a second
would delay them, though the samples are not needed once there are keys.
"""

from collections.abc import Callable, Sequence
from typing import Literal

import zmq

from telenano.runtime import LinkSide
from telenano.timing import NEVER_NS
from telenano.wire import TOPICS
from telenano_wide_area.datagram.body import DATAGRAM_TOPICS
from telenano_wide_area.datagram.sparse import SPARSE, WANTED_NS

# After a silence of SILENCE_NS TCP is used, and datagrams have to arrive for TRIED_NS before they are relied upon [ns].
SILENCE_NS = 300_000_000
TRIED_NS = 500_000_000
# The shortest deadline of the topics that cross as datagrams [ns].
DEADLINE_NS = round(1e9 * min(row.deadline_s for row in map(TOPICS.__getitem__, DATAGRAM_TOPICS) if row.deadline_s))
# TCP is subscribed to after a silence of half the deadline plus this multiple of the mean interval of datagrams.
_GAPS = 2.0
# TCP is subscribed to after at most this share of the deadline, before a reader acts on the silence.
_LATEST_SHARE = 0.9
# The capacity that TCP needs for each sample, on a line that has room for other traffic as well [bit].
_BITS_EACH = 8_000.0
# The share of the newest value in a mean, which follows some twenty datagrams.
_NEWEST_SHARE = 0.05
# The first datagrams may take this time from the first message of the other machine, or from the last change of keys
# [ns].
FIRST_NS = 3_000_000_000
_UNOFFERED_NS = 5_000_000_000
_REMIND_NS = 60_000_000_000
# Datagrams arrive again if the newest is not older than this [ns].
_LATELY_NS = 50_000_000

Way = Literal["datagram", "stream"]


class Reception:
    """The transport to receive by, and the topics that are subscribed over TCP for it."""

    def __init__(
        self,
        side: LinkSide,
        topics: Sequence[str],
        peer: tuple[str, int],
        tell: Callable[[str, str], None],
        *,
        falls_back: bool,
        now_ns: int,
    ) -> None:
        """Begin without a subscription over TCP.

        Args:
            side: The process of the end, whose reader receives the topics over TCP.
            topics: The topics that cross as datagrams to this end.
            peer: The other machine, and the UDP port between here and there.
            tell: Receives level and text of an event.
            falls_back: Whether TCP may carry the samples at all.
            now_ns: The time now [ns].
        """
        self.way: Way = "stream"
        # The time of the newest datagram, and the time at which a silence is long enough to subscribe over TCP.
        self.arrived_ns = now_ns
        self.missed_ns = NEVER_NS
        self._subscriber, self._topics = side.reader, topics
        self._machine, self._port = peer
        self._tell = tell
        self._falls_back = falls_back
        # Whether the topics are subscribed over TCP, as they are when a subscriber is made.
        self._streaming = True
        # The time at which the topics are subscribed over TCP if no datagram has arrived; None until a message of the
        # other machine has arrived.
        self._stream_at_ns: int | None = None
        self._tried_since_ns: int | None = None
        # The time of the last early subscription over TCP, and the mean interval of datagrams [ns].
        self._early_ns, self._gap_ns = now_ns, 0.0
        # Whether TCP can carry all samples, not only the sparse ones.
        self._roomy = True
        self._subscribed: set[bytes] = {topic.encode() for topic in topics}
        self._names = {sparse + topic.encode(): topic.encode() for sparse in SPARSE for topic in topics}
        # The sparse topics of the subscriber's socket, and those of the second connection.
        self._first, self._second = ([sparse + topic.encode() for topic in topics] for sparse in SPARSE)
        self._beside: zmq.Socket[bytes] | None = None
        # The newest sample that arrived over TCP under its own topic: its sparse copy is sent right after it.
        self._whole = b""
        self._next_reminder_ns = now_ns + _UNOFFERED_NS
        self._subscribe(streaming=False)

    def connect_beside(self, beside: "zmq.Socket[bytes]") -> None:
        """Use the socket of a second connection to the other machine, for its share of the sparse samples."""
        self._beside = beside

    def silence_ns(self, now_ns: int) -> int:
        """Return the time since the newest datagram [ns]."""
        return now_ns - self.arrived_ns

    def is_silent(self, now_ns: int) -> bool:
        """Return whether no datagram has arrived for so long that TCP is used."""
        return now_ns - self.arrived_ns > SILENCE_NS

    def record(self, now_ns: int) -> None:
        """Record a datagram that arrived."""
        if self._tried_since_ns is None or self.is_silent(now_ns):
            self._tried_since_ns = now_ns
        self._gap_ns += _NEWEST_SHARE * (now_ns - self.arrived_ns - self._gap_ns)
        self.arrived_ns = now_ns
        if self.way == "datagram" and not self._streaming and self._falls_back:
            silence_ns = min(DEADLINE_NS / 2 + _GAPS * self._gap_ns, _LATEST_SHARE * DEADLINE_NS)
            self.missed_ns = now_ns + round(silence_ns)

    def weigh(self, carried_by_tcp: float) -> None:
        """Update whether TCP can carry all samples; it can carry this rate to here [bit/s].

        Only while datagrams arrive does their interval show the rate of samples.
        """
        if self.way == "datagram" and self._gap_ns > 0.0:
            # More samples than that would only make a queue.
            self._roomy = carried_by_tcp >= _BITS_EACH * 1e9 / self._gap_ns

    def sift(self, frames: list[bytes], now_ns: int) -> list[bytes] | None:
        """Return a message that came over TCP; a sparse sample under its own topic, or None if it adds nothing new."""
        topic = self._names.get(frames[0])
        if topic is None:
            self._whole = frames[-1]
            return frames
        if self.silence_ns(now_ns) <= WANTED_NS or frames[-1] == self._whole:
            return None
        if self._subscriber.has_newer(topic.decode(), frames[-1]):
            return None
        return [topic, *frames[1:]]

    def begin_keys(self, now_ns: int) -> None:
        """Allow the datagrams under new keys FIRST_NS to arrive."""
        self._stream_at_ns = now_ns + FIRST_NS

    def forget(self) -> None:
        """Rely on datagrams only after they have arrived again for a while."""
        self._tried_since_ns = None

    def subscribe_early(self, now_ns: int) -> None:
        """Subscribe over TCP at a short silence, before its cause is known, because samples take a while to come."""
        self.missed_ns, self._early_ns = NEVER_NS, now_ns
        self._subscribe(streaming=True)

    def remind(self, now_ns: int) -> None:
        """Report at the next choice why TCP is used, because more is known about it."""
        self._next_reminder_ns = now_ns

    def choose(self, now_ns: int, why: str) -> None:
        """Choose the transport to receive by; called some twenty times a second.

        Args:
            now_ns: The time now [ns].
            why: A clause on the UDP port, for the event that no datagram arrives.
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
        # Before TCP replaces the datagrams, nothing is wrong.
        elif self.way == "stream" and now_ns >= self._next_reminder_ns and self._streaming == self._falls_back:
            self._warn(now_ns, f"UDP port {self._port} between here and {self._machine} {why}")

    def _warn(self, now_ns: int, what: str) -> None:
        self._next_reminder_ns = now_ns + _REMIND_NS
        advice = "the link continues over TCP, and tries again" if self._falls_back else "link.transport allows no TCP"
        self._tell("warning", f"{what}: {advice}")

    def _subscribe(self, *, streaming: bool) -> None:
        if streaming and not self._falls_back:
            return
        self._streaming = streaming
        wanted = set(self._names.values()) if streaming and self._roomy else set()
        if self._falls_back and (streaming or self.way == "datagram"):
            wanted |= set(self._first)
            beside, self._beside = self._beside, None
            if beside is not None:
                for frame in self._second:
                    beside.subscribe(frame)
        for frame in sorted(wanted - self._subscribed):
            self._subscriber.socket.subscribe(frame)
        for frame in sorted(self._subscribed - wanted):
            self._subscriber.socket.unsubscribe(frame)
        self._subscribed = wanted
