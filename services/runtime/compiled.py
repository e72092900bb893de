"""Compilation of pure steps.

A step is plain Python until `compile_steps` is called, before the modules with steps are imported: a node makes a few
calls a millisecond, and boxing their tuples for compiled code costs it more than the arithmetic. A process
that makes millions of calls in a row, as a study, compiles. Both give the same bits.

`@compiled` is then `numba.njit` with a cache on disk and a type that mypy understands. Numba notices a change of the
file a function is in, but not of the functions it calls from other files, so a plain cache would go on running an
old model after an edit. The cache folder here is named after a digest of every source that compiled code can
depend on: any edit gives a new folder, and a run on unchanged sources loads in milliseconds.
"""

import contextlib
import hashlib
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
# raised with every change of what `compile_cache` writes
_CACHE_FORMAT = "2"
# an edit a day leaves some tens of folders of some MB
CACHE_DAYS = 14

# the first step that was left as plain Python, and whether those after it are compiled
_plain = ""
_compiling = False


def compile_steps() -> None:
    """Compile every step that is defined from now on in this process.

    Raises: RuntimeError naming a step that exists already: compiled code could not call it.
    """
    global _compiling
    if _compiling:
        return
    if _plain:
        raise RuntimeError(f"{_plain} was imported before compile_steps(): call it (or import studies) first")
    _compiling = True


def is_compiling() -> bool:
    """Return whether steps are compiled in this process."""
    return _compiling


def source_digest(root: Path = _ROOT) -> str:
    """Return the digest (16 hex digits) of every Python file that may hold compiled steps or constants they use."""
    digest = hashlib.sha256((version("numba") + "/" + _CACHE_FORMAT).encode())
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            if path.name not in _SHELLS:
                digest.update(str(path.relative_to(root)).encode())
                digest.update(path.read_bytes())
    # installed packages have steps as well
    digest.update(digest_of_all().encode())
    return digest.hexdigest()[:16]


def cache_directory(root: Path = _ROOT) -> Path:
    """Return the folder of compiled code for the sources as they are now."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "telenano" / f"numba-{source_digest(root)}"


def clean_old_caches(base: Path, now_s: float) -> list[Path]:
    """Delete the folders of compiled code that no process has used for CACHE_DAYS; return them.

    Other checkouts and older versions have folders of their own beside this one, which may be in use.
    """
    old = []
    for folder in base.glob("numba-*"):
        with contextlib.suppress(OSError):
            if now_s - folder.stat().st_mtime > CACHE_DAYS * 86_400.0:
                shutil.rmtree(folder)
                old.append(folder)
    return old


def compiled(function: F) -> F:
    """Compile a pure function where this process compiles; NUMBA_DISABLE_JIT=1 keeps it plain Python there too."""
    global _plain
    if _compiling:
        return cast(F, _compiler()(function))
    _plain = _plain or f"{function.__module__}.{function.__qualname__}"
    return function


def always_compiled(function: F) -> F:
    """Compile a pure function in every process: a step that is thousands of others in one call.

    The module that has it needs numba, so a node imports it only where its scenario asks for it. It may call only
    functions that are compiled likewise. NUMBA_DISABLE_JIT=1 keeps it plain Python.
    """
    return cast(F, _compiler()(function))


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
            clean_old_caches(folder.parent, time.time())

    def compile_and_keep(function: Callable[..., object]) -> object:
        dispatcher = numba.njit(function)
        if not vars(config)["DISABLE_JIT"]:
            dispatcher._cache = CheckedCache(function)
        return dispatcher

    return compile_and_keep
