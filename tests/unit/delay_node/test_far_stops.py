"""A stop for the instrument at the other site is kept until it is obeyed, and nothing follows before that.

The link and the instrument are the real nodes in virtual time; between them stands a network that comes and goes.
"""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from services.afm_node.node import AfmNode
from services.delay_node.far_stop import FarStop, FarStopState
from services.delay_node.node import DelayNode
from telenano.afm import safety
from telenano.afm.sim import simulated_afm
from telenano.runtime.loop.commands import Command, CommandClient
from telenano.runtime.loop.kept_stop import keep
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import Node, NodeContext
from telenano.runtime.loop.node_loop import NodeLoop
from telenano.runtime.loop.realtime import RealtimeStatus
from telenano.sections.afm_section import AfmConfig
from telenano.settings.link_settings import LinkSettings
from telenano.testing import VirtualClock
from telenano.wire import decode, encode
from telenano.wire.messages import Message, SessionControl, SessionEvent
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival, SequenceTracker
from telenano.wire.topics import TOPICS

LINK, TIP = "delay_node@master", "afm_node@slave"
MS = 1_000_000
STEP_NS = 20 * MS
EPOCH_NS = 10**18
# after a sample that left before the stop: its deadline, and the turns of link and instrument
SETTLED_NS = 50 * MS + 3 * STEP_NS
ZERO = (0.0, 0.0, 0.0)


class _Log(StructuredLog):
    def write(self, level: str, text: str, **facts: Any) -> None:
        """Write nothing."""


class _Bus:
    """The bus of a node: what waits for it, and what the world does with what it publishes."""

    def __init__(self, world: "World", key: str) -> None:
        self._world, self._key = world, key
        self.waiting: list[Received] = []
        self.trackers: dict[tuple[str, str], SequenceTracker] = {}

    def bring(self, topic: str, message: Message) -> None:
        """Have a message wait, unless its number says that it is a repetition."""
        tracker = self.trackers.setdefault((topic, message.src), SequenceTracker())
        if tracker.accept(message.seq, message.t_ns) is not Arrival.DUPLICATE:
            self.waiting.append(Received(topic, message, encode(message), self._world.clock.now_ns(), Arrival.NEXT))

    def publish(self, topic: str, **fields: Any) -> Any:
        if topic == "session/event":
            self._world.published(self._key, topic, self._world.message(topic, self._key, **fields))

    def receive(self) -> Iterator[Received]:
        taken, self.waiting = self.waiting, []
        return iter(taken)

    def wait(self, deadline_ns: int) -> None:
        """Do not wait: the world advances the clock."""

    def process_events(self, *, now: bool = False) -> tuple[()]:
        return ()

    def input_health(self) -> tuple[()]:
        return ()

    def rejections(self) -> tuple[dict[str, int], str]:
        return {}, ""

    def sequence_numbers(self) -> dict[str, int]:
        return {}

    def has_arrived(self) -> bool:
        return False


class _Outlet:
    """The endpoint of the link at a site."""

    def __init__(self, world: "World", key: str) -> None:
        self._world, self._key = world, key

    def send(self, topic: str, payload: bytes) -> None:
        self._world.sent_on(self._key, topic, decode(topic, payload))

    def publish(self, topic: str, **fields: Any) -> Message:
        message = self._world.message(topic, self._key, **fields)
        self._world.sent_on(self._key, topic, message)
        return message

    def sequence_numbers(self) -> dict[str, int]:
        return {}


class World:
    """The link, the instrument, those who command, and a hand that is armed and moves all the time."""

    def __init__(self, folder: Path, way_ns: int) -> None:
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=EPOCH_NS)
        self.way_ns, self.is_linked = way_ns, True
        self.kept = {key: folder / f"{key}.kept" for key in (LINK, TIP)}
        self.loops: dict[str, NodeLoop] = {}
        self.buses: dict[str, _Bus] = {}
        self._numbers: dict[tuple[str, str], int] = {}
        # what is under way between the sites: when it arrives [ns], for whom, topic and message
        self._under_way: list[tuple[int, str, str, Message]] = []
        self.clients: list[CommandClient] = []
        # when a stop was given that the instrument has not obeyed [ns]
        self.owed_ns: int | None = None
        for key in (LINK, TIP):
            self.start(key)

    def message(self, topic: str, src: str, **fields: Any) -> Message:
        number = self._numbers[topic, src] = self._numbers.get((topic, src), -1) + 1
        model = TOPICS[topic].model
        header = {"seq": number, "t_ns": self.clock.now_ns(), "src": src, "v": model.version}
        made: Message = msgspec.convert({**header, **fields}, model)
        return made

    def start(self, key: str) -> None:
        """Start a process, which knows nothing of one before."""
        for place in [place for place in self._numbers if place[1] == key]:
            del self._numbers[place]
        self.buses[key] = bus = _Bus(self, key)
        context = NodeContext(key, self.clock, bus, _Log(key), kept_stop=self.kept[key])
        self.loops[key] = NodeLoop(self._node(context), bus, RealtimeStatus(fifo=False, memory_locked=False))

    def _node(self, context: NodeContext) -> Node:
        if context.key == TIP:
            config = AfmConfig()
            return AfmNode(context, config, simulated_afm(config.to_params()))
        outlets = (_Outlet(self, "delay_node@slave"), _Outlet(self, LINK))
        return DelayNode(context, LinkSettings(), *outlets, Path())

    def kill(self, key: str) -> None:
        self.loops.pop(key, None)

    def published(self, key: str, topic: str, message: Message) -> None:
        """Let what the instrument says cross to the link."""
        if key == TIP and TOPICS[topic].bridged in ("backward", "both") and self.is_linked:
            self._under_way.append((self.clock.monotonic_ns() + self.way_ns, LINK, topic, message))

    def sent_on(self, key: str, topic: str, message: Message) -> None:
        """Let what the link sends on arrive: at the other site while there is a network, here at once."""
        if key == LINK:
            for client in self.clients:
                client.on_event(message)
        elif self.is_linked:
            self._under_way.append((self.clock.monotonic_ns() + self.way_ns, TIP, topic, message))

    def give(self, topic: str, *, src: str, **fields: Any) -> None:
        """Hand a message to the link."""
        if LINK in self.loops:
            self.buses[LINK].bring(topic, self.message(topic, src, **fields))

    def arm(self) -> CommandClient:
        """Arm the tip as a person at the master's console does."""
        commands = [Command("arm", TIP, (TIP,))]
        publish = partial(self.give, src="console@master")
        client = CommandClient(self.clock, publish, commands)
        self.clients.append(client)
        return client

    def stop(self, *, by_file: bool) -> None:
        """Stop the tip once, and be gone: by the file of the link as well, as `telenano estop` does, or not."""
        number = f"stop-{self._numbers.get(('session/control', 'estop@master'), -1)}-{self.clock.now_ns()}"
        fields: dict[str, Any] = {"id": number, "command": "estop", "target": "*", "parameters": {}}
        src = "estop@master" if by_file else "console@master"
        if by_file:
            assert keep(self.kept[LINK], encode(self.message("session/control", src, **fields))) == ""
        self.give("session/control", src=src, **fields)
        if by_file:
            self.owed_ns = self.clock.monotonic_ns()

    @property
    def mode(self) -> str:
        if TIP not in self.loops:
            return "dead"
        node = self.loops[TIP].node
        assert isinstance(node, AfmNode)
        return safety.MODE_NAMES[node._memory.guard.mode]

    def run(self, duration_ns: int) -> None:
        end_ns = self.clock.monotonic_ns() + duration_ns
        while self.clock.monotonic_ns() < end_ns:
            self.step()

    def step(self) -> None:
        now_ns = self.clock.monotonic_ns()
        self.clients = [client for client in self.clients if not client.advance()]
        hand = {"hand_seq": 0, "hand_t_ns": self.clock.now_ns(), "hand_armed": True}
        still = {"position_m": ZERO, "velocity_m_per_s": ZERO, "force_n": ZERO, "wave_sqrt_w": None, "energy_j": None}
        self.give("teleop/forward", src="controller@master", law="virtual_impedance", active=True, **still, **hand)
        due = [entry for entry in self._under_way if entry[0] <= now_ns]
        self._under_way = [entry for entry in self._under_way if entry[0] > now_ns]
        for _, key, topic, message in due:
            if key in self.loops:
                self._arrive(key, topic, message)
        for key in (LINK, TIP):
            if key in self.loops:
                self.loops[key].turn()
        link: Any = self.loops[LINK].node if LINK in self.loops else None
        if self.owed_ns is None and self.mode != "estop" and link is not None and link._stop.identifier:
            # what a console sent is given once the link has taken it: a killed process has not
            self.owed_ns = now_ns
        self._judge(now_ns)
        self.clock.advance_ns(STEP_NS)

    def _arrive(self, key: str, topic: str, message: Message) -> None:
        if topic == "teleop/forward":
            # the half at the slave makes a command of it; the network is known, so that its delay is no age
            hand = {"hand_seq": 0, "hand_t_ns": self.clock.now_ns(), "hand_armed": message.hand_armed}  # type: ignore[attr-defined]
            fields = {"mode": "position", "base_position_m": (0.0, 0.0, 1e-8), **hand}
            self.buses[key].bring("afm/command", self.message("afm/command", "controller@slave", **fields))
        elif topic in ("session/control", "session/event"):
            assert isinstance(message, SessionControl | SessionEvent)
            self.buses[key].bring(topic, message)

    def _judge(self, now_ns: int) -> None:
        """Assert that the tip follows nothing between a stop and the moment at which it has obeyed it."""
        if self.owed_ns is None:
            return
        if self.mode == "estop":
            self.owed_ns = None
        elif now_ns - self.owed_ns > SETTLED_NS + self.way_ns:
            assert self.mode not in ("follow",), f"follows {(now_ns - self.owed_ns) / MS} ms after the stop"


@contextmanager
def world(way_ns: int = 0) -> Iterator[World]:
    folder = tempfile.mkdtemp()
    try:
        yield World(Path(folder), way_ns)
    finally:
        shutil.rmtree(folder)


ACTIONS = st.sampled_from(
    ["cut", "back", "arm", "stop", "stop_at_console", "kill_link", "start_link", "kill_tip", "start_tip"]
)
ORDERS = st.lists(st.tuples(st.sampled_from([0, 20, 60, 120, 300, 700, 1500]), ACTIONS), min_size=2, max_size=9)


def act(here: World, action: str) -> None:
    match action:
        case "cut" | "back":
            here.is_linked = action == "back"
        case "arm":
            here.arm()
        case "stop" | "stop_at_console":
            here.stop(by_file=action == "stop")
        case "kill_link" | "kill_tip":
            here.kill(LINK if action == "kill_link" else TIP)
        case "start_link" | "start_tip":
            key = LINK if action == "start_link" else TIP
            if key not in here.loops:
                here.start(key)


def check(order: list[tuple[int, str]], way_ms: int) -> None:
    with world(way_ms * MS) as here:
        here.run(100 * MS)
        here.arm()
        here.run(400 * MS)
        assert here.mode == "follow"
        for gap_ms, action in order:
            here.run(gap_ms * MS)
            act(here, action)
        # everything comes back, and those who sent before have given up
        for action in ("back", "start_link", "start_tip"):
            act(here, action)
        here.run(1500 * MS)
        assert here.owed_ns is None
        while here.clients:
            here.run(200 * MS)
        here.run(600 * MS)
        client = here.arm()
        here.run(1500 * MS)
        assert client.failure == ""
        assert here.mode == "follow"
        assert not any(path.exists() for path in here.kept.values())


@pytest.mark.parametrize(
    "order",
    [
        # a network that was away for less than it takes to withdraw the tip, and has lost the stop
        [(0, "cut"), (20, "stop_at_console"), (60, "back")],
        # the stop is lost, the line comes back, and a person arms before the stop can arrive
        [(0, "cut"), (700, "stop_at_console"), (700, "arm"), (300, "back"), (0, "arm")],
        # the link is killed after it has taken the stop, and the console is gone
        [(0, "cut"), (300, "stop_at_console"), (60, "kill_link"), (300, "start_link"), (1500, "back")],
        # the link does not run when the stop is given
        [(0, "kill_link"), (20, "stop"), (300, "start_link")],
        # the instrument is started again meanwhile, and knows of no stop
        [(0, "cut"), (60, "stop"), (300, "kill_tip"), (300, "start_tip"), (60, "arm"), (60, "back")],
    ],
)
@pytest.mark.parametrize("way_ms", [0, 20, 250])
def test_a_stop_that_the_network_has_lost_is_obeyed_first(order: list[tuple[int, str]], way_ms: int) -> None:
    check(order, way_ms)


def test_what_the_link_repeats_is_no_loss_to_its_reader() -> None:
    """Repeat a stop over a long way, as `telenano estop` and the link do by turns, and then another one."""
    with world(250 * MS) as here:
        here.run(100 * MS)
        for _ in range(2):
            fields: dict[str, Any] = {"id": f"stop-{here.clock.now_ns()}", "command": "estop", "target": "*"}
            for number in range(8):
                here._numbers["session/control", "estop@master"] = number - 1
                here.give("session/control", src="estop@master", parameters={}, **fields)
                here.run((60 if number % 3 else 420) * MS)
            here.run(1500 * MS)
            assert here.mode == "estop"
        tracker = here.buses[TIP].trackers["session/control", "estop@master"]
        assert (tracker.lost, tracker.gaps) == (0, 0)
        assert tracker.received > 16


def test_a_stop_that_is_kept_once_more_after_it_was_obeyed_is_not_sent_again() -> None:
    """Write the file late, as a sender does that has not heard the answer in its five seconds."""
    with world() as here:
        here.run(100 * MS)
        here.stop(by_file=True)
        content = here.kept[LINK].read_bytes()
        here.run(300 * MS)
        assert here.mode == "estop"
        assert not here.kept[LINK].exists()
        here.kept[LINK].write_bytes(content)
        here.run(1000 * MS)
        assert not here.kept[LINK].exists()
        here.arm()
        here.run(1500 * MS)
        assert here.mode == "follow"


@pytest.mark.parametrize("command", ["arm", "stop"])
def test_a_state_whose_stop_is_another_command_is_refused(command: str) -> None:
    fields = {"id": "a", "command": command, "target": TIP, "parameters": {}}
    with world() as here:
        payload = encode(here.message("session/control", "console@master", **fields))
    with pytest.raises(ValueError, match=f"is no emergency stop.*command='{command}'"):
        FarStop(None, FarStopState(payload=payload))


QUIET = [HealthCheck.too_slow, HealthCheck.data_too_large]


@pytest.mark.check("sixty drawn networks take 5 s")
@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=QUIET)
@given(ORDERS, st.sampled_from([0, 20, 250]))
def test_a_stop_is_obeyed_before_anything_follows_however_late(order: list[tuple[int, str]], way_ms: int) -> None:
    check(order, way_ms)
