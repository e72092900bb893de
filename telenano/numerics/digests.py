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

from telenano.settings.plugins import digest_of_all, in_lockstep, package_files, with_steps
from telenano.settings.plugins import modules as package_modules

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


def stamp(module: str) -> str:
    """Return the cache stamp of a module's code: the name of the cache folder, and a digest of packages with steps.

    The digest is added only for modules of such packages.
    """
    return cache_folder().name + (digest_of_all(with_steps()) if _has_own_steps(module) else "")


def digest_covers(module: str, classes: Iterable[str]) -> bool:
    """Return whether the stamp of a module covers its code and the classes, given by module, that the code uses.

    It does not if a module belongs neither to SOURCES nor to an installed package with steps, or if a source was edited
    after this process started: the imported code may then be older than its file.
    """
    modules = _known_modules() + (package_modules(with_steps()) if _has_own_steps(module) else ())
    return all((name + ".").startswith(modules) for name in (module, *classes)) and not _edited_since(_STARTED_S)


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
    own = (source.removesuffix(".py").replace("/", ".") + "." for source in SOURCES)
    return (*own, *package_modules(in_lockstep()))


def _has_own_steps(module: str) -> bool:
    return (module + ".").startswith(package_modules(with_steps()))


def _source_files(root: Path) -> Iterator[Path]:
    for source in SOURCES:
        for path in sorted((root / source).rglob("*.py")) or [root / source]:
            if path.is_file():
                yield path


@cache
def _watched() -> tuple[Path, ...]:
    return (*_source_files(_ROOT), *package_files([*in_lockstep(), *with_steps()]))


def _edited_since(time_s: float) -> bool:
    try:
        # Use the time of the last status change, which copying a file with its times does not set back.
        return any(path.stat().st_ctime > time_s for path in _watched())
    except OSError:
        return True
