"""SIGINT and SIGTERM in a process that computes: both raise the same exception, but only where that is safe.

Python runs a signal handler between two of its own instructions. Compiled code calls Python to build the tuples that it
returns, without checking for failure: a KeyboardInterrupt raised there is a segmentation fault. A signal that arrives
within a compiled call is therefore held back and raised after the call
([ADR 0064](../../docs/decisions/0064-raise-signals-between-compiled-calls.md)).
"""

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from importlib import import_module
from types import FrameType
from typing import Any

# Shells add this to the number of the signal that ended a command.
_CODE_OF_SIGNALS = 128
# An interruption that Python could not raise on arrival is raised after this time [s].
_AGAIN_S = 0.01

_SIGINT = int(signal.SIGINT)
# `signal.getsignal` converts to an enumeration, which takes as long as four calls of compiled code.
_handler_of: Callable[[int], Any] = import_module("_signal").getsignal

_received = 0
_held = 0
_holding = 0
_computing = False
_finishing = False
# Number of the signal that waits for the end of `finishing`, 0 for none.
_kept = 0


class Interrupted(KeyboardInterrupt):
    """SIGINT or SIGTERM, which every command treats alike."""


class Ended(BaseException):
    """A command ended by an interruption that it has not reported."""


def received() -> int:
    """Return the number of the first signal that interrupted this process, 0 for none."""
    return _received


def exit_code() -> int:
    """Return the exit code of an interrupted command, 130 for SIGINT and 143 for SIGTERM as in shells, else 0."""
    return _received and _CODE_OF_SIGNALS + _received


def watch() -> None:
    """Replace Python's default handler of SIGINT; a handler that other code installed stays."""
    if _handler_of(_SIGINT) is signal.default_int_handler and _is_main_thread():
        signal.signal(signal.SIGINT, _receive)


def computing(value: bool) -> None:
    """Set whether compiled code is running in the main thread; at its end, raise a signal that was held back."""
    global _computing
    _computing = value
    if _held:
        _raise_held()


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Hold signals back until the end of the block, for short work that must not be interrupted."""
    global _holding
    _holding += 1
    try:
        yield
    finally:
        _holding -= 1
        _raise_held()


@contextlib.contextmanager
def finishing() -> Iterator["Finishing"]:
    """Yield a `Finishing`; the block calls it when the work is done and only its results remain to be written.

    The first signal after that call is not raised, but counts as received when the block ends. A second one is raised
    at once, because a hanging disk must not keep a person waiting.
    """
    global _finishing, _kept, _received
    try:
        yield Finishing()
    finally:
        _finishing = False
        _received, _kept = _received or _kept, 0


class Finishing:
    """Callable that `finishing` yields."""

    def __call__(self) -> None:
        """Begin the writing of results, which the first signal does not interrupt."""
        global _finishing
        _finishing = True

    @property
    def exit_code(self) -> int:
        """The exit code for the signal received so far, see `exit_code`; 0 for none."""
        return exit_code()


def install() -> None:
    """Prepare the process of a command, once: call `handle`, and raise again interruptions that Python cannot raise."""
    handle()
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, lambda number, frame: _receive(_received or signal.SIGINT, frame))
        sys.unraisablehook = _again_after(sys.unraisablehook, lambda info: info.exc_type)
        sys.excepthook = _again_after(sys.excepthook, lambda kind, *rest: kind)


def handle() -> None:
    """Raise Interrupted at SIGINT and SIGTERM from now on, except for a signal that the parent process ignores."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _receive)


def is_handled() -> bool:
    """Return whether SIGINT raises `Interrupted` in this process."""
    return _handler_of(_SIGINT) is _receive


def restore() -> None:
    """Let both signals end the process at once, for its end when nothing is left to do."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is _receive:
            signal.signal(number, signal.SIG_DFL)


@contextlib.contextmanager
def kept_from_children() -> Iterator[None]:
    """Block SIGINT in child processes started in the block: a terminal sends it to all, but this process ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _receive(number: int, frame: FrameType | None) -> None:
    global _held
    if _holding or _computing:
        _held = number
    else:
        _raise(number)


def _raise_held() -> None:
    global _held
    if _held and not (_holding or _computing) and _is_main_thread():
        number, _held = _held, 0
        _raise(number)


def _raise(number: int) -> None:
    global _received, _kept
    if _finishing and not _kept:
        _kept = number
        return
    _received = _received or number
    raise Interrupted


def _again_after(hook: Callable[..., Any], kind_of: Callable[..., Any]) -> Callable[..., Any]:
    """Return a hook for exceptions that Python cannot raise, as in a destructor.

    It raises an interruption again a little later, and passes other exceptions to the previous hook.
    """

    def found(*args: Any) -> None:
        kind = kind_of(*args)
        if isinstance(kind, type) and issubclass(kind, KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
        else:
            hook(*args)

    return found


def _is_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
