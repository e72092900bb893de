"""A node that hangs is started again; one that is stopped, starved, or on a machine that stood still is left alone."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pytest
from launcher_bench import SECOND_NS, TICK_NS, FakeChildren, health

from telenano.launcher.supervisor import Supervisor
from telenano.launcher.watchdog import LOOK_S, RECORDER_BUSY_S, SILENCE_S, ProcessSample, ProcFiles, Watchdog
from telenano.testing import VirtualClock

NODE, OTHER, LINK = "afm_node@slave", "controller@slave", "delay_node@master"
NODES = (NODE, OTHER)


class FakeTimes:
    """What the kernel says of processes: `share` is what each takes of the time that passes."""

    def __init__(self) -> None:
        self.share = dict.fromkeys(range(1, 100), 0.3)
        self.state = dict.fromkeys(range(1, 100), "S")
        self.cpu_s = dict.fromkeys(range(1, 100), 5.0)
        self.fault = ""

    def pass_time(self, elapsed_s: float) -> None:
        for process_id, share in self.share.items():
            self.cpu_s[process_id] += share * elapsed_s

    def read(self, process_id: int) -> ProcessSample:
        if self.fault:
            raise PermissionError(self.fault)
        # in hundredths of a second, as the kernel counts
        return ProcessSample(self.state[process_id], int(self.cpu_s[process_id] * 100.0) / 100.0)


class Bench:
    """A supervisor of two nodes in virtual time, and what it has reported: (state, text)."""

    def __init__(self) -> None:
        self.clock, self.times, self.children = VirtualClock(start_ns=SECOND_NS), FakeTimes(), FakeChildren()
        self.supervisor = Supervisor(self.clock, NODES, self.children, Watchdog(self.clock, self.times))
        self.reported: list[tuple[str, str]] = []
        self.supervisor.launch(self.report)
        self.pids = {NODE: 1, OTHER: 2}
        self._health_ns = self.clock.monotonic_ns()

    def report(self, level: str, text: str, **data: object) -> None:
        self.reported.append((str(data.get("state", "")), text))

    def say(self, node: str, state: str = "running", process_id: int | None = None) -> None:
        message = msgspec.structs.replace(health(node, state=state), pid=process_id or self.pids[node])
        self.supervisor.record_health(message, self.report)

    def run(self, duration_s: float, *, silent: tuple[str, ...] = (), tick_s: float = TICK_NS * 1e-9) -> None:
        """Go on: the nodes report twice a second, but for the silent ones."""
        end_ns = self.clock.monotonic_ns() + round(duration_s * 1e9)
        while self.clock.monotonic_ns() < end_ns:
            self.clock.advance_ns(round(tick_s * 1e9))
            self.times.pass_time(tick_s)
            if self.clock.monotonic_ns() >= self._health_ns:
                self._health_ns = self.clock.monotonic_ns() + SECOND_NS // 2
                for node in NODES:
                    if node not in silent:
                        self.say(node)
            self.supervisor.handle_hangs(self.report)
            self.supervisor.handle_exits(self.report)
            self.supervisor.restart_due(self.report)

    @property
    def states(self) -> list[str]:
        return [state for state, _ in self.reported]


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    made.run(1.0)
    assert made.reported == []
    return made


def test_a_node_that_hangs_is_killed_and_started_again(bench: Bench) -> None:
    bench.times.share[1] = 0.98
    begun_ns = bench.clock.monotonic_ns()
    while not bench.children.killed:
        bench.run(0.05, silent=(NODE,))
        assert bench.clock.monotonic_ns() - begun_ns < 5 * SECOND_NS
    took_s = (bench.clock.monotonic_ns() - begun_ns) * 1e-9
    assert SILENCE_S - 0.5 <= took_s <= SILENCE_S + 3 * LOOK_S
    bench.run(0.5, silent=(NODE,))
    assert bench.children.killed == [NODE]
    assert bench.children.started == [*NODES, NODE]
    assert bench.supervisor.restarts() == {NODE: 1, OTHER: 0}
    first, second, third = (text for _, text in bench.reported)
    assert first.startswith(f"{NODE} has not reported for 2.")
    assert first.endswith("it hangs and is killed")
    assert second.startswith(f"{NODE} was killed by SIGKILL after")
    assert third == f"{NODE} was started again"


@pytest.mark.parametrize("duration_s", [3.0, 10.0, 120.0])
def test_a_node_that_is_stopped_is_reported_once_and_left_alone(bench: Bench, duration_s: float) -> None:
    bench.times.share[1], bench.times.state[1] = 0.0, "T"
    bench.run(duration_s, silent=(NODE,))
    assert bench.states == ["stopped"]
    # it goes on: first with all that waited for it, then with its reports
    bench.times.share[1], bench.times.state[1] = 1.0, "R"
    bench.run(1.5, silent=(NODE,))
    bench.run(5.0)
    assert bench.states == ["stopped", "back"]
    assert bench.children.killed == []
    assert bench.children.started == list(NODES)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_a_node_that_is_not_let_run_is_reported_once_and_left_alone(bench: Bench, share: float) -> None:
    bench.times.share[1] = share
    bench.run(60.0, silent=(NODE,))
    assert bench.states == ["starved"]
    assert "is left alone" in bench.reported[0][1]
    assert bench.children.killed == []
    # one that then hangs after all is found
    bench.times.share[1] = 1.0
    bench.run(4.0, silent=(NODE,))
    assert bench.children.killed == [NODE]


@pytest.mark.parametrize("pause_s", [3.0, 60.0])
def test_a_machine_that_stood_still_is_no_hang(bench: Bench, pause_s: float) -> None:
    # with it the clock goes on, and of processor time there may be some, or all of it by an account that is late
    bench.times.share = dict.fromkeys(bench.times.share, 1.0)
    bench.run(pause_s, silent=NODES, tick_s=pause_s)
    bench.times.share = dict.fromkeys(bench.times.share, 0.3)
    bench.run(5.0)
    assert bench.states == ["paused"]
    assert bench.children.killed == []


def test_a_machine_that_stutters_is_no_hang(bench: Bench) -> None:
    # the launcher comes to its turn every three seconds only, and finds reports that are old
    for _ in range(20):
        bench.run(3.0, silent=(NODE,), tick_s=3.0)
        bench.say(NODE)
    assert bench.children.killed == []
    assert set(bench.states) == {"paused"}


def test_before_its_first_report_a_node_may_take_any_time() -> None:
    bench = Bench()
    bench.times.share[1] = 1.0
    bench.run(60.0, silent=(NODE,))
    assert bench.reported == []


def test_a_node_that_stops_is_not_judged(bench: Bench) -> None:
    bench.say(NODE, state="stopping")
    bench.times.share[1] = 1.0
    bench.run(60.0, silent=(NODE,))
    assert bench.reported == []


def test_what_another_process_says_in_the_name_of_a_node_is_no_sign_of_life(bench: Bench) -> None:
    bench.times.share[1] = 1.0
    for _ in range(60):
        bench.say(NODE, process_id=77)
        bench.run(0.05, silent=(NODE,))
    assert bench.children.killed == [NODE]
    # and of a process that was started again, what its predecessor still says
    bench.run(0.5, silent=(NODE,))
    bench.say(NODE, process_id=1)
    bench.times.share[3] = 1.0
    bench.run(30.0, silent=(NODE,))
    assert bench.children.killed == [NODE]


def test_a_node_that_hangs_again_and_again_ends_the_rig() -> None:
    bench = Bench()
    bench.times.share = dict.fromkeys(bench.times.share, 1.0)
    for _ in range(5):
        started = bench.children.started
        bench.pids = {node: max(n for n, name in enumerate(started, 1) if name == node) for node in NODES}
        bench.say(NODE)
        bench.run(4.0, silent=(NODE,))
    assert "it died 5 times within 30 s" in bench.supervisor.failure


def test_without_the_files_of_the_kernel_nothing_is_killed_and_the_reason_is_given(bench: Bench) -> None:
    bench.times.fault = "/proc is not mounted"
    bench.times.share[1] = 1.0
    bench.run(60.0, silent=(NODE,))
    (state, text), = bench.reported  # fmt: skip
    assert state == "unknown"
    assert "whether it hangs cannot be decided here (/proc is not mounted)" in text
    assert bench.children.killed == []


def test_samples_are_those_of_the_kernel() -> None:
    text = "import time\nprint('begun', flush=True)\nwhile True: pass"
    with subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            times = ProcFiles()
            before = times.read(process.pid)
            while (now := times.read(process.pid)).cpu_s < before.cpu_s + 0.05:
                assert now.state in "RSD"
            os.kill(process.pid, signal.SIGSTOP)
            while times.read(process.pid).state != "T":
                time.sleep(0.001)
            assert times.read(process.pid).cpu_s == times.read(process.pid).cpu_s
        finally:
            process.kill()


def test_a_name_with_parentheses_is_no_field(tmp_path: Path) -> None:
    (tmp_path / "7").mkdir()
    fields = "S 1 7 7 0 -1 4194560 1 0 0 0 150 50 0 0 20"
    (tmp_path / "7" / "stat").write_text(f"7 (a) R 9 (b) {fields}\n")
    found = ProcFiles(tmp_path).read(7)
    assert found.state == "S"
    assert found.cpu_s == pytest.approx(200 / os.sysconf("SC_CLK_TCK"), rel=1e-12)
    with pytest.raises(FileNotFoundError):
        ProcFiles(tmp_path).read(8)
    (tmp_path / "7" / "stat").write_text("")
    with pytest.raises(ValueError, match="0 fields"):
        ProcFiles(tmp_path).read(7)


def test_a_recorder_may_end_a_long_file_in_one_go() -> None:
    clock, times, recorder = VirtualClock(start_ns=SECOND_NS), FakeTimes(), "recorder@master"
    watchdog = Watchdog(clock, times)
    watchdog.record_start(recorder, 1)
    watchdog.record_report(recorder, 1, is_stopping=False)
    times.share[1] = 1.0
    found = []
    for _ in range(round(RECORDER_BUSY_S / 0.05) + 40):
        clock.advance_ns(TICK_NS)
        times.pass_time(0.05)
        found += watchdog.check()
    assert [finding.kind for finding in found] == ["hung"]
    assert found[0].silence_s >= RECORDER_BUSY_S


class Carried:
    """A node whose reports pass another one, as those of the slave's nodes pass the link of a rig on one machine."""

    def __init__(self) -> None:
        self.clock, self.times = VirtualClock(start_ns=SECOND_NS), FakeTimes()
        self.watchdog = Watchdog(self.clock, self.times, {OTHER: LINK})
        self.pids = {LINK: 1, OTHER: 2}
        for node in self.pids:
            self.watchdog.record_start(node, self.pids[node])

    def run(self, duration_s: float, *heard: str) -> list[str]:
        """Go on: these nodes are heard twice a second; give what was found."""
        found = []
        for tick in range(round(duration_s / 0.05)):
            for node in heard if tick % 10 == 0 else ():
                found += self.watchdog.record_report(node, self.pids[node], is_stopping=False)
            self.clock.advance_ns(TICK_NS)
            self.times.pass_time(0.05)
            found += self.watchdog.check()
        return [finding.text for finding in found]


def test_a_node_that_is_heard_through_another_is_not_judged_while_that_is_started_again() -> None:
    rig = Carried()
    assert rig.run(2.0, LINK, OTHER) == []
    # The link ends, and its new process takes its time, in which this node may even be busy.
    rig.watchdog.forget([LINK])
    assert rig.run(1.0) == []
    rig.pids[LINK] = 3
    rig.watchdog.record_start(LINK, 3)
    rig.times.share[2] = 1.0
    assert rig.run(4.0) == []
    rig.times.share[2] = 0.3
    assert rig.run(1.5, LINK) == []
    assert rig.run(2.0, LINK, OTHER) == []


def test_a_node_that_is_not_heard_though_the_link_is_may_be_unheard_or_hang() -> None:
    rig = Carried()
    assert rig.run(2.0, LINK, OTHER) == []
    (text,) = rig.run(3.0, LINK)
    assert text.endswith(
        f"its reports pass {LINK}, where they may be held up or lost; it does not hang, and is left alone"
    )
    rig.times.share[2] = 1.0
    (text,) = rig.run(3.0, LINK)
    assert text.endswith("it hangs and is killed")
