"""Compilation of pure steps.

A step is plain Python until `compile_steps` is called, before the modules with steps are imported: a node makes a few
calls a millisecond, and boxing their tuples for compiled code costs it more than the arithmetic. A process
that makes millions of calls in a row, as a study, compiles. Both give the same bits.

`@compiled` is then `numba.njit` with a cache on disk and a type that mypy understands. Numba notices a change of the
file a function is in, but not of the functions it calls from other files, so a plain cache would go on running an
old model after an edit. Here what was compiled is kept with a digest of all that went into it (`code_digest`): after
an edit the functions that depend on it are compiled again, the others and a run on unchanged sources load in
milliseconds ([ADR 0049](../../docs/decisions/0049-compiled-code-by-what-went-into-it.md)).
"""

import contextlib
import hashlib
import importlib.util
import os
import shutil
import time
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar, cast

from presets.plugins import digest_of_all

F = TypeVar("F", bound=Callable[..., object])

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("services/haptic_node", "services/afm_node", "services/controller", "studies")
_SHELLS = ("node.py", "__main__.py")
# raised with every change of what `compile_cache` writes, or of the options of the compiler
_CACHE_FORMAT = "3"
# what other checkouts and signatures that are no more have left behind
CACHE_DAYS = 14
# in the folder of the cache: when it was last cleaned
_CLEANED = "cleaned"
# the attribute of a step that is chosen while compiling, by the class of its parameters: the function that chooses
CHOICE = "_telenano_choice"

# the first step that was left as plain Python, and whether those after it are compiled
_plain = ""
_compiling = False


def compile_steps() -> None:
    """Compile every step that is defined from now on in this process.

    Raises: RuntimeError naming a step that exists already: compiled code could not call it; ModuleNotFoundError without
    the compiler, after which steps are plain Python as before.
    """
    global _compiling
    if _compiling:
        return
    if importlib.util.find_spec("numba") is None:
        raise ModuleNotFoundError("compiled steps need the package numba", name="numba")
    if _plain:
        raise RuntimeError(f"{_plain} was imported before compile_steps(): call it (or import studies) first")
    _compiling = True


def is_compiling() -> bool:
    """Return whether steps are compiled in this process."""
    return _compiling


def source_digest(root: Path = _ROOT) -> str:
    """Return the digest (16 hex digits) of every Python file that may hold compiled steps or constants they use."""
    digest = hashlib.sha256(version("numba").encode())
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            if path.name not in _SHELLS:
                digest.update(str(path.relative_to(root)).encode())
                digest.update(path.read_bytes())
    # installed packages have steps as well
    digest.update(digest_of_all().encode())
    return digest.hexdigest()[:16]


def cache_directory() -> Path:
    """Return the folder of compiled code: a folder in it for each of sources, a file a function and signature."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "telenano" / f"numba-{_CACHE_FORMAT}-{version('numba')}"


def clean_cache(folder: Path, now_s: float) -> list[Path]:
    """Delete compiled code that no process has used for CACHE_DAYS; return what went.

    Beside the folder are those of other versions, which may be in use. Looks once a day.
    """
    old: list[Path] = []
    marker = folder / _CLEANED
    with contextlib.suppress(OSError):
        if marker.exists() and now_s - marker.stat().st_mtime < 86_400.0:
            return old
        marker.touch()
        os.utime(marker, (now_s, now_s))
    for other in folder.parent.glob("numba-*"):
        with contextlib.suppress(OSError):
            if other != folder and _unused(other, now_s):
                shutil.rmtree(other)
                old.append(other)
    for path in folder.glob("*/*"):
        with contextlib.suppress(OSError):
            if _unused(path, now_s):
                path.unlink()
                old.append(path)
    return old


def _unused(path: Path, now_s: float) -> bool:
    return now_s - path.stat().st_mtime > CACHE_DAYS * 86_400.0


def compiled(function: F) -> F:
    """Compile a pure function where this process compiles; NUMBA_DISABLE_JIT=1 keeps it plain Python there too."""
    global _plain
    if _compiling:
        return cast(F, _compiler()(function))
    _plain = _plain or f"{function.__module__}.{function.__qualname__}"
    return function


def chosen_step(choose: Callable[[type], Callable[..., Any]]) -> Callable[..., Any]:
    """Return a function of (params, *inputs) that calls the step which `choose` gives for the type of params.

    Compiled code makes the choice while it is compiled; steps handed over as arguments would be compiled anew by every
    process.
    """

    def plain(params: Any, *inputs: Any) -> Any:
        return choose(type(params))(params, *inputs)

    def typed(params: Any, *inputs: Any) -> Callable[..., Any]:
        step = choose(params.instance_class)
        return lambda params, *inputs: step(params, *inputs)

    setattr(plain, CHOICE, choose)
    if _compiling:
        from numba.extending import overload

        overload(plain, strict=False)(typed)
    return plain


@cache
def _compiler() -> Callable[[Callable[..., object]], object]:
    # here and not above: a process that compiles nothing need not have numba, nor wait for its import
    import numba
    from numba.core import config

    from services.runtime.compile_cache import CheckedCache

    if "NUMBA_CACHE_DIR" not in os.environ:
        folder = cache_directory()
        vars(config)["CACHE_DIR"] = str(folder)
        # where it cannot be made, numba says so when it wants to write
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            os.utime(folder)
            clean_cache(folder, time.time())

    def compile_and_keep(function: Callable[..., object]) -> object:
        dispatcher = numba.njit(function)
        if not vars(config)["DISABLE_JIT"]:
            dispatcher._cache = CheckedCache(function)
        return dispatcher

    return compile_and_keep
