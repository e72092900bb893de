"""A running rig as the source of a page: an observer of its bus that takes what it shows."""

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

from services.viz_node.feed import SeenMessage, seen
from services.viz_node.source import AGE_TOPICS, LOOP_TOPICS, NoTransport, is_shown
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.participant import Participant
from telenano.wire.nodes import site_of

# This number of batches of a node are taken at once: ten seconds of the busiest topics come in several calls.
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
                    # A message that comes from its publisher as well is taken there.
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
