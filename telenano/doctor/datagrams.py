"""The check of `telenano doctor` on what the link's datagrams between two machines need; it sends nothing."""

import errno
import importlib.util
import ipaddress
import socket
from typing import TYPE_CHECKING, NamedTuple

from proto.errors import EndpointError
from proto.extras import how_to_install
from proto.nodes import FAR_END, LINK
from telenano.doctor.checks import Finding

if TYPE_CHECKING:
    from services.runtime.bus.address_book import AddressBook

_NAME = "datagrams"
# Options of linux/in.h and linux/in6.h: the largest packet on the way to a connected address, as far as the kernel
# knows.
_IP_MTU, _IPV6_MTU = 14, 24
# a datagram of the link with the headers of IPv6 and UDP
_LARGEST_PACKET_BYTES = 1200 + 48


class Route(NamedTuple):
    """The way to another machine: address of this one on it, and the largest packet [bytes]; None where unknown."""

    own: str
    mtu_bytes: int | None


def check_datagrams(book: "AddressBook", machine: str) -> list[Finding]:
    """Check whether the link's end on a machine can send datagrams; nothing for a rig without a network."""
    near = f"{LINK}@slave"
    if not book.spans_machines or not {near, FAR_END} <= set(book.nodes):
        return []
    ends = {book.machine_of(near): FAR_END, book.machine_of(FAR_END): near}
    if machine not in ends or len(ends) < 2:
        return []
    if book.link.transport == "stream":
        return [Finding(_NAME, "ok", "link.transport is stream: everything crosses over TCP")]
    if importlib.util.find_spec("cryptography") is None:
        advice = f"run `{how_to_install('controller,delay')}`"
        return [Finding(_NAME, "warning", "cryptography is not installed: everything crosses over TCP", advice)]
    try:
        host, port = _host_and_port(book.bind_endpoint(near) if machine == book.machine_of(near) else None)
        peer, tcp_port = _host_and_port(book.connect_endpoint(ends[machine], machine))
    except (EndpointError, ValueError) as error:
        return [Finding(_NAME, "warning", str(error), "correct the addresses in the site file")]
    port = book.link.port or port or tcp_port
    findings = [] if not host else [bound(host, port)]
    route = route_to(peer, port)
    if route is not None:
        own, _ = _host_and_port(book.network_endpoint(near if machine == book.machine_of(near) else FAR_END))
        findings += judged_route(route, peer, own)
    return findings or [Finding(_NAME, "ok", f"to UDP port {port} of {peer}")]


def bound(host: str, port: int) -> Finding:
    """Try to bind the UDP port of the master's end, and release it at once."""
    with socket.socket(_family(host), socket.SOCK_DGRAM) as attempt:
        try:
            attempt.bind((host, port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                advice = "leave it if a rig runs; else end the process that `ss -ulnp` names, or set `link.port`"
                return Finding(_NAME, "warning", f"UDP port {port} is in use", advice)
            advice = "set this machine's own address in the site file, or one to bind by TELENANO_BIND_ADDRESS"
            return Finding(_NAME, "warning", f"UDP port {port} of {host} cannot be bound ({error.strerror})", advice)
    advice = "where the other machine reports it as blocked, open it in the firewall, the router and the container"
    return Finding(_NAME, "ok", f"UDP port {port} is free here; {advice}")


def route_to(peer: str, port: int) -> Route | None:
    """Return what the kernel knows of the way to another machine; None where there is none."""
    try:
        family = _family(peer)
    except ValueError:
        # a name that could not be resolved, which the check of endpoints reports
        return None
    of_ipv6 = family == socket.AF_INET6
    level, name = (socket.IPPROTO_IPV6, _IPV6_MTU) if of_ipv6 else (socket.IPPROTO_IP, _IP_MTU)
    with socket.socket(family, socket.SOCK_DGRAM) as attempt:
        try:
            attempt.connect((peer, port))
            return Route(attempt.getsockname()[0], attempt.getsockopt(level, name))
        except OSError:
            return None


def judged_route(route: Route, peer: str, own: str) -> list[Finding]:
    """Judge the way to another machine: packets that are split, and an address that others do not see."""
    findings = []
    if route.mtu_bytes is not None and route.mtu_bytes < _LARGEST_PACKET_BYTES:
        found = f"packets to {peer} have at most {route.mtu_bytes} bytes: a datagram of the link is split"
        advice = f"raise the MTU of the interface or the tunnel to {_LARGEST_PACKET_BYTES} or more"
        findings.append(Finding(f"{_NAME}: MTU", "warning", found, advice))
    if own and route.own != own:
        found = f"this machine is {route.own} on the way to {peer}, and {own} in the site file: behind a router"
        advice = "have the router hand on the ports of the site file; the slave's end of the datagrams needs none"
        findings.append(Finding(f"{_NAME}: NAT", "warning", found, advice))
    return findings


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET if ipaddress.ip_address(host).version == 4 else socket.AF_INET6


def _host_and_port(endpoint: str | None) -> tuple[str, int]:
    """Return host and port of a tcp endpoint, nothing for one of ipc or for none; a name stays one."""
    from services.runtime.bus.address_book import split_tcp

    if endpoint is None or not endpoint.startswith("tcp://"):
        return "", 0
    return split_tcp(endpoint)
