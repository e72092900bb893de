"""Re-runs of the reference recordings: what may differ between machines, and what may not on one.

    python tests/replay/references.py FOLDER

prints, for each recording of a folder and each node, a digest of the bits of all that the node publishes when the
recording drives it. Neither BLAS nor our compiler may change it; only the C library may, where it has other
instructions.
"""

import hashlib
import json
import sys
from pathlib import Path

import studies  # noqa: F401 first: with it every step is compiled, unless NUMBA_DISABLE_JIT says otherwise
from analysis.process_replay import RerunResult, rerun
from proto import Message, encode
from recording.reader import Recording
from recording.tolerance import Tolerances

FOLDER = Path(__file__).resolve().parent
REFERENCES = sorted(FOLDER.glob("*.mcap"))
OUTPUTS = {
    "controller@master": ("teleop/forward", "haptic/command", "law/status"),
    "controller@slave": ("afm/command", "teleop/backward", "law/status"),
    "afm_node@slave": ("afm/state",),
    "haptic_node@master": ("haptic/state",),
}
# of the greatest value that a field has in the recording
SHARE = 1e-9


def tolerances(recording: Recording, node: str) -> Tolerances:
    """Give what the figures of a node may differ by on another machine than that of the recording."""
    limits: dict[str, float] = {}
    for message in recording.messages(OUTPUTS[node]):
        if message.src != node:
            continue
        for field, value in message.fields().items():
            for part in value if isinstance(value, tuple) else (value,):
                if isinstance(part, float):
                    name = f"{message.topic}:{field}"
                    limits[name] = max(limits.get(name, 0.0), SHARE * abs(part))
    return Tolerances(limits)


def rerun_digest(path: Path, node: str) -> tuple[RerunResult, str]:
    """Run a node again within the tolerances, and give the digest of what it publishes this time."""
    recording, digest = Recording(path), hashlib.sha256()

    def take(topic: str, message: Message) -> None:
        digest.update(topic.encode() + encode(message))

    return rerun(recording, node, tolerances(recording, node), take=take), digest.hexdigest()


def digests(folder: Path) -> dict[str, tuple[str, str]]:
    """Give what differs, and the digest, for each recording of a folder and each node."""
    found = {}
    for path in sorted(folder.glob("*.mcap")):
        for node in OUTPUTS:
            result, digest = rerun_digest(path, node)
            found[f"{path.stem} {node}"] = (result.difference, digest)
    return found


if __name__ == "__main__":
    sys.stdout.write(json.dumps(digests(Path(sys.argv[1]))))
