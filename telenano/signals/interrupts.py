"""SIGINT and SIGTERM in a process that computes: raised where that is safe, both alike.

Python runs the handler of a signal between two of its own instructions. Compiled code calls Python to make the tuples
that it returns, and does not look whether that has failed: a KeyboardInterrupt raised there is a segmentation fault. A
signal that arrives within a compiled call is therefore kept until the call is over, and raised then
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

# a shell adds the number of the signal that ended a command
_CODE_OF_SIGNALS = 128
# an interruption that Python could not raise where it arrived is raised this much later [s]
_AGAIN_S = 0.01

_SIGINT = int(signal.SIGINT)
# `signal.getsignal` looks for an enumeration first, which takes as long as four calls of compiled code.
_handler_of: Callable[[int], Any] = import_module("_signal").getsignal

_received = 0
_held = 0
_holding = 0
_computing = False
_finishing = False
# the signal that waits for the end of `finishing`
_kept = 0


class Interrupted(KeyboardInterrupt):
    """SIGINT, or SIGTERM, which every command takes for the same."""


class Ended(BaseException):
    """The end of a command by an interruption that nothing in it has reported."""


def received() -> int:
    """Return the number of the first signal that interrupted this process, 0 for none."""
    return _received


def exit_code() -> int:
    """Return the exit code of a command that a signal ended, 130 for SIGINT and 143 for SIGTERM as in shells, or 0."""
    return _received and _CODE_OF_SIGNALS + _received


def watch() -> None:
    """Take the place of Python's own handler of SIGINT; what somebody else has installed stays."""
    if _handler_of(_SIGINT) is signal.default_int_handler and _is_main_thread():
        signal.signal(signal.SIGINT, _receive)


def computing(value: bool) -> None:
    """Set whether compiled code is about to run in the main thread; at its end raise a signal that has arrived."""
    global _computing
    _computing = value
    if _held:
        _raise_held()


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Raise a signal that arrives meanwhile at the end of the block, for what must be done as a whole and is short."""
    global _holding
    _holding += 1
    try:
        yield
    finally:
        _holding -= 1
        _raise_held()


@contextlib.contextmanager
def finishing() -> Iterator["Finishing"]:
    """Yield what is called when the work is done and only its results are left to be written in the block.

    The first signal after that call is not raised, and counts as received when the block ends. A second one is raised
    at once, because a disk that does not answer must not keep a person waiting.
    """
    global _finishing, _kept, _received
    try:
        yield Finishing()
    finally:
        _finishing = False
        _received, _kept = _received or _kept, 0


class Finishing:
    """What `finishing` yields."""

    def __call__(self) -> None:
        """Begin with what is left to be written."""
        global _finishing
        _finishing = True

    @property
    def exit_code(self) -> int:
        """The exit code for the signal that ended the work, or came while its results were written; 0 for none."""
        return exit_code()


def install() -> None:
    """Prepare the process of a command, once: see `handle`; no interruption is lost where Python cannot raise it."""
    handle()
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, lambda number, frame: _receive(_received or signal.SIGINT, frame))
        sys.unraisablehook = _again_after(sys.unraisablehook, lambda info: info.exc_type)
        sys.excepthook = _again_after(sys.excepthook, lambda kind, *rest: kind)


def handle() -> None:
    """Raise Interrupted at SIGINT and SIGTERM from now on, unless the parent process has them ignored."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _receive)


def is_handled() -> bool:
    """Return whether an interruption of this process has a class of its own, `Interrupted`."""
    return _handler_of(_SIGINT) is _receive


def restore() -> None:
    """Let both signals end the process at once: it has nothing left to do."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is _receive:
            signal.signal(number, signal.SIG_DFL)


@contextlib.contextmanager
def kept_from_children() -> Iterator[None]:
    """Keep SIGINT from processes that are started meanwhile: a terminal sends it to all, and this one ends them."""
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
    """Return a hook for what Python cannot raise, as in a destructor: an interruption is raised again a little later.

    All else goes to the hook before it.
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
