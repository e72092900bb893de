"""A format of one's own for `telenano bag export`: a function of a recording, a target and the chosen channels."""

from collections.abc import Iterable
from pathlib import Path

from recording.channel_filter import Selection as Selection
from recording.export import Payload as Payload
from recording.export import export_recording as export_recording
from recording.export import model_of as model_of
from recording.export import plain_schema as plain_schema
from recording.export import viewer_json as viewer_json
from recording.export import viewer_schema as viewer_schema
from recording.export import write_mcap as write_mcap
from recording.export import write_viewer_mcap as write_viewer_mcap
from recording.messages import RawChannel as RawChannel
from recording.messages import RecordedChannel as RecordedChannel
from recording.messages import RecordedMessage as RecordedMessage
from recording.reader import Recording as Recording
from recording.rewrite import CopyResult as CopyResult
from recording.tables import plain as plain
from recording.whole_files import whole_file as whole_file
from recording.whole_files import whole_folder as whole_folder
from recording.writer import RecordingWriter
from services.recorder.config import RecorderConfig
from services.recorder.provenance import versions as versions


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
