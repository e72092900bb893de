"""Whether this process hears the publishers on its machine that send, and a new connection to one that it does not.

libzmq gives a connection up for good where its peer breaks the protocol, such as by a frame that is too large, and
reports nothing. So silence is what shows it. Every node sends node/health twice a second, and each reader subscribes to
it. Where two looks in a row find nothing new of a publisher whose socket answers, a further connection is opened beside
the first. If something comes in by it, and still nothing by the first, the reader was deaf, and connects anew. If
nothing comes in by either, the publisher itself is silent, and the connection is left as it is, with what waits in it.

A console comes for a command and goes, so it may have broken the connection and left nothing to hear. The folder of the
sockets shows that somebody came or went: then readers connect anew to those who are not there, who cannot lose anything
by it.

No thread is needed: a look takes microseconds, and a loop has one with each report of its health. Safety relies on none
of this: a device goes by the age of its newest input.
"""

import contextlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import zmq

from telenano.runtime.bus.address_book import may_carry
from telenano.runtime.bus.bus import LARGEST_FRAME, ConnectionEvent, Subscriber, split_frames
from telenano.runtime.bus.local_endpoint import is_bound, path_of
from telenano.runtime.bus.publisher import FIRST_THREAD
from telenano.timing.clock import Clock
from telenano.wire.codec import WireError, accept
from telenano.wire.messages import MAX_KEYS

# Every node sends it twice a second.
BEACON = "node/health"
# Looks are at least this far apart, which is below the interval of the beacon and of the reports of a loop [ns].
_LOOK_NS = 400_000_000
# A publisher that was not heard at this number of looks in a row is listened to by a further connection.
_SILENT_LOOKS = 2
# A new connection that does not help is followed by the next after so many looks, and then after twice as many each.
_FIRST_PAUSE, _LONGEST_PAUSE = 2, 128
# A change of a folder is new at this number of looks, because the next one may come in the same tick of the clock.
_FRESH_LOOKS = 2
# This is enough to know that the publisher sends; of the rest, what the socket does not hold is dropped.
_PROBED = 20


@dataclass
class _Folder:
    """A folder of sockets: when a file was made or removed there last [ns], and at how many looks that is still new."""

    path: Path
    changed_ns: int = -1
    fresh: int = 0

    def look(self) -> None:
        try:
            changed_ns = self.path.stat().st_mtime_ns
        except OSError:
            changed_ns = 0
        self.fresh = _FRESH_LOOKS if changed_ns != self.changed_ns else max(0, self.fresh - 1)
        self.changed_ns = changed_ns


@dataclass
class _Ear:
    """The connection of a reader to one publisher.

    `heard` has how many messages came by it, `heard_ns` when that was found last [ns]. `there` is
    the socket that was at the endpoint at the last look without any; `probe` is the further connection. `wait` looks go
    by before the next new connection, and `pause` after that one.
    """

    node: str
    endpoint: str
    folder: _Folder
    heard_ns: int
    heard: int = 0
    silent_looks: int = 0
    was_there: bool = False
    there: tuple[int, int] | None = None
    is_deaf: bool = False
    probe: "zmq.Socket[bytes] | None" = None
    pause: int = _FIRST_PAUSE
    wait: int = 0
    path: Path = field(init=False)

    def __post_init__(self) -> None:
        self.path = path_of(self.endpoint)

    def socket_there(self) -> tuple[int, int] | None:
        """Return what tells the socket at the path from a later one there; None where no process has one."""
        try:
            status = self.path.stat()
        except OSError:
            return None
        # To ask again would fill the queue of a process that is stopped, from which it accepts connections.
        if self.probe is None and not is_bound(self.endpoint):
            return None
        return status.st_ino, status.st_ctime_ns

    def hears_by_probe(self) -> bool:
        """Return whether a message of the publisher came by the further connection that the reader would take."""
        if self.probe is None:
            return False
        with contextlib.suppress(zmq.Again):
            for _ in range(_PROBED):
                frames = self.probe.recv_multipart(zmq.DONTWAIT)
                with contextlib.suppress(WireError):
                    if may_carry(self.node, accept(*split_frames(frames)).src):
                        return True
        return False

    def close_probe(self) -> None:
        if self.probe is not None:
            self.probe.close(0)
            self.probe = None

    def event(self, level: str, text: str, state: str, silent_s: float) -> ConnectionEvent:
        facts: dict[str, bool | float | str] = {"peer": self.node, "endpoint": self.endpoint}
        return ConnectionEvent(level, text, {**facts, "connection": state, "silent_s": silent_s})


class Hearing:
    """The connections of one process to publishers on its machine."""

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]", clock: Clock) -> None:
        """Begin without a connection."""
        self._context, self._clock = context, clock
        self._ears: dict[Subscriber, list[_Ear]] = {}
        self._folders: dict[Path, _Folder] = {}
        self._next_look_ns = clock.monotonic_ns() + _LOOK_NS

    def add(self, subscriber: Subscriber, endpoints: Mapping[str, str]) -> None:
        """Look after the connections of a subscriber to nodes (keys), by their ipc endpoints.

        A subscriber that does not read the beacon gets it beside what it reads.
        """
        if BEACON not in subscriber.topics:
            subscriber.hear_beacon(BEACON)
        now_ns = self._clock.monotonic_ns()
        ears = self._ears.setdefault(subscriber, [])
        for node, endpoint in endpoints.items():
            parent = path_of(endpoint).parent
            folder = self._folders.setdefault(parent, _Folder(parent))
            ears.append(_Ear(node, endpoint, folder, now_ns))

    def nodes(self) -> list[str]:
        """Return the publishers whose connections are looked after."""
        return sorted({ear.node for ears in self._ears.values() for ear in ears})

    def deaf(self) -> dict[str, float]:
        """Return the publishers that send and are not heard, each with how long it has not been heard [s]."""
        now_ns = self._clock.monotonic_ns()
        deaf = [ear for ears in self._ears.values() for ear in ears if ear.is_deaf]
        return {ear.node: (now_ns - ear.heard_ns) * 1e-9 for ear in deaf[:MAX_KEYS]}

    def look(self) -> list[ConnectionEvent]:
        """Compare what was heard with what was heard at the last look, and connect anew where that is needed."""
        now_ns = self._clock.monotonic_ns()
        if now_ns < self._next_look_ns:
            return []
        self._next_look_ns = now_ns + _LOOK_NS
        events: list[ConnectionEvent] = []
        for folder in self._folders.values():
            folder.look()
        for subscriber, ears in self._ears.items():
            if not subscriber.socket.closed:
                events += self._look_at(subscriber, ears, now_ns)
        return events

    def close(self) -> None:
        """Close the connections that are open beside those of the readers."""
        for ears in self._ears.values():
            for ear in ears:
                ear.close_probe()

    def _look_at(self, subscriber: Subscriber, ears: Sequence[_Ear], now_ns: int) -> list[ConnectionEvent]:
        events: list[ConnectionEvent] = []
        received: Counter[str] = Counter()
        for (_, src), tracker in subscriber.trackers.items():
            received[src] += tracker.received + tracker.duplicates
        silent = []
        for ear in ears:
            heard = sum(count for src, count in received.items() if may_carry(ear.node, src))
            if heard == ear.heard:
                silent.append(ear)
            else:
                ear.heard = heard
                events += _note_heard(ear, now_ns)
        # What waits is read first, as after a stall of this process.
        if silent and not subscriber.pending():
            for ear in silent:
                events += self._listen_beside(subscriber, ear, now_ns)
        if silent:
            # A call on the socket may have taken the signal of its descriptor, for which a loop would wait.
            subscriber.drained = False
        return events

    def _listen_beside(self, subscriber: Subscriber, ear: _Ear, now_ns: int) -> Sequence[ConnectionEvent]:
        """Act on a publisher of which nothing new has come."""
        ear.silent_looks += 1
        before, ear.there = ear.there, ear.socket_there()
        if ear.silent_looks < _SILENT_LOOKS:
            return ()
        if ear.there is None:
            ear.close_probe()
            ear.is_deaf, ear.pause, ear.wait, ear.heard_ns = False, _FIRST_PAUSE, 0, now_ns
            if ear.was_there or ear.folder.fresh:
                ear.was_there = False
                _connect_anew(subscriber, ear)
            return ()
        ear.was_there = True
        if ear.there != before:
            # It has come since the last look, and nothing that it sent may have been expected before.
            ear.close_probe()
            ear.is_deaf, ear.silent_looks, ear.heard_ns = False, 1, now_ns
            return ()
        if ear.probe is None:
            ear.probe = self._connected_beside(subscriber, ear)
            return ()
        if ear.wait:
            ear.wait -= 1
            return ()
        # What comes at this moment has come by both connections.
        if not ear.hears_by_probe() or subscriber.pending():
            return ()
        _connect_anew(subscriber, ear)
        ear.close_probe()
        ear.silent_looks, ear.wait, ear.pause = 0, ear.pause, min(2 * ear.pause, _LONGEST_PAUSE)
        if ear.is_deaf:
            return ()
        ear.is_deaf = True
        silent_s = (now_ns - ear.heard_ns) * 1e-9
        text = f"deaf to {ear.node} for {silent_s:.1f} s, although it sends ({ear.endpoint}): connected to it anew"
        return (ear.event("warning", text, "deaf", silent_s),)

    def _connected_beside(self, subscriber: Subscriber, ear: _Ear) -> "zmq.Socket[bytes]":
        probe = self._context.socket(zmq.SUB)
        probe.set(zmq.AFFINITY, FIRST_THREAD)
        probe.set(zmq.RCVHWM, _PROBED)
        probe.set(zmq.LINGER, 0)
        probe.set(zmq.MAXMSGSIZE, LARGEST_FRAME)
        for topic in {*subscriber.topics, BEACON}:
            probe.subscribe(topic.encode())
        probe.connect(ear.endpoint)
        return probe


def _note_heard(ear: _Ear, now_ns: int) -> Sequence[ConnectionEvent]:
    silent_s = (now_ns - ear.heard_ns) * 1e-9
    was_deaf = ear.is_deaf
    ear.heard_ns, ear.silent_looks, ear.was_there, ear.is_deaf = now_ns, 0, True, False
    ear.pause, ear.wait = _FIRST_PAUSE, 0
    ear.close_probe()
    if not was_deaf:
        return ()
    return (ear.event("info", f"{ear.node} is heard again after {silent_s:.1f} s", "up", silent_s),)


def _connect_anew(subscriber: Subscriber, ear: _Ear) -> None:
    """Connect the socket to this one endpoint again; its other connections, and what they hold, stay as they are."""
    with contextlib.suppress(zmq.ZMQError):
        # libzmq may have let go of the endpoint.
        subscriber.socket.disconnect(ear.endpoint)
    subscriber.socket.connect(ear.endpoint)
