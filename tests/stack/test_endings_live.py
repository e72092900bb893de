"""Processes of a real rig end in order or are killed, and come back: its recording tells exactly what it lacks.

`tests/unit/recorder/test_endings.py` has the whole table, in virtual time.
"""

import os
import signal

import pytest
import told_and_counted
from stack_rig import BOTH_WAYS, Rig, wait_for_the_recorder

from telenano.recording.multi_file import open_recordings

HAND, TIP, LINK, LINK_AT_SLAVE = "haptic_node@master", "afm_node@slave", "delay_node@master", "delay_node@slave"
ENDINGS = ((LINK, signal.SIGTERM), (TIP, signal.SIGKILL), (HAND, signal.SIGTERM))


@pytest.mark.check("takes 25 s")
@BOTH_WAYS
def test_what_is_missing_when_processes_end_and_come_back_is_told(rig: Rig) -> None:
    rig.start("--duration", "600", rate=("--set", "realtime.rate_hz=100"))
    rig.wait_until(rig.running, "a running session")
    for node, how in ENDINGS:
        before = rig.process_of(node)
        assert before is not None
        os.kill(before, how)
        rig.wait_until(lambda node=node, before=before: rig.process_of(node) not in (None, before), f"{node} again")
        wait_for_the_recorder(rig)
    rig.stop()
    (path,) = rig.out.glob("session*.mcap")
    assert told_and_counted.check(path) == []
    channels = open_recordings([path]).info().channels
    counted = told_and_counted.lacking(path)
    assert {(one.channel_topic, one.src): one.lost for one in channels if one.lost} == counted
    # The link was away, and carried nothing of what was sent then.
    assert counted["node/health@master", "controller@slave"] > 0
    ended = {LINK_AT_SLAVE, *(mate for node, _ in ENDINGS for mate in rig.mates_of(node))}
    assert {one.src for one in channels if one.restarts and not one.src.startswith("console")} == ended
