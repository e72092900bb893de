"""What is asked of the machine, against a library that only notes it down; nothing here needs a privilege."""

import ctypes
import errno
import gc
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import ValidationError

from telenano.runtime.loop import realtime
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.realtime import (
    apply_realtime,
    freeze_garbage,
    lower_thread,
    may_use_fifo,
    on_time,
    ordinary_scheduling,
    processor_of,
    shallow_idle,
)
from telenano.settings.scenario import RealtimeConfig
from telenano.signals.children import die_with_parent
from telenano.wire.errors import ConfigError

PR_GET_PDEATHSIG, PR_SET_PDEATHSIG, PR_SET_TIMERSLACK, PR_GET_TIMERSLACK = 2, 1, 29, 30


NODE = "test@master"


class FakeMachine:
    """Grants what the test sets and records what was requested."""

    def __init__(self, *, permitted: bool) -> None:
        self.permitted = permitted
        self.asked: list[tuple[object, ...]] = []

    def prctl(self, *arguments: int) -> int:
        self.asked.append(("prctl", *arguments))
        return 0

    def mlockall(self, flags: int) -> int:
        self.asked.append(("mlockall", flags))
        ctypes.set_errno(0 if self.permitted else errno.ENOMEM)
        return 0 if self.permitted else -1

    def sched_setscheduler(self, pid: int, policy: int, parameters: os.sched_param) -> None:
        self.asked.append(("scheduler", pid, policy, parameters.sched_priority))
        if not self.permitted:
            raise PermissionError(errno.EPERM, "Operation not permitted")


class ListLog(StructuredLog):
    def __init__(self) -> None:
        super().__init__("test@master")
        self.warnings: list[str] = []

    def warning(self, text: str, **facts: object) -> None:
        self.warnings.append(text)


def machine(monkeypatch: pytest.MonkeyPatch, *, permitted: bool) -> FakeMachine:
    fake = FakeMachine(permitted=permitted)
    monkeypatch.setattr(realtime.ctypes, "CDLL", lambda *_, **__: fake)
    monkeypatch.setattr(os, "sched_setscheduler", fake.sched_setscheduler)
    return fake


@pytest.mark.parametrize(
    ("node", "permitted", "expected"),
    [
        ("haptic_node@master", [0, 1], 0),
        ("controller@master", [0, 1, 2, 3], 2),
        ("delay_node@master", [0, 1], 1),
        ("controller@slave", [0, 1, 2, 3], 3),
        ("afm_node@slave", [4, 7], 7),
        ("afm_node@slave", [0], None),
    ],
)
def test_each_side_of_the_link_has_a_processor(node: str, permitted: list[int], expected: int | None) -> None:
    assert processor_of(node, RealtimeConfig(), permitted) == expected
    assert processor_of(node, RealtimeConfig(cpus="free"), permitted) is None
    with_master = RealtimeConfig(cpus="link_at_master")
    assert processor_of("delay_node@master", with_master, [2, 3]) == processor_of(
        "controller@master", with_master, [2, 3]
    )
    assert processor_of("afm_node@slave", with_master, [2, 3]) != processor_of("controller@master", with_master, [2, 3])
    own = RealtimeConfig(cpus={"controller": 5, "controller@slave": 6})
    assert processor_of(node, own, permitted) == {"controller@master": 5, "controller@slave": 6}.get(node)


@pytest.mark.parametrize(
    ("variable", "node", "pinned", "priority"),
    [
        ("1,2", "haptic_node@master", {1}, 50),
        ("1,2", "afm_node@slave", {2}, 50),
        # one site alone has one
        ("1", "afm_node@slave", {1}, 50),
        # none was left: any processor, behind the rigs that hold theirs
        ("none", "haptic_node@master", None, 48),
        # processors that this process may not use are those of another machine
        ("7,8", "haptic_node@master", {2}, 50),
        ("", "afm_node@slave", {3}, 50),
    ],
)
def test_a_rig_stays_on_the_processors_that_it_holds(
    monkeypatch: pytest.MonkeyPatch, variable: str, node: str, pinned: set[int] | None, priority: int
) -> None:
    fake, asked = machine(monkeypatch, permitted=True), []
    monkeypatch.setenv(realtime.PROCESSORS_VARIABLE, variable)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1, 2, 3})
    monkeypatch.setattr(os, "sched_setaffinity", lambda process, numbers: asked.append(set(numbers)))
    apply_realtime(RealtimeConfig(), ListLog(), node)
    assert asked == ([] if pinned is None else [pinned])
    assert [row[3] for row in fake.asked if row[0] == "scheduler"] == [priority]


@pytest.mark.parametrize("granted", [os.SCHED_FIFO, os.SCHED_OTHER])
def test_work_at_the_start_is_done_without_fifo_and_what_was_granted_comes_back(
    monkeypatch: pytest.MonkeyPatch, granted: int
) -> None:
    fake = machine(monkeypatch, permitted=True)
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: granted)
    monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(37))
    during = []

    def work() -> None:
        with ordinary_scheduling():
            during.extend(fake.asked)
            raise RuntimeError("no such sample")

    with pytest.raises(RuntimeError, match="no such sample"):
        work()
    if granted == os.SCHED_FIFO:
        assert during == [("scheduler", 0, os.SCHED_OTHER, 0)]
        assert fake.asked == [*during, ("scheduler", 0, os.SCHED_FIFO, 37)]
    else:
        assert fake.asked == during == []


def test_a_process_without_fifo_is_left_free(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, permitted=False)
    asked: list[object] = []
    monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cpus: asked.append(cpus))
    apply_realtime(RealtimeConfig(), ListLog(), NODE)
    assert asked == []


def test_all_is_asked_for_and_granted(monkeypatch: pytest.MonkeyPatch) -> None:
    fake, log = machine(monkeypatch, permitted=True), ListLog()
    monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cpus: fake.asked.append(("cpus", len(cpus))))
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    status = apply_realtime(RealtimeConfig(priority=60), log, NODE)
    assert (status.fifo, status.memory_locked, log.warnings) == (True, True, [])
    assert fake.asked == [
        ("prctl", PR_SET_TIMERSLACK, 1, 0, 0, 0),
        ("scheduler", 0, os.SCHED_FIFO, 60),
        ("cpus", 1),
        ("mlockall", 7),
    ]


def test_what_is_not_permitted_is_reported_once_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, permitted=False)
    log = ListLog()
    status = apply_realtime(RealtimeConfig(), log, NODE)
    assert (status.fifo, status.memory_locked) == (False, False)
    assert len(log.warnings) == 2
    assert "ulimit -r" in log.warnings[0]
    assert "ulimit -l" in log.warnings[1]


def test_what_is_not_wanted_is_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    fake, log = machine(monkeypatch, permitted=False), ListLog()
    status = apply_realtime(RealtimeConfig(scheduler="normal", memory_lock="off"), log, NODE)
    assert (status.fifo, status.memory_locked, log.warnings) == (False, False, [])
    assert fake.asked == [("prctl", PR_SET_TIMERSLACK, 1, 0, 0, 0)]


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (RealtimeConfig(scheduler="fifo"), "realtime.scheduler: fifo is not permitted"),
        (RealtimeConfig(scheduler="normal", memory_lock="on"), "realtime.memory_lock: memory cannot be locked"),
    ],
)
def test_what_was_demanded_and_is_not_permitted_is_an_error(
    monkeypatch: pytest.MonkeyPatch, config: RealtimeConfig, message: str
) -> None:
    machine(monkeypatch, permitted=False)
    with pytest.raises(ConfigError, match=message):
        apply_realtime(config, ListLog(), NODE)


def test_a_processor_is_kept_to_and_one_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, permitted=True)
    asked: list[tuple[int, set[int]]] = []
    with monkeypatch.context() as patch:
        patch.setattr(os, "sched_setaffinity", lambda pid, cpus: asked.append((pid, cpus)))
        apply_realtime(RealtimeConfig(cpus={"test": 0}), ListLog(), NODE)
    assert asked == [(0, {0})]
    with pytest.raises(ConfigError, match=r"realtime\.cpus: 100000 cannot be used .*permitted processors are \d"):
        apply_realtime(RealtimeConfig(cpus={NODE: 100_000}), ListLog(), NODE)


@pytest.mark.parametrize(("cpus", "free"), [("auto", {0, 1}), ({NODE: 1}, None)])
def test_a_thread_of_strangers_comes_behind_the_loop_on_any_processor(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cpus: object, free: set[int] | None
) -> None:
    for task, name in (("11", "python"), ("12", "ZMQbg/IO/0"), ("13", "ZMQbg/IO/1")):
        (tmp_path / task).mkdir()
        (tmp_path / task / "comm").write_text(f"{name}\n")
    moved: list[tuple[int, set[int]]] = []
    fake = machine(monkeypatch, permitted=True)
    monkeypatch.setattr(realtime, "_TASKS", tmp_path)
    monkeypatch.setattr(realtime, "_permitted_before", set())
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(os, "sched_setaffinity", lambda task, where: moved.append((task, set(where))))
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: os.SCHED_OTHER)
    lower_thread("ZMQbg/IO/1")
    assert (fake.asked, moved) == ([], [])
    apply_realtime(RealtimeConfig.model_validate({"cpus": cpus}), ListLog(), NODE)
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: os.SCHED_FIFO)
    monkeypatch.setattr(os, "sched_getparam", lambda _: os.sched_param(50))
    fake.asked.clear()
    moved.clear()
    lower_thread("ZMQbg/IO/1")
    assert fake.asked == [("scheduler", 13, os.SCHED_FIFO, 49)]
    assert moved == ([] if free is None else [(13, free)])


def test_timer_slack_of_this_very_process() -> None:
    libc = ctypes.CDLL(None)
    try:
        apply_realtime(RealtimeConfig(scheduler="normal", memory_lock="off"), ListLog(), NODE)
        assert libc.prctl(PR_GET_TIMERSLACK, 0, 0, 0, 0) == 1
    finally:
        # zero gives back the default of the process
        libc.prctl(PR_SET_TIMERSLACK, 0, 0, 0, 0)


def test_the_signal_at_the_death_of_the_parent() -> None:
    libc = ctypes.CDLL(None)
    found = ctypes.c_int()
    try:
        die_with_parent(signal.SIGTERM)
        libc.prctl(PR_GET_PDEATHSIG, ctypes.byref(found), 0, 0, 0)
        assert found.value == signal.SIGTERM
    finally:
        libc.prctl(PR_SET_PDEATHSIG, 0, 0, 0, 0)


@pytest.fixture
def _collector_restored() -> Iterator[None]:
    yield
    gc.enable()


@pytest.mark.usefixtures("_collector_restored")
def test_garbage_is_frozen_and_collected_no_more() -> None:
    before = gc.get_freeze_count()
    kept = [[number] for number in range(1000)]
    freeze_garbage()
    assert not gc.isenabled()
    assert gc.get_freeze_count() >= before + len(kept)


def open_files() -> list[Path]:
    return [link.resolve() for link in Path("/proc/self/fd").iterdir()]


def test_a_block_that_is_to_be_on_time_has_its_scheduling_and_no_other_has() -> None:
    slack = Path("/proc/self/timerslack_ns")
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, slack.read_text()
    with on_time():
        assert int(slack.read_text()) in (0, 1)
        assert (os.sched_getscheduler(0) == os.SCHED_FIFO) == may_use_fifo(50)
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, slack.read_text()) == before


def test_on_time_without_permission_the_waits_are_precise_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*given: object) -> None:
        raise PermissionError

    policy = os.sched_getscheduler(0)
    with monkeypatch.context() as patch:
        patch.setattr(os, "sched_setscheduler", lambda *given: refuse() if given[1] == os.SCHED_FIFO else None)
        with on_time():
            assert os.sched_getscheduler(0) == policy


def test_shallow_idle_holds_the_file_open(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    device = tmp_path / "cpu_dma_latency"
    device.write_bytes(b"")
    monkeypatch.setattr(realtime, "_CPU_DMA_LATENCY", device)
    with shallow_idle() as granted:
        assert granted
        assert device.read_bytes() == bytes(4)
        assert device in open_files()
    assert device not in open_files()


def test_shallow_idle_without_permission_changes_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(realtime, "_CPU_DMA_LATENCY", tmp_path / "absent" / "cpu_dma_latency")
    with shallow_idle() as granted:
        assert not granted


@pytest.mark.parametrize(
    "wrong",
    [
        {"priority": 0},
        {"priority": 99},
        {"rate_hz": 49.0},
        {"rate_hz": 10_001.0},
        {"rate_hz": float("nan")},
        {"cpus": {"test": -1}},
        {"cpus": "two"},
    ],
)
def test_ranges(wrong: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        RealtimeConfig(**wrong)


def test_every_key_is_described() -> None:
    schema = RealtimeConfig.model_json_schema()
    assert all("description" in field for field in schema["properties"].values()), json.dumps(schema)


_IN_A_PROCESS_OF_ITS_OWN = """
import ctypes, mmap, sys
from telenano.runtime.loop.realtime import use_huge_pages
size = 8 << 20
full, sparse = (mmap.mmap(-1, 2 * size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) for _ in range(2))
full.write(bytes(range(256)) * (2 * size // 256))
for place in range(0, 2 * size, size // 8):
    sparse[place] = 1

def place(memory):
    return ctypes.addressof(ctypes.c_char.from_buffer(memory))

def present(memory):
    pages = (ctypes.c_ubyte * (len(memory) // 4096))()
    assert libc.mincore(place(memory), len(memory), pages) == 0
    return sum(bit & 1 for bit in pages)

def huge_kb():
    with open("/proc/self/smaps_rollup") as lines:
        return sum(int(line.split()[1]) for line in lines if line.startswith("AnonHugePages:"))

libc = ctypes.CDLL(None)
libc.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
libc.mincore.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]
probe = -(-place(full) // (2 << 20)) * (2 << 20)
if libc.madvise(probe, 2 << 20, 25):
    sys.exit("this kernel gives no huge pages on request")
count = use_huge_pages()
assert count >= 6, count
assert huge_kb() >= 6 * 2048, huge_kb()
assert present(sparse) < 64, present(sparse)
assert full[:] == bytes(range(256)) * (2 * size // 256)
"""


def test_memory_in_use_goes_to_huge_pages_and_keeps_its_content() -> None:
    done = subprocess.run([sys.executable, "-c", _IN_A_PROCESS_OF_ITS_OWN], capture_output=True, text=True, check=False)
    if "no huge pages" in done.stderr:
        pytest.skip(done.stderr.strip())
    assert done.returncode == 0, done.stderr
