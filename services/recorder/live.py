"""A running rig as something to read like a recording: the same iterator of the same messages."""

import time
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Self

import zmq

from proto import TOPICS, WireError
from services.recorder.intake import Listener, read_header
from services.recorder.reader import RecordedChannel, RecordedMessage
from services.recorder.writer import channel_topic
from services.runtime.bus import Subscriber, split_frames
from services.runtime.clock import Clock, SystemClock
from services.runtime.site import SiteBook, site_of

_WAIT_MS = 100


def connect(context: "zmq.Context[zmq.Socket[bytes]]", clock: Clock, book: SiteBook) -> list[Listener]:
    """Connect to each node for every recorded topic that can be heard there."""
    found = []
    for node, topics in book.observed().items():
        recorded = [topic for topic in topics if TOPICS[topic].recorded]
        if recorded:
            found.append(Listener(node, Subscriber(context, clock, {book.endpoint(node): recorded})))
    return found


class LiveRecording:
    """What is said on the bus now, as `Recording` gives what was said.

    A context manager: `with LiveRecording(book) as live: for message in live.messages(["afm/state"]): ...`
    """

    def __init__(self, book: SiteBook) -> None:
        self._context = zmq.Context[zmq.Socket[bytes]]()
        self._listeners = connect(self._context, SystemClock(), book)
        self._channels: dict[tuple[str, str, str], RecordedChannel] = {}

    def __enter__(self) -> Self:
        """Listen."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close every connection."""
        self.close()

    @property
    def channels(self) -> tuple[RecordedChannel, ...]:
        """Everything that was said so far, by whom and where heard."""
        return tuple(self._channels.values())

    def messages(
        self, topics: Iterable[str] | None = None, duration_s: float | None = None
    ) -> Iterator[RecordedMessage]:
        """Give messages as they come, without end when `duration_s` is None; frames that are no message are left out.

        Parameters: topics, names of channels such as `teleop/forward@slave`, all when None.
        """
        wanted = None if topics is None else frozenset(topics)
        end = None if duration_s is None else time.monotonic() + duration_s
        poller = zmq.Poller()
        for listener in self._listeners:
            poller.register(listener.subscriber.socket, zmq.POLLIN)
        while end is None or time.monotonic() < end:
            poller.poll(_WAIT_MS)
            for listener in self._listeners:
                for frames, received_ns in listener.subscriber.receive_raw():
                    message = self._message(listener.publisher, frames, received_ns)
                    if message is not None and (wanted is None or message.channel_topic in wanted):
                        yield message

    def close(self) -> None:
        """Close every connection."""
        for listener in self._listeners:
            listener.subscriber.close()
        self._context.term()

    def _message(self, publisher: str, frames: list[bytes], received_ns: int) -> RecordedMessage | None:
        try:
            topic, payload = split_frames(frames)
            row = TOPICS[topic]
            seq, t_ns, src = read_header(row, payload)
        except (WireError, KeyError):
            return None
        channel = self._channels.get((publisher, topic, src))
        if channel is None:
            site = site_of(publisher)
            via = "direct" if site_of(src) == site else "link"
            name = channel_topic(topic, src, site)
            channel = RecordedChannel(name, topic, site, via, src, row.rate_hz, row.delivery)
            self._channels[publisher, topic, src] = channel
        return RecordedMessage(channel, received_ns, t_ns, seq, payload)
