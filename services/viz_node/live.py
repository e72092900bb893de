"""A running rig as the source of a page: an observer of its bus that takes what it shows, and validates nothing."""

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import msgpack

from proto import WireError
from proto.nodes import site_of
from services.runtime.bus.address_book import AddressBook
from services.runtime.bus.bus import Subscriber, split_frames
from services.runtime.loop.participant import OBSERVER, open_participant
from services.viz_node.feed import UNREADABLE, Seen
from services.viz_node.source import LOOP_TOPICS, TOPICS_SHOWN, NoTransport

# So many batches of a node are taken at once: ten seconds of the busiest topics come in several calls.
_MOST_BATCHES = 8


class LiveSource(NoTransport):
    """The messages of a rig that pages show.

    It is an observer: it needs no endpoint, and the rig does not know of it. To topics of the loop it is subscribed
    only while a page is open. Of a message that crossed the link the original is taken where its publisher is reached.
    """

    def __init__(self, book: AddressBook, name: str) -> None:
        """Connect as the machine that this process runs on; ConfigError when it lacks a key that the rig demands."""
        self._name = name
        self._open = contextlib.ExitStack()
        participant = self._open.enter_context(open_participant(OBSERVER, book, publisher=False))
        self._network = participant.network
        self._subscribers = participant.observe(lambda topic, node: topic in TOPICS_SHOWN)
        self._watched = True
        self._watch(False)

    def poll(self, *, watched: bool) -> Iterator[Seen]:
        if watched != self._watched:
            self._watch(watched)
        self._network.process_events()
        for node, subscriber in self._subscribers.items():
            for _ in range(_MOST_BATCHES):
                for frames, _received_ns in subscriber.receive_raw():
                    seen = self._seen(node, subscriber, frames)
                    if seen is not None:
                        yield seen
                if subscriber.drained:
                    break

    def about(self) -> Mapping[str, Any]:
        return {"kind": "live", "name": self._name}

    def close(self) -> None:
        self._open.close()

    def _watch(self, watched: bool) -> None:
        self._watched = watched
        for subscriber in self._subscribers.values():
            for topic in set(subscriber.topics) & set(LOOP_TOPICS):
                if watched:
                    subscriber.socket.subscribe(topic.encode())
                else:
                    subscriber.socket.unsubscribe(topic.encode())

    def _seen(self, node: str, subscriber: Subscriber, frames: list[bytes]) -> Seen | None:
        """Return a message; None for one that is none, or that comes from its publisher as well."""
        try:
            topic, payload = split_frames(frames)
            fields = msgpack.unpackb(payload)
            src, t_ns = fields["src"], fields["t_ns"]
            if subscriber.permit is not None:
                subscriber.permit(topic, src)
            if site_of(src) != site_of(node) and src in self._subscribers:
                return None
            return Seen(topic, src, int(t_ns), fields)
        except (WireError, *UNREADABLE, msgpack.exceptions.UnpackException):
            return None
