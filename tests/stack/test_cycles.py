"""A rig started and ended again and again, at any moment and in any way: nothing of it is left."""

import os
import random
import shutil
import signal
import time
from pathlib import Path

import pytest
from stack_rig import Rig

from telenano.recording.reader import Recording
from telenano.wire.errors import RecordingError

CYCLES = int(os.environ.get("TELENANO_CYCLES", "200"))
LONGEST_S = 10.0
PATIENCE_S = 60.0
WAYS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL, None)
# what a launcher that was killed has had to leave: the lock tells that it has ended, and the next rig takes both over
LEFT_BY_A_KILL = {"launcher@master", "launcher@master.lock", "rig@master.lock", "rig@master.json"}


def end(rig: Rig, way: signal.Signals | None, after_s: float) -> None:
    """End a rig in a way at a moment, or let it end by itself."""
    assert rig.process is not None
    if way is not None:
        signal.sigtimedwait((), after_s)
        if rig.process.poll() is None:
            rig.process.send_signal(way)
    rig.process.communicate(timeout=PATIENCE_S)
    begin = time.monotonic()
    while left := rig.process_ids():
        assert time.monotonic() - begin < PATIENCE_S, left
        signal.sigtimedwait((), 0.05)


@pytest.mark.endurance
@pytest.mark.timeout(7200)
def test_a_rig_that_is_started_and_ended_again_and_again_leaves_nothing(tmp_path: Path) -> None:
    draw = random.Random(13)
    before = set(Path("/dev/shm").iterdir())
    readable = by_itself = 0
    sockets: Path | None = None
    left: set[str] = set()
    for number in range(CYCLES):
        rig = Rig(tmp_path / str(number))
        rig.folder.mkdir()
        # each finds what the one before it left
        sockets = rig.sockets = sockets or rig.sockets
        rig.environment["TELENANO_RUNTIME_DIR"] = str(sockets)
        way, after_s = draw.choice(WAYS), draw.uniform(0.0, LONGEST_S)
        try:
            rig.start("--duration", "1.5")
            end(rig, way, after_s)
            by_itself += way is None
            found = {path.name for path in sockets.iterdir()} if sockets.exists() else set()
            # one that was ended before it began has not come to take anything over
            left = LEFT_BY_A_KILL if way is signal.SIGKILL else found & left
            assert found <= left, way
            for path in rig.out.glob("session*.mcap"):
                try:
                    Recording(path).info()
                    readable += 1
                except RecordingError as error:
                    # killed before the first byte was written
                    assert "is empty" in str(error) or "ends before its first record" in str(error), error
            assert not list(rig.out.glob("*.part"))
            assert way is not None or not found
        except BaseException:
            rig.close()
            raise
        shutil.rmtree(rig.folder)
    shutil.rmtree(sockets)
    # those that were ended by themselves at least
    assert readable >= by_itself
    ours = {name for name in set(Path("/dev/shm").iterdir()) - before if "telenano" in name.name}
    assert not ours
