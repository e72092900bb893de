"""Several nodes in one process: who is waited for, what the guard counts, and what they share."""

import signal
import subprocess
import sys

import pytest

from telenano.runtime.loop.machine import SharedMachine
from telenano.runtime.loop.realtime import on_one_processor
from telenano.runtime.site.shared_tasks import NodeTasks, SharedTasks
from telenano.runtime.site.site_loop import SharedGuard
from telenano.settings.scenario import RealtimeConfig
from telenano.testing import VirtualClock
from telenano.timing.clock import NEVER_NS
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import HAND, JOINED, STOP_ORDER, TIP, counts_for_process

HALF, FAR_HALF, LINK = "controller@master", "controller@slave", "delay_node@master"


def test_each_node_of_a_site_is_in_its_process_and_the_device_is_the_last() -> None:
    assert {name: nodes[-1] for name, nodes in JOINED.items()} == {"site@master": HAND, "site@slave": TIP}
    joined = {node for nodes in JOINED.values() for node in nodes}
    others = {node for node in STOP_ORDER if node.startswith(("recorder", "viz_node"))}
    assert joined == set(STOP_ORDER) - others


def test_the_guard_begins_again_when_every_node_has_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    renewed: list[None] = []
    guard = SharedGuard([HALF, LINK])
    monkeypatch.setattr(guard, "renew", lambda: renewed.append(None))
    for key in (HALF, HALF, HALF):
        guard.note(key)
    assert len(renewed) == 0, "the other one may hang"
    guard.note(LINK)
    assert len(renewed) == 1
    guard.note(LINK)
    assert len(renewed) == 1
    guard.note(HALF)
    assert len(renewed) == 2


def test_the_end_of_one_node_leaves_the_guard_of_the_process_armed() -> None:
    with SharedGuard([HALF, LINK]) as guard:
        guard.note(HALF)
        # A node that ends reports once more, as the last of what it does.
        guard.note(HALF)
        assert signal.getitimer(signal.ITIMER_PROF)[0] > 0.0
    assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)


def test_what_a_process_takes_is_told_by_each_and_counted_once() -> None:
    facts = SharedMachine([HALF, LINK]).health(0.5, 1.0)
    assert (facts["cpu_percent"], facts["shares_with"]) == (50.0, (HALF, LINK))
    mates = [HAND, HALF, LINK]
    counted = [node for node in mates if counts_for_process(node, [other for other in mates if other != node])]
    assert len(counted) == 1
    assert counts_for_process(TIP, None)


def test_a_process_is_on_the_processor_of_its_nodes() -> None:
    nodes = JOINED["site@master"]
    auto = RealtimeConfig()
    assert on_one_processor(auto, nodes, HAND) is auto
    given = RealtimeConfig(cpus={"controller": 1, LINK: 1})
    assert on_one_processor(given, nodes, HAND).cpus == {HAND: 1}
    assert on_one_processor(RealtimeConfig(cpus={"recorder": 1}), nodes, HAND).cpus == {}
    with pytest.raises(ConfigError, match=r"controller@master on 1, haptic_node@master on 0: .* one processor"):
        on_one_processor(RealtimeConfig(cpus={"haptic_node": 0, "controller": 1}), nodes, HAND)


def test_tasks_of_all_nodes_share_one_gap_and_each_node_sees_its_own() -> None:
    clock = VirtualClock()
    shared = SharedTasks(clock)
    tasks = {key: NodeTasks(shared, key, clock) for key in (TIP, FAR_HALF)}
    done: list[str] = []

    def turn() -> None:
        done.append("turn")

    def report() -> None:
        done.append("report")

    tasks[TIP].add(turn, is_turn=True)
    tasks[FAR_HALF].add(report, within_ns=NEVER_NS)
    assert (tasks[TIP].has_turns, tasks[FAR_HALF].has_turns) == (True, False)
    # The loop of a node runs none of them: the process does.
    assert {task.due_ns for task in tasks.values()} == {NEVER_NS}
    assert shared.due_ns < NEVER_NS
    tasks[TIP].forget_unneeded()
    assert len(shared.of(FAR_HALF)) == 1, "the tasks of the other node are not its own"
    taken = tasks[TIP].take_turn()
    assert taken is turn
    assert (tasks[FAR_HALF].take_turn(), shared.of(TIP)) == (None, [])


LIMITED = """
import signal, sys, time
from telenano.runtime.loop.turn_limit import TurnLimit

def burn(cpu_s):
    begin = time.process_time()
    while time.process_time() - begin < cpu_s:
        pass

def tell(text):
    # a tick while the line is written
    signal.raise_signal(signal.SIGALRM)
    print(text, flush=True)

limit = TurnLimit(lambda: "afm_node@slave", tell)
limit.begin()
{work}
limit.end()
burn(0.2)
time.sleep(0.2)
print("ended by itself")
"""


def ended(work: str) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-c", LIMITED.format(work=work)], capture_output=True, text=True, timeout=60, check=False
    )
    return done.returncode, done.stdout


@pytest.mark.parametrize("work", ["burn(30)", "time.sleep(30)", "[0 for _ in iter(int, 1)]"])
def test_a_turn_without_an_end_ends_the_process_and_says_whose_it_was(work: str) -> None:
    code, out = ended(work)
    assert code == -signal.SIGVTALRM
    assert out in ("", "a turn of afm_node@slave has not ended within 50 ms: its process is ended\n")


def test_compiled_code_that_never_returns_is_ended_as_well() -> None:
    # No handler of Python runs while the interpreter is in such a call.
    assert ended("sum(range(10**10))") == (-signal.SIGVTALRM, "")


@pytest.mark.parametrize(
    "work",
    [
        "[limit.begin() or burn(0.02) for _ in range(8)]",
        # stopped for a second by a signal, in the middle of a turn
        "import os, signal, subprocess\n"
        "limit.end()\n"
        "wake = subprocess.Popen(['sh', '-c', f'sleep 0.6; kill -CONT {os.getpid()}'])\n"
        "limit.begin()\n"
        "os.kill(os.getpid(), signal.SIGSTOP)",
    ],
    ids=["short turns", "a process that was stopped"],
)
def test_who_ends_its_turns_or_was_not_let_run_goes_on(work: str) -> None:
    assert ended(work) == (0, "ended by itself\n")
