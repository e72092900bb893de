"""The nodes of the rig on a bus in virtual time, recorded to a file: real nodes, real loops, and no process.

Every delay comes from one seed: transit on a site and how late a loop wakes up; between the sites stands the link, with
the impairments of the scenario. So a session of a second takes less than that, and gives the same messages every time.
Each topic and each loop draws from a stream of random numbers of its own, so that one message more, such as a part of a
journal, moves no other.
With `constant_timing` nothing is random, and a constant delay stands for the link: the rig then runs on the grid that
the lockstep loop assumes. A node can be made to stand still (`stall`): what is sent to it meanwhile waits for it.
"""

import heapq
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
import zmq

from services.afm_node.__main__ import build as build_afm_node
from services.controller.__main__ import half_of_site
from services.haptic_node.__main__ import build as build_haptic_node
from telenano.afm.config import AfmConfig
from telenano.hand.config import HapticConfig
from telenano.laws.config import ControllerConfig
from telenano.link.config import LinkSettings
from telenano.recording.provenance import write_provenance
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import RejectedRecord
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.runtime.bus.bus import ConnectionEvent, Subscriber
from telenano.runtime.link_node import DelayNode
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import Node, NodeContext
from telenano.runtime.loop.node_loop import NodeLoop
from telenano.runtime.loop.realtime import RealtimeStatus
from telenano.settings import package_topics
from telenano.settings.config import flag_overrides, merge
from telenano.settings.included import SITE_DIRECTORY
from telenano.settings.scenario import LoadedScenario, Scenario
from telenano.testing import VirtualClock
from telenano.wire import Message, compose, decode, encode
from telenano.wire.codec import WireError, decode_header
from telenano.wire.messages import DELAY_STEP_NS, InputHealth
from telenano.wire.nodes import LINK, name_of, site_of
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival
from telenano.wire.topics import TOPICS, Topic

EPOCH_OFFSET_NS = 1_750_000_000_000_000_000
LAUNCHER = "launcher@master"
RECORDER = "recorder@master"
LINK_NODE, LINK_ENDPOINT = "delay_node@master", "delay_node@slave"
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

# as many as a subscriber takes at once
_BATCH = 256

Range = tuple[int, int]


def _row(topic: str) -> Topic:
    row = package_topics.row_of(topic)
    assert row is not None, topic
    return row


@dataclass(frozen=True)
class Timing:
    """Delays of the rig [ns], each drawn evenly from low <= delay < high, and shares of what happens now and then.

    sending: from the start of a turn to a message; site: transit on a site; link: transit between the sites, None where
    the link is a node of its own; start: from one node to the next; wake: lateness of a loop; recorder: until the
    recorder receives a message. stall_share of the turns are 3 ms late on top.
    """

    sending: Range = (0, 20_000)
    site: Range = (10_000, 200_000)
    link: Range | None = None
    start: Range = (100_000, 5_000_000)
    wake: Range = (0, 60_000)
    recorder: Range = (20_000, 400_000)
    stall_share: float = 2e-3


def constant_timing(link_ns: int, site_ns: int = 1_000) -> Timing:
    """Return a timing without jitter, lateness, stalls and repetitions: one delay of the link and one on a site [ns].

    The delay on a site is more than zero, because it orders what happens within a tick. The recorder gets every
    message as late as every other, and so in the order of sending.
    """
    site, link = (site_ns, site_ns + 1), (link_ns, link_ns + 1)
    return Timing((0, 1), site, link, (10_000, 10_001), (0, 1), site, stall_share=0.0)


RANDOM_TIMING = Timing()


class QuietLog(StructuredLog):
    """Nothing of what the nodes log is of interest here."""

    def write(self, level: str, text: str, **facts: Any) -> None:
        """Write nothing."""


class VirtualReader(Subscriber):
    """A subscriber whose messages are handed to it, and whose bytes need no second decoding."""

    def __init__(self, rig: "VirtualRig", newest_only: bool) -> None:
        super().__init__(rig.sockets, rig.clock, {"": tuple(TOPICS)}, connect=False, newest_only=newest_only)
        self._rig = rig

    def decode_and_track(self, frames: Sequence[bytes], received_ns: int) -> Received | None:
        topic, payload = frames[0].decode(), frames[1]
        message = self._rig.messages[payload]
        arrival = self.tracker(topic, message.src).accept(message.seq, message.t_ns)
        if arrival is Arrival.DUPLICATE or (arrival is Arrival.LATE and _row(topic).delivery == "latest"):
            return None
        return Received(topic, message, payload, received_ns, arrival)


class VirtualBus:
    """The bus of one node: what it publishes goes to the rig, what has arrived is taken by a subscriber."""

    def __init__(self, rig: "VirtualRig", key: str) -> None:
        self.key = key
        self.inbox: list[tuple[int, int, str, bytes]] = []
        # the link takes every message, the other nodes the newest
        self.reader = VirtualReader(rig, newest_only=name_of(key) != LINK)
        self._rig = rig
        self._numbers: dict[str, int] = {}

    def publish(self, topic: str, **fields: Any) -> Message:
        seq = self._numbers.get(topic, 0)
        self._numbers[topic] = seq + 1
        model = _row(topic).model
        # sent some time after the turn began, which no re-run knows
        t_ns = self._rig.clock.now_ns() + self._rig.draw(self._rig.timing.sending, "sending", self.key, topic)
        if topic == "node/health":
            # what differs between machines and runs, also in its length, which the rate of a link counts
            fields |= {"pid": 1, "cpu_percent": 0.0, "memory_bytes": 1}
        values = {"seq": seq, "t_ns": t_ns, "src": self.key, "v": model.version, **fields}
        message, _ = compose(topic, values)
        self._rig.carry(topic, message)
        return message

    def send(self, topic: str, payload: bytes) -> None:
        self._rig.forward(self.key, topic, payload)

    def receive(self) -> Iterator[Received]:
        now_ns, waiting = self._rig.clock.monotonic_ns(), []
        while self.inbox and self.inbox[0][0] <= now_ns and len(waiting) < _BATCH:
            _, _, topic, payload = heapq.heappop(self.inbox)
            waiting.append(([topic.encode(), payload], self._rig.clock.now_ns()))
        return iter(self.reader.take(waiting))

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

    def has_arrived(self) -> bool:
        return False

    def close(self) -> None:
        self.inbox.clear()
        self.reader.close()


class VirtualRig:
    """Two sites, the link between them, and a recorder that receives everything a little later.

    Parameters: folder of the recording, None for none; settings, dotted flags on top of the scenario; scenario, as read
    from a file (none: a hand presses the tip onto mica and lets go).
    """

    def __init__(
        self,
        folder: Path | None,
        seed: int,
        settings: Sequence[str] = (),
        timing: Timing = RANDOM_TIMING,
        scenario: Mapping[str, Any] | None = None,
    ):
        self._seed = seed
        self._streams: dict[tuple[str, ...], random.Random] = {}
        self.timing = timing
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=EPOCH_OFFSET_NS)
        self._order = 0
        self._received: list[tuple[int, int, str, str, bytes]] = []
        self.sockets = zmq.Context[zmq.Socket[bytes]]()
        self.messages: dict[bytes, Message] = {}
        # a connection keeps the order of what is sent through it
        self._last_arrival_ns: dict[tuple[str, str], int] = {}
        # a recorder receives from an endpoint in the order of sending
        self._received_ns: dict[str, int] = {}
        document = merge(scenario or yaml.safe_load(_SCENARIO), flag_overrides(settings))
        self._loaded = LoadedScenario(Scenario.model_validate(document), "virtual", document)
        self.writer = None if folder is None else RecordingWriter.create(RECORDER, FileSettings(directory=folder))
        if self.writer is not None and folder is not None:
            path = folder / "scenario.yaml"
            path.write_text(yaml.safe_dump(document), encoding="utf-8")
            config = RecorderConfig(directory=folder)
            write_provenance(self.writer, config, SITE_DIRECTORY / "local.yaml", path, self.clock.now_ns())
        self._channels: dict[tuple[str, str, str], int] = {}
        self.nodes = NODES if timing.link is not None else (LINK_NODE, *NODES)
        self._known_due_ns: dict[str, int] = {}
        self.buses = {key: VirtualBus(self, key) for key in self.nodes}
        self._link_at_slave, self._launcher = VirtualBus(self, LINK_ENDPOINT), VirtualBus(self, LAUNCHER)
        self.loops: dict[str, NodeLoop] = {}
        for key in self.nodes:
            period_s = self._loaded.scenario.period_s
            node = self._node(NodeContext(key, self.clock, self.buses[key], QuietLog(key), period_s=period_s))
            # nodes start one after the other
            self.clock.advance_ns(self.draw(timing.start, "start", key))
            self.loops[key] = NodeLoop(node, self.buses[key], RealtimeStatus(fifo=True, memory_locked=False))
        self._started_ns = self.clock.monotonic_ns()
        self._late_ns = dict.fromkeys(self.nodes, 0)
        self._stalled_until_ns = dict.fromkeys(self.nodes, 0)
        if timing.link is not None:
            self._declare(timing.link[0])

    def command(self, command: str, target: str, seen: Message | None = None, **parameters: Any) -> None:
        """Send a command, and the same once more as a session does that has not received the answer yet.

        Parameters: seen: a message of the target that proves to it that the command is fresh, none where it needs none.
        """
        name = f"{command}{self._order}"
        proof = {} if seen is None else {"node_t_ns": {seen.src: seen.t_ns}}
        for _ in range(2):
            self._launcher.publish(
                "session/control", id=name, command=command, target=target, parameters=parameters, **proof
            )

    def _declare(self, delay_ns: int) -> None:
        """Tell the delay that stands for the link, as the link does."""
        told = {"hand_t_ns": 0, "delay_ns": delay_ns - delay_ns % DELAY_STEP_NS, "transit_ns": 0, "clock_ahead_ns": 0}
        at_master = VirtualBus(self, LINK_NODE)
        for bus, direction in ((self._link_at_slave, "forward"), (at_master, "forward"), (at_master, "backward")):
            bus.publish("link/delay", direction=direction, **told)
        at_master.close()

    def stall(self, key: str, duration_s: float) -> None:
        """Let a node stand still from now on: it takes no turn, and what is sent to it waits."""
        self._stalled_until_ns[key] = self.clock.monotonic_ns() + round(duration_s * 1e9)
        self._known_due_ns.pop(key, None)

    def received(self, topic: str, src: str) -> list[Any]:
        """Give what a node has published on a topic so far."""
        found = (self.messages[entry[4]] for entry in self._received if entry[3] == topic and entry[2] == src)
        return [message for message in found if message.src == src]

    def run_until(self, time_s: float) -> None:
        """Let the nodes take their turns until a time since the start [s]."""
        end_ns = self._started_ns + round(time_s * 1e9)
        while True:
            now_ns = self.clock.monotonic_ns()
            due_ns, key = min((max(self._due_ns(key), now_ns), key) for key in self.nodes)
            if due_ns > end_ns:
                break
            self.clock.advance_ns(due_ns - now_ns)
            # its next turn, and that of each node that something is brought to, has to be found anew
            self._known_due_ns.pop(key, None)
            self.loops[key].turn()
            # a loop wakes up late, and now and then very late
            is_stalled = self._stream("stall", key).random() < self.timing.stall_share
            self._late_ns[key] = self.draw(self.timing.wake, "wake", key) + 3_000_000 * is_stalled

    def draw(self, low_high: Range, *names: str) -> int:
        """Draw a delay [ns] from the stream of these names."""
        return self._stream(*names).randrange(*low_high)

    def _stream(self, *names: str) -> random.Random:
        if names not in self._streams:
            self._streams[names] = random.Random(f"{self._seed} {' '.join(names)}")
        return self._streams[names]

    def close(self) -> None:
        """Close the sockets, which nothing came through."""
        for bus in (*self.buses.values(), self._link_at_slave, self._launcher):
            bus.close()
        self.sockets.term()

    def finish(self) -> Path:
        """Stop the nodes and complete the file."""
        for loop in self.loops.values():
            loop.node.context.request_stop()
            loop.run()
        self.close()
        assert self.writer is not None, "nothing was to be recorded"
        for log_ns, _, endpoint, topic, payload in sorted(self._received):
            try:
                (seq, t_ns, src), _ = decode_header(topic, payload)
            except WireError:
                self.writer.write_rejected(log_ns, _rejected(endpoint, topic, payload))
                continue
            place = (topic, src, site_of(endpoint))
            if place not in self._channels:
                self._channels[place] = self.writer.channel(*place)
            self.writer.write(self._channels[place], log_ns, t_ns, seq, payload)
        self.writer.finish({"state": "stopped", "note": ""})
        return self.writer.path

    def carry(self, topic: str, message: Message) -> None:
        """Bring a message to those who listen, on its own site and through the link."""
        site, payload = site_of(message.src), encode(message)
        self.messages[payload] = message
        self._record(message.src, topic, payload, message.t_ns)
        for key in self._readers(topic, message, site):
            self._deliver(message.src, key, topic, payload, message.t_ns - EPOCH_OFFSET_NS)
        crosses = _row(topic).bridged in ("both", "forward" if site == "master" else "backward")
        if self.timing.link is not None and crosses:
            far = LINK_ENDPOINT if site == "master" else LINK_NODE
            arrives_ns = message.t_ns - EPOCH_OFFSET_NS + self.draw(self.timing.link, "link", message.src, topic)
            self._bring(far, topic, message, payload, arrives_ns)
        elif self.timing.link is None and name_of(message.src) != LINK and (crosses or topic == "clock/pong"):
            self._deliver(message.src, LINK_NODE, topic, payload, message.t_ns - EPOCH_OFFSET_NS)

    def forward(self, endpoint: str, topic: str, payload: bytes) -> None:
        """Bring a message that left the link to those who listen there; they refuse what is none, the recorder not."""
        sent_ns = self.clock.monotonic_ns() + self.draw(self.timing.sending, "forwarding", endpoint, topic)
        try:
            message = self.messages[payload] if payload in self.messages else decode(topic, payload)
            self._bring(endpoint, topic, message, payload, sent_ns)
        except WireError:
            self._record(endpoint, topic, payload, sent_ns + EPOCH_OFFSET_NS)

    def _bring(self, endpoint: str, topic: str, message: Message, payload: bytes, sent_ns: int) -> None:
        self.messages[payload] = message
        self._record(endpoint, topic, payload, sent_ns + EPOCH_OFFSET_NS)
        for key in self._readers(topic, message, site_of(endpoint)):
            self._deliver(endpoint, key, topic, payload, sent_ns)

    def _record(self, endpoint: str, topic: str, payload: bytes, sent_ns: int) -> None:
        self._order += 1
        arrives_ns = sent_ns + self.draw(self.timing.recorder, "recorder", endpoint, topic)
        log_ns = max(arrives_ns, self._received_ns.get(endpoint, 0))
        self._received_ns[endpoint] = log_ns
        self._received.append((log_ns, self._order, endpoint, topic, payload))

    def _readers(self, topic: str, message: Message, site: str) -> list[str]:
        return [
            key
            for key, loop in self.loops.items()
            if topic in loop.node.inputs and site_of(key) == site and key not in (message.src, LINK_NODE)
        ]

    def _deliver(self, sender: str, key: str, topic: str, payload: bytes, sent_ns: int) -> None:
        self._order += 1
        arrives_ns = sent_ns + self.draw(self.timing.site, "site", sender, key, topic)
        arrives_ns = max(arrives_ns, self._last_arrival_ns.get((sender, key), 0))
        self._last_arrival_ns[sender, key] = arrives_ns
        heapq.heappush(self.buses[key].inbox, (arrives_ns, self._order, topic, payload))
        self._known_due_ns.pop(key, None)

    def _due_ns(self, key: str) -> int:
        due_ns = self._known_due_ns.get(key)
        if due_ns is None:
            loop, inbox = self.loops[key], self.buses[key].inbox
            deadline_ns = min(loop.node.deadline_ns(), loop.health_due_ns)
            wanted_ns = min(deadline_ns, inbox[0][0]) if inbox else deadline_ns
            due_ns = max(wanted_ns + self._late_ns[key], self._stalled_until_ns[key])
            self._known_due_ns[key] = due_ns
        return due_ns

    def _node(self, context: NodeContext) -> Node:
        name = context.key.partition("@")[0]
        if name == "controller":
            return half_of_site(context, self._loaded.section("controller", ControllerConfig))
        if name == "afm_node":
            return build_afm_node(context, self._loaded.section("afm_node", AfmConfig))
        if name == LINK:
            settings = self._loaded.section(LINK, LinkSettings)
            return DelayNode(context, settings, self._link_at_slave, self.buses[LINK_NODE], Path())
        return build_haptic_node(context, self._loaded.section("haptic_node", HapticConfig))


def _rejected(endpoint: str, topic: str, payload: bytes) -> RejectedRecord:
    frames = (topic.encode(), payload)
    size_bytes = sum(map(len, frames))
    return RejectedRecord(
        reason="malformed", text="flipped bits", publisher=endpoint, size_bytes=size_bytes, frames=frames
    )


def record_session(
    folder: Path,
    seed: int,
    settings: Sequence[str] = (),
    duration_s: float = 1.5,
    scenario: Mapping[str, Any] | None = None,
) -> Path:
    """Record a session: arm, start, press, let go."""
    rig = VirtualRig(folder, seed, settings, scenario=scenario)
    rig.run_until(ARMED_S)
    rig.command("arm", "*", place="hand")
    rig.run_until(STARTED_S)
    rig.command("start", "haptic_node")
    rig.run_until(duration_s)
    return rig.finish()
