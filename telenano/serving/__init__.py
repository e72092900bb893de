"""Serving of a rig's web page: address, access, connections, certificates, and the panels of packages."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.serving.config import ViewConfig as ViewConfig
    from telenano.serving.panels import Asked as Asked
    from telenano.serving.panels import Panel as Panel
    from telenano.serving.serve import web_folder as web_folder
    from telenano.serving.token_socket import TokenSocket as TokenSocket
else:
    __getattr__, __dir__ = face(__name__)
