"""The sources of compiled steps, their digest, and the folder of compiled code that it names (ADR 0010)."""

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
# These folders and files hold the steps, and everything else that the outcome of a study depends on.
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
    # a verdict
    *("telenano/analysis/modes.py", "telenano/analysis/verdict_thresholds.py", "telenano/analysis/read_out.py"),
    *("telenano/analysis/motion_fit.py", "telenano/analysis/envelope.py", "telenano/analysis/findings.py"),
    *("telenano/analysis/decision.py", "telenano/analysis/verdict_sentences.py", "telenano/analysis/verdict.py"),
    # deadlines and the step of a reported delay, which are compiled into the loop
    *("telenano/wire/topics.py", "telenano/wire/messages.py", "telenano/timing/freshness.py"),
)
# Each edit begins a folder of a few megabytes; as many are kept as were used last.
KEPT_FOLDERS = 8
# Every module with steps imports this one before it defines them.
_STARTED_S = time.time()


def source_digest(root: Path = _ROOT) -> str:
    """Return the digest (16 hex digits) of every Python file that may hold compiled steps or constants they use."""
    digest = hashlib.sha256(version("numba").encode())
    for path in _source_files(root):
        digest.update(str(path.relative_to(root)).encode())
        digest.update(path.read_bytes())
    # installed packages have steps as well
    digest.update(digest_of_all(in_lockstep()).encode())
    return digest.hexdigest()[:16]


def stamp(module: str) -> str:
    """Return what the compiled code of a module depends on: the name of its folder, and packages that only it uses."""
    return cache_folder().name + (digest_of_all(with_steps()) if _has_own_steps(module) else "")


def digest_covers(module: str, classes: Iterable[str]) -> bool:
    """Return whether its stamp represents the code of a module, given classes of others, as this process imported it.

    It does not where one is neither of SOURCES nor of an installed package with steps, nor where a source was edited
    after this process began: what was imported may be older than its file.
    """
    modules = _known_modules() + (package_modules(with_steps()) if _has_own_steps(module) else ())
    return all((name + ".").startswith(modules) for name in (module, *classes)) and not _edited_since(_STARTED_S)


def cache_directory() -> Path:
    """Return the folder in which each digest has a folder of compiled code."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("NUMBA_CACHE_DIR") or Path(base) / "telenano")


@cache
def cache_folder() -> Path:
    """Return the folder of the code that is compiled from the sources as they are, made if that is possible."""
    folder = cache_directory() / f"numba-{source_digest()}"
    with contextlib.suppress(OSError):
        if not folder.exists():
            # Numba makes folders in it that others may write, if the user's umask allows it.
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            remove_unused(folder.parent)
        os.utime(folder)
    return folder


def remove_unused(directory: Path) -> None:
    """Delete the folders of compiled code but the KEPT_FOLDERS that were used last."""
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
        # the time of the last change of a file, which copying it with its times does not set back
        return any(path.stat().st_ctime > time_s for path in _watched())
    except OSError:
        return True
