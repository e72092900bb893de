"""Digest of the sources of compiled steps, and the folder of compiled code that is named by it (ADR 0010)."""

import contextlib
import hashlib
import os
import shutil
import time
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path

from telenano.settings.plugins import (
    digest_of_all,
    digest_of_parts,
    files_of,
    in_lockstep,
    parts_of,
    parts_of_module,
)

_ROOT = Path(__file__).resolve().parents[2]
# Folders and files with the steps, and with everything else on which the result of a study depends.
SOURCES = (
    *(
        "telenano/numerics",
        "telenano/extend",
        "telenano/afm",
        "telenano/hand",
        "telenano/laws",
        "telenano/link",
        "telenano/lockstep",
        "telenano/sections",
        "telenano/settings",
    ),
    # The verdict.
    *("telenano/analysis/modes.py", "telenano/analysis/verdict_thresholds.py", "telenano/analysis/read_out.py"),
    *("telenano/analysis/motion_fit.py", "telenano/analysis/envelope.py", "telenano/analysis/findings.py"),
    *("telenano/analysis/measured_noise.py", "telenano/analysis/stated_noise.py", "telenano/analysis/beyond_noise.py"),
    *("telenano/analysis/decision.py", "telenano/analysis/verdict_sentences.py", "telenano/analysis/verdict.py"),
    # Deadlines and the step of a reported delay, which are compiled into the loop.
    *("telenano/wire/topics.py", "telenano/wire/messages.py", "telenano/timing/freshness.py"),
)
# Number of most recently used folders that are kept; each edit of a source creates one of a few megabytes.
KEPT_FOLDERS = 8
# Start time of the process: every module with steps imports this one before it defines them.
_STARTED_S = time.time()


def source_digest(root: Path = _ROOT) -> str:
    """Return the digest (16 hex digits) of every Python file with compiled steps or the constants that they use."""
    digest = hashlib.sha256(version("numba").encode())
    for path in _source_files(root):
        digest.update(str(path.relative_to(root)).encode())
        digest.update(path.read_bytes())
    # Installed packages also have steps.
    digest.update(digest_of_all(in_lockstep()).encode())
    return digest.hexdigest()[:16]


def further_digest(modules: Iterable[str]) -> str | None:
    """Return a digest of what the code of these modules is made of beyond the sources of `source_digest`.

    Returns:
        The digest of the parts of installed packages that the modules belong to; it is empty if `source_digest` covers
        all modules. None if the code cannot be kept: a module belongs to neither, or a source was edited after this
        process started, so that the imported code may be older than its file.
    """
    others = sorted(module for module in modules if not (module + ".").startswith(_known_modules()))
    if not all(parts := [parts_of_module(module) for module in others]):
        return None
    further = tuple(sorted({part for found in parts for part in found}))
    return None if _edited_since(_STARTED_S, further) else digest_of_parts(further) if further else ""


def cache_directory() -> Path:
    """Return the folder that contains a folder of compiled code for each digest."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("NUMBA_CACHE_DIR") or Path(base) / "telenano")


@cache
def cache_folder() -> Path:
    """Return the folder for code compiled from the present sources; create it if possible."""
    folder = cache_directory() / f"numba-{source_digest()}"
    with contextlib.suppress(OSError):
        if not folder.exists():
            # Private, because numba creates folders in it that others may write if the user's umask allows it.
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            remove_unused(folder.parent)
        os.utime(folder)
    return folder


def remove_unused(directory: Path) -> None:
    """Delete all folders of compiled code except the KEPT_FOLDERS most recently used."""
    used = {folder: folder.stat().st_mtime for folder in directory.glob("numba-" + 16 * "[0-9a-f]")}
    for folder in sorted(used, key=lambda folder: used[folder])[:-KEPT_FOLDERS]:
        shutil.rmtree(folder, ignore_errors=True)


@cache
def _known_modules() -> tuple[str, ...]:
    """Return what `source_digest` covers, as prefixes of names of modules with a dot at their ends."""
    own = (source.removesuffix(".py").replace("/", ".") for source in SOURCES)
    return tuple(f"{name}." for name in (*own, *parts_of(in_lockstep())))


def _source_files(root: Path) -> Iterator[Path]:
    for source in SOURCES:
        for path in sorted((root / source).rglob("*.py")) or [root / source]:
            if path.is_file():
                yield path


@cache
def _watched() -> tuple[Path, ...]:
    return (*_source_files(_ROOT), *files_of(parts_of(in_lockstep())))


def _edited_since(time_s: float, further: tuple[str, ...]) -> bool:
    try:
        # Use the time of the last status change, which copying a file with its times does not set back.
        return any(path.stat().st_ctime > time_s for path in (*_watched(), *files_of(further)))
    except OSError:
        return True
