"""Where an end of the link's datagrams is on the network, and where it publishes."""

import socket
from typing import Any, NamedTuple, Protocol

from telenano.wire import Message
from telenano_wide_area.relay.path import RelayPath

Address = tuple[Any, ...]


class Outlet(Protocol):
    """What an end publishes its keys and its reports with."""

    def publish(self, topic: str, **fields: Any) -> Message:
        """Send a message on a topic; the header is filled in."""


class Outlets(NamedTuple):
    """Where an end publishes: its public keys, so that the other end receives them; its reports, at its own site."""

    keys: Outlet
    reports: Outlet


class Place(NamedTuple):
    """Where an end binds, and where it finds the other one: None until something of it was received.

    `relay`: the way to the other end where both can only dial out.
    """

    family: socket.AddressFamily
    bind: Address
    peer: Address | None
    port: int
    relay: RelayPath | None = None
