"""kill -9 of a recorder at random moments: every file opens, and lacks no more than what came after the last flush."""

import random
import subprocess
import time
from typing import Any

import machine
import pytest

from services.recorder.reader import Recording

NS_PER_S = 1_000_000_000
FLUSH_NS = NS_PER_S // 5
SLACK_NS = 3 * NS_PER_S // 10


def behind_ns(recording: Recording, at_ns: int) -> int:
    """Give how far behind the bus the rig's own recorder was around a time [ns]: the machine had no more for either."""
    around = recording.messages(["haptic/state"], at_ns - 2 * NS_PER_S, at_ns + NS_PER_S)
    return max((message.log_ns - message.publish_ns for message in around), default=0)


@pytest.mark.parametrize("kills", [8, pytest.param(20, marks=pytest.mark.endurance)])
def test_killed_recordings_are_readable_and_lose_no_more_than_a_flush(rig: Any, kills: int) -> None:
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    draw = random.Random(4)
    killed = []
    for number in range(kills):
        path = rig.folder / f"killed{number}.mcap"
        recorder = subprocess.Popen(
            rig.command("record", "--out", str(path)),
            env=rig.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        rig.wait_until(lambda path=path: path.exists() and path.stat().st_size > 4000, "a flushed recording")
        time.sleep(draw.uniform(0.1, 0.8))  # the moment of the kill is what is drawn
        recorder.kill()
        killed.append((path, time.time_ns()))
        recorder.wait()
    code, _, err = rig.stop()
    assert code == 0, err
    undisturbed = Recording(rig.out / "session.mcap")
    for path, killed_ns in killed:
        recording = Recording(path)
        assert not recording.complete
        behind = behind_ns(undisturbed, killed_ns)
        if behind > FLUSH_NS:
            machine.note(f"the rig's own recorder was {behind * 1e-9:.2f} s behind when {path.stem} was killed")
        assert killed_ns - max(message.log_ns for message in recording.messages()) < FLUSH_NS + SLACK_NS + 2 * behind
    verified = rig.tell("bag", "verify", str(killed[0][0]))
    assert verified.returncode == 1
    assert "the file was not closed" in verified.stdout
