"""The wall clock is set by an hour in mid-session: whoever gives commands afterwards is obeyed, and so is a stop."""

import os
import signal
import subprocess
import time

import pytest
from ledger import record
from stack_rig import CONSTANT_PUSH, PATIENCE_S, Rig

from telenano.cli.exit_codes import EXIT_INCOMPLETE
from telenano.timing.clock import EPOCH_OFFSET_VARIABLE

HOUR_NS = 3600 * 10**9
ARM = ("session", "arm")
COMMANDS = (
    ("session", "mark", "label=set"),
    ("session", "set", "forward.delay_s=0.001", "--target", "delay_node@master"),
    ("estop",),
    ARM,
    ("session", "start"),
)


def is_to_be_given_again(done: subprocess.CompletedProcess[str]) -> bool:
    return "not armed: still_retracting" in done.stdout or "give it again to release the stop" in done.stderr


@pytest.mark.drawn(0.0, "telenano/timing/", "telenano/runtime/loop/")
def test_commands_of_processes_with_another_clock_are_obeyed(rig: Rig) -> None:
    rig.start("--duration", "300", "--set", CONSTANT_PUSH)
    rig.wait_until(rig.running, "a running session")
    # A process that starts after such a step reads this from the wall clock.
    own_ns = time.time_ns() - time.monotonic_ns()
    for step_ns in (HOUR_NS, -HOUR_NS):
        rig.environment[EPOCH_OFFSET_VARIABLE] = str(own_ns + step_ns)
        for words in COMMANDS:
            done = rig.telenano(*words)
            # The stop before it makes the tip withdraw, which takes its time whatever the clocks say. On a busy machine
            # a copy of it may come after an arm that follows at once, which is void then.
            again_until_s = time.monotonic() + PATIENCE_S
            while words == ARM and is_to_be_given_again(done) and time.monotonic() < again_until_s:
                time.sleep(0.1)
                done = rig.telenano(*words)
            assert done.returncode == 0, (step_ns, words, done.stdout, done.stderr)
    process_id = rig.process_of("afm_node@slave")
    assert process_id is not None
    os.kill(process_id, signal.SIGKILL)
    rig.wait_until(lambda: rig.log_has("launcher@master", "afm_node@slave was started again"), "the AFM's process")
    rig.wait_until(lambda: rig.telenano("session", "arm", "--target", "afm_node").returncode == 0, "an armed AFM")
    code, summary, err = rig.stop()
    # Of the process that was started again, all is missing that it sent before the recorder was connected.
    missing = summary["recording"]["missing"]
    assert code == (EXIT_INCOMPLETE if missing else 0), err + rig.logs()
    assert [text for text in missing if " of afm_node@slave on " not in text] == []
    assert summary["processes_ended"] == 1
    commands = f"{2 * len(COMMANDS)} commands and an arm of a node that was started again"
    record("the wall clock is set by an hour, forwards and back", f"{commands}: each obeyed; the recording is whole")
