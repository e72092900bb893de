"""Make the reference recordings of this folder anew, one a law and one for the link, with a rig on this machine.

    python tests/replay/make_references.py [LAW ...] [link]

To be run when the wire changes, or when a law or the link is meant to behave differently; a re-run that differs for any
other reason is what the recordings are there to find.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from references import FOLDER, LINK_NODE, LINK_REFERENCE, OUTPUTS, nodes_of

from recording.channel_filter import Selection
from recording.reader import Recording
from recording.rewrite import filter_recording
from services.controller.config import LAWS

DURATION_S = 1.1
# more than a batch of the journal, at whose beginning a re-run starts
BEFORE_S = 0.6
# all inputs and outputs of the nodes with a journal
TOPICS = {
    node: (
        "haptic/*", "teleop/*", "afm/*", "law/*", "link/delay*", "clock/*", "session/control*", "session/event",
        "node/journal",
    )
    for node in OUTPUTS
}  # fmt: skip
TOPICS[LINK_NODE] = (
    "teleop/*", "law/*", "clock/*", "session/*", "node/health*", "link/*", "node/journal", "recorder/rejected"
)  # fmt: skip
# every message of the link twice, and the delay that a law has to bear
LAW_LINK = {"delay_s": 0.004}
# all that is random in a link; what is damaged are figures that no device acts on
FORWARD = {
    "delay_s": 0.004,
    "jitter": {"scale_s": 0.001, "distribution": "pareto_normal", "correlation": 0.9},
    "gilbert_elliott": {"p": 0.01, "r": 0.3},
    "order": "topic",
    "rate": {"rate_bytes_per_s": 400_000.0, "overhead_bytes": 54},
    "queue": {"limit_messages": 5, "drop": "random"},
}
BACKWARD = {
    "delay_s": 0.003,
    "jitter": {"scale_s": 0.001},
    "loss": {"probability": 0.02, "correlation": 0.5},
    "duplication": {"probability": 0.03},
    "reordering": {"probability": 0.02, "gap": 3},
    "topics": {"law/*": {"corruption": {"probability": 0.3, "bits": 4}}},
}


@dataclass(frozen=True)
class _Kept(Selection):
    """A selection that has the journals of some nodes only."""

    journals: tuple[str, ...] = ()

    def __call__(self, channel: Any) -> bool:
        return super().__call__(channel) and (channel.channel_topic != "node/journal" or channel.src in self.journals)


def make(name: str) -> Path:
    """Record a session and keep what a re-run of its nodes needs."""
    target = FOLDER / f"{name}.mcap"
    link, nodes = target == LINK_REFERENCE, nodes_of(target)
    settings = {
        "controller.law": "virtual_impedance" if link else name,
        "delay_node.forward": FORWARD if link else LAW_LINK,
        "delay_node.backward": BACKWARD if link else LAW_LINK,
    }
    with tempfile.TemporaryDirectory() as folder:
        source = record(Path(folder), [f"{key}={json.dumps(value)}" for key, value in settings.items()])
        target.unlink(missing_ok=True)
        # the long rest before the devices are armed proves nothing
        recording = Recording(source)
        armed_ns = next(recording.messages(["session/control"])).log_ns
        start_s = max(0.0, (armed_ns - recording.span_ns[0]) * 1e-9 - BEFORE_S)
        chosen = Selection.of(TOPICS[nodes[0]])
        filter_recording(source, target, _Kept(chosen.topics, journals=nodes), start_s)
    return target


def record(folder: Path, settings: Sequence[str]) -> Path:
    """Record a session of a rig."""
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(folder / "run")}
    command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12"]
    command += [part for setting in settings for part in ("--set", setting)]
    command += ["--duration", str(DURATION_S), "--out", str(folder / "out"), "--json"]
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
    return folder / "out" / "session.mcap"


if __name__ == "__main__":
    known = (*LAWS, LINK_REFERENCE.stem)
    parser = argparse.ArgumentParser(description="Make the reference recordings anew.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"any of {', '.join(known)}; default: all of them")
    for name in parser.parse_args().names or known:
        path = make(name)
        sys.stdout.write(f"{path} {path.stat().st_size} bytes\n")
