"""What serves a page: address, access, connections, certificates."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
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
    from telenano.serving.serve import web_folder as web_folder
else:
    __getattr__, __dir__ = face(__name__)
