"""The bus in memory: a node publishes to the rig, and reads the messages that have arrived as from a socket."""

import heapq
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from operator import itemgetter
from typing import Any, NamedTuple, Protocol

from telenano.runtime.bus.bus import ConnectionEvent
from telenano.runtime.bus.handed_reader import Arriving, HandedReader
from telenano.runtime.bus.publisher import version_of
from telenano.timing.clock import NEVER_NS
from telenano.virtual.world import World
from telenano.wire import TOPICS, Message, compose
from telenano.wire.messages import MAX_ROWS, SUPERSEDED, InputHealth
from telenano.wire.nodes import LINK, RECORDER, name_of
from telenano.wire.received import Received
from telenano.wire.sequence import run_at

# greatest number of messages that a reader takes at once
_BATCH = 256
# period in which a recorder takes its messages together [ns]; each message keeps its own time of reception
_RECORDER_PERIOD_NS = 5_000_000


class VirtualBus:
    """The bus of one node, or the endpoint of a publisher without subscriptions."""

    # A publisher of the link has this flag for its thread, of which there is none here.
    yields = False
    is_brief = False

    def __init__(self, rig: World, key: str, topics: Sequence[str] = (), *, newest_only: bool | None = None) -> None:
        """Open the bus of node `key`; by default the link reads every message, and any other node only the newest."""
        self.key = key
        self.inbox: list[Arriving] = []
        is_newest_only = name_of(key) != LINK if newest_only is None else newest_only
        self._clock = rig.clock_of(key)
        self.reader = HandedReader(self._clock, topics or TOPICS, newest_only=is_newest_only)
        self._rig = rig
        self._run = run_at(self._clock.now_ns())
        self._numbers: dict[str, int] = {}
        # By topic, the version of its messages, and a function that draws the delay of sending one [ns].
        self._sending: dict[str, tuple[int, Callable[[], int]]] = {}

    def publish(self, topic: str, **fields: Any) -> Message:
        rig, seq = self._rig, self._numbers.get(topic, 0)
        version, draw = self._sending.get(topic) or self._open(topic)
        # A message is sent some time after the start of the turn, which a re-run does not know.
        drawn_ns = draw()
        t_ns = self._clock.now_ns() + drawn_ns
        message, payload = compose(
            topic, {"seq": seq, "t_ns": t_ns, "src": self.key, "v": version, "run": self._run, **fields}
        )
        self._numbers[topic] = seq + 1
        rig.carry(topic, message, payload, rig.clock.monotonic_ns() + drawn_ns)
        return message

    def _open(self, topic: str) -> tuple[int, Callable[[], int]]:
        names = ("sending", self.key, topic)
        self._sending[topic] = version_of(topic), self._rig.streams.draws(self._rig.timing.sending, names)
        return self._sending[topic]

    def send(self, topic: str, payload: bytes) -> None:
        self._rig.forward(self.key, topic, payload)

    def receive(self) -> Iterable[Received]:
        inbox, now_ns = self.inbox, self._rig.clock.monotonic_ns()
        if not inbox or inbox[0][0] > now_ns:
            return ()
        waiting = [heapq.heappop(inbox)]
        while inbox and inbox[0][0] <= now_ns and len(waiting) < _BATCH:
            waiting.append(heapq.heappop(inbox))
        return self.reader.arrived(waiting, self._clock.now_ns())

    def wait(self, deadline_ns: int) -> None:
        """Return at once, because the rig advances the time."""

    def next_ns(self) -> int:
        """Return when the next message arrives, on the monotonic clock [ns]."""
        return self.inbox[0][0] if self.inbox else NEVER_NS

    def sequence_numbers(self) -> dict[str, int]:
        return dict(self._numbers)

    def input_health(self) -> tuple[InputHealth, ...]:
        return tuple(islice(self.reader.input_health(), MAX_ROWS)) if self._rig.counts_inputs else ()

    def rejections(self) -> tuple[dict[str, int], str]:
        total = dict(self.reader.rejected)
        superseded = sum(tracker.superseded for tracker in self.reader.trackers.values())
        if superseded and self._rig.counts_inputs:
            total[SUPERSEDED] = superseded
        return total, self.reader.last_error

    def process_events(self, *, now: bool = False) -> Sequence[ConnectionEvent]:
        return ()

    def has_arrived(self) -> bool:
        return False

    def close(self) -> None:
        self.inbox.clear()


class _Listener(Protocol):
    """A connection of a recorder to one publisher, `console.listener.Listener`."""

    @property
    def publisher(self) -> str: ...

    @property
    def subscriber(self) -> Any: ...


class _Intake(Protocol):
    """The part of a recorder that writes messages."""

    def record(self, listener: Any, frames: Sequence[bytes], received_ns: int) -> Received | None:
        """Record one message, received at a time [ns]; return it if the node must act on it."""


class RecorderWay(NamedTuple):
    """The connection of a topic from an endpoint to a recorder: draw of its delay [ns], listener, first frame."""

    draw: Callable[[], int]
    listener: _Listener
    frame: bytes


class RecordingBus(VirtualBus):
    """The bus of a recorder, which records the messages of every endpoint with their times of reception."""

    def __init__(self, publisher: VirtualBus, listeners: Sequence[_Listener], intake: _Intake) -> None:
        super().__init__(publisher._rig, publisher.key)
        self._listeners: Mapping[str, _Listener] = {listener.publisher: listener for listener in listeners}
        self._record: Callable[..., Received | None] = intake.record
        self._taken_ns = 0
        self._ways: dict[tuple[str, str], RecorderWay | None] = {}
        # By endpoint, the reception of its newest message [ns]: its messages arrive in the order of sending.
        self.newest_ns: dict[str, int] = {}
        # Messages in transit: time of reception [ns], number, connection and bytes of each.
        self.coming: list[tuple[int, int, RecorderWay, bytes]] = []

    def way(self, endpoint: str, topic: str) -> RecorderWay | None:
        """Return the connection of a topic from an endpoint to this recorder; None if it does not want the topic."""
        place = (endpoint, topic)
        try:
            return self._ways[place]
        except KeyError:
            listener = self._listeners.get(endpoint)
            if listener is None or not listener.subscriber.wants(topic):
                self._ways[place] = None
            else:
                # The first recorder adds no name to its streams.
                further = () if self.key == RECORDER else (self.key,)
                draw = self._rig.streams.draws(self._rig.timing.recorder, ("recorder", endpoint, topic, *further))
                self._ways[place] = RecorderWay(draw, listener, topic.encode())
            return self._ways[place]

    def next_ns(self) -> int:
        return max(self.coming[0][0], self._taken_ns + _RECORDER_PERIOD_NS) if self.coming else NEVER_NS

    def receive(self) -> Iterator[Received]:
        """Record what has arrived; yield only commands, for the node to answer."""
        now_ns, record = self._rig.clock.monotonic_ns(), self._record
        ahead_ns = self._clock.now_ns() - now_ns
        coming = self.coming
        if not coming:
            return
        coming.sort()
        if coming[-1][0] <= now_ns:
            taken, self.coming = coming, []
        else:
            later = bisect_right(coming, now_ns, key=itemgetter(0))
            taken, self.coming = coming[:later], coming[later:]
        self._taken_ns = now_ns
        for at_ns, _, way, payload in taken:
            received = record(way.listener, (way.frame, payload), at_ns + ahead_ns)
            if received is not None:
                yield received

    def input_health(self) -> tuple[InputHealth, ...]:
        if not self._rig.counts_inputs:
            return ()
        rows: Iterable[InputHealth] = chain.from_iterable(
            one.subscriber.input_health() for one in self._listeners.values()
        )
        if self.is_brief:
            rows = (row for row in rows if TOPICS[row.topic].rate_hz or row.gaps or row.repeated or row.restarts)
        return tuple(islice(rows, MAX_ROWS))

    def rejections(self) -> tuple[dict[str, int], str]:
        total: dict[str, int] = {}
        text = ""
        for listener in self._listeners.values():
            for reason, count in listener.subscriber.rejected.items():
                total[reason] = total.get(reason, 0) + count
            text = listener.subscriber.last_error or text
        return total, text

    def close(self) -> None:
        self.coming.clear()
