"""A server of one's own beside a rig, with the rules of the page: address, host name, origin, token and connections.

It needs the extra `view`.
"""

from telenano.cli.options import AllowOption as AllowOption
from telenano.cli.options import CertificateKeyOption as CertificateKeyOption
from telenano.cli.options import CertificateOption as CertificateOption
from telenano.cli.options import HostNameOption as HostNameOption
from telenano.cli.options import HostOption as HostOption
from telenano.serving.access import LOOPBACK as LOOPBACK
from telenano.serving.access import Access as Access
from telenano.serving.connections import Connections as Connections
from telenano.serving.connections import Listener as Listener
from telenano.serving.connections import most_connections as most_connections
from telenano.serving.gate import client_of as client_of
from telenano.serving.gate import end_quietly as end_quietly
from telenano.serving.gate import guarded as guarded
from telenano.serving.serve import Tls as Tls
from telenano.serving.serve import announced as announced
from telenano.serving.serve import bind as bind
from telenano.serving.serve import checked_tls as checked_tls
from telenano.serving.serve import make_server as make_server
