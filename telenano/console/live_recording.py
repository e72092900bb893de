"""Reading of a running rig with the interface of a recording: the same iterator of the same messages."""

import contextlib
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import Self

import zmq

from telenano.console.listener import Listener
from telenano.recording.messages import RecordedChannel, RecordedMessage
from telenano.recording.writer import channel_topic
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.participant import SITES, Participant
from telenano.wire import TOPICS
from telenano.wire.nodes import is_visitor, site_of

_WAIT_MS = 100


def connect(
    participant: Participant,
    sites: Sequence[str] = SITES,
    wanted: Callable[[str, str], bool] = lambda topic, node: True,
    *,
    shared: bool = False,
    unknown: bool = False,
) -> list[Listener]:
    """Subscribe at each node of `sites` to every recorded topic that it publishes.

    `wanted(topic, node)` selects among them; other topics are not even sent. With `shared` one process may read the
    nodes for all observers. With `unknown` subscribe to all topics of visitors, including those that nothing here
    declares, such as those of a package that is not installed.
    """
    readers = participant.observe(
        lambda topic, node: (topic not in TOPICS or TOPICS[topic].recorded) and wanted(topic, node),
        sites,
        shared=shared,
    )
    for node, reader in readers.items() if unknown else ():
        if is_visitor(node):
            reader.socket.subscribe(b"")
    return [Listener(node, reader) for node, reader in readers.items()]


class Rate:
    """Thins out the messages of each channel and source to a rate; topics sent on change are never thinned out."""

    def __init__(self, rate_hz: float) -> None:
        """Pass up to `rate_hz` messages a second of each channel and source [Hz]; 0 for all of them."""
        self._period_ns = round(1e9 / rate_hz) if rate_hz > 0.0 else 0
        self._due_ns: dict[tuple[str, str], int] = {}

    def is_due(self, message: RecordedMessage) -> bool:
        """Return whether a message is passed on."""
        if not self._period_ns or message.channel.rate_hz is None:
            return True
        key = message.channel_topic, message.src
        due_ns = self._due_ns.get(key, 0)
        if message.log_ns < due_ns:
            return False
        # The next message is due on the time grid of the rate, unless the channel was silent.
        kept = message.log_ns - due_ns < self._period_ns
        self._due_ns[key] = (due_ns if kept else message.log_ns) + self._period_ns
        return True


class LiveRecording:
    """The messages on the bus now, with the interface of `Recording`.

    A context manager: `with LiveRecording(book) as live: for message in live.messages(["afm/state"]): ...`
    """

    # Rate for viewers: a rig sends 8000 messages a second, more than a viewer can draw.
    VIEWER_HZ = 100.0

    def __init__(self, book: AddressBook, topics: Collection[str] | None = None, rate_hz: float = 0.0) -> None:
        """Subscribe to the rig as an observer on this machine.

        Args:
            book: The addresses of the rig.
            topics: The topics to subscribe to; None for all.
            rate_hz: Highest rate of each channel [Hz]; 0 for all messages. Topics sent on change are not thinned out.

        Raises:
            ConfigError: This machine lacks a key that the rig requires.
        """
        self._rate = Rate(rate_hz)
        self._open = contextlib.ExitStack()
        participant = self._open.enter_context(Participant.observing(book))
        self._network = participant.network
        self.book = book
        # Lead of reception times over the monotonic clock [ns].
        self.epoch_offset_ns = participant.clock.epoch_offset_ns
        self._listeners = connect(
            participant, wanted=lambda topic, node: topics is None or topic in topics, shared=True
        )
        self._channels: dict[tuple[str, str, str], RecordedChannel] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def channels(self) -> tuple[RecordedChannel, ...]:
        return tuple(self._channels.values())

    def messages(
        self, topics: Iterable[str] | None = None, duration_s: float | None = None
    ) -> Iterator[RecordedMessage]:
        """Yield messages as they arrive; invalid ones are left out.

        Args:
            topics: Names of channels such as `teleop/forward@slave`; None for all.
            duration_s: Duration of reading [s]; None for no end.
        """
        wanted = None if topics is None else frozenset(topics)
        end = None if duration_s is None else time.monotonic() + duration_s
        poller = zmq.Poller()
        for listener in self._listeners:
            poller.register(listener.subscriber.socket, zmq.POLLIN)
        while end is None or time.monotonic() < end:
            poller.poll(_WAIT_MS)
            self._network.process_events()
            for listener in self._listeners:
                for frames, received_ns in listener.subscriber.receive_raw():
                    message = self._message(listener, frames, received_ns)
                    if message is None or (wanted is not None and message.channel_topic not in wanted):
                        continue
                    if self._rate.is_due(message):
                        yield message

    def is_here(self, node: str) -> bool:
        """Return whether a node of the rig is on this machine and thus shares its monotonic clock."""
        is_in_book = node in self.book.nodes
        return is_in_book and self.book.endpoint(node, self._network.machine).startswith("ipc://")

    def close(self) -> None:
        self._open.close()

    def _message(self, listener: Listener, frames: list[bytes], received_ns: int) -> RecordedMessage | None:
        publisher, accepted = listener.publisher, listener.subscriber.accepted(frames)
        if accepted is None:
            return None
        topic, message, payload, _ = accepted
        row, src = TOPICS[topic], message.src
        channel = self._channels.get((publisher, topic, src))
        if channel is None:
            site = site_of(publisher)
            via = "direct" if site_of(src) == site else "link"
            name = channel_topic(topic, src, site)
            channel = RecordedChannel(name, topic, site, via, src, row.rate_hz, row.delivery)
            self._channels[publisher, topic, src] = channel
        return RecordedMessage(channel, received_ns, message.t_ns, message.seq, payload)
