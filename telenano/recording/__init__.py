"""Recordings as a library: write, read, check, cut and export MCAP files, without a socket or a process."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.recording.arrays import last_force_profile as last_force_profile
    from telenano.recording.channel_filter import Selection as Selection
    from telenano.recording.column_table import ColumnTable as ColumnTable
    from telenano.recording.export import IMAGE_ENTRY as IMAGE_ENTRY
    from telenano.recording.export import export_recording as export_recording
    from telenano.recording.export import viewer_json as viewer_json
    from telenano.recording.export import write_mcap as write_mcap
    from telenano.recording.export import write_viewer_mcap as write_viewer_mcap
    from telenano.recording.field_differences import Tolerances as Tolerances
    from telenano.recording.made_records import recorded as recorded
    from telenano.recording.messages import RecordedChannel as RecordedChannel
    from telenano.recording.messages import RecordedMessage as RecordedMessage
    from telenano.recording.multi_file import RecordingSource as RecordingSource
    from telenano.recording.multi_file import files_of as files_of
    from telenano.recording.multi_file import open_recordings as open_recordings
    from telenano.recording.provenance import versions as versions
    from telenano.recording.quantities import quantity as quantity
    from telenano.recording.reader import Recording as Recording
    from telenano.recording.recorded_time import RecordedTime as RecordedTime
    from telenano.recording.recorded_time import span_of as span_of
    from telenano.recording.rewrite import CopyResult as CopyResult
    from telenano.recording.rewrite import filter_recording as filter_recording
    from telenano.recording.session_folder import SessionFolder as SessionFolder
    from telenano.recording.session_folder import recordings_of as recordings_of
    from telenano.recording.session_identity import demand_several as demand_several
    from telenano.recording.site_clock import Timeline as Timeline
    from telenano.recording.tables import columns_of as columns_of
    from telenano.recording.writer import FileSettings as FileSettings
    from telenano.recording.writer import RecordingWriter as RecordingWriter
else:
    __getattr__, __dir__ = face(__name__)
