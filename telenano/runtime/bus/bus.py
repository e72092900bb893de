"""The bus of one node: a PUB socket that it binds, SUB connections to its publishers, and the statistics of both."""

import select
from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from heapq import nlargest
from itertools import islice
from typing import Any, NamedTuple, Protocol

import zmq

from telenano.runtime.bus.publisher import FIRST_THREAD, SEND_HIGH_WATER_MARK, Publisher
from telenano.runtime.bus.socket_monitor import end_monitor
from telenano.timing.clock import NEVER_NS, Clock
from telenano.wire import TOPICS
from telenano.wire.codec import MAX_MESSAGE_BYTES, WireError, accept, read_whole_header
from telenano.wire.messages import MAX_ROWS, SUPERSEDED, InputHealth, Message
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival, Numbers, SequenceTracker, is_behind

# Time of messages that a publisher queues for a reader [s]; a running reader that is behind queues as many again.
# Beyond that the newest messages are lost, and the reader counts them.
QUEUE_S = 10
RECEIVE_HIGH_WATER_MARK = SEND_HIGH_WATER_MARK
# A reader with heartbeats can queue the messages of five minutes while its thread is blocked, such as by a compiler. If
# its socket is full, libzmq reads no answer to its pings, drops the connection, and may abort the process when a
# message is read (libzmq #3937).
PINGING_HIGH_WATER_MARK = 30 * SEND_HIGH_WATER_MARK
_PING_MS = 1000
# Largest frame [bytes]; a larger one is not even read into memory: libzmq drops the connection that sent it.
LARGEST_FRAME = 16 * MAX_MESSAGE_BYTES
_RECONNECT_MS = 50
# A node checks its deadline again after this many messages, so that a flood cannot block a loop.
_BATCH = 256
# A message has two frames. A longer one is read in turns of at most this number of frames; those of the first turn are
# rejected as one message, and the rest is dropped.
_MOST_FRAMES = 1000
# After this many messages in one turn, a reader receives without first polling the socket, because more are likely.
_FEW = 3
# Plain numbers, because the enumerations of the binding make a call 50 % more expensive.
_EVENTS = int(zmq.EVENTS)
_READABLE = int(zmq.POLLIN)
_DONTWAIT = int(zmq.DONTWAIT)
# Bound to a name, because it is used for every message and the lookup of an enumeration member takes longer.
_NEXT = Arrival.NEXT
# Most sources of which a node keeps sequence statistics: a peer that invents names must not fill the memory.
_MOST_TRACKERS = 1024
# A connection reports at most this number of sources, twice a second. The sender and every reader process each row, and
# a thousand rows would cost a loop of 1 kHz tens of ticks.
MOST_REPORTED = 64


# Frames of a message, and its time of reception [ns].
Taken = tuple[Sequence[bytes], int]
# Sequence statistics of the source of a message, and the numbers in its header.
Header = tuple[SequenceTracker, Numbers]


class Bus(Protocol):
    """The interface of the bus for a node."""

    def publish(self, topic: str, **fields: Any) -> Message:
        """Send a message; the header is filled in."""

    def receive(self) -> Iterable[Received]:
        """Return the messages that have arrived, without waiting."""

    def wait(self, deadline_ns: int) -> None:
        """Wait until a message has arrived or the monotonic clock has reached `deadline_ns` [ns]."""


class ConnectionEvent(NamedTuple):
    """An event of a connection of a node; it becomes a session/event."""

    level: str
    text: str
    data: dict[str, bool | float | str]


class MessageReader:
    """Turns frames into messages for a node, from a socket or another source.

    It decodes messages, counts rejected and lost ones, and drops those that a newer one has overtaken.
    """

    def __init__(
        self,
        clock: Clock,
        topics: Iterable[str],
        *,
        permit: Callable[[str, str], None] | None = None,
        newest_only: bool = False,
    ) -> None:
        """Read topics; for the other arguments see `Subscriber`."""
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
        # A topic that is read only to know that its publishers are heard; reports of inputs leave it out.
        self._unlisted = ""

    def take(self, waiting: Sequence[Taken]) -> list[Received]:
        """Decode, validate and track the messages of one batch, each with its time of reception [ns]."""
        if self._conflated and len(waiting) > 1:
            # Commands, and reports of a changed delay, come before the messages that they apply to: `latest` topics
            # are sorted to the end.
            left = without_superseded(waiting, self._conflated, self._header)
            waiting = sorted(left, key=lambda taken: taken[0][0] in self._conflated)
        return [message for frames, at_ns in waiting if (message := self.decode_and_track(frames, at_ns)) is not None]

    def _header(self, frames: Sequence[bytes]) -> Header | None:
        if len(frames) != 2:
            return None
        topic = self._conflated[frames[0]]
        try:
            seq, t_ns, src, run = read_whole_header(topic, frames[1])
            if self.permit is not None:
                self.permit(topic, src)
        except WireError:
            return None
        tracker = self.trackers.get((topic, src))
        return None if tracker is None else (tracker, (seq, t_ns, run))

    def decode_and_track(self, frames: Sequence[bytes], received_ns: int) -> Received | None:
        """Decode, validate and count one message; None if it is rejected, set aside, repeated or superseded."""
        if (accepted := self.accepted(frames)) is None:
            return None
        topic, message, payload, tracker = accepted
        arrival = tracker.accept(message.seq, message.t_ns, message.run)
        if topic in self._aside:
            self._aside[topic](message)
            return None
        if arrival is not _NEXT:
            overtaken = arrival is Arrival.LATE and TOPICS[topic].delivery == "latest"
            # Commands are recognised as repeated by their id, because their seq depends on the clock of an earlier
            # sender of commands.
            if overtaken or (arrival is Arrival.DUPLICATE and topic != "session/control"):
                return None
        return Received(topic, message, payload, received_ns, arrival)

    def accepted(self, frames: Sequence[bytes]) -> tuple[str, Message, bytes, SequenceTracker] | None:
        """Return topic, message, payload, and the statistics of its source; None if it is rejected.

        Every message from the bus passes through here: all fields of an accepted message are within the bounds of its
        model, and rejected messages are counted by their reason.
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
        """Return whether a message as new as this one, or newer, was received from the same source."""
        try:
            seq, t_ns, src, run = read_whole_header(topic, payload)
        except WireError:
            return False
        tracker = self.trackers.get((topic, src))
        return tracker is not None and tracker.is_behind(seq, t_ns, run)

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of the sources that sent most, and empty ones for silent topics."""
        now = self._clock.now_ns()
        received = {topic for topic, _ in self.trackers}
        silent = [_health_of(topic, "", SequenceTracker(), now) for topic in self.topics if topic not in received]
        listed = ((source, tracker) for source, tracker in self.trackers.items() if source[0] != self._unlisted)
        chosen = nlargest(MOST_REPORTED, listed, key=lambda source: source[1].received)
        return (*(_health_of(topic, src, t, now) for (topic, src), t in sorted(chosen)), *silent)

    def tracker(self, topic: str, src: str) -> SequenceTracker:
        """Return the sequence statistics of a topic from a source; raise WireError (`source`) for too many sources."""
        tracker = self.trackers.get((topic, src))
        if tracker is None:
            if len(self.trackers) >= _MOST_TRACKERS:
                raise WireError(
                    "source", f"{topic}: {src} is one source more than the {_MOST_TRACKERS} that are counted"
                )
            tracker = self.trackers[topic, src] = SequenceTracker()
        return tracker


class Subscriber(MessageReader):
    """SUB connections of a node: a `MessageReader` with its own socket."""

    # A subscriber is never due by itself: it returns only messages that have arrived.
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
            permit: Called with topic and source of each message; raises WireError for messages that the peers of this
                socket may not publish.
            newest_only: Whether only the newest waiting message of each source is returned on a `latest` topic.
            queue_s: Longest time that messages stay queued while this process is stopped [s].
        """
        topics = {topic for topics in connections.values() for topic in topics}
        super().__init__(clock, topics, permit=permit, newest_only=newest_only)
        # True once all messages were read; before that, ZeroMQ's descriptor may not signal although messages wait.
        self.drained = True
        # The next frames are the rest of a message with more frames than are read in one turn.
        self._is_in_rest = False
        # Other code also calls the socket, which may consume the signal of its descriptor.
        self.shared = not connect
        self.socket = context.socket(zmq.SUB)
        self.socket.set(zmq.AFFINITY, FIRST_THREAD)
        self.socket.set(zmq.RCVHWM, PINGING_HIGH_WATER_MARK if newest_only else RECEIVE_HIGH_WATER_MARK)
        if newest_only:
            # The peer drops a connection, with the messages queued in it, if it receives nothing for the time that the
            # last ping of this side named; so a process that was stopped continues with the newest messages.
            self.socket.set(zmq.HEARTBEAT_IVL, min(_PING_MS, round(250 * queue_s)))
            self.socket.set(zmq.HEARTBEAT_TTL, round(1000 * queue_s))
            self.socket.set(zmq.HEARTBEAT_TIMEOUT, round(1000 * queue_s))
        self.socket.set(zmq.LINGER, 0)
        self.socket.set(zmq.MAXMSGSIZE, LARGEST_FRAME)
        self.socket.set(zmq.RECONNECT_IVL, _RECONNECT_MS)
        # Called with the frames of each message before it is decoded; returns the frames to decode, or None to drop the
        # message. Only a reader that also receives the link's datagrams has one.
        self.sift: Callable[[list[bytes]], list[bytes] | None] | None = None
        for topic in self.topics:
            self.socket.subscribe(topic.encode())
        for endpoint in connections if connect else ():
            self.socket.connect(endpoint)
        self.descriptor: int = self.socket.fileno()

    def receive_raw(self, *, signalled: bool = False) -> list[tuple[list[bytes], int]]:
        """Return the frames of a bounded number of arrived messages, each with the time at which it was read [ns].

        Args:
            signalled: Whether the descriptor has become readable, so that a message has probably arrived.
        """
        receive, pending, now_ns = self.socket.recv, self.pending, self._clock.now_ns
        waiting: list[tuple[list[bytes], int]] = []
        self.drained = False
        for taken in range(_BATCH):
            # The socket is polled first, because an exception costs as much as reading a message; if many messages
            # come, polling is skipped.
            if taken < _FEW and not (signalled and taken == 0) and not pending():
                self.drained = True
                break
            try:
                # A frame object knows whether more follow; querying the socket costs more than receiving a frame.
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
        """Return the valid messages that have arrived, without overtaken ones on `latest` topics and repeated ones.

        Commands are returned even if repeated.
        """
        waiting = self.receive_raw(signalled=signalled)
        if self.sift is not None:
            sifted = ((self.sift(frames), received_ns) for frames, received_ns in waiting)
            return self.take([(frames, received_ns) for frames, received_ns in sifted if frames is not None])
        return self.take(waiting)

    def set_aside(self, topic: str, handle: Callable[[Message], None]) -> None:
        """Subscribe to a topic whose messages are passed to `handle`, and not returned by `receive`."""
        self._aside[topic] = handle
        self.socket.subscribe(topic.encode())

    def hear_beacon(self, topic: str) -> None:
        """Subscribe to a topic only to count its messages, which tells that a publisher is heard."""
        self._unlisted = topic
        self.set_aside(topic, lambda message: None)

    def pending(self) -> bool:
        """Return whether a message has arrived."""
        # `Socket.poll` is avoided, because it makes a poller first.
        events: Any = self.socket.get(_EVENTS)
        return bool(events & _READABLE)

    def close(self) -> None:
        """Close the socket."""
        end_monitor(self.socket)
        self.socket.close()


class Reader(Protocol):
    """A receiving part of a bus."""

    descriptor: int
    drained: bool
    # Whether the reader is called in each turn, even if its descriptor is not readable.
    shared: bool
    # Time at which the reader returns messages without a readable descriptor, on the monotonic clock [ns].
    due_ns: int
    trackers: dict[tuple[str, str], SequenceTracker]
    rejected: dict[str, int]
    last_error: str

    def receive(self, *, signalled: bool = False) -> list[Received]:
        """Return the messages that have arrived."""

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of every input."""


class Refusals(Protocol):
    """A counter of refused messages or connections."""

    @property
    def rejected(self) -> dict[str, int]:
        """The number of refusals by reason."""

    @property
    def last_error(self) -> str:
        """The newest refusal in words."""


class NetworkEvents(Refusals, Protocol):
    """The events of the connections of a bus; `has_pending` tells whether some are not processed yet."""

    has_pending: bool

    @property
    def descriptors(self) -> Sequence[int]:
        """Descriptors that become readable when there are events to process."""

    def process_events(self) -> list[ConnectionEvent]:
        """Process a bounded number of pending events; set `has_pending` if more are left."""


class ZmqBus:
    """A publisher and its subscribers as one bus; a signal or a message ends its wait.

    If `is_brief`, inputs without a declared rate are reported only if messages were lost or repeated or the source has
    restarted: the node's health crosses to another machine, and these inputs are not judged by their age.
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
        # At most one reader holds messages back until a due time: the end of the link's datagrams.
        self._timed = next((reader for reader in subscribers if not isinstance(reader, Subscriber)), None)
        self._clock = clock
        self._descriptors = [*(subscriber.descriptor for subscriber in subscribers), wake_descriptor]
        self.publish = publisher.publish
        self.sequence_numbers = publisher.sequence_numbers
        self._counters: list[Refusals] = [*self.subscribers]
        self._counted = [0] * len(self._counters)
        self._last_error = ""
        # The descriptors that the last wait found readable; if empty, every socket has to be polled.
        self._readable: Sequence[int] = ()
        self._network: NetworkEvents | None = None
        self._network_descriptors: frozenset[int] = frozenset()
        self._events_pending = False
        self.look_after(network)

    def look_after(self, network: NetworkEvents | None) -> None:
        """Also process the events of the connections of this process, whose sockets are all open by now."""
        if network is None:
            return
        self._network, self._network_descriptors = network, frozenset(network.descriptors)
        self._descriptors += self._network_descriptors
        # Connections within this machine have no descriptors here: their events wait for a report.
        self._events_pending = bool(self._network_descriptors)
        self.count(network)

    def receive(self) -> Iterable[Received]:
        """Return the messages that have arrived on all connections, without waiting."""
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
        """Wait until a message has arrived or the monotonic clock has reached `deadline_ns` [ns]; may return early.

        ZeroMQ's descriptor is edge-triggered, by changes of connections too: waiting for it is only possible once all
        messages that it has signalled are read.
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
        """Include the refusals of another counter in `rejections`."""
        self._counters.append(counter)
        self._counted.append(0)

    def has_arrived(self) -> bool:
        """Return whether messages may have arrived since the last wait; `receive` then reads only those sockets."""
        self._readable, _, _ = select.select(self._descriptors, (), (), 0)
        return bool(self._readable)

    def process_events(self, *, now: bool = False) -> Sequence[ConnectionEvent]:
        """Process events of connections if some may be pending, or if `now` is set; return the notices."""
        if self._network is None or not (self._events_pending or now):
            return ()
        notices = self._network.process_events()
        self._events_pending = self._network.has_pending
        return notices or ()

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of the inputs, at most as many as fit into a message."""
        rows = (row for subscriber in self.subscribers for row in subscriber.input_health())
        if self.is_brief:
            rows = (row for row in rows if TOPICS[row.topic].rate_hz or row.gaps or row.repeated or row.restarts)
        return tuple(islice(rows, MAX_ROWS))

    def rejections(self) -> tuple[dict[str, int], str]:
        """Return the number of messages and connections not accepted so far, by reason, and the newest refusal's text.

        Superseded messages are counted too. They are no fault: a newer message was waiting as well.
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
    """Return the waiting messages without those of a `latest` topic that a newer one from the same source follows.

    The omitted messages are tracked by their headers and counted as superseded. All others keep their order and are
    checked later as usual: late or repeated messages, those without a valid header, and the first from a source.

    Args:
        waiting: The waiting messages, in order of arrival.
        latest: The `latest` topics, encoded.
        header_of: Returns the header, or None for a message that has to be kept.
    """
    topics = [frames[0] for frames, _ in waiting]
    if len(set(topics)) == len(topics):
        return waiting
    crowded = {topic for topic, count in Counter(topics).items() if count > 1 and topic in latest}
    newest: dict[SequenceTracker, tuple[int, Numbers]] = {}
    superseded: set[int] = set()
    for place, (frames, _) in enumerate(waiting):
        header = header_of(frames) if frames[0] in crowded else None
        if header is None:
            continue
        tracker, numbers = header
        before = newest.get(tracker)
        if before is not None:
            older, older_numbers = before
            if is_behind(numbers, older_numbers):
                continue
            superseded.add(older)
            arrival = tracker.accept(*older_numbers)
            tracker.superseded += arrival not in (Arrival.DUPLICATE, Arrival.LATE)
        newest[tracker] = (place, numbers)
    return [taken for place, taken in enumerate(waiting) if place not in superseded]


def split_frames(frames: Sequence[bytes]) -> tuple[str, bytes]:
    """Return topic and payload of a message of two frames; raise WireError (`frames`, `topic`) for any other."""
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
