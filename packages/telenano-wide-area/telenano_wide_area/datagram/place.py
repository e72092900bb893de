"""The addresses of an end of the link's datagrams."""

import socket
from typing import Any, NamedTuple

from telenano_wide_area.relay.path import RelayPath

Address = tuple[Any, ...]


class Place(NamedTuple):
    """The address that an end binds, and that of the other end: None until a datagram of it has arrived.

    `relay`: the path to the other end if both ends can only dial out.
    """

    family: socket.AddressFamily
    bind: Address
    peer: Address | None
    port: int
    relay: RelayPath | None = None
