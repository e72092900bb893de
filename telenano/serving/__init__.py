"""What serves a page: address, access, connections, certificates."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.serving.page_files import page_folder as page_folder
else:
    __getattr__, __dir__ = face(__name__)
