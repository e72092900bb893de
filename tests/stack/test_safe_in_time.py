"""A site whose law never returns, or whose process is killed or stopped: how soon the device at the other one is safe.

With a process a site it is as soon as with a process a node, and what hangs is ended before that.
"""

import itertools
import os
import signal
import statistics
import time
from collections.abc import Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import pytest
from recovered import Kill, coupled, recover
from stack_rig import CONSTANT_PUSH, ROOT, Rig, arm

from telenano.wire.nodes import HAND, TIP

pytestmark = [pytest.mark.stack, pytest.mark.endurance]

HANGS = ROOT / "tests" / "fuzz" / "hang_in_turn"
# The process of this half is disturbed; the device at the other site, its topic, and the mode in which it is safe.
FAR = {
    "controller@slave": (HAND, "haptic/state", "off"),
    "controller@master": (TIP, "afm/state", "hold"),
}
EVENTS = {"never returns": signal.SIGUSR1, "kill -9": signal.SIGKILL, "SIGSTOP": signal.SIGSTOP}
# How often each is tried.
ROUNDS = 3
# What a process a site may add to the times of a process a node.
MORE_MS = 20.0
WATCHED_NS = 1_500_000_000


def disturb(rig: Rig, half: str, event: str) -> Kill:
    """Disturb the process of a half while the tip is in contact; return when that was."""
    rig.wait_until(lambda: coupled(rig) and bool(rig.newest("afm/state").in_contact), "a tip in contact")
    process_id = rig.process_of(half)
    assert process_id is not None
    kill = Kill(half, time.time_ns())
    os.kill(process_id, EVENTS[event])
    if event == "SIGSTOP":
        time.sleep(1.0)
        os.kill(process_id, signal.SIGCONT)
    return kill


def safe_after_ms(rig: Rig, kill: Kill) -> float:
    """Return how long after a disturbance the device at the other site was safe, without what it stood still [ms]."""
    _, topic, mode = FAR[kill.node]
    states = [one.decode() for one in rig.recording().messages(topic, kill.at_ns - WATCHED_NS)]
    of_it = [state for state in states if kill.at_ns <= state.t_ns <= kill.at_ns + WATCHED_NS]
    safe = next(state for state in of_it if state.mode == mode)
    until = [state.t_ns for state in of_it if state.t_ns <= safe.t_ns]
    usual_ns = statistics.median(b - a for a, b in pairwise(until))
    stood_ns = sum(b - a - usual_ns for a, b in pairwise(until) if b - a > 5 * usual_ns)
    return (safe.t_ns - kill.at_ns - stood_ns) * 1e-6


def times_of(rig: Rig) -> Iterator[tuple[tuple[str, str], float]]:
    """Yield half and event of each disturbance, and after how long the device at the other site was safe [ms]."""
    rig.environment["PYTHONPATH"] = str(HANGS)
    rig.start("--duration", "900", "--set", CONSTANT_PUSH)
    rig.wait_until(rig.running, "a running session")
    for half in FAR:
        ends = 0
        for event, _ in itertools.product(EVENTS, range(ROUNDS)):
            kill = disturb(rig, half, event)
            if event == "SIGSTOP":
                arm(rig)
            else:
                ends += 1
                recover(rig, kill, ends)
            yield (half, event), safe_after_ms(rig, kill)
            # A node that dies again and again ends its rig.
            time.sleep(5.0)


@pytest.mark.timeout(900)
def test_the_other_site_is_safe_as_soon_as_with_a_process_a_node(tmp_path: Path) -> None:
    found: dict[str, dict[tuple[str, str], list[float]]] = {}
    for processes in ("node", "site"):
        (folder := tmp_path / processes).mkdir()
        with closing(Rig(folder, processes)) as rig:
            times = found[processes] = {}
            for case, after_ms in times_of(rig):
                times.setdefault(case, []).append(after_ms)
    medians = {way: {case: statistics.median(ms) for case, ms in times.items()} for way, times in found.items()}
    before, now = medians["node"], medians["site"]
    late = {case: (before[case], ms) for case, ms in now.items() if ms > before[case] + MORE_MS}
    assert not late, f"{late} of {found}"
