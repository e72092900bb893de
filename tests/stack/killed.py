"""Recorders beside a running rig, killed at random moments: each file opens and lacks only what came after a flush."""

import random
import subprocess
import time
from pathlib import Path

import machine
from stack_rig import Rig

from telenano.recording.reader import Recording
from telenano.wire.errors import RecordingError

NS_PER_S = 1_000_000_000
TURN_NS = 5_000_000
FLUSH_NS = NS_PER_S // 5
SLACK_NS = 3 * NS_PER_S // 10


def slept(duration_s: float) -> int:
    """Sleep in short turns; return by how much the latest of them came late, as a recorder beside it may have [ns]."""
    end_ns, worst_ns = time.monotonic_ns() + round(duration_s * NS_PER_S), 0
    while (began_ns := time.monotonic_ns()) < end_ns:
        time.sleep(TURN_NS / NS_PER_S)
        worst_ns = max(worst_ns, time.monotonic_ns() - began_ns - TURN_NS)
    return worst_ns


def has_messages(path: Path) -> bool:
    """Return whether messages were flushed to a recording; what stands before them is longer with every package."""
    try:
        return path.exists() and any(True for _ in Recording(path).messages())
    except RecordingError:
        return False


def kill_recorders(rig: Rig, kills: int) -> list[tuple[Path, int, int]]:
    """Start recorders beside a running rig, one after the other, and kill each.

    Return its file, the time of the kill, and how late a process of the same priority was before it [ns].
    """
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
        rig.wait_until(lambda path=path: has_messages(path), "a flushed recording")
        late_ns = slept(draw.uniform(0.1, 0.8))  # the moment of the kill is what is drawn
        recorder.kill()
        killed.append((path, time.time_ns(), late_ns))
        recorder.wait()
    return killed


def check_killed(rig: Rig, killed: list[tuple[Path, int, int]]) -> None:
    """Assert of each file that it opens and what it lacks, against the recording of the rig's own recorder."""
    last_ns = killed[-1][1]
    rig.wait_until(
        lambda: rig.recording().messages("haptic/state")[-1].publish_ns > last_ns, "the time of the last kill recorded"
    )
    for path, killed_ns, late_ns in killed:
        recording = Recording(path)
        assert not recording.closed
        # how far behind the bus the rig's own recorder was then: the machine had no more for either
        around = rig.recording().messages("haptic/state", killed_ns - 2 * NS_PER_S)
        lags = [m.log_ns - m.publish_ns for m in around if m.publish_ns < killed_ns + NS_PER_S]
        behind = max([late_ns, *lags])
        if behind > FLUSH_NS:
            machine.note(f"recorders were {behind * 1e-9:.2f} s behind when {path.stem} was killed")
        assert killed_ns - max(message.log_ns for message in recording.messages()) < FLUSH_NS + SLACK_NS + 2 * behind
    verified = rig.telenano("bag", "verify", str(killed[0][0]))
    assert verified.returncode == 1
    assert "the file was not closed" in verified.stdout
