"""Reading of files by untrusted libraries in a child process with limits, which returns arrays.

On a damaged file, libraries of the field may allocate gigabytes for a flipped bit, loop for ever, or crash with a
segmentation fault. In a child this costs at most the limits, and becomes an error message. The child is Python with
only the module of the reading function; it takes 0.2 s for a small file, mostly for importing the library.

The answer is a line of JSON followed by the bytes of the arrays, in an unnamed file; nothing in it is executed.
"""

import importlib
import json
import mmap
import os
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from telenano.signals import children

# Systems without this module have no such limits; there only the wall time limits the child.
try:
    import resource
except ImportError:
    resource = None  # type: ignore[assignment]

LARGEST_FILE_BYTES = 1 << 30
# Address space of a child [bytes]; Python and the libraries need 120 MB of it.
_MEMORY_BYTES = 512 << 20
# Additional address space for each byte of the file, because a reader makes some copies of it.
_MEMORY_PER_BYTE = 6
# Processor time of a child.
_CPU_S = 20.0
# Additional processor time for each byte of the file.
_CPU_S_PER_BYTE = 2.5e-7
# Ratio of wall time to processor time at the limit, because the machine may be busy.
_WALL_FACTOR = 4.0
# Most characters of an error text.
_LONGEST_TEXT = 500


class Limits(NamedTuple):
    """Limits of a child: address space [bytes], processor time [s] and wall time [s]."""

    memory_bytes: int
    cpu_s: int
    wall_s: float

    @classmethod
    def of_size(cls, size_bytes: int) -> "Limits":
        """Return the limits for reading a file of this size."""
        cpu_s = round(_CPU_S + _CPU_S_PER_BYTE * size_bytes)
        return Limits(_MEMORY_BYTES + _MEMORY_PER_BYTE * size_bytes, cpu_s, _WALL_FACTOR * cpu_s)


class Answer(NamedTuple):
    """Result of a reading function: plain values by name, and arrays of numbers."""

    facts: dict[str, Any]
    arrays: list[npt.NDArray[Any]]


def read_in_child(
    function: str,
    path: Path,
    *arguments: str | None,
    limits: Limits | None = None,
    watch: Callable[[float], None] | None = None,
) -> Answer:
    """Call a reading function with a path and texts in a child process; return its facts and arrays.

    Args:
        function: The function, as `module:name`; it returns facts and arrays.
        path: Its first argument.
        *arguments: Its further arguments.
        limits: The limits of the child; None for `Limits.of_size` of the file.
        watch: Called with the finished share, from 0 to 1. The function then has one more argument, a descriptor to
            which it writes one byte for each advance, the percentage done. `wall_s` then limits the time between two.

    Raises:
        ImportError: A package is missing; `name` is its name.
        OSError: Reading the file raised this error in the child.
        ValueError: The file is larger than `LARGEST_FILE_BYTES`, or the function raised any other error or reached a
            limit; the message tells which.
    """
    size = _size_of(path)
    limits = limits or Limits.of_size(size)
    command = [sys.executable, "-m", __name__, function]
    orders = [limits, os.fspath(path), *arguments]
    environment = _environment()
    with _answer_file() as out:
        try:
            if watch is None:
                code = children.run(
                    [*command, json.dumps(orders)], stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.DEVNULL,
                    env=environment, timeout=limits.wall_s, check=False,
                ).returncode  # fmt: skip
            else:
                code = _watched(command, orders, out, environment, limits.wall_s, watch)
        except subprocess.TimeoutExpired as error:
            raise ValueError(f"it cannot be read within {limits.wall_s:g} s") from error
        out.seek(0)
        return _answer(out, code, limits)


class ChildReading:
    """A call of a reading function in a child process that this process does not wait for; `close` ends it.

    Args:
        function: The function, as `module:name`; it returns facts and arrays.
        path: Its first argument.
        *arguments: Its further arguments.

    Raises:
        OSError: The file cannot be found, or no child can be started.
        ValueError: The file is larger than `LARGEST_FILE_BYTES`.
    """

    def __init__(self, function: str, path: Path, *arguments: str) -> None:
        self._limits = Limits.of_size(_size_of(path))
        self._out = _answer_file()
        orders = json.dumps([self._limits, os.fspath(path), *arguments])
        self._process = children.start(
            [sys.executable, "-m", __name__, function, orders], stdin=subprocess.DEVNULL, stdout=self._out,
            stderr=subprocess.DEVNULL, env=_environment(),
        )  # fmt: skip

    def answer(self) -> Answer | None:
        """Return the answer, None while the child reads; raise as `read_in_child`.

        The arrays are read-only views of the file that the child has written: a copy of a long one takes too long.
        """
        code = self._process.poll()
        if code is None:
            return None
        self._out.seek(0)
        return _answer(self._out, code, self._limits, _view)

    def close(self) -> None:
        """End the child, if it still reads."""
        self._process.kill()
        self._process.wait()
        self._out.close()


def _size_of(path: Path) -> int:
    size = path.stat().st_size
    if size > LARGEST_FILE_BYTES:
        raise ValueError(f"it has {size} bytes; at most {LARGEST_FILE_BYTES} are read")
    return size


def _environment() -> dict[str, str]:
    # A single thread, because each thread of a linear algebra library reserves memory.
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}


def _watched(
    command: list[str],
    arguments: list[Any],
    out: BinaryIO,
    environment: dict[str, str],
    wall_s: float,
    watch: Callable[[float], None],
) -> int:
    """Run a child that reports its advance at least every `wall_s` [s]; return its exit code."""
    reader, writer = os.pipe()
    try:
        process = children.start(
            [*command, json.dumps([*arguments, writer])],
            stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.DEVNULL,
            env=environment, pass_fds=(writer,),
        )  # fmt: skip
    except BaseException:
        os.close(reader)
        raise
    finally:
        os.close(writer)
    try:
        while select.select([reader], [], [], wall_s)[0] and (advance := os.read(reader, 4096)):
            watch(0.01 * advance[-1])
        return process.wait(wall_s)
    finally:
        process.kill()
        process.wait()
        os.close(reader)


def _answer_file() -> BinaryIO:
    """Open an unnamed file, in memory if the system can: a container may have no writable folder."""
    if hasattr(os, "memfd_create"):
        return os.fdopen(os.memfd_create("answer"), "w+b")
    return cast(BinaryIO, tempfile.TemporaryFile())


def _answer(
    out: BinaryIO,
    code: int,
    limits: Limits,
    array: "Callable[[BinaryIO, str, list[int]], npt.NDArray[Any]] | None" = None,
) -> Answer:
    line = out.readline(1 << 16)
    if not line.endswith(b"\n"):
        if code in (-signal.SIGXCPU, -signal.SIGKILL):
            raise ValueError(f"it cannot be read within {limits.cpu_s} s of processor time")
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        raise ValueError(f"it cannot be read: the program that reads it {how}")
    head = json.loads(line)
    match head.get("error"):
        case None:
            return Answer(head["facts"], [(array or _array)(out, *each) for each in head["arrays"]])
        case ["ImportError", name]:
            raise ImportError(name=name)
        case ["OSError", number, text]:
            raise OSError(number, text)
        case ["MemoryError"]:
            raise ValueError(f"it cannot be read with {limits.memory_bytes >> 20} MB of memory")
        case [_, text]:
            raise ValueError(text)
    raise ValueError("it cannot be read")


def _array(out: BinaryIO, kind: str, shape: list[int]) -> npt.NDArray[Any]:
    dtype = np.dtype(kind)
    count = int(np.prod(shape))
    content = out.read(count * dtype.itemsize)
    return np.frombuffer(content, dtype).reshape(shape).copy()


def _view(out: BinaryIO, kind: str, shape: list[int]) -> npt.NDArray[Any]:
    """Return an array as a view of the file from its position on, and move the position behind it."""
    dtype, count = np.dtype(kind), int(np.prod(shape))
    begin = out.tell()
    out.seek(begin + count * dtype.itemsize)
    # The view keeps the mapping, also after the file is closed.
    whole = mmap.mmap(out.fileno(), 0, access=mmap.ACCESS_READ)
    return np.frombuffer(whole, dtype, count, begin).reshape(shape)


def _limit(limits: Limits) -> None:
    if resource is None:
        return
    bounds = {
        resource.RLIMIT_AS: limits.memory_bytes,
        resource.RLIMIT_CPU: limits.cpu_s,
        resource.RLIMIT_FSIZE: limits.memory_bytes,
        resource.RLIMIT_CORE: 0,
    }
    for kind, wanted in bounds.items():
        _, hard = resource.getrlimit(kind)
        bound = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(kind, (bound, bound))


def _described(error: BaseException) -> list[Any]:
    """Return an error as a list from which the parent raises the corresponding one."""
    if isinstance(error, MemoryError):
        return ["MemoryError"]
    if isinstance(error, ImportError):
        return ["ImportError", error.name]
    text = (" ".join(str(error).split()) or type(error).__name__)[:_LONGEST_TEXT]
    if isinstance(error, OSError) and error.errno is not None and error.strerror:
        return ["OSError", error.errno, error.strerror[:_LONGEST_TEXT]]
    # The text of a KeyError is only the key, so its class is added.
    return ["", f"{type(error).__name__}: {text}" if isinstance(error, LookupError) else text]


def main() -> None:
    """Call the function that the command line names, and write the answer to standard output."""
    function, texts = sys.argv[1:]
    limits, *arguments = json.loads(texts)
    out = os.fdopen(os.dup(1), "wb")
    # Redirect the prints of a library, which are no part of the answer.
    os.dup2(2, 1)
    _limit(Limits(*limits))
    module, _, name = function.partition(":")
    try:
        facts, arrays = getattr(importlib.import_module(module), name)(*arguments)
        kept = [np.ascontiguousarray(each) for each in arrays]
        head = {"facts": facts, "arrays": [[each.dtype.str, each.shape] for each in kept]}
    # Some of these libraries raise errors that are not derived from `Exception`.
    except BaseException as error:  # noqa: BLE001
        head, kept = {"error": _described(error)}, []
    out.write(json.dumps(head).encode() + b"\n")
    for each in kept:
        out.write(each.tobytes())
    out.flush()
    # Skip the work at exit, which a malicious file could prolong.
    os._exit(0)


if __name__ == "__main__":
    main()
