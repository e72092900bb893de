"""How a process opens its end of the link's datagrams."""

import ipaddress
import socket
from collections.abc import Sequence

from telenano.runtime import AccessControl, AddressBook, LinkEnds, OpenEnds, Subscriber, Transport, ZmqPublisher
from telenano.wire import FAR_END, LINK, ConfigError
from telenano_wide_area.datagram.end import DatagramEnd
from telenano_wide_area.datagram.place import Outlets, Place
from telenano_wide_area.datagram.sparse import BesideConnection
from telenano_wide_area.relay.path import RelayPath
from telenano_wide_area.relay.protocol import TO_RELAY, TO_SITE, SharedKeys, raw_key, relay_key, split_host_port
from telenano_wide_area.settings import DatagramSettings

NEAR_END = f"{LINK}@slave"


def open_ends(
    key: str, network: Transport, outgoing: ZmqPublisher, reports: ZmqPublisher, readers: Sequence[Subscriber]
) -> LinkEnds:
    """Open the end of the node `key`, attached to what it sends and receives with, and a connection beside it.

    There is nothing where there can be no end.

    Raises:
        OSError: Another process has the port, or the name of the relay has no address.
        ValueError: The name of the master cannot be resolved here.
        ConfigError: A key that is needed is not listed here, or a key of the site file is wrong.
    """
    book = network.book
    if not {NEAR_END, FAR_END} <= set(book.nodes):
        return LinkEnds()
    is_master = key != FAR_END
    machine = book.machine_of(FAR_END if is_master else NEAR_END)
    reader = network.reader_of(machine, readers)
    if reader is None or machine == network.machine:
        return LinkEnds()
    access, settings = network.access_control, book.link.read(DatagramSettings)
    end = DatagramEnd(
        network.clock,
        place_of(book, network.machine, settings.port, is_master=is_master)
        if book.relay is None
        else relayed_place(book.relay, access, machine, direct=settings.direct),
        settings,
        reader,
        Outlets(outgoing, reports),
        machine=machine,
        is_master=is_master,
        is_allowed=lambda: not access.requires_keys or bool(access.roles(machine)),
        is_connected=lambda: network.is_connected_to(machine),
    )
    # closed with the other handlers of the network
    network.look_after(end)
    beside = BesideConnection(network.context, network.clock, end.take_sparse)
    network.connect_beside(FAR_END if is_master else NEAR_END, beside)
    end.connect_beside(beside)
    return LinkEnds([end, beside], end.carry, end.send_train)


def place_of(book: AddressBook, machine: str, port: int | None, *, is_master: bool) -> Place:
    """Return where an end binds and sends to, by a UDP port or else that of the link.

    ValueError for a name of the master that cannot be resolved here.

    The master's end has a port; the slave's takes any, so that it may stand behind a router: it is the first to send.
    """
    endpoint = book.bind_endpoint(NEAR_END) if is_master else book.connect_endpoint(NEAR_END, machine)
    host, tcp_port = split_host_port((endpoint or "").removeprefix("tcp://"))
    port = port or tcp_port
    family = socket.AF_INET if ipaddress.ip_address(host).version == 4 else socket.AF_INET6
    if is_master:
        return Place(family, (host, port), None, port)
    return Place(family, ("::" if family is socket.AF_INET6 else "0.0.0.0", 0), (host, port), port)


def relayed_place(relay: str, access: AccessControl, machine: str, *, direct: bool = True) -> Place:
    """Return where an end binds that reaches the one at `machine` through a relay, given as host:port.

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


# The type checker holds the entry of the package to its declared type.
_: OpenEnds = open_ends
