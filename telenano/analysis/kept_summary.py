"""Cache for the summary of a recording, in a file beside it, so that a recording is judged only once.

    kept = KeptSummary([path])
    judged = kept.read()            # None where it has to be judged
    kept.write(judge(path))

The cache of a recording is the hidden file `.NAME.summary` in its folder. It is valid only for the same bytes of the
recording, the same judge and the same options. Its key has the SHA-256 of each whole file, because neither size, time
nor stored checksums are sufficient: an edit inside a chunk may keep size and time, and a report leaves a damaged chunk
out although the stored checksums are unchanged. The judge is a digest of the source of the library, of the installed
packages that a recording can name, and of the versions of the packages that read and compute. Nothing is kept if the
folder cannot be written, or if a source was changed while this process ran; a damaged cache is ignored.
"""

import contextlib
import hashlib
import json
import os
import platform
import time
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from telenano.files.atomic_files import write_whole
from telenano.files.regular_files import open_regular, read_regular
from telenano.settings.plugins import Plugin, files_of, in_scenarios, installed, parts_of

_LIBRARY = Path(__file__).resolve().parents[1]
# File types on which a verdict depends: source, and the networks, instruments and schemas that come with it.
_SOURCES = (".py", ".yaml", ".json", ".txt", ".csv")
_PACKAGES = ("mcap", "msgpack", "numpy", "pydantic", "zstandard")
# greatest length of a kept summary [bytes]: some ten thousand holds
MOST_BYTES = 4 << 20
# size of the pieces in which a file is read [bytes]
_PIECE_BYTES = 1 << 20
_LOADED_NS = time.time_ns()


class KeptSummary:
    """The file that keeps the summary of a recording, or of several files read as one."""

    def __init__(self, paths: Sequence[Path], options: Mapping[str, Any] | None = None) -> None:
        self._paths = list(paths)
        self._options = dict(options or {})
        self._seen = self._stamps()
        self._key: dict[str, Any] | None = None

    @property
    def path(self) -> Path:
        """Path of the cache: beside the recording itself, even if that is opened through a symbolic link."""
        first = Path(os.path.realpath(self._paths[0]))
        more = f"+{len(self._paths) - 1}" if self._paths[1:] else ""
        return first.with_name(f".{first.name}{more}.summary")

    def read(self) -> dict[str, Any] | None:
        """Return the summary kept for the same recording, judge and options; None if there is none."""
        self._key = self._found_key()
        if self._key is None:
            return None
        try:
            digest, _, body = read_regular(self.path, MOST_BYTES, follows_links=False).partition(b"\n")
            if hashlib.sha256(body).hexdigest().encode() != digest:
                return None
            content = json.loads(body)
            judged = content["judged"] if content["key"] == self._key else None
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return judged if isinstance(judged, dict) else None

    def write(self, judged: Mapping[str, Any]) -> None:
        """Keep a summary made since `read`, unless recording or judge changed meanwhile, or it cannot be kept."""
        if self._key is None or self._key != self._found_key() or _is_changed():
            return
        body = json.dumps({"key": self._key, "judged": dict(judged)}, allow_nan=False).encode()
        content = hashlib.sha256(body).hexdigest().encode() + b"\n" + body
        if len(content) <= MOST_BYTES:
            with contextlib.suppress(OSError):
                write_whole(self.path, content, 0o644, is_forced=False)

    def _found_key(self) -> dict[str, Any] | None:
        """Return the key of the cache; None if nothing can be kept, or a file changed since this object was made."""
        # Nothing is written into the folder of the library itself.
        if self._seen is None or self.path.is_relative_to(_LIBRARY):
            return None
        try:
            digests = [_digest_of(path) for path in self._paths]
        except OSError:
            return None
        if self._seen != self._stamps() or (judge := judge_digest()) is None:
            return None
        return {"judge": judge, "files": digests, "options": self._options}

    def _stamps(self) -> list[tuple[int, ...]] | None:
        try:
            found = [path.stat() for path in self._paths]
        except (OSError, ValueError):
            # An impossible file name is reported by the code that opens the file.
            return None
        return [(one.st_dev, one.st_ino, one.st_size, one.st_mtime_ns, one.st_ctime_ns) for one in found]


def _digest_of(path: Path) -> str:
    digest = hashlib.sha256()
    with open_regular(path) as file:
        while piece := file.read(_PIECE_BYTES):
            digest.update(piece)
    return digest.hexdigest()


@cache
def judge_digest() -> str | None:
    """Return a digest of code and versions on which a verdict depends; None if the source is unreadable or changed.

    A process whose source changed after it was loaded may run the old or the new code, so it keeps nothing.
    """
    own = source_digest(_LIBRARY)
    if _is_changed() or own is None:
        return None
    try:
        plugins = sorted((row.kind, row.name, row.target, row.problem, row.digest) for row in _plugins())
    except OSError:
        return None
    versions = {name: _version(name) for name in _PACKAGES}
    facts = {"sources": own, "plugins": plugins, "python": platform.python_version(), **versions}
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def _plugins() -> list[Plugin]:
    """Return the entries of installed packages that a recording can name, and the topics that packages add."""
    return [*in_scenarios(), *installed("topics").values()]


def _is_changed() -> bool:
    return source_changed([*_sources(_LIBRARY), *files_of(parts_of(_plugins()))], _LOADED_NS)


def source_digest(folder: Path) -> str | None:
    """Return a digest of names and contents of all sources in a folder; None if none is readable."""
    digest, found = hashlib.sha256(), sorted(_sources(folder))
    try:
        for path in found:
            content = path.read_bytes()
            digest.update(f"{path.relative_to(folder).as_posix()} {len(content)}\n".encode())
            digest.update(content)
    except OSError:
        return None
    return digest.hexdigest() if found else None


def source_changed(files: Iterable[Path], since_ns: int) -> bool:
    """Return whether a file was written or replaced after a time [ns], or cannot be examined."""
    try:
        stats = (path.stat() for path in files)
        return any(max(one.st_mtime_ns, one.st_ctime_ns) > since_ns for one in stats)
    except OSError:
        return True


def _sources(folder: Path) -> Iterable[Path]:
    return (path for path in folder.rglob("*") if path.suffix in _SOURCES and path.is_file())


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
