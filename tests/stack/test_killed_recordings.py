"""kill -9 of a recorder at random moments: every file opens, and lacks no more than what came after the last flush."""

import random
import subprocess
import time
from typing import Any

from services.recorder.reader import Recording

KILLS = 20
# the recorder flushes every 200 ms; beyond it lies what a busy machine takes to run the recorder at all
LONGEST_LOSS_NS = 200_000_000 + 500_000_000


def test_twenty_killed_recordings_are_readable_and_lose_no_more_than_a_flush(rig: Any) -> None:
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    draw = random.Random(4)
    killed = []
    for number in range(KILLS):
        path = rig.folder / f"killed{number}.mcap"
        recorder = subprocess.Popen(
            rig.command("record", "--out", str(path)),
            env=rig.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        rig.wait_until(lambda path=path: path.exists() and path.stat().st_size > 4000, "a flushed recording")
        time.sleep(draw.uniform(0.1, 1.5))  # the moment of the kill is what is drawn
        recorder.kill()
        killed.append((path, time.time_ns()))
        recorder.wait()
    code, _, err = rig.stop()
    assert code == 0, err
    for path, killed_ns in killed:
        recording = Recording(path)
        assert not recording.complete
        assert killed_ns - max(message.log_ns for message in recording.messages()) < LONGEST_LOSS_NS
    verified = rig.tell("bag", "verify", str(killed[0][0]))
    assert verified.returncode == 1
    assert "the file was not closed" in verified.stdout
