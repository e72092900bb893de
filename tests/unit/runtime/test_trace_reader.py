"""The files of a link that runs are read in a child process, once for each state of a file."""

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from telenano.runtime.wiring import trace_reader
from telenano.runtime.wiring.trace_reader import TraceReader
from telenano.settings.link_files import OWN_TRACES, TraceFile
from telenano.settings.link_traces import Columns
from telenano.wire.errors import ConfigError, LaterError

TEXTS = {
    "delay": "0 0.01\n0.5 0.02\n",
    "loss": "0 1\n0.5 0\n",
    "delivery": "0\n2\n2\n5\n",
    "table": "3.5\n-1\n2\n",
}


@pytest.fixture
def running() -> Iterator[TraceReader]:
    reader = TraceReader()
    reader.begin()
    yield reader
    reader.close()


def made(folder: Path, kind: str, text: str | None = None) -> TraceFile:
    path = folder / f"{kind}.txt"
    path.write_text(TEXTS[kind] if text is None else text)
    return TraceFile(kind, path, path.name, unit_s=1e-3)  # type: ignore[arg-type]


def later(read: Callable[[], Columns]) -> Columns:
    """Ask until the file is there, as the copies of a command do."""
    while True:
        try:
            return read()
        except LaterError:
            time.sleep(0.01)


def no_child(*_: object) -> None:
    raise AssertionError("a child was started")


@pytest.mark.parametrize("kind", TEXTS)
def test_a_child_returns_what_this_process_would_have_read(tmp_path: Path, running: TraceReader, kind: str) -> None:
    file = made(tmp_path, kind)
    with pytest.raises(LaterError):
        running.read(file)
    found = later(lambda: running.read(file))
    assert found == OWN_TRACES.read(file)
    assert [list(column) for column in found] == [list(column) for column in OWN_TRACES.read(file)]


def test_before_it_runs_a_link_reads_at_once_and_a_file_that_stays_is_not_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader, file = TraceReader(), made(tmp_path, "delay")
    before = reader.read(file)
    reader.begin()
    with monkeypatch.context() as patch:
        patch.setattr(trace_reader, "ChildReading", no_child)
        assert reader.read(file) is before
    file.path.write_text("0 0.5\n")
    os.utime(file.path, ns=(1, 1))
    assert later(lambda: reader.read(file))[1][0] == 500_000_000


def test_a_fault_names_the_line_and_is_looked_for_again(tmp_path: Path, running: TraceReader) -> None:
    file = made(tmp_path, "delay", "0 0.01\n0 x\n")
    with pytest.raises(ConfigError, match=r"^delay.txt, line 2: is not a number$"):
        later(lambda: running.read(file))
    with pytest.raises(LaterError):
        running.read(file)
    with pytest.raises(ConfigError, match="cannot be read"):
        running.read(TraceFile("delay", tmp_path / "none.txt", "none.txt"))


def test_a_reading_that_nobody_asks_for_any_more_is_ended(tmp_path: Path, running: TraceReader) -> None:
    file, other = made(tmp_path, "delay"), made(tmp_path, "loss")
    with pytest.raises(LaterError):
        running.read(file)
    later(lambda: running.read(other))
    running.forget_unused()
    assert later(lambda: running.read(other)) == OWN_TRACES.read(other)
    running.forget_unused()
    with pytest.raises(LaterError):
        running.read(file)
