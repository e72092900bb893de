"""What the input journal takes from a node: an entry for each turn, and a batch with the state of the node.

    python benchmarks/journal.py [LAW]

Each figure stands beside the decoding of one message of the same run, which every input costs anyway. All of it comes
after the turn's outputs were sent; the batch comes twice a second, with node/health.
"""

import sys
import timeit
from types import SimpleNamespace
from typing import Any

from proto import TOPICS, decode, encode
from proto.contract import examples
from proto.sequence import Arrival
from services.controller.config import ControllerConfig
from services.controller.node import MasterController
from services.runtime.bus import Received
from services.runtime.clock import SystemClock
from services.runtime.journal import InputJournal
from services.runtime.log import StructuredLog
from services.runtime.node import NodeContext

TURNS = 1000
REPEATS = 50


class _NullBus(SimpleNamespace):
    """Builds and encodes what is published, and sends nothing."""

    def publish(self, topic: str, **fields: Any) -> Any:
        model = TOPICS[topic].model
        message = model(seq=0, t_ns=1, src="controller@master", v=model.version, **fields)
        encode(message)
        return message


def main(law: str) -> None:
    """Measure and print."""
    bus: Any = _NullBus()
    node = MasterController(
        NodeContext("controller@master", SystemClock(), bus, StructuredLog("controller@master")),
        ControllerConfig.model_validate({"law": law}),
    )
    journal = InputJournal(node, lambda: {"teleop/forward": 1, "haptic/command": 1})
    message = examples(TOPICS["haptic/state"])["ordinary"]
    payload = encode(message)
    received = Received("haptic/state", message, payload, 10**18, Arrival.NEXT)
    node.on_message(received)

    def turns() -> None:
        for _ in range(TURNS):
            journal.clock.time_ns = received.received_ns
            journal.record_message(received, executed=False)

    def batch() -> None:
        turns()
        journal.publish()

    decoding_s = _best(lambda: [decode("haptic/state", payload) for _ in range(TURNS)]) / TURNS
    entries_s = min(_timed(turns, journal) for _ in range(REPEATS))
    batch_s = _best(batch) - entries_s
    for name, figure_s in (("entry of a turn", entries_s / TURNS), (f"batch of {TURNS} turns", batch_s)):
        sys.stdout.write(f"{name}: {figure_s * 1e6:.2f} us, {figure_s / decoding_s:.2f} decodings of a haptic/state\n")


def _timed(turns: Any, journal: InputJournal) -> float:
    taken_s = timeit.timeit(turns, number=1)
    journal.publish()
    return taken_s


def _best(run: Any) -> float:
    return min(timeit.repeat(run, number=1, repeat=REPEATS))


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "virtual_impedance")
