"""A server of one's own beside a rig, with the rules of the page: address, host name, origin, token and connections.

It needs the extra `view`.
"""

from services.viz_node.access import LOOPBACK, Access
from services.viz_node.connections import Connections, Listener, most_connections
from services.viz_node.serve import Tls, announced, bind, checked_tls, make_server
from services.viz_node.server import client_of, end_quietly, guarded
from telenano.cli.options import AllowOption, CertificateKeyOption, CertificateOption, HostNameOption, HostOption

__all__ = [
    "LOOPBACK",
    "Access",
    "AllowOption",
    "CertificateKeyOption",
    "CertificateOption",
    "Connections",
    "HostNameOption",
    "HostOption",
    "Listener",
    "Tls",
    "announced",
    "bind",
    "checked_tls",
    "client_of",
    "end_quietly",
    "guarded",
    "make_server",
    "most_connections",
]
