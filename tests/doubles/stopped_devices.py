"""Both device nodes in virtual time; tests stop, kill and arm them with the project's client and with others."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from services.afm_node.node import AfmNode
from services.haptic_node.node import HapticNode
from telenano.afm import safety
from telenano.afm.sim import simulated_afm
from telenano.hand.sim import SimulatedHaptic
from telenano.runtime.loop.arming import ARM
from telenano.runtime.loop.commands import Command, CommandClient
from telenano.runtime.loop.kept_stop import keep
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import Node, NodeContext
from telenano.runtime.loop.node_loop import NodeLoop
from telenano.runtime.loop.realtime import RealtimeStatus
from telenano.sections.afm_section import AfmConfig
from telenano.sections.hand_section import HapticConfig
from telenano.testing import VirtualClock
from telenano.wire import encode
from telenano.wire.messages import Message, SessionControl, SessionEvent
from telenano.wire.nodes import is_meant, site_of
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival
from telenano.wire.topics import TOPICS

TIP, HAND = "afm_node@slave", "haptic_node@master"
DEVICES = (TIP, HAND)
MS = 1_000_000
# Step of the world, shorter than the 50 ms after which a process counts as stalled.
STEP_NS = 40 * MS
SECOND_NS = 1000 * MS
_DEADLINE_NS = 50 * MS
EPOCH_NS = 10**18


class _Log(StructuredLog):
    def write(self, level: str, text: str, **facts: Any) -> None:
        """Write nothing."""


class _Bus:
    """The bus of one device: messages that wait at its inlet and elsewhere; its answers go to the world."""

    def __init__(self, world: "World", key: str) -> None:
        self._world, self._key = world, key
        self.waiting: list[Received] = []
        self.inlet: list[Received] = []

    def publish(self, topic: str, **fields: Any) -> Any:
        if topic == "haptic/state":
            self._world.hand_sample = self._world.clock.now_ns(), fields["armed"]
        if topic == "session/event":
            header = {"seq": 0, "t_ns": self._world.clock.now_ns(), "src": self._key, "v": 1}
            self._world.answers.append(
                (
                    self._world.clock.monotonic_ns() + self._world.way_ns,
                    msgspec.convert({**header, **fields}, SessionEvent),
                )
            )

    def receive(self) -> Iterator[Received]:
        first, last = (self.inlet, self.waiting) if self._world.inlet_first else (self.waiting, self.inlet)
        taken = [*first, *last]
        self.waiting, self.inlet = [], []
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


class Device:
    """The process of a device: it runs, stands still (SIGSTOP), or is dead until it is started again."""

    def __init__(self, world: "World", key: str) -> None:
        self._world, self.key = world, key
        self.kept = world.folder / f"{key}.kept"
        self.stands_still = self.is_dead = False
        self.start()

    def start(self) -> None:
        self.is_dead = self.stands_still = False
        self.bus = _Bus(self._world, self.key)
        context = NodeContext(self.key, self._world.clock, self.bus, _Log(self.key), kept_stop=self.kept)
        self.loop = NodeLoop(_node(context), self.bus, RealtimeStatus(fifo=False, memory_locked=False))

    @property
    def runs(self) -> bool:
        return not (self.is_dead or self.stands_still)

    @property
    def mode(self) -> str:
        node = self.loop.node
        if isinstance(node, AfmNode):
            return safety.MODE_NAMES[node._memory.guard.mode]
        assert isinstance(node, HapticNode)
        return "estop" if node._memory.guard.estop_latched else "free"

    def turn(self) -> None:
        if self.runs:
            self.bus.waiting += self._commands()
            self.loop.turn()

    def _commands(self) -> list[Received]:
        """Return the present command of the law; the tip's one descends from the hand's newest sample, if linked."""
        now_ns = self._world.clock.now_ns()
        if self.key == TIP and not self._world.is_linked:
            return []
        if self.key == TIP:
            sampled_ns, armed = self._world.hand_sample
            hand = {"hand_seq": 0, "hand_t_ns": sampled_ns, "hand_armed": armed}
            command = self._world.message(
                "afm/command",
                "controller@slave",
                mode="hold" if self._world.no_position else "position",
                base_position_m=(0.0, 0.0, 1e-8),
                **hand,
            )
            return [command]
        still = (0.0, 0.0, 0.0)
        fields = {"position_m": still, "velocity_m_per_s": still, "force_n": still, "hand_seq": 0, "hand_t_ns": now_ns}
        return [self._world.message("haptic/command", "controller@master", mode="position", **fields)]


def _node(context: NodeContext) -> Node:
    if context.key == TIP:
        afm = AfmConfig()
        return AfmNode(context, afm, simulated_afm(afm.to_params()))
    hand = HapticConfig()
    return HapticNode(context, hand, SimulatedHaptic(hand.to_plant_params(), 0.0))


class _Stop(NamedTuple):
    """A running `telenano estop`, which is sent to the inlets until all have answered, or it gives up."""

    control: SessionControl
    until_ns: int
    missing: set[str]


class World:
    """Two devices, the programs that command them, and the delay between these."""

    def __init__(self, folder: Path, *, way_ns: int = 0, inlet_first: bool = True, hears_stops: bool = True) -> None:
        """Begin with both devices, not armed.

        Parameters: way_ns, delay of commands and of answers [ns]; inlet_first, whether a device reads its inlet before
        its other sockets; hears_stops, whether the commanding programs receive the answers to an emergency stop.
        """
        self._hears_stops = hears_stops
        self.folder, self.way_ns, self.inlet_first = folder, way_ns, inlet_first
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=EPOCH_NS)
        self.no_position = False
        # Time of the hand's last sample [ns], and whether it was armed then; whether its samples reach the tip.
        self.hand_sample, self.is_linked = (EPOCH_NS, False), True
        # Time at which the hand was last armed and running [ns].
        self._armed_ns = -SECOND_NS
        self.answers: list[tuple[int, SessionEvent]] = []
        self._coming: list[tuple[int, SessionControl]] = []
        self.clients: list[CommandClient] = []
        self._naive: list[tuple[int, str]] = []
        self._stops: list[_Stop] = []
        self.heard: list[SessionEvent] = []
        self.devices = {key: Device(self, key) for key in DEVICES}
        # Run until there is a position to follow.
        self.run(5 * STEP_NS)

    def message(self, topic: str, src: str, **fields: Any) -> Received:
        now_ns = self.clock.now_ns()
        model = TOPICS[topic].model
        header = {"seq": 0, "t_ns": now_ns, "src": src, "v": model.version}
        made: Message = msgspec.convert({**header, **fields}, model)
        return Received(topic, made, b"", now_ns, Arrival.NEXT)

    def send(self, src: str) -> Callable[..., None]:
        """Return the function with which a console or the launcher publishes commands."""

        def publish(topic: str, **fields: Any) -> None:
            control = self.message(topic, src, **fields).message
            assert isinstance(control, SessionControl)
            self._coming.append((self.clock.monotonic_ns() + self.way_ns, control))

        return publish

    def arm(self, *targets: str, launcher: bool = False, waited_ns: int = 0) -> CommandClient:
        """Arm devices like a person at a console, or like the launcher at the start of a session."""
        src = "launcher@master" if launcher else "console@master"
        steps = list(ARM) if launcher else [Command("arm", target, (target,)) for target in targets or DEVICES]
        options: dict[str, Any] = {"retry_ns": 5000 * MS, "releases_stops": False} if launcher else {}
        issued_ns = self.clock.monotonic_ns() - waited_ns
        self.clients.append(CommandClient(self.clock, self.send(src), steps, issued_ns=issued_ns, **options))
        return self.clients[-1]

    def arm_naively(self, duration_ns: int) -> None:
        """Arm like a simple program that sends a new command in each step, and quotes nothing."""
        self._naive.append((self.clock.monotonic_ns() + duration_ns, "*"))

    def withdraw(self) -> None:
        self.send("launcher@master")(
            "session/control", id=os.urandom(8).hex(), command="stop", target="afm_node", parameters={}
        )

    def stop(self, repeated_ns: int) -> None:
        """Stop both devices like `telenano estop`, which gives up after `repeated_ns` [ns]."""
        fields = {"id": os.urandom(8).hex(), "command": "estop", "target": "*", "parameters": {}}
        control = self.message("session/control", "estop@slave", **fields).message
        assert isinstance(control, SessionControl)
        for key in DEVICES:
            keep(self.devices[key].kept, encode(control))
        self._stops.append(_Stop(control, self.clock.monotonic_ns() + repeated_ns, set(DEVICES)))

    def stop_at_console(self) -> None:
        self.clients.append(CommandClient(self.clock, self.send("console@master"), [Command("estop", "*", DEVICES)]))

    def run(self, duration_ns: int) -> None:
        end_ns = self.clock.monotonic_ns() + duration_ns
        while self.clock.monotonic_ns() < end_ns:
            self.step()

    def step(self) -> None:
        """Let a step of time pass: all programs send, and the devices process arrived messages."""
        now_ns = self.clock.monotonic_ns()
        self.clients = [client for client in self.clients if not client.advance()]
        for until_ns, target in self._naive:
            if now_ns < until_ns:
                self.send("console@master")(
                    "session/control", id=os.urandom(8).hex(), command="arm", target=target, parameters={}
                )
        self._send_stops(now_ns)
        due = [control for at_ns, control in self._coming if at_ns <= now_ns]
        self._coming = [(at_ns, control) for at_ns, control in self._coming if at_ns > now_ns]
        for device in self.devices.values():
            for control in due if not device.is_dead else ():
                device.bus.waiting.append(Received("session/control", control, b"", self.clock.now_ns(), Arrival.NEXT))
            device.turn()
        self._judge(now_ns)
        self._hand_out(now_ns)
        self.clock.advance_ns(STEP_NS)

    def _judge(self, now_ns: int) -> None:
        """Assert that the tip follows only a hand that is armed, or was so within a deadline and two steps."""
        hand, tip = self.devices[HAND], self.devices[TIP]
        assert isinstance(hand.loop.node, HapticNode)
        if hand.runs and hand.loop.node._memory.guard.armed:
            self._armed_ns = now_ns
        if tip.runs and tip.mode == "follow":
            assert now_ns - self._armed_ns <= _DEADLINE_NS + 2 * STEP_NS

    def _send_stops(self, now_ns: int) -> None:
        for stop in list(self._stops):
            # Only a running process completes a connection, before which nothing is sent on it.
            for key in [key for key in stop.missing if self.devices[key].runs]:
                self.devices[key].bus.inlet.append(
                    Received("session/control", stop.control, b"", self.clock.now_ns(), Arrival.NEXT)
                )
            if now_ns >= stop.until_ns and stop.missing:
                for key in stop.missing:
                    keep(self.devices[key].kept, encode(stop.control))
            if now_ns >= stop.until_ns or not stop.missing:
                self._stops.remove(stop)

    def _hand_out(self, now_ns: int) -> None:
        due = [event for at_ns, event in self.answers if at_ns <= now_ns]
        self.answers = [(at_ns, event) for at_ns, event in self.answers if at_ns > now_ns]
        for event in due:
            self.heard.append(event)
            for client in self.clients if self._hears_stops or event.data.get("command") != "estop" else ():
                client.on_event(event)
        for stop in self._stops:
            # The stopping program reads the sockets of the devices directly.
            answered = {event.src for event in due if event.id == stop.control.id and event.kind == "ack"}
            stop.missing.difference_update(answered)

    def go_on(self) -> None:
        """Start dead processes, and let all run."""
        for device in self.devices.values():
            if device.is_dead:
                device.start()
            device.stands_still = False

    def modes(self) -> dict[str, str]:
        return {key: device.mode for key, device in self.devices.items()}


STOPPED = dict.fromkeys(DEVICES, "estop")
ARMED = {TIP: "follow", HAND: "free"}
assert all(is_meant(key, "*") and site_of(key) for key in DEVICES)
