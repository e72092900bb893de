"""Nodes killed, ended and stopped in a session: figure and summary of every part, and no gap that is none."""

import os
import signal
import sys
import time
from collections import Counter
from typing import Any

import pytest
from stack_rig import Rig
from storm import HAND, RECORDER, check_gaps, check_parts, disturb, parts, plan, start_of, steps, verdicts_of

KILL, TERM, STOP = signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP
KILLS = int(os.environ.get("TELENANO_STORM_KILLS", "60"))
SEED = int(os.environ.get("TELENANO_STORM_SEED", "25"))


@pytest.mark.endurance
def test_a_recorder_that_was_ended_a_hand_that_stood_still_and_one_that_was_killed_leave_one_session(rig: Rig) -> None:
    rig.start("--duration", "600", "--set", steps(60.0))
    rig.wait_until(rig.running, "a running session")
    begun_s = time.monotonic()
    for node, number, stop_s in ((RECORDER, TERM, 0.0), (HAND, STOP, 2.0), (HAND, KILL, 0.0)):
        disturb(rig, node, number, stop_s)
    lasted_s = time.monotonic() - begun_s
    code, summary, err = rig.stop()
    # the parts and what is missing between them are stated
    assert code == 3, err
    assert "Traceback" not in err
    assert len(parts(rig)) == 2
    check_parts(rig, summary)
    check_gaps(parts(rig))
    # from the start of the programme on, and not from one of the faults
    assert summary["duration_s"] > lasted_s - 0.5


@pytest.mark.endurance
@pytest.mark.timeout(3600)
def test_a_storm_of_kills_leaves_every_part_in_the_figure_and_no_false_gap(rig: Rig, capsys: Any) -> None:
    rig.start("--duration", "3600", "--set", steps(900.0))
    rig.wait_until(rig.running, "a running session")
    disturbances = []
    for node, number, pause_s in plan(SEED, [KILL, TERM] * KILLS):
        signal.sigtimedwait((), pause_s)
        disturbances.append(disturb(rig, node, number))
    code, summary, err = rig.stop()
    assert "Traceback" not in err
    assert code == 3, err
    check_parts(rig, summary)
    missing = check_gaps(parts(rig))
    quiet, hit = verdicts_of(summary, start_of(parts(rig)), disturbances)
    pauses = sorted(part["pause_s"] for part in summary["recording"]["parts"][1:])
    counts = Counter((one.node, signal.Signals(one.number).name) for one in disturbances)
    lines = (
        f"signals: {dict(counts)}",
        f"parts: {len(parts(rig))}, pauses between them [s]: {pauses}; recorded as missing within them: {missing}",
        f"verdicts: undisturbed {quiet}, disturbed {hit}; session of {summary['duration_s']} s",
    )
    with capsys.disabled():
        sys.stderr.write("\n" + "\n".join(lines) + "\n")
    assert summary["duration_s"] > sum(one.end_ns - one.begin_ns for one in disturbances) * 1e-9
    # a hold that no kill touched has data throughout
    assert quiet
    assert "no_data" not in quiet
