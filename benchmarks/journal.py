"""What the input journal takes from a node: an entry for each turn, and a batch with the state of the node.

    python benchmarks/journal.py [LAW]

Each time stands beside that of decoding one message in the same run, which every input costs anyway. All of this work
comes after the turn's outputs were sent; the batch comes twice a second, with node/health.

The link handles the most messages. Here it runs in its own loop on its own sockets, with a journal and without one, on
the same messages at the rate of a rig, a hundredth of a second at a time. The ratio is that of the processor times of
its thread. In a rig each message has to wake it as well, so the ratio is lower there.
"""

import argparse
import json
import tempfile
import time
import timeit
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import zmq
from wire_examples import ordinary_example

from services.controller.master_half import MasterController
from services.delay_node.node import DelayNode
from telenano.runtime.bus.bus import Subscriber, ZmqBus
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.journal import InputJournal
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import NodeContext
from telenano.runtime.loop.node_loop import NodeLoop
from telenano.runtime.loop.realtime import RealtimeStatus
from telenano.sections.controller_section import ControllerConfig
from telenano.settings.link_settings import LinkSettings
from telenano.timing.clock import SystemClock
from telenano.wire import TOPICS, decode, encode
from telenano.wire.codec import fields_of
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival

TURNS = 1000
REPEATS = 50
# A second of a rig has signals at 1 kHz each way, and the law's status at 100 Hz.
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
    """A bus that builds and encodes each published message, and sends nothing."""

    def publish(self, topic: str, **fields: Any) -> Any:
        model = TOPICS[topic].model
        message = model(seq=0, t_ns=1, src="controller@master", v=model.version, **fields)
        encode(message)
        return message


def measure_turns(law: str, repeats: int) -> dict[str, dict[str, float]]:
    """Return the time of an entry and of a batch [us], and the same in units of the decoding of a message."""
    bus: Any = _NullBus()
    node = MasterController(
        NodeContext("controller@master", SystemClock(), bus, StructuredLog("controller@master")),
        ControllerConfig.model_validate({"law": law}),
    )
    journal = InputJournal(node, lambda: {"teleop/forward": 1, "haptic/command": 1})
    message = ordinary_example("haptic/state")
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

    decoding_s = _best(lambda: [decode("haptic/state", payload) for _ in range(TURNS)], repeats) / TURNS
    entries_s = min(_timed(turns, journal) for _ in range(repeats))
    batch_s = _best(batch, repeats) - entries_s
    figures = {"entry of a turn": entries_s / TURNS, f"batch of {TURNS} turns": batch_s}
    return {name: {"us": 1e6 * taken_s, "decodings": taken_s / decoding_s} for name, taken_s in figures.items()}


class LinkBench:
    """Two links on their own sockets that receive the same messages: one keeps a journal, the other does not."""

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
            node = kind(context, LinkSettings.of(settings), to_slave, to_master, Path())
            self.loops[journalled] = NodeLoop(node, bus, RealtimeStatus(fifo=False, memory_locked=False))
            reader = Subscriber(self._context, self._clock, {endpoint: list(TOPICS) for endpoint in endpoints})
            self._readers.append(reader)
            self._sockets += [to_master, to_slave, inputs, reader]
        time.sleep(0.3)

    def second(self) -> dict[bool, float]:
        """Let both links handle a second of a rig; return the processor time [s] with and without a journal."""
        taken_s = dict.fromkeys(self.loops, 0.0)
        fields = {
            topic: {
                key: value
                for key, value in fields_of(ordinary_example(topic)).items()
                if key not in ("seq", "t_ns", "src", "v")
            }
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


def measure_links(rounds: int) -> dict[str, dict[str, float]]:
    """Return the processor time for a message [us] in the link with and without a journal, and their ratio."""
    messages, found = sum(count for _, _, count in SECOND), {}
    for name, settings in LINKS.items():
        with tempfile.TemporaryDirectory() as folder:
            bench = LinkBench(Path(folder), settings)
            bench.second()
            taken = [bench.second() for _ in range(rounds)]
            bench.close()
        medians_s = (float(np.median([taken_s[kind] for taken_s in taken])) for kind in (True, False))
        with_us, without_us = (1e6 * median_s / messages for median_s in medians_s)
        ratio = float(np.median([taken_s[True] / taken_s[False] for taken_s in taken]))
        found[f"link, {name}"] = {"with_us": with_us, "without_us": without_us, "ratio": ratio}
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("law", nargs="?", default="virtual_impedance", help="law of the controller")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    found = measure_turns(given.law, 2 if given.smoke else REPEATS) | measure_links(1 if given.smoke else ROUNDS)
    if given.json:
        print(json.dumps(found))
        return
    for name, figures in found.items():
        print(f"{name}: " + ", ".join(f"{figure:.3f} {key}" for key, figure in figures.items()))


def _timed(turns: Any, journal: InputJournal) -> float:
    taken_s = timeit.timeit(turns, number=1)
    journal.complete()
    journal.publish()
    return taken_s


def _best(run: Any, repeats: int) -> float:
    return min(timeit.repeat(run, number=1, repeat=repeats))


if __name__ == "__main__":
    main()
