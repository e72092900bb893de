"""Cache of the levels and facts of long recordings, so that they need not be read again.

A file of the cache is named by a digest of its inputs: sizes, times, beginnings and ends of the recording's files, and
the sources of this program. A damaged, old or foreign file counts as missing.
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
# Greatest unpacked size of a file of the cache [bytes].
_MOST_BYTES = 256 << 20
# Greatest size of all files of the cache together [bytes].
_MOST_TOGETHER = 512 << 20
_UNUSABLE = (OSError, RuntimeError, zstandard.ZstdError, TypeError, ValueError, MemoryError)
_ROOT = Path(__file__).resolve().parents[2]
_SOURCES = ("services/viz_node", "telenano")


class LevelCache:
    """The cache file of one recording. Its methods raise no errors, because a recording can be read again."""

    def __init__(self, paths: Sequence[Path], folder: Path | None = None) -> None:
        """Prepare for the files of a recording; `folder` is the cache, by default that of the user."""
        self._paths, self._given = paths, folder

    def load(self, levels: Levels) -> Mapping[str, Any] | None:
        """Fill the levels and return the stored facts; None if there is no usable file."""
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
        """Store the levels and facts, and remove the least recently used files if the cache gets too large."""
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
        # `Path.home` raises RuntimeError for a process without a home, which then has no cache.
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
    """Return names, sizes and times of the sources that read and judge a recording."""
    files = sorted(path for folder in _SOURCES for path in (_ROOT / folder).rglob("*.py"))
    return " ".join(f"{path.name} {path.stat().st_size} {path.stat().st_mtime_ns}" for path in files)
