"""Checks whether this process receives from the publishers on its machine, and reconnects to one that it does not hear.

libzmq drops a connection for good and without a report if the peer breaks the protocol, such as by a frame that is too
large; only silence shows it. Every node sends node/health twice a second, and each reader subscribes to it. If two
checks in a row find nothing new from a publisher whose socket answers, this module opens a second connection, the
probe. If messages arrive by the probe and none by the first connection, the reader was deaf, and reconnects. If none
arrive by either, the publisher itself is silent, and the connection stays as it is, with the messages queued in it.

A console connects for a command and leaves, so it may break a connection and leave nothing to hear. A change of the
folder of sockets shows that a process has come or gone: then readers reconnect to absent publishers, where no message
can be lost by it.

No thread is needed: a check takes microseconds, and a loop makes one with each report of its health. Safety does not
rely on any of this: a device acts on the age of its newest input.
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

# The topic that every node sends twice a second.
BEACON = "node/health"
# Least time between two checks, below the interval of the beacon and of the reports of a loop [ns].
_LOOK_NS = 400_000_000
# A publisher that was not heard at this number of checks in a row gets a probe.
_SILENT_LOOKS = 2
# Number of checks between a reconnection that did not help and the next one: at first, and, as it doubles, at most.
_FIRST_PAUSE, _LONGEST_PAUSE = 2, 128
# A change of a folder counts as new for this number of checks, because a further one may have the same time stamp.
_FRESH_LOOKS = 2
# Messages that a probe queues and reads at once: enough to know that the publisher sends; the rest may be dropped.
_PROBED = 20


@dataclass
class _Folder:
    """A folder of sockets: time of its last change [ns], and the number of checks for which it still counts as new."""

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

    `heard` is the number of messages received by it, and `heard_ns` the time when a check last found new ones [ns].
    `there` identifies the socket at the endpoint at the last check without new messages; `probe` is the second
    connection. `wait` is the number of checks to skip before the next reconnection, and `pause` that after it.
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
        """Return inode number and change time [ns] of the socket at the path; None if no process holds one."""
        try:
            status = self.path.stat()
        except OSError:
            return None
        # While there is a probe, `is_bound` is not called: it would fill the connection queue of a stopped process.
        if self.probe is None and not is_bound(self.endpoint):
            return None
        return status.st_ino, status.st_ctime_ns

    def hears_by_probe(self) -> bool:
        """Return whether a valid message of the publisher has arrived by the probe."""
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
        """Begin without connections to check."""
        self._context, self._clock = context, clock
        self._ears: dict[Subscriber, list[_Ear]] = {}
        self._folders: dict[Path, _Folder] = {}
        self._next_look_ns = clock.monotonic_ns() + _LOOK_NS

    def add(self, subscriber: Subscriber, endpoints: Mapping[str, str]) -> None:
        """Check the connections of a subscriber to nodes (keys) at their ipc endpoints (values) from now on.

        A subscriber that does not read the beacon is subscribed to it in addition.
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
        """Return the publishers whose connections are checked, sorted."""
        return sorted({ear.node for ears in self._ears.values() for ear in ears})

    def deaf(self) -> dict[str, float]:
        """Return the publishers that send but are not heard, each with the time since it was last heard [s]."""
        now_ns = self._clock.monotonic_ns()
        deaf = [ear for ears in self._ears.values() for ear in ears if ear.is_deaf]
        return {ear.node: (now_ns - ear.heard_ns) * 1e-9 for ear in deaf[:MAX_KEYS]}

    def look(self) -> list[ConnectionEvent]:
        """Check which publishers were heard since the last check, and reconnect where needed; return the events."""
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
        """Close the probes."""
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
        # If messages wait, as after a stall of this process, they are read first, and nothing is concluded yet.
        if silent and not subscriber.pending():
            for ear in silent:
                events += self._listen_beside(subscriber, ear, now_ns)
        if silent:
            # A call on the socket may have consumed the signal of its descriptor, for which a loop would wait.
            subscriber.drained = False
        return events

    def _listen_beside(self, subscriber: Subscriber, ear: _Ear, now_ns: int) -> Sequence[ConnectionEvent]:
        """Act on a publisher from which nothing new has arrived: open a probe, or reconnect; return the events."""
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
            # This socket is new since the last check, so no messages from it could be expected before.
            ear.close_probe()
            ear.is_deaf, ear.silent_looks, ear.heard_ns = False, 1, now_ns
            return ()
        if ear.probe is None:
            ear.probe = self._connected_beside(subscriber, ear)
            return ()
        if ear.wait:
            ear.wait -= 1
            return ()
        # If a message is pending at this moment, both connections work.
        if not ear.hears_by_probe() or subscriber.pending():
            return ()
        _connect_anew(subscriber, ear)
        ear.close_probe()
        ear.silent_looks, ear.wait, ear.pause = 0, ear.pause, min(2 * ear.pause, _LONGEST_PAUSE)
        if ear.is_deaf:
            return ()
        ear.is_deaf = True
        silent_s = (now_ns - ear.heard_ns) * 1e-9
        silence = f"received nothing from {ear.node} for {silent_s:.1f} s, although it sends"
        text = f"{silence}: connected again to {ear.endpoint}"
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
    return (ear.event("info", f"messages of {ear.node} arrive again after {silent_s:.1f} s", "up", silent_s),)


def _connect_anew(subscriber: Subscriber, ear: _Ear) -> None:
    """Reconnect the socket to this one endpoint; its other connections and their queued messages stay as they are."""
    with contextlib.suppress(zmq.ZMQError):
        # libzmq may have dropped the endpoint already.
        subscriber.socket.disconnect(ear.endpoint)
    subscriber.socket.connect(ear.endpoint)
