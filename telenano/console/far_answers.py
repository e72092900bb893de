"""Answers of the hand to an emergency stop that was given at the instrument's machine.

The instrument's answer carries the stop over the link to the hand (`services/delay_node/far_stop.py`), and the link
reports at its endpoint for the instrument's site when the hand has obeyed it. That endpoint is on the other machine, so
hearing it needs keys and a network, for which a stop does not wait: it is sent before.
"""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any

from telenano.console.answers import Answer
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import Subscriber
from telenano.runtime.wiring.participant import Participant
from telenano.wire.answers import OBEYED
from telenano.wire.errors import TelenanoError
from telenano.wire.messages import SessionEvent
from telenano.wire.nodes import LINK

_FAR_LINK = f"{LINK}@slave"


class Listener:
    """Hears the reports of the link at the instrument's site."""

    def __init__(self, subscribers: Sequence[Subscriber], participant: Participant | None) -> None:
        self._subscribers, self._participant = subscribers, participant

    def sockets(self) -> Sequence[Any]:
        """Return the sockets to wait for."""
        return [subscriber.socket for subscriber in self._subscribers]

    def answers(self, identifier: str) -> Iterator[Answer]:
        """Yield the answers to a stop that have arrived."""
        if self._participant is not None:
            self._participant.network.process_events()
        for subscriber in self._subscribers:
            for received in subscriber.receive():
                event = received.message
                if isinstance(event, SessionEvent) and event.data.get(OBEYED) == identifier:
                    yield Answer(str(event.data.get("about_node")), "ack", event.text)


@contextmanager
def _open(site_file: Path) -> Iterator[Listener]:
    with ExitStack() as opened:
        try:
            book = AddressBook.load(site_file)
            participant = opened.enter_context(Participant.observing(book))
            listener = Listener(participant.subscribers({_FAR_LINK: ["session/event"]}), participant)
        except (TelenanoError, ValueError, KeyError):
            # Without an address or a key nothing is heard, and the device counts as out of reach.
            listener = Listener((), None)
        yield listener


def listening(site_file: Path) -> AbstractContextManager[Listener]:
    """Listen to the link of a site file; if that is not possible, a listener that hears nothing."""
    return _open(site_file)
