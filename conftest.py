"""What every test shares: seeded property tests without a time limit on single examples, and which cases run when."""

import contextlib
import gc
import logging
import signal
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from changed_files import touches
from hypothesis import HealthCheck, settings

from telenano.settings import plugins
from telenano.wire import codec
from telenano.wire.topics import TOPICS

ROOT = Path(__file__).parent
# What the main function of a process changes for as long as that process lives.
_SIGNALS = sorted(signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP})
_TABLES: tuple[dict[Any, Any], ...] = (TOPICS, codec._FORMS, codec.MOST_BYTES, plugins._problems)

# derandomize: the same examples every run, and no database of them on disk
settings.register_profile(
    "telenano",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("telenano")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave the cases of a grid to `make check` but for one, and what is not drawn of many cases to `make endurance`.

    A case is drawn by its name, so that each run has the same ones and a new case moves no other.
    """
    for item in items:
        if (grid := item.get_closest_marker("grid")) and item.get_closest_marker("endurance") is None:
            values = item.callspec.params  # type: ignore[attr-defined]
            if any(values[name] != chosen for name, chosen in grid.kwargs.items()):
                item.add_marker(pytest.mark.check(f"{grid.kwargs} stand for the grid"))
        drawn = item.get_closest_marker("drawn") if item.get_closest_marker("check") else None
        if drawn and zlib.crc32(item.name.encode()) >= drawn.args[0] * 2**32 and not touches(*_places(item, drawn)):
            item.add_marker(pytest.mark.endurance(f"{drawn.args[0]:.0%} of the cases stand for all"))


def _places(item: pytest.Item, drawn: pytest.Mark) -> tuple[str, ...]:
    """Return the files whose change has all cases of a test run: that of the test, and those that its mark names."""
    return (item.path.relative_to(ROOT).as_posix(), *drawn.args[1:])


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect the tests without looking for garbage, which takes a third of the time, and leave them out of it later.

    Modules and tests are half a million objects that stay: one collection of all of them takes seconds. Their bytecode
    is kept, also where the environment forbids it: other workers, runs and the processes that tests start read it.
    """
    forbidden, sys.dont_write_bytecode = sys.dont_write_bytecode, False
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()
        sys.dont_write_bytecode = forbidden


@contextlib.contextmanager
def _restored() -> Iterator[None]:
    """Give this process back its handlers of signals, its log, its collection of garbage and tables that grow by use.

    Without it a test would pass or fail by the files that the same process has run before it.
    """
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
def _process_restored_after_a_file() -> Iterator[None]:
    with _restored():
        yield


@pytest.fixture(autouse=True)
def _process_restored() -> Iterator[None]:
    with _restored():
        yield
