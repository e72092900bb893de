"""The simulated hand at the page of a rig, pushed by a person or by a program.

with contextlib.closing(RigHand(site_file)) as hand:
hand.push(0.5)
"""

import contextlib
from pathlib import Path
from typing import Any

from telenano.numerics.frames import to_site_frame
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.participant import Participant
from telenano.wire.errors import TelenanoError
from telenano.wire.messages import Message
from telenano.wire.nodes import VIEW


class RigHand:
    """Publisher of `operator/force`, the force of an operator at a page, which an interactive scenario follows."""

    def __init__(self, site_file: Path) -> None:
        """Bind the endpoint of the view; raise ConfigError if the site file has none, EndpointError if it is in use."""
        self._open = contextlib.ExitStack()
        participant = self._open.enter_context(Participant.open(VIEW, AddressBook.load(site_file)))
        self._clock = participant.clock
        try:
            self._publisher = participant.bind(VIEW, ends=True)
        except TelenanoError:
            self._open.close()
            raise

    def push(self, force_n: float, across_n: tuple[float, float] = (0.0, 0.0), by: str = "") -> None:
        named = {"by": by} if by else {}
        self._publisher.publish("operator/force", force_n=(*across_n, to_site_frame(force_n)[2]), **named)

    def publish(self, topic: str, **fields: Any) -> Message:
        """Publish on a topic of a package, as panels of the page do; return the message."""
        return self._publisher.publish(topic, **fields)

    def now_ns(self) -> int:
        """Return the time on the clock of this endpoint [ns]."""
        return self._clock.now_ns()

    def close(self) -> None:
        """Publish the end message, and close the endpoint."""
        self._open.close()
