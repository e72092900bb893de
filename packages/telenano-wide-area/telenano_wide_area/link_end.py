"""Open a process's end of the link's datagrams."""

import ipaddress
import socket

from telenano.runtime import AccessControl, LinkSide
from telenano.wire import ConfigError
from telenano_wide_area.datagram.end import DatagramEnd
from telenano_wide_area.datagram.place import Place
from telenano_wide_area.relay.path import RelayPath
from telenano_wide_area.relay.protocol import TO_RELAY, TO_SITE, SharedKeys, raw_key, relay_key, split_host_port
from telenano_wide_area.settings import DatagramSettings


def open_end(side: LinkSide) -> None:
    """Open the end of a side, attach it to the side's sending and receiving, and open a second TCP connection.

    Raises:
        OSError: Another process has the port, or the name of the relay has no address.
        ValueError: The name of the master cannot be resolved here.
        ConfigError: A key that is needed is not listed here, or a key of the site file is wrong.
    """
    settings = side.book.link.read(DatagramSettings)
    if side.book.relay is None:
        place = place_of(side.endpoint, settings.port, None if side.is_master else side.own_endpoint or "")
    else:
        access = side.network.access_control
        place = relayed_place(side.book.relay, access, side.machine, direct=settings.direct)
    end = DatagramEnd(side, place, settings)
    beside = side.connect_beside(end.take_sparse)
    end.connect_beside(beside.socket)
    side.opened(
        end,
        beside,
        carry=end.carry,
        measure=end.send_train,
        permissions_changed=end.apply_permissions,
        close=end.close,
    )


def place_of(endpoint: str, port: int | None, own: str | None) -> Place:
    """Return the addresses of an end, from the endpoint of the link and a UDP port (None: that of the endpoint).

    The master's end has a fixed port. The slave's end takes any port and sends first, so that it may be behind a
    router; it binds the address that its site binds for TCP.

    Args:
        endpoint: The TCP endpoint of the link, which the master binds.
        port: The UDP port of the master's end.
        own: The TCP endpoint that the slave binds, empty without one; None at the master.

    Raises:
        ValueError: The name of the master cannot be resolved here.
    """
    host, tcp_port = split_host_port(endpoint.removeprefix("tcp://"))
    port = port or tcp_port
    family = socket.AF_INET if ipaddress.ip_address(host).version == 4 else socket.AF_INET6
    if own is None:
        return Place(family, (host, port), None, port)
    bound = split_host_port(own.removeprefix("tcp://"))[0] if own.startswith("tcp://") else ""
    if not bound or (ipaddress.ip_address(bound).version == 4) != (family is socket.AF_INET):
        bound = "::" if family is socket.AF_INET6 else "0.0.0.0"
    return Place(family, (bound, 0), (host, port), port)


def relayed_place(relay: str, access: AccessControl, machine: str, *, direct: bool = True) -> Place:
    """Return the addresses of an end that reaches the one at `machine` through a relay, given as host:port.

    Raises:
        ConfigError: A key that is needed is not listed here.
        OSError: The name of the relay cannot be resolved here.
    """
    own, peer = access.own, access.server_key(machine)
    if own is None or peer is None:
        raise ConfigError(f"{access.why_not(machine)}, with which the relay joins the two sites")
    host, port = split_host_port(relay)
    family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    relay_public, peer_public = raw_key(relay_key(access)), raw_key(peer)
    path = RelayPath(
        address,
        SharedKeys(own, relay_public, TO_RELAY),
        SharedKeys(own, peer_public, TO_SITE),
        raw_key(own.public),
        peer_public,
        direct=direct,
    )
    return Place(family, ("::" if family is socket.AF_INET6 else "0.0.0.0", 0), None, port, path)
