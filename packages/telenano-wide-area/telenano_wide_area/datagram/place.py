"""Where an end of the link's datagrams is on the network."""

import socket
from typing import Any, NamedTuple

from telenano_wide_area.relay.path import RelayPath

Address = tuple[Any, ...]


class Place(NamedTuple):
    """Where an end binds, and where it finds the other one: None until something of it was received.

    `relay`: the way to the other end where both can only dial out.
    """

    family: socket.AddressFamily
    bind: Address
    peer: Address | None
    port: int
    relay: RelayPath | None = None
