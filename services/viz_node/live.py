"""A running rig as the source of a page: an observer of the bus that receives the topics shown."""

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

from services.viz_node.feed import SeenMessage, seen
from services.viz_node.source import AGE_TOPICS, LOOP_TOPICS, NoTransport, is_shown
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.participant import Participant
from telenano.wire.nodes import site_of

# Most batches received from a node in one call; ten seconds of the busiest topics need several calls.
_MOST_BATCHES = 8


class LiveSource(NoTransport):
    """The messages of a rig that pages show.

    This is an observer: it needs no endpoint, and the rig does not know of it. It subscribes to topics of the loop only
    while a page is open. If a publisher is reached directly, its messages are not also received over the link.
    """

    def __init__(self, book: AddressBook, name: str) -> None:
        """Connect with the keys of this machine; raise ConfigError if it lacks a key that the rig requires."""
        self._name = name
        self._open = contextlib.ExitStack()
        participant = self._open.enter_context(Participant.observing(book))
        self._network = participant.network
        self.subscribers = participant.observe(lambda topic, node: is_shown(topic) or topic in AGE_TOPICS)
        self._watched = True
        self._watch(False)

    def poll(self, *, watched: bool) -> Iterator[SeenMessage]:
        if watched != self._watched:
            self._watch(watched)
        self._network.process_events()
        for node, subscriber in self.subscribers.items():
            for _ in range(_MOST_BATCHES):
                for received in subscriber.receive():
                    # Skip a message over the link if its publisher is subscribed to directly.
                    src = received.message.src
                    if site_of(src) == site_of(node) or src not in self.subscribers:
                        yield seen(received.topic, src, received.message.t_ns, received.message)
                if subscriber.drained:
                    break

    def about(self) -> Mapping[str, Any]:
        return {"kind": "live", "name": self._name}

    def close(self) -> None:
        self._open.close()

    def _watch(self, watched: bool) -> None:
        self._watched = watched
        for subscriber in self.subscribers.values():
            for topic in set(subscriber.topics) & set(LOOP_TOPICS):
                if watched:
                    subscriber.socket.subscribe(topic.encode())
                else:
                    subscriber.socket.unsubscribe(topic.encode())
