"""Re-runs of the reference recordings: what may differ between machines, and what may not on one.

    python tests/replay/references.py

prints, for the beginning of each recording and each of its nodes, a digest of the bits of all that the node publishes
when the recording drives it. Neither BLAS nor our compiler may change it; only the C library may, where it has other
instructions.
"""

import hashlib
import json
import os
import sys
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import FunctionType

from in_memory import InMemory

from analysis.process_replay import RerunResult, rerun
from proto import Message, encode
from recording.reader import Recording
from recording.tolerance import Tolerances
from services.controller.config import LAWS
from services.numerics.compiled import compiled_form, is_step

FOLDER = Path(__file__).resolve().parent
REFERENCES = sorted(FOLDER.glob("*.mcap"))
LINK_REFERENCE, LINK_NODE = FOLDER / "link.mcap", "delay_node@master"
OUTPUTS = {
    "controller@master": ("teleop/forward", "haptic/command", "law/status"),
    "controller@slave": ("afm/command", "teleop/backward", "law/status"),
    "afm_node@slave": ("afm/state",),
    "haptic_node@master": ("haptic/state",),
    LINK_NODE: ("link/fates", "link/status"),
}
# The variable of the environment with which every step of the nodes is compiled.
COMPILED = "TELENANO_TEST_COMPILED"
# of the greatest value that a field has in the recording
SHARE = 1e-9
# shows all that the nodes do
SHORT_S = 1.3


class MachineTolerances(Tolerances):
    """What the figures of a node may differ by on another machine than that of the recording.

    They are found when a message differs for the first time: on the same machine none does.
    """

    def __init__(self, recording: Recording, node: str) -> None:
        super().__init__()
        self._recording, self._node = recording, node

    @cached_property
    def _allowed(self) -> Tolerances:
        # the link's figures are whole nanoseconds: one where a random delay falls between two of them
        limits = {"link/fates:fates.*_ns": 1.0, "link/status:*": 1e-9} if self._node == LINK_NODE else {}
        for message in self._recording.messages(OUTPUTS[self._node]):
            if message.src != self._node:
                continue
            for field, value in message.fields().items():
                for part in value if isinstance(value, tuple) else (value,):
                    if isinstance(part, float):
                        name = f"{message.topic}:{field}"
                        limits[name] = max(limits.get(name, 0.0), SHARE * abs(part))
        return Tolerances(limits)

    def on(self, topic: str) -> Tolerances:
        return self._allowed.on(topic)


def nodes_of(path: Path) -> tuple[str, ...]:
    """Return the nodes that a recording is a reference for."""
    return (LINK_NODE,) if path == LINK_REFERENCE else tuple(node for node in OUTPUTS if node != LINK_NODE)


def rerun_digests(recording: Recording, node: str) -> tuple[RerunResult, list[str]]:
    """Run a node again within the tolerances; return also the digest of all that it published so far, each time."""
    digest, digests = hashlib.sha256(), []

    def take(topic: str, message: Message) -> None:
        digest.update(topic.encode() + encode(message))
        digests.append(digest.hexdigest())

    return rerun(recording, node, MachineTolerances(recording, node), take=take), digests


def digests_of_beginnings() -> dict[str, tuple[str, int, str]]:
    """Return what differs, the count of outputs and their digest, for the beginning of each recording and each node."""
    found = {}
    for path in REFERENCES:
        recording = InMemory(path, SHORT_S)
        for node in nodes_of(path):
            result, digests = rerun_digests(recording, node)
            found[f"{path.stem} {node}"] = (result.difference, len(digests), digests[-1])
    return found


def compile_every_step() -> None:
    """Put the compiled form in the place of every step that the nodes call as plain Python."""
    for name, law in LAWS.items():
        LAWS[name] = replace(
            law, **{key: compiled_form(value) for key, value in vars(law).items() if callable(value) and is_step(value)}
        )
    for module in [found for name, found in sys.modules.items() if name.startswith("services.")]:
        for name, value in list(vars(module).items()):
            if isinstance(value, FunctionType) and is_step(value):
                setattr(module, name, compiled_form(value))


if __name__ == "__main__":
    if COMPILED in os.environ:
        compile_every_step()
    sys.stdout.write(json.dumps(digests_of_beginnings()))
