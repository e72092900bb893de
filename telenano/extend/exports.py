"""A format of one's own for `telenano bag export`: a function of a recording, a target and the chosen channels."""

from collections.abc import Iterable
from pathlib import Path

from telenano.files.whole_files import whole_file as whole_file
from telenano.files.whole_files import whole_folder as whole_folder
from telenano.recording.channel_filter import Selection as Selection
from telenano.recording.export import Payload as Payload
from telenano.recording.export import export_recording as export_recording
from telenano.recording.export import model_of as model_of
from telenano.recording.export import plain_schema as plain_schema
from telenano.recording.export import viewer_json as viewer_json
from telenano.recording.export import viewer_schema as viewer_schema
from telenano.recording.export import write_mcap as write_mcap
from telenano.recording.export import write_viewer_mcap as write_viewer_mcap
from telenano.recording.messages import RawChannel as RawChannel
from telenano.recording.messages import RecordedChannel as RecordedChannel
from telenano.recording.messages import RecordedMessage as RecordedMessage
from telenano.recording.provenance import versions as versions
from telenano.recording.quantities import quantity as quantity
from telenano.recording.reader import Recording as Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.rewrite import CopyResult as CopyResult
from telenano.recording.tables import plain as plain
from telenano.recording.tables import typed_columns as typed_columns
from telenano.recording.tables import uniform as uniform
from telenano.recording.writer import RecordingWriter
from telenano.wire.schema import json_schema as json_schema


def write_recording(folder: Path, messages: Iterable[RecordedMessage]) -> Path:
    """Write messages (`telenano.extend.messages.recorded`) as the recorder does, for a test; return the file."""
    writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=folder))
    numbers: dict[RecordedChannel, int] = {}
    for message in messages:
        known = message.channel
        if known not in numbers:
            numbers[known] = writer.channel(known.topic, known.src, known.site)
        writer.write(numbers[known], message.log_ns, message.publish_ns, message.seq, message.payload)
    writer.finish()
    return writer.path
