"""The files of the link, read in a child process while the link runs, so that no turn of it takes as long as a file."""

from pathlib import Path
from typing import NamedTuple

from telenano.files.held_files import standing
from telenano.files.limited_child import ChildReading
from telenano.runtime.loop.realtime import ordinary_scheduling
from telenano.settings.link_files import TraceFile, Traces
from telenano.settings.link_traces import Columns
from telenano.wire.errors import ConfigError, LaterError

# The child imports no more than this module.
_READ = "telenano.settings.link_traces:columns_in_child"


class _Known(NamedTuple):
    """A file that was read: its state at that time, and its columns or, in `fault`, the reason why there are none."""

    state: tuple[int, int, int]
    columns: Columns
    fault: str


class TraceReader(Traces):
    """Reads files at once until `begin`, and then in child processes, without waiting for them.

    A file that has not changed since it was read is not read again.
    """

    def __init__(self) -> None:
        self._runs = False
        self._known: dict[TraceFile, _Known] = {}
        self._reading: dict[TraceFile, tuple[tuple[int, int, int], ChildReading]] = {}
        self._asked: set[TraceFile] = set()

    def begin(self) -> None:
        self._runs = True

    def read(self, file: TraceFile) -> Columns:
        self._asked.add(file)
        path = standing(file.path)
        try:
            status = path.stat()
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
        state = (status.st_ino, status.st_size, status.st_mtime_ns)
        if file in self._reading:
            self._take(file)
        known = None if file in self._reading else self._known.get(file)
        if known is None or known.state != state:
            if self._runs:
                if file not in self._reading:
                    self._begin(file, path, state)
                raise LaterError(f"{file.name} is being read")
            known = self._known[file] = _Known(state, super().read(file), "")
        if known.fault:
            # The next command reads it again: the fault may have been that of the child.
            del self._known[file]
            raise ConfigError(known.fault)
        return known.columns

    def forget_unused(self) -> None:
        for file in [file for file in self._reading if file not in self._asked]:
            self._reading.pop(file)[1].close()
        self._known = {file: known for file, known in self._known.items() if file in self._asked}
        self._asked.clear()

    def close(self) -> None:
        while self._reading:
            self._reading.popitem()[1][1].close()

    def _begin(self, file: TraceFile, path: Path, state: tuple[int, int, int]) -> None:
        words = (file.kind, file.name, str(file.by_number), repr(file.unit_s))
        try:
            # With SCHED_FIFO the child would have the priority of the loop on its processor.
            with ordinary_scheduling():
                self._reading[file] = state, ChildReading(_READ, path, *words)
        except (OSError, ValueError) as error:
            raise ConfigError(f"{path}: cannot be read: {error}") from error

    def _take(self, file: TraceFile) -> None:
        """Take the columns of a file if its child has ended."""
        state, child = self._reading[file]
        columns: Columns = ()
        fault = ""
        try:
            if (answer := child.answer()) is None:
                return
            # A view that keeps the file of the child, and has the elements of `array` when it is indexed.
            columns = tuple(
                column.data.cast("B").cast(code)
                for code, column in zip(answer.facts["codes"], answer.arrays, strict=True)
            )
        except (ImportError, OSError, ValueError) as error:
            fault = str(error)
        self._known[file] = _Known(state, columns, fault)
        del self._reading[file]
        child.close()
