"""From a configuration to an intake that records."""

from pathlib import Path

from proto.errors import RecordingError
from recording.writer import RecordingWriter
from services.recorder.config import RecorderConfig
from services.recorder.intake import Intake
from services.recorder.provenance import write_provenance
from services.recorder.rotation import FileRotation
from services.recorder.snapshot_buffer import SnapshotBuffer, trigger
from services.runtime.clock import Clock


def open_recording(
    key: str, clock: Clock, config: RecorderConfig, site_file: Path, scenario_file: Path | None
) -> Intake:
    """Begin a recording of the node `key`, or with a snapshot the wait for its trigger.

    A file that cannot be written is a fault that the intake tells, not an error: the rig goes on.
    """

    def begin_file(number: int) -> RecordingWriter:
        writer = RecordingWriter.create(key, config, number)
        write_provenance(writer, config, site_file, scenario_file, clock.now_ns())
        return writer

    parts = FileRotation(config, begin_file)
    ring = None if config.snapshot_s is None else SnapshotBuffer(config.snapshot_s, config.snapshot_size_bytes)
    writer, fault = None, ""
    if ring is None:
        try:
            writer = parts.begin(clock.monotonic_ns())
        except RecordingError as error:
            fault = str(error)
    return Intake(
        writer,
        fault,
        selection=config.selection(),
        parts=parts,
        ring=ring,
        happened=trigger(config.snapshot_on),
        after_s=config.snapshot_after_s,
    )
