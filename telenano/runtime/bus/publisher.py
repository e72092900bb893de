"""The sending side of a node: a PUB socket that it binds; messages are numbered, time-stamped and checked."""

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import zmq

from telenano.runtime.bus.endpoint_lock import EndpointLock
from telenano.runtime.bus.ipc_listener import IpcListener
from telenano.runtime.bus.socket_monitor import end_monitor
from telenano.settings.package_topics import row_of
from telenano.timing.clock import Clock
from telenano.wire import TOPICS, compose
from telenano.wire.ends import END_TOPIC, end_data
from telenano.wire.errors import EndpointError
from telenano.wire.messages import Message
from telenano.wire.sequence import run_at

# Most messages that a publisher queues for a reader whose process is stopped: ten seconds of the busiest publisher, a
# half of the controller with 2100 messages per second.
SEND_HIGH_WATER_MARK = 22_000
# Largest message from a subscriber [bytes]; subscribers send nothing but names of topics.
_LARGEST_SUBSCRIPTION = 4096
# A plain number, because the enumeration of the binding makes a call 50 % more expensive.
SNDMORE = int(zmq.SNDMORE)
# The I/O thread of a context for the messages of a node, as a bit of the affinity; sockets that strangers can reach are
# served by another thread.
FIRST_THREAD = 1
_FRAMES = {topic: topic.encode() for topic in TOPICS}
# A node that ends continues to send for at most this time to a reader that is behind, above all its recorder. The time
# is shorter than the grace period of a supervisor.
LINGER_S = 20.0


class Publisher(Protocol):
    """The sending part of a bus."""

    def publish(self, topic: str, **fields: Any) -> Message:
        """Send a message on a topic; the header is filled in."""

    def sequence_numbers(self) -> dict[str, int]:
        """Return the seq of the next message on each topic."""


class _NumberingPublisher(ABC):
    def __init__(self, clock: Clock, node: str) -> None:
        self.node = node
        # Called with a sentence when a quantity was out of its range and has been limited.
        self.on_limited: Callable[[str], None] = lambda text: None
        self._clock = clock
        self._run = run_at(clock.now_ns())
        self._sequence: dict[str, int] = {}

    def publish(self, topic: str, **fields: Any) -> Message:
        """Send a message on a topic with the header filled in, and values limited to their ranges.

        Raises:
            WireError: The message is invalid or too large.
        """
        seq = self._sequence.get(topic, 0)
        header = {"seq": seq, "t_ns": self._clock.now_ns(), "src": self.node, "v": version_of(topic), "run": self._run}
        message, payload = compose(topic, {**header, **fields}, self.on_limited)
        self.send(topic, payload)
        self._sequence[topic] = seq + 1
        return message

    def sequence_numbers(self) -> dict[str, int]:
        """Return the seq of the next message on each topic."""
        return dict(self._sequence)

    @abstractmethod
    def send(self, topic: str, payload: bytes) -> None: ...


class NullPublisher(_NumberingPublisher):
    """A publisher for a process without an endpoint: it numbers and checks messages, but sends none."""

    def send(self, topic: str, payload: bytes) -> None:
        """Drop a message."""


class ZmqPublisher(_NumberingPublisher):
    """The PUB socket of a node: numbers, stamps, checks and sends its messages."""

    def __init__(
        self,
        context: "zmq.Context[zmq.Socket[bytes]]",
        clock: Clock,
        node: str,
        endpoint: str,
        *,
        kind: int = zmq.PUB,
        prepare: Callable[["zmq.Socket[bytes]"], None] = lambda socket: None,
    ) -> None:
        """Open a socket, call `prepare` with it, and bind it to an endpoint; raise EndpointError if that fails."""
        super().__init__(clock, node)
        self._lock = EndpointLock(endpoint, node)
        self.socket = context.socket(kind)
        self.socket.set(zmq.AFFINITY, FIRST_THREAD)
        self.socket.set(zmq.SNDHWM, SEND_HIGH_WATER_MARK)
        self.socket.set(zmq.LINGER, round(LINGER_S * 1e3))
        self.socket.set(zmq.MAXMSGSIZE, _LARGEST_SUBSCRIPTION)
        # Call the C base class directly: the method of the subclass first checks options that a PUB socket does not
        # have.
        self.send_frame = super(zmq.Socket, self.socket).send
        # Called with topic and bytes before each message is sent: it may send the message to another machine by another
        # transport. If it returns a prefix, this socket sends the message a second time, with the prefix before the
        # topic.
        self.carry: Callable[[str, bytes], bytes | None] | None = None
        # Whether to yield the processor after each message, so that the thread that sends it can run at once.
        self.yields = False
        prepare(self.socket)
        try:
            self._listener = bind(self.socket, endpoint, node)
        except EndpointError:
            self._lock.release()
            raise

    def send(self, topic: str, payload: bytes) -> None:
        """Send bytes unchanged: a message that the link forwards keeps the header of its publisher."""
        sparse = None if self.carry is None else self.carry(topic, payload)
        # A player may send on a topic that is not in the table.
        frame = _FRAMES.get(topic) or topic.encode()
        self.send_frame(frame, SNDMORE)
        self.send_frame(payload)
        if sparse is not None:
            self.send_frame(sparse + frame, SNDMORE)
            self.send_frame(payload)
        if self.yields:
            os.sched_yield()

    def also_bind(self, endpoint: str) -> None:
        """Bind a further endpoint; if that fails, close everything and raise EndpointError with the reason."""
        try:
            bind(self.socket, endpoint, self.node)
        except EndpointError:
            if self._listener is not None:
                self._listener.remove()
            self._lock.release()
            raise

    def lost(self) -> str:
        """Return the path of the lock or socket that was removed or replaced; empty while both are in place."""
        return self._lock.lost() or ("" if self._listener is None else self._listener.lost())

    def make_again(self) -> None:
        """Restore a lost lock or socket; raise EndpointError if another process holds the endpoint."""
        if self._lock.lost():
            self._lock.make_again()
        if self._listener is not None and self._listener.lost():
            self._listener.make_again()

    def close(self) -> None:
        """Close the socket and release the endpoint."""
        end_monitor(self.socket)
        self.socket.close()
        if self._listener is not None:
            self._listener.remove()
        self._lock.release()


def version_of(topic: str) -> int:
    """Return the version of the messages of a topic; KeyError if it is unknown."""
    row = row_of(topic)
    if row is None:
        raise KeyError(topic)
    return row.model.version


def publish_end(publisher: Publisher, node: str, forwarded: Mapping[tuple[str, str], int] | None = None) -> None:
    """Publish the last message of a node: the number of messages it sent on each topic (see telenano/wire/ends.py).

    Args:
        publisher: Sends the event and has counted the messages.
        node: The name of the publisher.
        forwarded: The numbers of forwarded messages, see `end_data`.
    """
    sent = publisher.sequence_numbers()
    sent[END_TOPIC] = sent.get(END_TOPIC, 0) + 1
    text = f"{node} has ended, after {sum(sent.values())} messages of its own"
    publisher.publish(END_TOPIC, id="", kind="node", level="info", text=text, data=end_data(sent, forwarded))


def bind(socket: "zmq.Socket[bytes]", endpoint: str, node: str) -> IpcListener | None:
    """Bind a socket; on failure close it and raise EndpointError, which names node, endpoint and the reason.

    Returns:
        The listener that keeps the file of an ipc endpoint; None for other endpoints, which have no file.
    """
    try:
        if endpoint.startswith("ipc://"):
            return IpcListener(socket, endpoint)
        socket.bind(endpoint)
    except (OSError, zmq.ZMQError) as error:
        socket.close()
        hint = "another process has it: stop that one or give another endpoint in the site file"
        reason = hint if error.errno == zmq.EADDRINUSE else error.strerror or error
        raise EndpointError(f"{node} cannot bind {endpoint}: {reason}") from error
    return None
