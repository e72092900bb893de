"""Every kind of node in virtual time, fed with extreme and broken frames through the very reader of a live one.

    python fuzzed_nodes.py SEED COUNT [NODE ...]

A process of its own, so that steps are plain Python as in the nodes. Prints a JSON object: for each node, and each half
of each law, what was taken, what was refused by reason, and the traceback of what ended it, which is to be empty.
"""

import contextlib
import json
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import zmq

from services.afm_node.node import AfmNode
from services.controller.__main__ import half_of_site
from services.delay_node.node import DelayNode
from services.haptic_node.node import HapticNode
from services.player.node import PlayerNode, PlaySettings
from services.player.plan import ReplayPlan
from services.player.playback import Playback, Span
from services.recorder.intake import Intake, Listener
from services.recorder.node import RecorderNode
from telenano.afm.sim import simulated_afm
from telenano.hand.sim import SimulatedHaptic
from telenano.launcher.processes import StopObserver
from telenano.launcher.session import SessionNode
from telenano.launcher.supervisor import Supervisor
from telenano.recording.channel_filter import Selection
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import ConnectionEvent, Subscriber, ZmqBus
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import Node, NodeContext
from telenano.runtime.loop.node_loop import NodeLoop
from telenano.runtime.loop.realtime import RealtimeStatus
from telenano.sections.afm_section import AfmConfig
from telenano.sections.controller_section import OWN_LAWS, ControllerConfig
from telenano.sections.hand_section import HapticConfig
from telenano.settings.link_settings import LinkSettings
from telenano.testing import VirtualClock
from telenano.testing.frames import Frames, stream
from telenano.wire import Message, compose
from telenano.wire.messages import InputHealth
from telenano.wire.nodes import HAND, TIP
from telenano.wire.received import Received
from telenano.wire.topics import OWN_TOPICS as TOPICS

LAWS = (*OWN_LAWS, "model_mediated")
EPOCH_NS = 1_750_000_000_000_000_000
# between two frames: ten a millisecond, as fast as a flood
STEP_NS = 100_000


class QuietLog(StructuredLog):
    """What the nodes log is of no interest here."""

    def write(self, level: str, text: str, **facts: Any) -> None:
        """Write nothing."""


class FuzzedBus:
    """A bus in virtual time: what a node publishes is encoded, what it receives was given to its reader as bytes."""

    def __init__(self, key: str, clock: VirtualClock, reader: Subscriber) -> None:
        self.published = 0
        self.waiting: list[Received] = []
        self._key, self.clock, self.reader = key, clock, reader
        self._numbers: dict[str, int] = {}
        # only to add up accounts: it has no socket of its own
        self._counters = ZmqBus(self, [reader], clock, -1)  # type: ignore[arg-type]

    def publish(self, topic: str, **fields: Any) -> Message:
        seq = self._numbers.get(topic, 0)
        self._numbers[topic] = seq + 1
        model = TOPICS[topic].model
        header = {"seq": seq, "t_ns": self.clock.now_ns(), "src": self._key, "v": model.version}
        message, _ = compose(topic, {**header, **fields})
        self.published += 1
        return message

    def take(self, frames: Sequence[bytes]) -> None:
        received = self.reader.decode_and_track(frames, self.clock.now_ns())
        if received is not None:
            self.waiting.append(received)

    def receive(self) -> Iterator[Received]:
        waiting, self.waiting = self.waiting, []
        yield from waiting

    def wait(self, deadline_ns: int) -> None:
        """Do not wait: the fuzzer lets the time pass."""

    def sequence_numbers(self) -> dict[str, int]:
        return dict(self._numbers)

    def input_health(self) -> tuple[InputHealth, ...]:
        return self._counters.input_health()

    def rejections(self) -> tuple[dict[str, int], str]:
        return self._counters.rejections()

    def process_events(self, *, now: bool = False) -> Sequence[ConnectionEvent]:
        return ()

    def has_arrived(self) -> bool:
        return False

    def send(self, topic: str, payload: bytes) -> bool:
        """Send what the link or a player passes on."""
        self.published += 1
        return True


class Children:
    """No processes at all."""

    def start(self, node: str) -> int:
        return 1

    def reap(self) -> dict[str, int]:
        return {}

    def log_tail(self, node: str) -> str:
        return ""

    def log_path(self, node: str) -> Path:
        return Path(node)

    def stop(self, observer: StopObserver) -> None:
        """There is nothing to stop."""


def _recorder(context: NodeContext, bus: FuzzedBus, reader: Subscriber, folder: Path) -> RecorderNode:
    config = RecorderConfig(directory=folder)
    intake = Intake(RecordingWriter.create(context.key, config))
    listener = Listener("controller@slave", reader)

    def take(frames: Sequence[bytes]) -> None:
        received = intake.record(listener, frames, context.clock.now_ns())
        if received is not None:
            bus.waiting.append(received)

    bus.take = take  # type: ignore[method-assign]
    return RecorderNode(context, config, intake)


def _player(context: NodeContext, bus: FuzzedBus, reader: Subscriber, folder: Path) -> PlayerNode:
    writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=folder))
    frames = Frames("recorded")
    channel = writer.channel("afm/state", TIP, "slave")
    for number in range(50):
        writer.write(channel, EPOCH_NS + number * 10**7, EPOCH_NS, number, frames.extreme("afm/state"))
    writer.finish()
    recording = Recording(writer.path)
    book = AddressBook(nodes={TIP: "ipc:///tmp/x"})
    plan = ReplayPlan(recording, book, Selection.of())
    publisher: Any = type("Publisher", (), {})()
    publisher.send, publisher.publisher, publisher.sent = bus.send, bus, 0
    publisher.read_subscriptions, publisher.has_subscriber = lambda: False, lambda topic: True
    playback = Playback(recording, plan.plays, Span(loop=True))
    return PlayerNode(context, playback, plan, {TIP: publisher}, PlaySettings())


def _launcher(context: NodeContext, bus: FuzzedBus, reader: Subscriber, folder: Path) -> SessionNode:
    children: Any = Children()
    supervisor = Supervisor(context.clock, (), children)
    return SessionNode(context, supervisor, 1.0, others=(HAND, TIP), site="master", other_site="slave")


def _haptic(context: NodeContext, *_: Any) -> HapticNode:
    config = HapticConfig()
    return HapticNode(context, config, SimulatedHaptic(config.to_plant_params(), 0.0))


def _afm(context: NodeContext, *_: Any) -> AfmNode:
    config = AfmConfig()
    return AfmNode(context, config, simulated_afm(config.to_params()))


def _controller(law: str) -> Callable[..., Node]:
    config = ControllerConfig.model_validate({"law": law, "deadband": {"enabled": law == "wave"}})
    return lambda context, *_: half_of_site(context, config)


def _link(context: NodeContext, bus: FuzzedBus, reader: Subscriber, folder: Path) -> DelayNode:
    outlet: Any = bus
    return DelayNode(context, LinkSettings(), outlet, outlet, folder)


# by name of the node, and of the law at a controller
BUILD: dict[str, Callable[..., Node]] = {
    "haptic_node@master": _haptic,
    **{f"controller@{site} {law}": _controller(law) for site in ("master", "slave") for law in LAWS},
    "afm_node@slave": _afm,
    "delay_node@master": _link,
    "recorder@master": _recorder,
    "player@master": _player,
    "launcher@master": _launcher,
}


@contextlib.contextmanager
def opened(folder: Path) -> Iterator[Callable[[str], tuple[FuzzedBus, NodeLoop]]]:
    """Give a function that builds a node by its name and returns its bus and its loop."""
    clock = VirtualClock(start_ns=10**9, epoch_offset_ns=EPOCH_NS)
    with zmq.Context() as sockets, contextlib.closing(Subscriber(sockets, clock, {})) as reader:

        def build(name: str) -> tuple[FuzzedBus, NodeLoop]:
            key = name.partition(" ")[0]
            bus = FuzzedBus(key, clock, reader)
            context = NodeContext(key, clock, bus, QuietLog(key))
            node = BUILD[name](context, bus, reader, folder)
            return bus, NodeLoop(node, bus, RealtimeStatus(fifo=False, memory_locked=False))

        yield build


def fuzz(name: str, seed: str, count: int, folder: Path) -> dict[str, Any]:
    """Feed a node with `count` extreme messages and as many broken ones; give what came of it."""
    with opened(folder) as build:
        bus, loop = build(name)
        node, clock, reader = loop.node, bus.clock, bus.reader
        frames = Frames(f"{seed} {name}", clock.now_ns())
        # a recorder and the link take everything that there is
        topics = list(TOPICS) if name.startswith(("recorder", "delay_node")) else list(node.inputs)
        ended = ""
        try:
            for given in stream(frames, topics, count):
                bus.take(given)
                loop.turn()
                clock.advance_ns(STEP_NS)
                frames.now_ns = clock.now_ns()
                # a command may ask a node to end, as the player's `stop` does: then it begins anew
                node.context.stop_requested = False
            # and on without any, until every deadline has come
            for _ in range(2000):
                loop.turn()
                clock.advance_ns(10 * STEP_NS)
            node.make_safe()
        except Exception:  # noqa: BLE001
            ended = traceback.format_exc()
        received = sum(tracker.received for tracker in reader.trackers.values())
        return {"received": received, "refused": reader.rejected, "published": bus.published, "ended": ended}


def main(seed: str, count: int, names: Sequence[str]) -> dict[str, Any]:
    """Fuzz each node; give the results by name."""
    found = {}
    for name in names or BUILD:
        with tempfile.TemporaryDirectory() as folder:
            found[name] = fuzz(name, seed, count, Path(folder))
    return found


if __name__ == "__main__":
    json.dump(main(sys.argv[1], int(sys.argv[2]), sys.argv[3:]), sys.stdout)
