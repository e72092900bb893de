"""Marks on a serial port, a parallel one and a file, each emulated; and a port that is not there or goes away."""

import fcntl
import os
import select
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from experiment_bench import plan_of
from telenano_lab.experiments.apparatus import marks
from telenano_lab.experiments.apparatus.base import Course, Take
from telenano_lab.experiments.apparatus.live import Live
from telenano_lab.experiments.apparatus.marks import END, PRACTICE, Marks, code_of
from telenano_lab.experiments.desk import Desk
from telenano_lab.experiments.plan import Plan
from telenano_lab.experiments.tasks import TASKS

from telenano.testing import invoke
from telenano.wire import ConfigError, RigError

# fcntl of Linux (F_SETPIPE_SZ)
_SET_PIPE_SIZE = 1031


@pytest.fixture
def line() -> Iterator[tuple[int, Path]]:
    """Yield the far end of a serial line, and the path of the near one."""
    far, near = os.openpty()
    yield far, Path(os.ttyname(near))
    for each in (far, near):
        os.close(each)


def read(far: int, count: int) -> bytes:
    """Return so many bytes of the far end, and what else is there; the kernel hands a line over some time later."""
    got = b""
    while len(got) < count and select.select([far], [], [], 10.0)[0]:
        got += os.read(far, 16)
    return got + (os.read(far, 16) if select.select([far], [], [], 0.05)[0] else b"")


def test_a_serial_port_gets_the_byte_and_then_nought(line: tuple[int, Path]) -> None:
    far, path = line
    port = Marks(path, 115200)
    first_ns, second_ns = port.send(7), port.send(END)
    port.close()
    assert read(far, 4) == bytes([7, 0, END, 0])
    assert second_ns - first_ns >= 1e9 * marks.PULSE_S


def test_a_parallel_port_has_the_byte_on_its_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, Any]] = []
    null = Path("/dev/null")
    assert stat.S_ISCHR(null.stat().st_mode)
    monkeypatch.setattr(marks.os, "major", lambda device: 99)
    monkeypatch.setattr(marks.fcntl, "ioctl", lambda descriptor, request, data=None: asked.append((request, data)))
    port = Marks(null, 115200)
    port.send(7)
    port.close()
    # linux/ppdev.h calls the requests PPEXCL, PPCLAIM and PPWDATA
    assert asked == [(0x708F, None), (0x708B, None), (0x40017086, b"\x07"), (0x40017086, b"\x00")]


def test_a_port_that_is_none_is_refused_by_name_before_anything_starts(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for name, reason in (("absent", "No such file"), ("pipe", "No such device"), ("", "Is a directory")):
        with pytest.raises(ConfigError, match=f"--marks .*{name}: cannot be opened: {reason}"):
            Marks(tmp_path / name, 115200)
    for words, reason in (
        (("--marks", str(tmp_path / "absent"), "--apparatus", "live"), "cannot be opened"),
        (("--marks", str(tmp_path / "absent"), "--apparatus", "lockstep"), "simulated time has nothing to mark"),
    ):
        done = invoke(["experiment", "run", "delay_and_law", "--out", str(tmp_path / "out"), *words])
        assert done.exit_code == 2 and reason in done.stderr
        assert not (tmp_path / "out").exists()


def test_every_condition_has_a_number_and_practice_has_its_own(tmp_path: Path) -> None:
    factors = {"law": ["wave", "passivity"], "round_trip_ms": [0, 20, 40]}
    plan = plan_of(tmp_path, participants=2, factors=factors, repetitions=2, practice={"trials": 2})
    trials = plan.trials("P02")
    found = {(trial.condition["law"], trial.condition["round_trip_ms"]): code_of(plan, trial)
             for trial in trials if trial.phase == "main"}  # fmt: skip
    assert sorted(found.values()) == [1, 2, 3, 4, 5, 6]
    assert {code_of(plan, trial) for trial in trials if trial.phase == "practice"} == {PRACTICE}


class Marked(Live):
    """A rig whose trial is recorded already, and is marked now."""

    def __init__(self, plan: Plan, recording: Path, port: Marks) -> None:
        super().__init__(plan, recording.parent, Desk(plan), marks=port)
        self._recording = recording

    def take(self, course: Course) -> Take:
        marked: dict[int, int | str] = {}
        self._mark(code_of(self.plan, course.trial), marked)
        self._mark(END, marked)
        return self._judged(course, self._recording, {}, [], marked)


@pytest.mark.parametrize("goes_away", [False, True])
def test_a_trial_says_when_it_was_marked_and_is_disturbed_where_it_was_not(
    tmp_path: Path, recording_of: Callable[[str], Path], goes_away: bool
) -> None:
    path = recording_of("wave")
    plan = plan_of(tmp_path, tasks=[next(iter(TASKS))], known=TASKS)
    far, near = os.openpty()
    port = Marks(Path(os.ttyname(near)), 115200)
    os.close(near)
    if goes_away:
        os.close(far)
    outcome = Marked(plan, path, port).run(plan.trials("P01")[0], 0)
    noted = {key: value for key, value in outcome.verified.items() if key.startswith("mark_")}
    if goes_away:
        assert outcome.status == "disturbed" and noted == {}
        assert outcome.disturbance.count("was not written to /dev/pts/") == 2
        with pytest.raises(RigError, match="the mark 1 was not written"):
            port.send(1)
    else:
        assert list(noted) == ["mark_1_s", f"mark_{END}_s"]
        assert read(far, 4) == bytes([1, 0, END, 0])
        os.close(far)
    port.close()


def test_a_port_that_is_pulled_filled_or_left_by_its_reader_is_a_sentence_and_leaves_no_descriptor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(marks, "PULSE_S", 0.0)
    far, near = os.openpty()
    os.mkfifo(tmp_path / "left")
    os.mkfifo(tmp_path / "unread")
    readers = [os.open(tmp_path / name, os.O_RDONLY | os.O_NONBLOCK) for name in ("left", "unread")]
    # Linux has no smaller pipe
    fcntl.fcntl(readers[1], _SET_PIPE_SIZE, 4096)
    ends: dict[Path, Callable[[], object]] = {
        Path(os.ttyname(near)): lambda: os.close(far),
        tmp_path / "left": lambda: os.close(readers[0]),
        tmp_path / "unread": lambda: None,
        Path("/dev/full"): lambda: None,
    }
    os.close(near)
    for path, end in ends.items():
        if path != Path("/dev/full"):
            before = set(Path("/proc/self/fd").iterdir())
        port = Marks(path, 115200)
        if path != Path("/dev/full"):
            port.send(1)
        end()
        # a pipe that is not read is full at last
        with pytest.raises(RigError, match=f"the mark 2 was not written to {path}: "):
            for _ in range(40_000):
                port.send(2)
        port.close()
        assert set(Path("/proc/self/fd").iterdir()) <= before
    os.close(readers[1])


def test_bytes_are_not_appended_to_a_file_with_a_content(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    path.write_text("trial,answer\n")
    with pytest.raises(ConfigError, match="is a file with a content, to which bytes would be appended"):
        Marks(path, 9600)
    assert path.read_text() == "trial,answer\n"
    (tmp_path / "empty").touch()
    Marks(tmp_path / "empty", 9600).close()


def test_a_parallel_port_that_another_program_has_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    def taken(*_: object) -> None:
        raise OSError(16, "Device or resource busy")

    monkeypatch.setattr(marks.os, "major", lambda device: 99)
    monkeypatch.setattr(marks.fcntl, "ioctl", taken)
    before = set(Path("/proc/self/fd").iterdir())
    with pytest.raises(ConfigError, match="cannot be opened: Device or resource busy"):
        Marks(Path("/dev/null"), 9600)
    assert set(Path("/proc/self/fd").iterdir()) == before
