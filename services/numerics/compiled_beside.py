"""The first call of its kind runs as plain Python, and a process of its own compiles what it runs for the next one.

A cold compile takes ten seconds and more, a session of some seconds in plain Python one or two, and the bits are the
same. A mark in the cache of compiled code says, for the types of the arguments, that such a call has run compiled to
its end, and from which sources. Where there is none, `soonest` starts the process and runs the plain form. A mark can
be wrong, on another processor or after the code was deleted: then the call compiles first, as every other call does.
"""

import hashlib
import importlib.util
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from services.numerics.compiled import cache_directory, compiled_form, kept_digest

# Set to anything, it makes each call compile first.
COMPILE_FIRST = "TELENANO_COMPILE_FIRST"
# A process runs so many ticks as plain Python, because one that goes on after them is faster compiled, though it waits.
PLAIN_TICKS = 30_000
_LIMIT_S, _NICE = 600, 10
_DAY_S = 86_400.0

_plain_ticks = 0
# the process that this one has started; nobody waits for it
_compiling: list[subprocess.Popen[bytes]] = []


class Mark(NamedTuple):
    """The file that tells that a call with arguments of these types ran compiled, and what it has to contain."""

    path: Path
    digest: str

    def made(self) -> bool:
        """Return whether it is there; it is touched once a day, because unused files of the cache are deleted."""
        try:
            if time.time() - self.path.stat().st_mtime > _DAY_S:
                os.utime(self.path)
            return self.path.read_text() == self.digest
        except OSError:
            return False

    def make(self) -> None:
        """Write it, if the folder lets itself be written."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.write_text(self.digest)
        except OSError:
            return


def soonest(step: Callable[..., Any], given: tuple[Any, ...], few: tuple[Any, ...], ticks: int) -> Any:
    """Call a marked step: compiled where it lies compiled on disk, else as plain Python while it is compiled beside.

    Args:
        step: The step.
        given: Its arguments.
        few: Arguments of the same types with which it takes no time; it is compiled by a call with them.
        ticks: How many ticks the call has; a process has at most PLAIN_TICKS as plain Python.
    """
    global _plain_ticks
    mark = mark_of(step, given)
    if mark is None:
        return compiled_form(step)(*given)
    made = mark.made()
    if not made and _plain_ticks + ticks <= PLAIN_TICKS and _compile_beside(mark, step, few):
        _plain_ticks += ticks
        return step(*given)
    result = compiled_form(step)(*given)
    if not made:
        mark.make()
    return result


def mark_of(step: Callable[..., Any], given: tuple[Any, ...]) -> Mark | None:
    """Return the mark of a call, None where each call compiles first, or nothing compiled is kept."""
    plain = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0") or importlib.util.find_spec("numba") is None
    if plain or os.environ.get(COMPILE_FIRST):
        return None
    modules = {step.__module__}
    options = (sys.implementation.cache_tag, os.environ.get("NUMBA_BOUNDSCHECK"), step.__module__, step.__qualname__)
    described = repr((options, _structure(given, modules)))
    digest = kept_digest(modules)
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or cache_directory())
    name = hashlib.sha256(described.encode()).hexdigest()[:24]
    return Mark(base / "sessions" / name, digest) if digest else None


def _structure(value: Any, modules: set[str]) -> Any:
    """Return what the compiler goes by: the classes of tuples, layouts of arrays, and types of the rest."""
    kind = type(value)
    name = f"{kind.__module__}.{kind.__qualname__}"
    if isinstance(value, tuple):
        if hasattr(kind, "_fields"):
            modules.add(kind.__module__)
        return (name, *(_structure(part, modules) for part in value))
    if isinstance(value, np.ndarray):
        flags = value.flags
        return (name, value.dtype.str, value.ndim, flags.c_contiguous, flags.f_contiguous, flags.writeable)
    return name


def _compile_beside(mark: Mark, step: Callable[..., Any], few: tuple[Any, ...]) -> bool:
    """Start the process that compiles, unless one compiles already; False where none can be or nothing be kept."""
    try:
        # It is imported here, because there is no such module on some systems, which compile first.
        import fcntl

        mark.path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile() as call, (mark.path.parent / "lock").open("w") as lock:
            os.utime(lock.fileno())
            try:
                # The process inherits the lock and holds it until its end, however it ends.
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
            pickle.dump((mark.path, step, few), call, protocol=pickle.HIGHEST_PROTOCOL)
            call.seek(0)
            start(call, lock.fileno())
    # the last three are what pickle says of what it cannot take
    except (ImportError, OSError, pickle.PicklingError, AttributeError, TypeError):
        return False
    return True


def start(call: Any, lock: int) -> None:
    """Start the process that compiles, which reads the call from its input and has nothing to do with the terminal."""
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "services.numerics.compiled_beside"],
        stdin=call,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        pass_fds=(lock,),
        # an empty entry of the path is the present folder
        env={**os.environ, "PYTHONPATH": os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)},
    )
    _compiling[:] = [*(other for other in _compiling if other.poll() is None), process]


def compile_call(path: Path, step: Callable[..., Any], few: tuple[Any, ...]) -> None:
    """Compile a step into the cache by a call of it, and make the mark of that call."""
    mark = mark_of(step, few)
    compiled_form(step)(*few)
    if mark is not None:
        # The path is that of the call that could not be run compiled, so that it is not tried for ever.
        mark._replace(path=path).make()


if __name__ == "__main__":
    os.nice(_NICE)
    signal.alarm(_LIMIT_S)
    compile_call(*pickle.load(sys.stdin.buffer))
