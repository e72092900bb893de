"""Serving of a rig's web page: address, access, connections, certificates, and the panels of packages."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.serving.access import Access as Access
    from telenano.serving.config import ViewConfig as ViewConfig
    from telenano.serving.connections import Connections as Connections
    from telenano.serving.connections import Listener as Listener
    from telenano.serving.gate import client_of as client_of
    from telenano.serving.gate import guarded as guarded
    from telenano.serving.panels import Asked as Asked
    from telenano.serving.panels import Panel as Panel
    from telenano.serving.serve import Tls as Tls
    from telenano.serving.serve import bind as bind
    from telenano.serving.serve import checked_tls as checked_tls
    from telenano.serving.serve import make_server as make_server
    from telenano.serving.serve import missing_for_view as missing_for_view
    from telenano.serving.serve import page_folder as page_folder
    from telenano.serving.serve import web_folder as web_folder
    from telenano.serving.token_socket import TokenSocket as TokenSocket
else:
    __getattr__, __dir__ = face(__name__)
