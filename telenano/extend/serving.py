"""A server of one's own beside a rig, with the rules of the page: address, host name, origin, token and connections.

It needs the extra `view`.
"""

from services.viz_node.access import LOOPBACK as LOOPBACK
from services.viz_node.access import Access as Access
from services.viz_node.connections import Connections as Connections
from services.viz_node.connections import Listener as Listener
from services.viz_node.connections import most_connections as most_connections
from services.viz_node.serve import Tls as Tls
from services.viz_node.serve import announced as announced
from services.viz_node.serve import bind as bind
from services.viz_node.serve import checked_tls as checked_tls
from services.viz_node.serve import make_server as make_server
from services.viz_node.server import client_of as client_of
from services.viz_node.server import end_quietly as end_quietly
from services.viz_node.server import guarded as guarded
from telenano.cli.options import AllowOption as AllowOption
from telenano.cli.options import CertificateKeyOption as CertificateKeyOption
from telenano.cli.options import CertificateOption as CertificateOption
from telenano.cli.options import HostNameOption as HostNameOption
from telenano.cli.options import HostOption as HostOption
