"""Setup of a recording from its configuration."""

from pathlib import Path

from services.recorder.intake import Intake
from services.recorder.rotation import FileRotation
from telenano.recording.provenance import write_provenance
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.timing.clock import Clock
from telenano.wire.errors import RecordingError


def begin_recording(
    key: str, clock: Clock, config: RecorderConfig, site_file: Path, scenario_file: Path | None
) -> Intake:
    """Start a recording by the node `key`.

    A file that cannot be written is a fault that the intake reports, not an error: the rig goes on.
    """

    def create_file(number: int) -> RecordingWriter:
        writer = RecordingWriter.create(key, config, number)
        write_provenance(writer, config, site_file, scenario_file, clock.now_ns())
        return writer

    rotation = FileRotation(config, create_file)
    writer, fault = None, ""
    try:
        writer = rotation.begin(clock.monotonic_ns())
    except RecordingError as error:
        fault = str(error)
    return Intake(writer, fault, selection=config.selection(), rotation=rotation)
