"""The start of every child process, without the working folder on the import path of Python.

Python puts the folder in which it is started first on its path, before the project and its libraries: a file
`recording.py` or `numpy.py` there would be imported instead of them, and code in a foreign folder would run. Every
Python process is therefore started with `-P`, and PYTHONSAFEPATH is set for its own child processes.
"""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from telenano.signals.interrupts import kept_from_children

if TYPE_CHECKING:
    from concurrent.futures import Future

Task = TypeVar("Task")
Made = TypeVar("Made")

_SAFE_PATH = "PYTHONSAFEPATH"
_PR_SET_PDEATHSIG = 1
# The longest time after which a signal is handled that another thread has received [s].
_AWAKE_S = 0.1


def start(
    command: Sequence[str], *, dies_with_parent: bool = False, ends_with_command: bool = False, **options: Any
) -> "subprocess.Popen[Any]":
    """Start a command; the options are those of `subprocess.Popen`.

    Args:
        command: The command and its arguments.
        dies_with_parent: Whether the child gets SIGTERM when this process ends in any way; on Linux only.
        ends_with_command: Whether this process ends the child in an orderly way itself. SIGINT, which a terminal sends
            to both, is then blocked in the child.
        **options: Options of `subprocess.Popen`.
    """
    if dies_with_parent:
        options["preexec_fn"] = partial(_tie_to, os.getpid())
    with kept_from_children() if ends_with_command else contextlib.nullcontext():
        return subprocess.Popen(_safe(command), **options | {"env": _environment(options.get("env"))})


def run(command: Sequence[str], **options: Any) -> "subprocess.CompletedProcess[Any]":
    """Run a command and wait for its end; the options are those of `subprocess.run`."""
    return subprocess.run(_safe(command), **options | {"env": _environment(options.get("env"))})


def become(command: Sequence[str]) -> NoReturn:
    """Replace this process by a command, so that signals reach the command directly."""
    os.execvpe(command[0], _safe(command), _environment(None))


@contextlib.contextmanager
def spawning_workers() -> Iterator[None]:
    """Set PYTHONSAFEPATH while `multiprocessing` spawns workers, because it starts Python in its own way.

    SIGINT is blocked in the workers, because the process with the pool ends them. A program that starts them is not run
    again in each: they call functions of the library alone, so that a script needs no guard of its main part.
    """
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    program = vars(sys.modules["__main__"])
    names: dict[str, Any] = {name: program[name] for name in ("__file__", "__spec__") if name in program}
    try:
        program.pop("__file__", None)
        program["__spec__"] = None
        with kept_from_children():
            yield
    finally:
        program.update(names)
        if not before:
            del os.environ[_SAFE_PATH]


def in_processes(
    jobs: int | None, function: Callable[[Task], Made], tasks: Sequence[Task]
) -> Generator[tuple[int, Made], None, None]:
    """Call a function of the library with each task in processes of this machine; yield place and result as they come.

    `jobs` is the number of processes, None for one a processor; a single one is this process itself. The others end
    when the reader of their results ends, at once if that is by an exception.
    """
    jobs = min(jobs or len(permitted()), len(tasks))
    if jobs < 2:
        yield from ((place, function(task)) for place, task in enumerate(tasks))
        return
    # Imported here, because they take a tenth of the start of a process, and few have workers.
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import active_children, get_context

    # The workers are spawned, not forked, because the parent has threads of its own by now. The pool starts a further
    # process itself, which tracks its semaphores.
    others = set(active_children())
    with spawning_workers():
        pool = ProcessPoolExecutor(jobs, get_context("spawn"))
    try:
        with spawning_workers():
            places = {pool.submit(function, task): place for place, task in enumerate(tasks)}
        for future in as_ended(places):
            yield places[future], future.result()
    except BaseException:
        # The work in progress is useless now, and may take seconds.
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown()


def as_ended(futures: "Iterable[Future[Made]]") -> "Iterator[Future[Made]]":
    """Yield futures as they end, and let the main thread run ten times a second until then.

    The kernel may give a signal to another thread, and Python handles it when the main thread runs next.
    """
    from concurrent.futures import FIRST_COMPLETED, wait

    waiting = set(futures)
    while waiting:
        ended, waiting = wait(waiting, _AWAKE_S, FIRST_COMPLETED)
        yield from ended


def permitted() -> set[int]:
    """Return the numbers of the processors that this process may use."""
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))


def die_with_parent(signal_number: int) -> None:
    """Ask the kernel to send this process a signal when its parent dies, so that no node outlives its supervisor."""
    # On other systems only the supervisor ends a node.
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal_number, 0, 0, 0)


def _tie_to(parent: int) -> None:
    """Tie a new process to its parent from its first moment; its own option --with-parent acts seconds later."""
    die_with_parent(signal.SIGTERM)
    if os.getppid() != parent:
        os.kill(os.getpid(), signal.SIGTERM)


def _safe(command: Sequence[str]) -> list[str]:
    words = list(command)
    return [words[0], "-P", *words[1:]] if words[0] == sys.executable and "-P" not in words[1:2] else words


def _environment(variables: Mapping[str, str] | None) -> dict[str, str]:
    return {**(os.environ if variables is None else variables), _SAFE_PATH: "1"}
