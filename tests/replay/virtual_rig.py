"""The nodes of the rig on a bus in virtual time, recorded to a file: real nodes, real loops, and no process.

Every delay comes from one seed: transit on a site, the link between them with its overtaking and repeated messages, and
how late a loop wakes up. So a session of a second takes less than that, and gives the same file every time.
"""

import heapq
import random
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml

from proto import TOPICS, Message, encode
from proto.messages import InputHealth
from proto.nodes import site_of
from proto.sequence import Arrival, SequenceTracker
from recording.writer import FileSettings, RecordingWriter
from services.afm_node.config import AfmConfig
from services.afm_node.node import AfmNode
from services.afm_node.sim import SimulatedAfm
from services.controller.config import ControllerConfig
from services.controller.node import half_of_site
from services.haptic_node.config import HapticConfig
from services.haptic_node.node import HapticNode
from services.haptic_node.sim import SimulatedHaptic
from services.runtime.bus import ConnectionEvent, Received
from services.runtime.clock import VirtualClock
from services.runtime.config import flag_overrides, merge
from services.runtime.log import StructuredLog
from services.runtime.node import Node, NodeContext, NodeLoop
from services.runtime.realtime import RealtimeStatus
from services.runtime.scenario import LoadedScenario, Scenario

EPOCH_OFFSET_NS = 1_750_000_000_000_000_000
LAUNCHER = "launcher@master"
RECORDER = "recorder@master"
NODES = ("afm_node@slave", "controller@slave", "controller@master", "haptic_node@master")
ARMED_S, STARTED_S = 0.15, 0.3
_SCENARIO = """
name: virtual
description: A hand presses the tip onto mica and lets go
duration_s: 1.0
haptic_node:
  operator:
    kind: force_profile
    points:
      - {time_s: 0.05, force_n: 0.0}
      - {time_s: 0.1, force_n: 2.0}
      - {time_s: 0.9, force_n: 2.0}
      - {time_s: 0.95, force_n: 0.0}
afm_node:
  rest_distance_m: 10.0e-9
"""


class QuietLog(StructuredLog):
    """Nothing of what the nodes log is of interest here."""

    def write(self, level: str, text: str, **facts: Any) -> None:
        """Write nothing."""


class VirtualBus:
    """The bus of one node: what it publishes goes to the rig, what has arrived is taken as a Subscriber would."""

    def __init__(self, rig: "VirtualRig", key: str) -> None:
        self.key = key
        self.inbox: list[tuple[int, int, Message]] = []
        self._rig = rig
        self._numbers: dict[str, int] = {}
        self._trackers: dict[tuple[str, str], SequenceTracker] = {}

    def publish(self, topic: str, **fields: Any) -> Message:
        seq = self._numbers.get(topic, 0)
        self._numbers[topic] = seq + 1
        model = TOPICS[topic].model
        # sent some time after the turn began, which no re-run knows
        t_ns = self._rig.clock.now_ns() + self._rig.random.randrange(20_000)
        message = model(seq=seq, t_ns=t_ns, src=self.key, v=model.version, **fields)
        self._rig.carry(topic, message)
        return message

    def receive(self) -> Iterator[Received]:
        while self.inbox and self.inbox[0][0] <= self._rig.clock.monotonic_ns():
            _, _, message = heapq.heappop(self.inbox)
            topic = self._rig.topic_of(message)
            tracker = self._trackers.setdefault((topic, message.src), SequenceTracker())
            arrival = tracker.accept(message.seq, message.t_ns)
            if arrival is Arrival.DUPLICATE or (arrival is Arrival.LATE and TOPICS[topic].delivery == "latest"):
                continue
            yield Received(topic, message, encode(message), self._rig.clock.now_ns(), arrival)

    def wait(self, deadline_ns: int) -> None:
        """The rig has let the time pass."""

    def sequence_numbers(self) -> dict[str, int]:
        return dict(self._numbers)

    def input_health(self) -> tuple[InputHealth, ...]:
        return ()

    def rejections(self) -> tuple[dict[str, int], str]:
        return {}, ""

    def process_events(self, *, now: bool = False) -> Sequence[ConnectionEvent]:
        return ()

    def close(self) -> None:
        self.inbox.clear()


class VirtualRig:
    """Two sites, a link of random delay, and a recorder that hears everything a little later."""

    def __init__(self, folder: Path, seed: int, settings: Sequence[str] = (), link_ms: tuple[float, float] = (1, 4)):
        self.random = random.Random(seed)
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=EPOCH_OFFSET_NS)
        self._link_ns = [round(bound * 1e6) for bound in link_ms]
        self._order = 0
        self._heard: list[tuple[int, int, str, Message]] = []
        document = merge(yaml.safe_load(_SCENARIO), flag_overrides(settings))
        self._loaded = LoadedScenario(Scenario.model_validate(document), "virtual", document)
        self.writer = RecordingWriter.create(RECORDER, FileSettings(directory=folder))
        text = yaml.safe_dump(document).encode()
        self.writer.attach("scenario.yaml", "application/yaml", text, self.clock.now_ns())
        self._channels: dict[tuple[str, str, str], int] = {}
        self.buses = {key: VirtualBus(self, key) for key in NODES}
        self.loops = {}
        for key in NODES:
            node = self._node(NodeContext(key, self.clock, self.buses[key], QuietLog(key)))
            # nodes start one after the other
            self.clock.advance_ns(self.random.randrange(100_000, 5_000_000))
            self.loops[key] = NodeLoop(node, self.buses[key], RealtimeStatus(fifo=True, memory_locked=False))
        self._started_ns = self.clock.monotonic_ns()
        self._launcher = VirtualBus(self, LAUNCHER)
        self._late_ns = dict.fromkeys(NODES, 0)

    def command(self, command: str, target: str, **parameters: Any) -> None:
        """Send a command, and the same once more as a session does that has not heard the answer yet."""
        name = f"{command}{self._order}"
        for _ in range(2):
            self._launcher.publish("session/control", id=name, command=command, target=target, parameters=parameters)

    def run_until(self, time_s: float) -> None:
        """Let the nodes take their turns until a time since the start [s]."""
        end_ns = self._started_ns + round(time_s * 1e9)
        while True:
            due_ns, key = min((self._due_ns(key), key) for key in NODES)
            if due_ns > end_ns:
                break
            self.clock.advance_ns(max(0, due_ns - self.clock.monotonic_ns()))
            self.loops[key].turn()
            # a loop wakes up late, and now and then very late
            self._late_ns[key] = self.random.randrange(60_000) + 3_000_000 * (self.random.random() < 2e-3)

    def finish(self) -> Path:
        """Stop the nodes and complete the file."""
        for loop in self.loops.values():
            loop.node.context.request_stop()
            loop.run()
        for log_ns, _, site, message in sorted(self._heard, key=lambda entry: entry[:2]):
            topic = self.topic_of(message)
            place = (topic, message.src, site)
            if place not in self._channels:
                self._channels[place] = self.writer.channel(*place)
            self.writer.write(self._channels[place], log_ns, message.t_ns, message.seq, encode(message))
        self.writer.finish()
        return self.writer.path

    def carry(self, topic: str, message: Message) -> None:
        """Bring a message to those who listen, on its own site and behind the link."""
        site = site_of(message.src)
        self._record(message, site, message.t_ns)
        for bus in self._readers(topic, message, site):
            self._deliver(bus, message, message.t_ns - EPOCH_OFFSET_NS + self.random.randrange(10_000, 200_000))
        bridged = TOPICS[topic].bridged
        if bridged not in ("both", "forward" if site == "master" else "backward"):
            return
        far = "slave" if site == "master" else "master"
        for _ in range(1 + (self.random.random() < 0.01)):
            arrives_ns = message.t_ns - EPOCH_OFFSET_NS + self.random.randrange(*self._link_ns)
            self._record(message, far, arrives_ns + EPOCH_OFFSET_NS)
            for bus in self._readers(topic, message, far):
                self._deliver(bus, message, arrives_ns + self.random.randrange(10_000, 200_000))

    def topic_of(self, message: Message) -> str:
        """Give the topic of a message: each has a model of its own."""
        return next(topic.name for topic in TOPICS.values() if topic.model is type(message))

    def _record(self, message: Message, site: str, sent_ns: int) -> None:
        self._order += 1
        self._heard.append((sent_ns + self.random.randrange(20_000, 400_000), self._order, site, message))

    def _readers(self, topic: str, message: Message, site: str) -> list[VirtualBus]:
        return [
            self.buses[key]
            for key, loop in self.loops.items()
            if topic in loop.node.inputs and site_of(key) == site and key != message.src
        ]

    def _deliver(self, bus: VirtualBus, message: Message, arrives_ns: int) -> None:
        self._order += 1
        heapq.heappush(bus.inbox, (arrives_ns, self._order, message))

    def _due_ns(self, key: str) -> int:
        loop, inbox = self.loops[key], self.buses[key].inbox
        deadline_ns = min(loop.node.deadline_ns(), loop.health_due_ns)
        wanted_ns = min(deadline_ns, inbox[0][0]) if inbox else deadline_ns
        return max(wanted_ns + self._late_ns[key], self.clock.monotonic_ns())

    def _node(self, context: NodeContext) -> Node:
        name = context.key.partition("@")[0]
        if name == "controller":
            return half_of_site(context, self._loaded.section("controller", ControllerConfig))
        if name == "afm_node":
            afm = self._loaded.section("afm_node", AfmConfig)
            return AfmNode(context, afm, SimulatedAfm(afm.to_params()))
        hand = self._loaded.section("haptic_node", HapticConfig)
        return HapticNode(context, hand, SimulatedHaptic(hand.to_plant_params(), hand.device.start_position_m))


def record_session(folder: Path, seed: int, settings: Sequence[str] = (), duration_s: float = 1.5) -> Path:
    """Record a session: arm, start, press, let go."""
    rig = VirtualRig(folder, seed, settings)
    rig.run_until(ARMED_S)
    rig.command("arm", "*")
    rig.run_until(STARTED_S)
    rig.command("start", "haptic_node")
    rig.run_until(duration_s)
    return rig.finish()
