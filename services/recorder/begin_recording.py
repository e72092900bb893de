"""Setup of a recording from its configuration."""

from pathlib import Path

from proto.errors import RecordingError
from recording.writer import RecordingWriter
from services.recorder.config import RecorderConfig
from services.recorder.intake import Intake
from services.recorder.provenance import write_provenance
from services.recorder.rotation import FileRotation
from services.recorder.snapshot_buffer import SnapshotBuffer, event_trigger
from services.runtime.clock import Clock


def begin_recording(
    key: str, clock: Clock, config: RecorderConfig, site_file: Path, scenario_file: Path | None
) -> Intake:
    """Start a recording by the node `key`; with a snapshot buffer, wait for its trigger.

    A file that cannot be written is a fault that the intake reports, not an error: the rig goes on.
    """

    def create_file(number: int) -> RecordingWriter:
        writer = RecordingWriter.create(key, config, number)
        write_provenance(writer, config, site_file, scenario_file, clock.now_ns())
        return writer

    rotation = FileRotation(config, create_file)
    snapshot_buffer = (
        None if config.snapshot_s is None else SnapshotBuffer(config.snapshot_s, config.snapshot_size_bytes)
    )
    writer, fault = None, ""
    if snapshot_buffer is None:
        try:
            writer = rotation.begin(clock.monotonic_ns())
        except RecordingError as error:
            fault = str(error)
    return Intake(
        writer,
        fault,
        selection=config.selection(),
        rotation=rotation,
        snapshot_buffer=snapshot_buffer,
        is_trigger=event_trigger(config.snapshot_on),
        after_s=config.snapshot_after_s,
    )
