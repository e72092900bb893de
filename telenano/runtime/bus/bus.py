"""The bus of one node: a PUB socket that it binds, SUB connections to its publishers, and the statistics of both."""

import select
from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from heapq import nlargest
from itertools import islice
from typing import Any, NamedTuple, Protocol

import zmq

from telenano.runtime.bus.publisher import FIRST_THREAD, SEND_HIGH_WATER_MARK, Publisher
from telenano.timing.clock import NEVER_NS, Clock
from telenano.wire import TOPICS
from telenano.wire.codec import MAX_MESSAGE_BYTES, WireError, accept, read_header
from telenano.wire.messages import MAX_ROWS, SUPERSEDED, InputHealth, Message
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival, SequenceTracker

# Ten seconds of messages wait for a reader at the publisher, and as much again in a reader that runs and is behind.
# Beyond that the newest are lost, which the reader counts.
QUEUE_S = 10
RECEIVE_HIGH_WATER_MARK = SEND_HIGH_WATER_MARK
# A reader with heartbeats has room for what comes in five minutes while its thread is held up, such as by a compiler.
# Where its socket is full, libzmq reads no answer to its pings, gives the connection up, and may abort the process when
# a message is taken (libzmq #3937).
PINGING_HIGH_WATER_MARK = 30 * SEND_HIGH_WATER_MARK
_PING_MS = 1000
# a frame above this is not even taken into memory: libzmq drops the connection that sent it
LARGEST_FRAME = 16 * MAX_MESSAGE_BYTES
_RECONNECT_MS = 50
# A node looks at its deadline again after this many messages, so that a flood cannot hold a loop.
_BATCH = 256
# A message has two frames. Of one with more, at most this number is read in a turn, and the first turn's are refused.
_MOST_FRAMES = 1000
# A reader expects more messages after this many.
_FEW = 3
# Plain numbers are used, because the enumerations of the binding make the call half as expensive again.
_EVENTS = int(zmq.EVENTS)
_READABLE = int(zmq.POLLIN)
_DONTWAIT = int(zmq.DONTWAIT)
# a member of an enumeration takes longer to look up, and there is one for every message
_NEXT = Arrival.NEXT
# sources that one node keeps sequence statistics of; a peer that makes up names must not fill the memory
_MOST_TRACKERS = 1024
# A connection reports at most this number of sources twice a second. The sender and every reader handle each of them,
# and a thousand would cost a loop of 1 kHz tens of ticks.
MOST_REPORTED = 64


# frames of a message, and the time of reception [ns]
Taken = tuple[Sequence[bytes], int]
# the sequence statistics of its source, seq, t_ns
Header = tuple[SequenceTracker, int, int]


class Bus(Protocol):
    """What a node may ask of the bus."""

    def publish(self, topic: str, **fields: Any) -> Message:
        """Send a message; the header is filled in."""

    def receive(self) -> Iterable[Received]:
        """Return what has arrived, without waiting."""

    def wait(self, deadline_ns: int) -> None:
        """Wait until something has arrived or the monotonic clock has reached `deadline_ns`."""


class ConnectionEvent(NamedTuple):
    """What happened to a connection of a node; it becomes a session/event."""

    level: str
    text: str
    data: dict[str, bool | float | str]


class MessageReader:
    """Turns frames of the bus into messages of a node, wherever they came from.

    It decodes, counts what is refused or lost, and drops what was overtaken.
    """

    def __init__(
        self,
        clock: Clock,
        topics: Iterable[str],
        *,
        permit: Callable[[str, str], None] | None = None,
        newest_only: bool = False,
    ) -> None:
        """Read topics; for the rest see `Subscriber`."""
        self._clock = clock
        self.permit = permit
        self.trackers: dict[tuple[str, str], SequenceTracker] = {}
        self.rejected: dict[str, int] = {}
        self.last_error = ""
        self.topics = sorted(set(topics))
        self._names = {topic.encode(): topic for topic in self.topics if topic in TOPICS}
        latest = {frame: topic for frame, topic in self._names.items() if TOPICS[topic].delivery == "latest"}
        self._conflated = latest if newest_only else {}
        self._aside: dict[str, Callable[[Message], None]] = {}
        # a topic that is read only to know that its publishers are heard, and that no report of inputs has
        self._unlisted = ""

    def take(self, waiting: Sequence[Taken]) -> list[Received]:
        """Decode, validate and track what waited together, each message with the time of reception [ns]."""
        if self._conflated and len(waiting) > 1:
            # Commands, and reports of a changed delay, come before the messages that they apply to.
            left = without_superseded(waiting, self._conflated, self._header)
            waiting = sorted(left, key=lambda taken: taken[0][0] in self._conflated)
        return [message for frames, at_ns in waiting if (message := self.decode_and_track(frames, at_ns)) is not None]

    def _header(self, frames: Sequence[bytes]) -> Header | None:
        if len(frames) != 2:
            return None
        topic = self._conflated[frames[0]]
        try:
            seq, t_ns, src = read_header(topic, frames[1])
            if self.permit is not None:
                self.permit(topic, src)
        except WireError:
            return None
        tracker = self.trackers.get((topic, src))
        return None if tracker is None else (tracker, seq, t_ns)

    def decode_and_track(self, frames: Sequence[bytes], received_ns: int) -> Received | None:
        """Decode, validate and count one message; None when it is rejected, repeated or superseded."""
        if (accepted := self.accepted(frames)) is None:
            return None
        topic, message, payload, tracker = accepted
        arrival = tracker.accept(message.seq, message.t_ns)
        if topic in self._aside:
            self._aside[topic](message)
            return None
        if arrival is not _NEXT:
            overtaken = arrival is Arrival.LATE and TOPICS[topic].delivery == "latest"
            # A repeated command is known by its id; its number depends on the clock of an earlier sender of commands.
            if overtaken or (arrival is Arrival.DUPLICATE and topic != "session/control"):
                return None
        return Received(topic, message, payload, received_ns, arrival)

    def accepted(self, frames: Sequence[bytes]) -> tuple[str, Message, bytes, SequenceTracker] | None:
        """Return topic, message and payload, and the statistics of its source; None when it is rejected.

        Whatever is read from the bus comes through here: each field is then bounded by its model, and what is not is
        counted by its reason.
        """
        try:
            topic, payload = self._names.get(frames[0], ""), frames[-1]
            if not topic or len(frames) != 2:
                topic, payload = split_frames(frames)
            message = accept(topic, payload)
            src = message.src
            if self.permit is not None:
                self.permit(topic, src)
            return topic, message, payload, self.trackers.get((topic, src)) or self.tracker(topic, src)
        except WireError as error:
            self.rejected[error.reason] = self.rejected.get(error.reason, 0) + 1
            self.last_error = str(error)
            return None

    def has_newer(self, topic: str, payload: bytes) -> bool:
        """Return whether what was received of the source of a message is as new as it, or newer."""
        try:
            seq, t_ns, src = read_header(topic, payload)
        except WireError:
            return False
        tracker = self.trackers.get((topic, src))
        return tracker is not None and seq <= tracker.last_seq and t_ns <= tracker.last_t_ns

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of the sources that sent most; a topic without messages has empty ones."""
        now = self._clock.now_ns()
        received = {topic for topic, _ in self.trackers}
        silent = [_health_of(topic, "", SequenceTracker(), now) for topic in self.topics if topic not in received]
        listed = ((source, tracker) for source, tracker in self.trackers.items() if source[0] != self._unlisted)
        chosen = nlargest(MOST_REPORTED, listed, key=lambda source: source[1].received)
        return (*(_health_of(topic, src, t, now) for (topic, src), t in sorted(chosen)), *silent)

    def tracker(self, topic: str, src: str) -> SequenceTracker:
        """Return the sequence statistics of a topic from a source; WireError (`source`) for one too many."""
        tracker = self.trackers.get((topic, src))
        if tracker is None:
            if len(self.trackers) >= _MOST_TRACKERS:
                raise WireError(
                    "source", f"{topic}: {src} is one source more than the {_MOST_TRACKERS} that are counted"
                )
            tracker = self.trackers[topic, src] = SequenceTracker()
        return tracker


class Subscriber(MessageReader):
    """SUB connections of a node: a `MessageReader` with a socket of its own."""

    # A subscriber is never due by itself: it gives only what has arrived.
    due_ns = NEVER_NS

    def __init__(
        self,
        context: "zmq.Context[zmq.Socket[bytes]]",
        clock: Clock,
        connections: Mapping[str, Sequence[str]],
        *,
        connect: bool = True,
        permit: Callable[[str, str], None] | None = None,
        newest_only: bool = False,
        queue_s: float = QUEUE_S,
    ) -> None:
        """Connect to endpoints (keys) for topics (values).

        Args:
            context: The context of ZeroMQ.
            clock: The clock that stamps the reception.
            connections: The topics by endpoint.
            connect: False if the socket is connected later.
            permit: Called with topic and source of each message; raises WireError for what the peers of this socket may
                not publish.
            newest_only: Whether only the newest waiting message of each source is returned on a `latest` topic.
            queue_s: How much may wait after a stall [s].
        """
        topics = {topic for topics in connections.values() for topic in topics}
        super().__init__(clock, topics, permit=permit, newest_only=newest_only)
        # It is true once everything was read; before that, ZeroMQ's descriptor may be silent although messages wait.
        self.drained = True
        # What comes next is the rest of a message of more frames than are read in a turn.
        self._is_in_rest = False
        # Other code calls the socket as well, which may consume the signal of its descriptor.
        self.shared = not connect
        self.socket = context.socket(zmq.SUB)
        self.socket.set(zmq.AFFINITY, FIRST_THREAD)
        self.socket.set(zmq.RCVHWM, PINGING_HIGH_WATER_MARK if newest_only else RECEIVE_HIGH_WATER_MARK)
        if newest_only:
            # The peer cuts a connection on which nothing came for the time that a ping of this side names, with what
            # waits in it, so that a process that was stopped continues with the newest.
            self.socket.set(zmq.HEARTBEAT_IVL, min(_PING_MS, round(250 * queue_s)))
            self.socket.set(zmq.HEARTBEAT_TTL, round(1000 * queue_s))
            self.socket.set(zmq.HEARTBEAT_TIMEOUT, round(1000 * queue_s))
        self.socket.set(zmq.LINGER, 0)
        self.socket.set(zmq.MAXMSGSIZE, LARGEST_FRAME)
        self.socket.set(zmq.RECONNECT_IVL, _RECONNECT_MS)
        # Looks at each message first, and returns its frames, or None where it is not wanted; only a reader that the
        # link's datagrams feed as well has one.
        self.sift: Callable[[list[bytes]], list[bytes] | None] | None = None
        for topic in self.topics:
            self.socket.subscribe(topic.encode())
        for endpoint in connections if connect else ():
            self.socket.connect(endpoint)
        self.descriptor: int = self.socket.fileno()

    def receive_raw(self, *, signalled: bool = False) -> list[tuple[list[bytes], int]]:
        """Return the frames of what has arrived, a bounded number, and the time [ns] at which each was taken.

        Args:
            signalled: Whether the descriptor has become readable, so that a message has probably arrived.
        """
        receive, pending, now_ns = self.socket.recv, self.pending, self._clock.now_ns
        waiting: list[tuple[list[bytes], int]] = []
        self.drained = False
        for taken in range(_BATCH):
            # The socket is asked first, because an exception costs as much as reading a message; where many come it is
            # not asked.
            if taken < _FEW and not (signalled and taken == 0) and not pending():
                self.drained = True
                break
            try:
                # A frame object knows whether more follow; asking the socket costs more than receiving a frame.
                frame = receive(_DONTWAIT, False)
            except zmq.Again:
                self.drained = True
                break
            frames = [frame.bytes]
            while frame.more and len(frames) < _MOST_FRAMES:
                frame = receive(0, False)
                frames.append(frame.bytes)
            if not self._is_in_rest:
                waiting.append((frames, now_ns()))
            self._is_in_rest = frame.more
            if frame.more:
                break
        return waiting

    def receive(self, *, signalled: bool = False) -> list[Received]:
        """Return the messages that have arrived: valid, not overtaken on `latest` topics, repeated only if commands."""
        waiting = self.receive_raw(signalled=signalled)
        if self.sift is not None:
            sifted = ((self.sift(frames), received_ns) for frames, received_ns in waiting)
            return self.take([(frames, received_ns) for frames, received_ns in sifted if frames is not None])
        return self.take(waiting)

    def set_aside(self, topic: str, handle: Callable[[Message], None]) -> None:
        """Subscribe to a topic whose messages are for `handle` and not for the reader."""
        self._aside[topic] = handle
        self.socket.subscribe(topic.encode())

    def hear_beacon(self, topic: str) -> None:
        """Subscribe to a topic only to count its messages, by which `Hearing` knows that a publisher is heard."""
        self._unlisted = topic
        self.set_aside(topic, lambda message: None)

    def pending(self) -> bool:
        """Return whether a message has arrived."""
        # `Socket.poll` is avoided because it first makes a poller.
        events: Any = self.socket.get(_EVENTS)
        return bool(events & _READABLE)

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()


class Reader(Protocol):
    """What a bus receives with."""

    descriptor: int
    drained: bool
    # It is called in each turn, whether or not its descriptor is readable.
    shared: bool
    # It returns messages at this time without a readable descriptor, on the monotonic clock [ns].
    due_ns: int
    trackers: dict[tuple[str, str], SequenceTracker]
    rejected: dict[str, int]
    last_error: str

    def receive(self, *, signalled: bool = False) -> list[Received]:
        """Return the messages that have arrived."""

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of every input."""


class Refusals(Protocol):
    """What counts the messages or connections that it refuses."""

    @property
    def rejected(self) -> dict[str, int]:
        """How often something was refused, by reason."""

    @property
    def last_error(self) -> str:
        """The newest refusal in words."""


class NetworkEvents(Refusals, Protocol):
    """What looks after the network connections of a bus."""

    has_pending: bool

    @property
    def descriptors(self) -> Sequence[int]:
        """What becomes readable when there is something to process."""

    def process_events(self) -> list[ConnectionEvent]:
        """Process pending events, a bounded number; `has_pending`: whether more are left."""


class ZmqBus:
    """A publisher and its subscribers as one bus, with a wait that a signal or a message ends.

    One that `is_brief` reports of the inputs that are sent on change only those that were disturbed: its node's health
    crosses to another machine, and these inputs are not judged by their age.
    """

    is_brief = False

    def __init__(
        self,
        publisher: Publisher,
        subscribers: Sequence[Reader],
        clock: Clock,
        wake_descriptor: int,
        network: NetworkEvents | None = None,
    ) -> None:
        self.subscribers = list(subscribers)
        # At most one reader holds messages back until their time: the end of the link's datagrams.
        self._timed = next((reader for reader in subscribers if not isinstance(reader, Subscriber)), None)
        self._clock = clock
        self._descriptors = [*(subscriber.descriptor for subscriber in subscribers), wake_descriptor]
        self.publish = publisher.publish
        self.sequence_numbers = publisher.sequence_numbers
        self._counters: list[Refusals] = [*self.subscribers]
        self._counted = [0] * len(self._counters)
        self._last_error = ""
        # The readers that the last wait found readable; it is empty where every socket has to be asked.
        self._readable: Sequence[int] = ()
        self._network: NetworkEvents | None = None
        self._network_descriptors: frozenset[int] = frozenset()
        self._events_pending = False
        self.look_after(network)

    def look_after(self, network: NetworkEvents | None) -> None:
        """Have this bus look after the network of its process, whose sockets are all open by now."""
        # a rig on one machine has no network to look after
        if network is None or not network.descriptors:
            return
        self._network, self._network_descriptors = network, frozenset(network.descriptors)
        self._descriptors += self._network_descriptors
        self._events_pending = True
        self.count(network)

    def receive(self) -> Iterable[Received]:
        """Return what has arrived on every connection, without waiting."""
        readable, self._readable = self._readable, ()
        if not readable:
            return [received for subscriber in self.subscribers for received in subscriber.receive()]
        messages: list[Received] = []
        for subscriber in self.subscribers:
            if subscriber.descriptor in readable:
                messages += subscriber.receive(signalled=True)
            elif subscriber.shared:
                messages += subscriber.receive()
        return messages

    def wait(self, deadline_ns: int) -> None:
        """Wait until something has arrived or the monotonic clock has reached `deadline_ns`; it may end for nothing.

        ZeroMQ's descriptor is edge-triggered, by changes of connections too: it may be waited for once everything
        that it signalled has been taken.
        """
        self._readable = ()
        for subscriber in self.subscribers:
            if not subscriber.drained:
                return
        due_ns = self._timed.due_ns if self._timed is not None else deadline_ns
        remaining = min(deadline_ns, due_ns) - self._clock.monotonic_ns()
        if remaining > 0 and not self._events_pending:
            ready, _, _ = select.select(self._descriptors, (), (), remaining * 1e-9)
            self._readable = ready
            if self._network_descriptors:
                self._events_pending = not self._network_descriptors.isdisjoint(ready)

    def count(self, counter: Refusals) -> None:
        """Report what somebody else refuses as well."""
        self._counters.append(counter)
        self._counted.append(0)

    def has_arrived(self) -> bool:
        """Return whether something may have arrived since the last wait, for `receive`."""
        self._readable, _, _ = select.select(self._descriptors, (), (), 0)
        return bool(self._readable)

    def process_events(self, *, now: bool = False) -> Sequence[ConnectionEvent]:
        """Process events of network connections, if there may be any or `now`; return what happened to them."""
        if self._network is None or not (self._events_pending or now):
            return ()
        notices = self._network.process_events()
        self._events_pending = self._network.has_pending
        return notices

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of every input, or of as many as a message takes."""
        rows = (row for subscriber in self.subscribers for row in subscriber.input_health())
        if self.is_brief:
            rows = (row for row in rows if TOPICS[row.topic].rate_hz or row.gaps or row.repeated or row.restarts)
        return tuple(islice(rows, MAX_ROWS))

    def rejections(self) -> tuple[dict[str, int], str]:
        """Return what was not taken so far by reason, and the text of a refusal since it was last asked.

        Beside what is refused that is what was superseded: no fault, for a newer message was waiting as well.
        """
        total: dict[str, int] = {}
        for place, counter in enumerate(self._counters):
            for reason, count in counter.rejected.items():
                total[reason] = total.get(reason, 0) + count
            counted = sum(counter.rejected.values())
            if counted != self._counted[place]:
                self._counted[place], self._last_error = counted, counter.last_error
        superseded = sum(tracker.superseded for reader in self.subscribers for tracker in reader.trackers.values())
        if superseded:
            total[SUPERSEDED] = superseded
        return total, self._last_error


def without_superseded(
    waiting: Sequence[Taken], latest: Container[bytes], header_of: Callable[[Sequence[bytes]], Header | None]
) -> Sequence[Taken]:
    """Return what waits without the messages of a `latest` topic that a newer one of their source stands behind.

    Those are tracked by their header, and counted as superseded. The rest stays in its order and is judged as ever:
    what is late or repeated, has no good header, or is the first from its source.

    Args:
        waiting: The messages that wait, in their order.
        latest: The topics concerned.
        header_of: Returns the header, or None for a message that is left alone.
    """
    topics = [frames[0] for frames, _ in waiting]
    if len(set(topics)) == len(topics):
        return waiting
    crowded = {topic for topic, count in Counter(topics).items() if count > 1 and topic in latest}
    newest: dict[SequenceTracker, tuple[int, int, int]] = {}
    superseded: set[int] = set()
    for place, (frames, _) in enumerate(waiting):
        header = header_of(frames) if frames[0] in crowded else None
        if header is None:
            continue
        tracker, seq, t_ns = header
        before = newest.get(tracker)
        if before is not None:
            older, older_seq, older_t_ns = before
            if seq <= older_seq and t_ns <= older_t_ns:
                continue
            superseded.add(older)
            arrival = tracker.accept(older_seq, older_t_ns)
            tracker.superseded += arrival not in (Arrival.DUPLICATE, Arrival.LATE)
        newest[tracker] = (place, seq, t_ns)
    return [taken for place, taken in enumerate(waiting) if place not in superseded]


def split_frames(frames: Sequence[bytes]) -> tuple[str, bytes]:
    """Return topic and payload of a two-frame message; WireError (`frames`, `topic`) for any other."""
    if len(frames) != 2:
        raise WireError("frames", f"a message has 2 frames (topic, msgpack map), this one has {len(frames)}")
    try:
        return frames[0].decode(), frames[1]
    except UnicodeDecodeError as error:
        raise WireError("topic", f"the topic frame {frames[0][:40]!r} is not UTF-8") from error


def _health_of(topic: str, src: str, tracker: SequenceTracker, now_ns: int) -> InputHealth:
    received = tracker.received > 0
    return InputHealth(
        topic=topic,
        src=src,
        received=tracker.received,
        lost=tracker.lost,
        gaps=tracker.gaps,
        repeated=tracker.late + tracker.duplicates,
        restarts=tracker.restarts,
        age_valid=received,
        age_s=(now_ns - tracker.last_t_ns) * 1e-9 if received else 0.0,
    )
