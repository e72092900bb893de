"""Rotation of the files of a recording: it begins the next file when due, and enforces the disk quota."""

from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path

from telenano.recording.disk import OWN_DISK, Disk
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.wire.errors import RecordingError

# Room with which a recording that a full disk has stopped continues: less would be full again at once.
ROOM_BYTES = 1 << 20

CreateFile = Callable[[int], RecordingWriter]


class QuotaError(RecordingError):
    """The quota is used up and the policy is to stop."""


class FileRotation:
    """The current and the finished files of a recording.

    Sizes include only flushed data, so limits hold to within one flush interval.
    """

    def __init__(self, config: RecorderConfig, create_file: CreateFile, disk: Disk = OWN_DISK) -> None:
        """Create each file with `create_file`, which writes provenance and uses a number, or the next free one."""
        self._config = config
        self._create_file = create_file
        self._disk = disk
        self._started_ns = 0
        self._next_number = 0
        self._finished: deque[tuple[Path, int]] = deque()
        self.count = 0
        self.dropped = 0

    def begin(self, now_ns: int) -> RecordingWriter:
        """Create the next file; raise RecordingError, with the reason, if that fails."""
        # Numbers only grow, even if files with lower ones were removed.
        writer = self._create_file(self._next_number)
        self._next_number = writer.number + 1
        self._started_ns = now_ns
        self.count += 1
        return writer

    def finish(self, writer: RecordingWriter, end: Mapping[str, str]) -> None:
        """Finish a file, whose whole size then counts against the quota."""
        writer.finish(end)
        self._finished.append((writer.path, writer.size_bytes))

    @property
    def finished_bytes(self) -> int:
        """Size of the finished files that were not dropped [bytes]."""
        return sum(size for _, size in self._finished)

    def has_room(self) -> bool:
        """Return whether the disk has room for the beginning of a further file, as far as that is known."""
        free = self._disk.free_bytes(self._config.directory)
        return free is None or free >= ROOM_BYTES

    def due(self, writer: RecordingWriter, now_ns: int) -> bool:
        config = self._config
        too_large = config.split_size_bytes is not None and writer.size_bytes >= config.split_size_bytes
        too_long = config.split_interval_s is not None and now_ns - self._started_ns >= config.split_interval_s * 1e9
        return too_large or too_long

    def keep_quota(self, writer: RecordingWriter | None) -> None:
        """Enforce the quota: with the policy `drop_oldest`, remove the oldest files until it holds.

        Raises QuotaError with the policy `stop`, RecordingError if an old file cannot be removed.
        """
        quota = self._config.quota_bytes
        if quota is None:
            return
        current = 0 if writer is None else writer.size_bytes
        while current + self.finished_bytes > quota:
            if self._config.quota_policy == "stop":
                raise QuotaError(f"the quota of {quota} bytes is used up")
            if not self._finished:
                return
            self._drop(self._finished.popleft()[0])

    def _drop(self, path: Path) -> None:
        try:
            self._disk.remove(path)
        except OSError as error:
            raise RecordingError(f"{path}: the oldest file cannot be removed: {error.strerror}") from error
        self.dropped += 1
