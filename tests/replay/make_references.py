"""Make the reference recordings of this folder anew, one a law, with a rig on this machine.

    python tests/replay/make_references.py [LAW ...]

To be run when the wire changes, or when a law is meant to behave differently; a re-run that differs for any other
reason is what the recordings are there to find.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from recording.channel_filter import Selection
from recording.reader import Recording
from recording.rewrite import filter_recording
from services.controller.config import LAWS

FOLDER = Path(__file__).resolve().parent
DURATION_S = 1.1
# all inputs and outputs of a node with a journal
TOPICS = ("haptic/*", "teleop/*", "afm/*", "law/*", "clock/*", "session/control*", "session/event", "node/journal")
# every message of the link twice, and the delay that a law has to bear
DELAY_MS = "4"
# more than a batch of the journal, at whose beginning a re-run starts
BEFORE_S = 0.6


def make(law: str) -> Path:
    """Record a session under a law and keep what a re-run needs."""
    target = FOLDER / f"{law}.mcap"
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(Path(folder) / "run")}
        setting = f"controller.law={law}"
        command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--set", setting]
        options = ["--delay-ms", DELAY_MS, "--duration", str(DURATION_S), "--out", str(Path(folder) / "out"), "--json"]
        subprocess.run([*command, *options], env=environment, check=True, stdout=subprocess.DEVNULL)
        target.unlink(missing_ok=True)
        source = Path(folder) / "out" / "session.mcap"
        # the long rest before the devices are armed proves nothing
        recording = Recording(source)
        armed_ns = next(recording.messages(["session/control"])).log_ns
        start_s = max(0.0, (armed_ns - recording.span_ns[0]) * 1e-9 - BEFORE_S)
        filter_recording(source, target, Selection.of(TOPICS), start_s)
    return target


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Make the reference recordings anew.")
    parser.add_argument("laws", nargs="*", metavar="LAW", help=f"any of {', '.join(LAWS)}; default: all of them")
    for name in parser.parse_args().laws or LAWS:
        path = make(name)
        sys.stdout.write(f"{path} {path.stat().st_size} bytes\n")
