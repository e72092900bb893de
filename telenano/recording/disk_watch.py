"""Warning of a recording's disk that is nearly full: its free space and how long that will last."""

import shutil
from collections.abc import Callable
from pathlib import Path

# Below either of these the watch warns.
LOW_S = 120.0
LOW_BYTES = 16_000_000
_CHECK_NS = 1_000_000_000
_RATE_NS = 5_000_000_000


def free_bytes(path: Path) -> int | None:
    """Return the free space at the place of a file or folder [bytes], existing or not; None if unknown."""
    for folder in (path, *path.absolute().parents):
        try:
            return shutil.disk_usage(folder).free
        except FileNotFoundError:
            continue
        except OSError:
            return None
    return None


class DiskWatch:
    """Compares the free space with the rate at which the recording grows, once a second.

    `text` is the warning in force, empty while there is room.
    """

    def __init__(self, directory: Path, free: Callable[[Path], int | None] = free_bytes) -> None:
        self._directory = directory
        self._free = free
        self._due_ns = 0
        self._since: tuple[int, int] | None = None
        self._rate = 0.0
        self.text = ""

    def check(self, now_ns: int, written_bytes: int) -> None:
        """Update `text`, at most once a second.

        Args:
            now_ns: The time on the monotonic clock [ns].
            written_bytes: The size of all files of the recording up to now [bytes].
        """
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + _CHECK_NS
        self._measure_rate(now_ns, written_bytes)
        left = self._free(self._directory)
        self.text = "" if left is None else self._warning(left)

    def _measure_rate(self, now_ns: int, written_bytes: int) -> None:
        if self._since is None or written_bytes < self._since[1]:
            self._since = (now_ns, written_bytes)
        since_ns, before = self._since
        if now_ns - since_ns >= _RATE_NS:
            self._rate = (written_bytes - before) * 1e9 / (now_ns - since_ns)
            self._since = (now_ns, written_bytes)

    def _warning(self, left: int) -> str:
        enough_s = left / self._rate if self._rate > 0.0 else None
        if left >= LOW_BYTES and (enough_s is None or enough_s >= LOW_S):
            return ""
        lasts = "" if enough_s is None else f", enough for about {enough_s:.0f} s at {self._rate / 1e6:.2f} MB/s"
        return f"the disk of {self._directory} has {left / 1e6:.1f} MB left{lasts}"
