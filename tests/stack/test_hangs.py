"""A live node that spins is killed and started again within seconds; one that is stopped keeps its process."""

import os
import signal
import time
from pathlib import Path

import pytest
from ledger import record
from stack_rig import BOTH_WAYS, Rig

from telenano.wire.nodes import START_ORDER

pytestmark = pytest.mark.stack
HANGS = Path(__file__).parents[1] / "fuzz" / "hang_on_signal"
SPUN, STOPPED = "controller@slave", "afm_node@slave"


@pytest.fixture
def rig(rig: Rig) -> Rig:
    rig.environment["PYTHONPATH"] = str(HANGS)
    return rig


def processes(rig: Rig) -> dict[str, int | None]:
    return {node: rig.process_of(node) for node in START_ORDER}


@BOTH_WAYS
def test_a_node_that_spins_is_started_again_and_one_that_is_stopped_is_left_alone(rig: Rig) -> None:
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    before = processes(rig)
    stopped = before[STOPPED]
    assert stopped is not None
    os.kill(stopped, signal.SIGSTOP)
    rig.wait_until(lambda: rig.log_has("launcher@master", f"{STOPPED} has not reported for"), "a reported stop")
    os.kill(stopped, signal.SIGCONT)
    rig.wait_until(lambda: rig.log_has("launcher@master", f"{STOPPED} reports again after"), "the end of the stop")
    assert processes(rig) == before
    spun = before[SPUN]
    assert spun is not None
    begun = time.monotonic()
    os.kill(spun, signal.SIGUSR1)
    rig.wait_until(lambda: rig.log_has("launcher@master", f"{SPUN} was started again"), "a restart")
    took_s = time.monotonic() - begun
    rig.wait_until(lambda: rig.process_of(SPUN) not in (None, spun), "the new process")
    after = processes(rig)
    mates = rig.mates_of(SPUN)
    assert {node: pid for node, pid in after.items() if node not in mates} == {
        node: pid for node, pid in before.items() if node not in mates
    }
    assert len({after[node] for node in mates}) == 1
    for node in mates:
        rig.wait_until(lambda node=node: rig.log_has("launcher@master", f"{node} was started again"), f"{node} again")
    # whoever is the first: the kernel, at a limit of the process's own, or the launcher
    ended = (f"{SPUN} hung: it computed", f"{SPUN} hung: a turn took", "it hangs and is killed")
    assert any(rig.log_has("launcher@master", text) for text in ended)
    code, _, err = rig.stop()
    # what the killed process had in hand is lost, and the recording says so
    assert code in (0, 1, 3), err
    assert "Traceback" not in err
    way = " in a process of several" if rig.processes == "site" else ""
    record(f"a node that spins{way}", f"killed and started again {took_s:.1f} s after it began to spin")


@pytest.mark.endurance
@BOTH_WAYS
@pytest.mark.parametrize("duration_s", [3.0, 10.0])
def test_every_node_that_is_stopped_keeps_its_process(rig: Rig, duration_s: float) -> None:
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    before = processes(rig)
    for node, process_id in before.items():
        assert process_id is not None
        os.kill(process_id, signal.SIGSTOP)
        time.sleep(duration_s)
        os.kill(process_id, signal.SIGCONT)
        text = f"{node} reports again after"
        rig.wait_until(lambda text=text: rig.log_has("launcher@master", text), f"{node} after its stop")
    time.sleep(3.0)
    assert processes(rig) == before
    assert not rig.log_has("launcher@master", "it hangs and is killed")
    rig.stop()
