"""Recordings as a library: MCAP files written, read, checked, cut and exported; no socket and no process."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.recording.writer import FileSettings as FileSettings
    from telenano.recording.writer import RecordingWriter as RecordingWriter
else:
    __getattr__, __dir__ = face(__name__)
