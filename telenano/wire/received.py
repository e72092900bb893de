"""A message as a node receives it."""

from typing import NamedTuple

from telenano.wire.messages import Message
from telenano.wire.sequence import Arrival


class Received(NamedTuple):
    """A message with its bytes, its reception time by the node's clock [ns], and its relation to the previous one."""

    topic: str
    message: Message
    payload: bytes
    received_ns: int
    arrival: Arrival
