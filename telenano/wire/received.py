"""A message as a node gets it."""

from typing import NamedTuple

from telenano.wire.messages import Message
from telenano.wire.sequence import Arrival


class Received(NamedTuple):
    """A message with its bytes, when it was received on the clock of the stamps [ns], and how it follows the last."""

    topic: str
    message: Message
    payload: bytes
    received_ns: int
    arrival: Arrival
