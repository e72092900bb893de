"""Recordings as a library: MCAP files written, read, checked, cut and exported; no socket and no process."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.recording.reader import Recording as Recording
    from telenano.recording.site_merge import merge_sites as merge_sites
else:
    __getattr__, __dir__ = face(__name__)
