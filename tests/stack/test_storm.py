"""Nodes killed, ended and stopped in a session: figure and summary of every part, and no gap that is none."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stack_rig import PATIENCE_S, Rig
from storm import HAND, NODES, RECORDER, check_gaps, check_parts, disturb, parts, plan, start_of, steps, verdicts_of

from telenano.recording.reader import Recording
from telenano.sections.afm_parts import SafetyConfig

KILL, TERM, STOP = signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP
KILLS = int(os.environ.get("TELENANO_STORM_KILLS", "60"))
SEED = int(os.environ.get("TELENANO_STORM_SEED", "25"))
# how often a rig is ended by SIGTERM at all processes, and how long each may take [s]
TERM_STORMS, STORM_S = 10, 60.0
# how often each node is killed while hand and tip are coupled again
COUPLINGS = 2
# a hand that lies on its device and presses nothing
AT_REST = "haptic_node.operator.points=[{time_s: 0.2, force_n: 0.0}]"
# where the tip is of a hand at rest, each time anew [m]
SAME_PLACE_M, STOOD = 1e-9, 250
# how fast the tip may go at most, and how much later than its time a step may be
SPEED_M_PER_S, LATE_S = SafetyConfig().base_speed_m_per_s, 4e-3


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


@pytest.mark.endurance
@pytest.mark.timeout(1800)
def test_sigterm_at_every_process_again_and_again_ends_a_rig_with_a_whole_recording(tmp_path: Path) -> None:
    """A machine that is shut down tells all processes at once to end, and a person who waits tells them again."""
    draw = random.Random(SEED)
    for number in range(TERM_STORMS):
        with closing(Rig(tmp_path / str(number))) as rig:
            rig.folder.mkdir()
            rig.start("--duration", "60")
            rig.wait_until(rig.running, "a running session")
            signal.sigtimedwait((), draw.uniform(0.5, 4.0))
            begin_s = time.monotonic()
            while left := rig.process_ids():
                assert time.monotonic() - begin_s < STORM_S, (left, rig.logs())
                for process_id in draw.sample(left, len(left)):
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(process_id, TERM)
                signal.sigtimedwait((), draw.uniform(0.0, 0.2))
            assert rig.process is not None
            _, err = rig.process.communicate(timeout=STORM_S)
            assert "Traceback" not in err + rig.logs(), err + rig.logs()
            recorded = Recording(rig.out / "session.mcap")
            assert recorded.info().closed, f"{rig.out}: the recorder did not end its file"
            # the second signal ends the report, and the way to make it is said
            assert rig.process.returncode in (-TERM, 128 + TERM), (rig.process.returncode, err)
            assert "telenano report" in err, err
            assert not list(rig.out.glob("*.part"))


@pytest.mark.endurance
@pytest.mark.timeout(1800)
def test_coupling_anew_while_nodes_are_killed_moves_the_tip_by_no_jump(rig: Rig) -> None:
    rig.start("--duration", "1800", "--set", AT_REST)
    rig.wait_until(rig.running, "a running session")
    draw = random.Random(SEED)
    answered = 0
    for node in [node for node in NODES if node != RECORDER] * COUPLINGS:
        command = rig.command("session", "couple")
        couple = subprocess.Popen(
            command, env=rig.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        signal.sigtimedwait((), draw.uniform(0.2, 1.5))
        disturb(rig, node, KILL)
        out, err = couple.communicate(timeout=PATIENCE_S)
        assert couple.returncode in (0, 1), (node, couple.returncode, out, err)
        assert "Traceback" not in err
        # it says what became of it
        assert (out + err).strip(), node
        answered += couple.returncode == 0
    rig.wait_until(lambda: rig.telenano("session", "couple").returncode == 0, "hand and tip that are coupled anew")
    _, summary, err = rig.stop()
    assert "Traceback" not in err
    check_parts(rig, summary)
    states = [message.fields() for message in Recording(rig.out / "session.mcap").messages(["afm/state"])]
    pairs = [
        (before, after)
        for before, after in pairwise(states)
        if before["mode"] == after["mode"] == "follow" and after["seq"] == before["seq"] + 1
    ]
    following = [
        (after["base_position_m"][2] - before["base_position_m"][2], 1e-9 * (after["t_ns"] - before["t_ns"]))
        for before, after in pairs
    ]
    following_m = [after["base_position_m"][2] for _, after in pairs]
    assert len(following) > 1000
    # no faster than the tip may go in any case; a step that came late makes up for it in the next one
    assert max(abs(moved_m) - SPEED_M_PER_S * (dt_s + LATE_S) for moved_m, dt_s in following) < 0.0, answered
    # and each time back to where a hand at rest holds it
    stood_m = [state["base_position_m"][2] for state in states if state["mode"] == "follow"][-STOOD:]
    far = [
        number
        for number, (moved_m, _) in enumerate(following)
        if abs(moved_m) < SAME_PLACE_M / STOOD and abs(following_m[number] - stood_m[-1]) > SAME_PLACE_M
    ]
    assert np.ptp(stood_m) < SAME_PLACE_M, stood_m
    # where it stands anywhere else, it is on its way
    assert len(far) < STOOD, [following_m[number] for number in far]
