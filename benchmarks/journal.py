"""What the input journal takes from a node: an entry for each turn, and a batch with the state of the node.

    python benchmarks/journal.py [LAW]

Each figure stands beside the decoding of one message of the same run, which every input costs anyway. All of it comes
after the turn's outputs were sent; the batch comes twice a second, with node/health.

The link handles the most messages. It runs here in its own loop on its own sockets, with a journal and without, on the
same messages at the rate of a rig, a hundredth of a second at a time: the ratio is that of the processor time of its
thread. In a rig each message has to wake it as well, so that the ratio there is lower.
"""

import argparse
import sys
import tempfile
import time
import timeit
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import zmq

from proto import TOPICS, decode, encode
from proto.contract import examples
from proto.sequence import Arrival
from services.controller.config import ControllerConfig
from services.controller.node import MasterController
from services.delay_node.config import parse_settings
from services.delay_node.node import DelayNode
from services.runtime.bus.bus import Received, Subscriber, ZmqBus
from services.runtime.bus.publisher import ZmqPublisher
from services.runtime.loop.clock import SystemClock
from services.runtime.loop.journal import InputJournal
from services.runtime.loop.log import StructuredLog
from services.runtime.loop.node import NodeContext, NodeLoop
from services.runtime.loop.realtime import RealtimeStatus

TURNS = 1000
REPEATS = 50
# of a rig: signals at 1 kHz each way, the law's status at 100 Hz
SECOND = (("teleop/forward", "controller@master", 1000), ("teleop/backward", "controller@slave", 1000))
SECOND += (("law/status", "controller@slave", 100),)
LINKS: dict[str, dict[str, Any]] = {
    "plain": {},
    "constant 4 ms": {"forward": {"delay_s": 0.004}, "backward": {"delay_s": 0.004}},
    "lte": {"profile": "lte"},
    "satellite": {"profile": "satellite"},
}
SLICES = 100
ROUNDS = 8


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
        journal.complete()
        journal.publish()

    decoding_s = _best(lambda: [decode("haptic/state", payload) for _ in range(TURNS)]) / TURNS
    entries_s = min(_timed(turns, journal) for _ in range(REPEATS))
    batch_s = _best(batch) - entries_s
    for name, figure_s in (("entry of a turn", entries_s / TURNS), (f"batch of {TURNS} turns", batch_s)):
        sys.stdout.write(f"{name}: {figure_s * 1e6:.2f} us, {figure_s / decoding_s:.2f} decodings of a haptic/state\n")


class LinkBench:
    """Two links on sockets of their own that receive the same messages: one keeps a journal, the other does not."""

    def __init__(self, folder: Path, settings: dict[str, Any]) -> None:
        self._context = zmq.Context[zmq.Socket[bytes]]()
        self._clock = SystemClock()
        self._handled = 0
        self._first = False
        sources = {topic: f"ipc://{folder}/{src}" for topic, src, _ in SECOND}
        self._feeders = {
            src: ZmqPublisher(self._context, self._clock, src, f"ipc://{folder}/{src}")
            for src in sorted({src for _, src, _ in SECOND})
        }
        self._sockets: list[Any] = list(self._feeders.values())
        plan: dict[str, list[str]] = {}
        for topic, endpoint in sources.items():
            plan.setdefault(endpoint, []).append(topic)
        self.loops: dict[bool, NodeLoop] = {}
        self._readers: list[Subscriber] = []
        for journalled in (True, False):
            kind = type("Link", (DelayNode,), {"journalled": journalled})
            endpoints = [f"ipc://{folder}/link{int(journalled)}@{site}" for site in ("master", "slave")]
            to_master, to_slave = (
                ZmqPublisher(self._context, self._clock, f"delay_node@{endpoint.rpartition('@')[2]}", endpoint)
                for endpoint in endpoints
            )
            inputs = Subscriber(self._context, self._clock, plan)
            bus = ZmqBus(to_master, [inputs], self._clock, inputs.descriptor)
            context = NodeContext("delay_node@master", self._clock, bus, StructuredLog("delay_node@master"))
            node = kind(context, parse_settings(settings), to_slave, to_master, Path())
            self.loops[journalled] = NodeLoop(node, bus, RealtimeStatus(fifo=False, memory_locked=False))
            reader = Subscriber(self._context, self._clock, {endpoint: list(TOPICS) for endpoint in endpoints})
            self._readers.append(reader)
            self._sockets += [to_master, to_slave, inputs, reader]
        time.sleep(0.3)

    def second(self) -> dict[bool, float]:
        """Let both links handle a second of a rig; return the processor time of each [s]."""
        taken_s = dict.fromkeys(self.loops, 0.0)
        fields = {
            topic: examples(TOPICS[topic])["ordinary"].model_dump(exclude={"seq", "t_ns", "src", "v"})
            for topic, _, _ in SECOND
        }
        due_ns = self._clock.monotonic_ns()
        for _ in range(SLICES):
            for topic, src, count in SECOND:
                for _ in range(count // SLICES):
                    self._feeders[src].publish(topic, **fields[topic])
            self._handled += sum(count // SLICES for _, _, count in SECOND)
            due_ns += 10**9 // SLICES
            time.sleep(max(0, due_ns - self._clock.monotonic_ns()) * 1e-9)
            self._first = not self._first
            for journalled in (self._first, not self._first):
                taken_s[journalled] += self._catch_up(journalled)
        for reader in self._readers:
            while any(True for _ in reader.receive_raw()):
                pass
        return taken_s

    def _catch_up(self, journalled: bool) -> float:
        loop = self.loops[journalled]
        node = loop.node
        start_s = time.thread_time()
        while node.steps < self._handled or min(node.deadline_ns(), loop.health_due_ns) <= self._clock.monotonic_ns():
            loop.turn()
        return time.thread_time() - start_s

    def close(self) -> None:
        for socket in self._sockets:
            socket.close()
        self._context.destroy(linger=0)


def measure_links() -> None:
    """Print the processor time of the link with a journal as a ratio to that without, for some settings."""
    messages = sum(count for _, _, count in SECOND)
    for name, settings in LINKS.items():
        with tempfile.TemporaryDirectory() as folder:
            bench = LinkBench(Path(folder), settings)
            bench.second()
            rounds = [bench.second() for _ in range(ROUNDS)]
            bench.close()
        ratio = np.median([taken_s[True] / taken_s[False] for taken_s in rounds])
        with_s, without_s = (np.median([taken_s[kind] for taken_s in rounds]) / messages for kind in (True, False))
        figures = f"{with_s * 1e6:.1f} us a message with a journal, {without_s * 1e6:.1f} without"
        sys.stdout.write(f"link, {name}: {figures}: {ratio:.3f}\n")


def _timed(turns: Any, journal: InputJournal) -> float:
    taken_s = timeit.timeit(turns, number=1)
    journal.complete()
    journal.publish()
    return taken_s


def _best(run: Any) -> float:
    return min(timeit.repeat(run, number=1, repeat=REPEATS))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("law", nargs="?", default="virtual_impedance", help="law of the controller")
    main(parser.parse_args().law)
    measure_links()
