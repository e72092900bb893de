"""Fixtures that give a process back what a test or a file has changed in it: no test depends on those before it.

Files share the processes of a run, and which ones depends on their times.
"""

import contextlib
import gc
import logging
import signal
from collections.abc import Iterator
from typing import Any

import pytest

from telenano.settings import plugins
from telenano.wire import codec
from telenano.wire.topics import TOPICS

# What the main function of a process changes for as long as that process lives.
_SIGNALS = sorted(signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP})
_TABLES: tuple[dict[Any, Any], ...] = (TOPICS, codec._FORMS, codec.MOST_BYTES, plugins._problems)


@contextlib.contextmanager
def _restored() -> Iterator[None]:
    """Give this process back its handlers of signals, its log, its garbage collection and tables that grow by use."""
    handlers = {number: signal.getsignal(number) for number in _SIGNALS}
    wakeup = signal.set_wakeup_fd(-1)
    signal.set_wakeup_fd(wakeup)
    root, collects = logging.getLogger(), gc.isenabled()
    log_handlers, level = root.handlers[:], root.level
    tables = [dict(table) for table in _TABLES]
    yield
    signal.set_wakeup_fd(wakeup)
    for number, handler in handlers.items():
        # The kernel keeps some numbers for the threads of the C library, and a handler of C has no object.
        if signal.getsignal(number) is not handler and handler is not None:
            signal.signal(number, handler)
    root.handlers[:] = log_handlers
    root.setLevel(level)
    (gc.enable if collects else gc.disable)()
    for table, before in zip(_TABLES, tables, strict=True):
        if table != before:
            table.clear()
            table.update(before)


@pytest.fixture(autouse=True, scope="module")
def process_restored_after_a_file() -> Iterator[None]:
    with _restored():
        yield


@pytest.fixture(autouse=True)
def process_restored() -> Iterator[None]:
    with _restored():
        yield
