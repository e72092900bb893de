"""An emergency stop is the last word in a real rig: with processes stopped, and arms that waited for them.

The same in every order, and a device that is killed in its stop, are in virtual time, in
`tests/unit/runtime/test_runtime_estop_orders.py` and `tests/simulation`; a stop for an instrument that is being started
again is in `test_lost_paths.py`.
"""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from ledger import record
from stack_rig import BOTH_WAYS, Rig, arm, mode

TIP = "afm_node@slave"
# in which an arm that was not void would have been obeyed
WATCHED_S = 1.5


@pytest.fixture
def rig(shared_rig: Rig) -> Rig:
    return shared_rig


@contextmanager
def stopped(rig: Rig, node: str) -> Iterator[None]:
    process_id = rig.process_of(node)
    assert process_id is not None
    os.kill(process_id, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(process_id, signal.SIGCONT)


def states(rig: Rig, since_ns: int) -> list[Any]:
    """Give what was sent since then: what a stopped process had sent before may be received after it went on."""
    sent = [found.decode() for found in rig.recording().messages("afm/state", since_ns)]
    return sorted((state for state in sent if state.t_ns >= since_ns), key=lambda state: state.t_ns)


def stays_stopped(rig: Rig, since_ns: int) -> str:
    """Watch the tip for a while, and give how far it went towards the sample; it must not leave the stop."""
    rig.wait_until(lambda: mode(rig) == "estop", "the tip in emergency stop")
    time.sleep(WATCHED_S)
    until_ns = time.time_ns()
    rig.wait_until(lambda: rig.recording().messages("afm/state")[-1].publish_ns > until_ns, "what came of it")
    seen = states(rig, since_ns)
    first = next(place for place, state in enumerate(seen) if state.mode == "estop")
    assert {state.mode for state in seen[first:]} == {"estop"}
    base_m = [state.base_position_m[2] for state in seen[first:]]
    # towards the sample is down
    return f"{1e9 * (base_m[0] - min(base_m)):.1f} nm"


# `test_running_rig.py` has such an arm after the stop in `make test`, and virtual time has every order.
@BOTH_WAYS
@pytest.mark.check("stops a process of a rig for 3 s")
@pytest.mark.drawn(0.0, "telenano/runtime/", "telenano/console/", "services/afm_node/")
def test_an_arm_that_waits_at_a_stopped_instrument_is_void_after_a_stop(rig: Rig) -> None:
    begin_ns = time.time_ns()
    assert rig.telenano("estop").returncode == 0
    rig.wait_until(lambda: mode(rig) == "estop", "the emergency stop")
    pipes = {"env": rig.environment, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with stopped(rig, TIP):
        waiting: Any = subprocess.Popen(rig.command("session", "arm", "--target", "afm_node"), **pipes)
        time.sleep(2.0)
        stopping: Any = subprocess.Popen(rig.command("estop"), **pipes)
        time.sleep(1.2)
    out, err = stopping.communicate(timeout=60)
    assert stopping.returncode == 0, out + err
    out, err = waiting.communicate(timeout=60)
    assert waiting.returncode == 1, out + err
    assert "emergency stop" in err
    way = stays_stopped(rig, begin_ns)
    record(f"an arm at a stopped AFM, then an emergency stop{rig.way}", f"void; the tip approached by {way}")
    # who arms now means this stop
    arm(rig)


@BOTH_WAYS
def test_an_instrument_that_was_stopped_for_longer_than_the_stop_is_sent_comes_back_latched(rig: Rig) -> None:
    with stopped(rig, TIP):
        sent = rig.telenano("estop")
        assert sent.returncode == 1
        assert sent.stderr.startswith(
            f"telenano: {TIP} did not answer estop within 5 s: "
            "it will stop as soon as it continues or is started again; last seen "
        )
        time.sleep(1.0)
        begin_ns = time.time_ns()
    stays_stopped(rig, begin_ns)
    # what it had in hand when it was stopped, and the stall, come first
    (at_ns, *_) = (state.t_ns for state in states(rig, begin_ns) if state.mode == "estop")
    assert "follow" not in {state.mode for state in states(rig, begin_ns + 50_000_000)}
    took = f"in emergency stop {(at_ns - begin_ns) / 1e6:.0f} ms after it went on"
    record(f"an AFM stopped for longer than the emergency stop is sent{rig.way}", took)
    arm(rig)
