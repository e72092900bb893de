"""A format of one's own for `telenano bag export`: a function of a recording, a target and the chosen channels."""

from collections.abc import Iterable
from pathlib import Path

from recording.channel_filter import Selection
from recording.export import (
    Payload,
    export_recording,
    model_of,
    plain_schema,
    viewer_json,
    viewer_schema,
    write_mcap,
    write_viewer_mcap,
)
from recording.messages import RawChannel, RecordedChannel, RecordedMessage
from recording.reader import Recording
from recording.rewrite import CopyResult
from recording.tables import plain
from recording.whole_files import whole_file, whole_folder
from recording.writer import RecordingWriter
from services.recorder.config import RecorderConfig

__all__ = [
    "CopyResult",
    "Payload",
    "RawChannel",
    "RecordedChannel",
    "RecordedMessage",
    "Recording",
    "Selection",
    "export_recording",
    "model_of",
    "plain",
    "plain_schema",
    "viewer_json",
    "viewer_schema",
    "whole_file",
    "whole_folder",
    "write_mcap",
    "write_recording",
    "write_viewer_mcap",
]


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
