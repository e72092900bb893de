"""Carries out the requests of pages to read a recording: its facts as a whole, and the curves of parts."""

import asyncio
from functools import partial
from typing import Any

from services.viz_node.document import Document
from services.viz_node.page_threads import in_thread
from services.viz_node.requests import DocumentRequest, PartRequest
from telenano.wire.errors import RefusedError

# Most simultaneous reads for all pages together: each takes a thread and up to a second.
_MOST_READS = 8


class ReadDesk:
    """Reads the recording that is shown, for all pages."""

    def __init__(self, document: Document | None) -> None:
        """Prepare to read a document; None for a running rig."""
        self._document = document
        self._reads = 0

    async def read(self, request: DocumentRequest | PartRequest) -> Any:
        """Return the requested facts or curves; raise RefusedError if there is no recording, or too many reads."""
        if self._document is None:
            raise RefusedError("only a recording can be read in parts, and this page shows a running rig")
        if self._reads >= _MOST_READS:
            raise RefusedError(f"{self._reads} parts of the recording are already being read: try again in a moment")
        work = self._document.about
        if isinstance(request, PartRequest):
            work = partial(self._document.part, request.from_s, request.to_s, request.spans)
        self._reads += 1
        try:
            return await asyncio.wrap_future(in_thread(work))
        finally:
            self._reads -= 1
