"""What was read of long recordings, kept in the user's cache, so that the next look at one does not read it again.

A file of the cache is named by a digest of what it was made from: sizes, times, beginnings and ends of the recording,
and the sources of this program. What is damaged, old or of something else is as if it were not there.
"""

import contextlib
import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgpack
import zstandard

from services.viz_node.levels import Levels
from telenano.files.atomic_files import atomic_file

_FORMAT = 1
_ENDS_BYTES = 1 << 16
# A file of the cache has this size at most, and all of them together that one [bytes].
_MOST_BYTES, _MOST_TOGETHER = 256 << 20, 512 << 20
_UNUSABLE = (OSError, RuntimeError, zstandard.ZstdError, TypeError, ValueError, MemoryError)
_ROOT = Path(__file__).resolve().parents[2]
_SOURCES = ("services/viz_node", "telenano")


class LevelCache:
    """The place of what was read of one recording; nothing of it raises, because everything can be read again."""

    def __init__(self, paths: Sequence[Path], folder: Path | None = None) -> None:
        """Name the place of a recording in its parts."""
        self._paths, self._given = paths, folder

    def load(self, levels: Levels) -> Mapping[str, Any] | None:
        """Fill the levels, and return what else was kept; None where nothing usable was."""
        try:
            path = self._path()
            data = path.read_bytes()
            if not 0 < zstandard.frame_content_size(data) <= _MOST_BYTES:
                return None
            document = msgpack.unpackb(zstandard.ZstdDecompressor().decompress(data))
            levels.restore(document["levels"])
            facts = document["facts"]
            os.utime(path)
        except (*_UNUSABLE, KeyError, msgpack.UnpackException):
            return None
        return facts if isinstance(facts, dict) else None

    def save(self, levels: Levels, facts: Mapping[str, Any]) -> None:
        """Keep the levels and what else is known, and remove what was not used for longest where it gets too much."""
        with contextlib.suppress(*_UNUSABLE):
            path = self._path()
            packed = msgpack.packb({"levels": levels.kept(), "facts": dict(facts)})
            if len(packed) > _MOST_BYTES:
                return
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_file(path) as part:
                part.write_bytes(zstandard.ZstdCompressor(level=1, write_checksum=True).compress(packed))
            self._prune(path)

    def _path(self) -> Path:
        digest = hashlib.sha256(f"{_FORMAT} {_program()}".encode())
        for path in self._paths:
            with path.open("rb") as file:
                status = os.fstat(file.fileno())
                digest.update(f"{status.st_size} {status.st_mtime_ns} ".encode())
                digest.update(file.read(_ENDS_BYTES))
                file.seek(max(0, status.st_size - _ENDS_BYTES))
                digest.update(file.read(_ENDS_BYTES))
        # a process without a home has no cache
        folder = self._given or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "telenano/recordings"
        return folder / f"{digest.hexdigest()[:32]}.levels"

    @staticmethod
    def _prune(kept: Path) -> None:
        files = sorted(kept.parent.glob("*.levels"), key=lambda path: path.stat().st_mtime, reverse=True)
        together = 0
        for path in files:
            together += path.stat().st_size
            if together > _MOST_TOGETHER and path != kept:
                path.unlink()


def _program() -> str:
    """Return what changes with the sources that read and judge a recording."""
    files = sorted(path for folder in _SOURCES for path in (_ROOT / folder).rglob("*.py"))
    return " ".join(f"{path.name} {path.stat().st_size} {path.stat().st_mtime_ns}" for path in files)
