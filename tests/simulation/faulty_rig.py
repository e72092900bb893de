"""A rig of two sites in virtual time under a schedule of faults, recorded at both sites.

    outcome = run(Schedule.drawn(7), Path("out"))

The folder then contains the input of the judge: the recordings of both sites, the schedule, a history of outside
actions (`history.json`), and a ledger of every message sent (`ledger.msgpack`).
"""

import contextlib
import dataclasses
import gc
import json
import zlib
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple
from unittest import mock

import msgpack
from fault_schedule import HAND, LINK, PAGE, RECOVERY_S, TIP, Event, Schedule
from faulty_devices import FaultyHand, FaultyTip
from faulty_disk import FaultyDisk
from faulty_network import Way

import services.afm_node.__main__ as afm_process
import services.haptic_node.__main__ as haptic_process
from telenano.launcher.plan import Plan
from telenano.launcher.run import Outcome, outcome_of
from telenano.runtime.loop import kept_stop
from telenano.runtime.loop.arming import ARM_HAND, ARM_TIP, PLACE_TIP, START
from telenano.runtime.loop.commands import Command, CommandClient
from telenano.runtime.loop.deadlines import PeriodicDeadline
from telenano.runtime.loop.node import Node, NodeContext
from telenano.runtime.loop.node_loop import STARTING_PERIOD_NS, NodeLoop
from telenano.runtime.wiring.main import EXIT_DIED
from telenano.timing.clock import NEVER_NS, Clock, VirtualClock
from telenano.virtual.bus import RecorderWay, VirtualBus
from telenano.virtual.request import SimulateRequest, plan_of
from telenano.virtual.rig import BEGIN_NS, EPOCH_OFFSET_NS, LINK_ENDPOINT
from telenano.virtual.session import SimulatedRig
from telenano.virtual.timing import RANDOM_TIMING
from telenano.virtual.wiring import VirtualWiring
from telenano.wire import TOPICS, Message
from telenano.wire.codec import encode, read_header
from telenano.wire.messages import SessionControl, SessionEvent
from telenano.wire.nodes import FAR_RECORDER, KEEPERS, LAUNCHER, RECORDER, STOP_ORDER, is_meant, name_of, site_of
from telenano.wire.received import Received

# Messages of a turn have equal stamps, because the stamps of a real process never go back.
_TIMING = dataclasses.replace(RANDOM_TIMING, sending=(10_000, 10_001))
_KILLED = -9
# Time after the first message of a process that came back until a recorder is connected to it [ns].
_CONNECTING_NS = (0, 60_000_000)
_PERSON_NS = 20_000_000
_STOP_NS = 50_000_000
_STOP_PATIENCE_NS = 5_000_000_000
# Time after which a session that does not end is ended; a launcher waits a minute for nodes that are not ready.
_LONGEST_S = 90.0
# Number of successive turns of a node without progress of time after which it would go on forever.
_MOST_TURNS = 1000
_PROFILE = [(0.4, 0.0), (0.7, 1.0), (3.7, 1.0), (4.0, 1.6), (7.6, 1.6), (7.9, 0.0)]
# Folder of the kept stops, in the folder of the session, which is the working directory while it runs.
KEPT = Path("kept")


class Killed(BaseException):
    """Ends a process at once, without any cleanup."""


class StandsStillError(Exception):
    """A node takes turn after turn without progress of time."""


class MachineClock:
    """The clock of a machine, with an offset and a drift against that of the rig."""

    def __init__(self, base: VirtualClock, ahead_ns: int = 0, drift_ppm: float = 0.0) -> None:
        """Begin now; `base` is the clock of the rig."""
        self._base, self._begun_ns = base, base.monotonic_ns()
        self._rate = 1.0 + 1e-6 * drift_ppm
        self.epoch_offset_ns = base.epoch_offset_ns + ahead_ns

    def monotonic_ns(self) -> int:
        passed_ns = self._base.monotonic_ns() - self._begun_ns
        return self._begun_ns + (passed_ns if self._rate == 1.0 else round(passed_ns * self._rate))

    def now_ns(self) -> int:
        return self.monotonic_ns() + self.epoch_offset_ns

    def on_rig_ns(self, time_ns: int) -> int:
        """Convert a time on this monotonic clock to that of the rig, rounded up [ns]."""
        if self._rate == 1.0 or time_ns >= NEVER_NS:
            return time_ns
        return self._begun_ns + int(-(-(time_ns - self._begun_ns) // self._rate)) + 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class _KeepingWiring(VirtualWiring):
    """The wiring of a node, with the path of the stop that is kept for it."""

    def kept_stop(self) -> Path | None:
        return kept_path(self.key) if self.key in KEEPERS else None


def kept_path(key: str) -> Path:
    """Return the path of the stop kept for a node, below the folder of the session."""
    return KEPT / f"{key}.estop.kept"


class PersonNode(Node):
    """The console of a person who gives commands and reads the answers."""

    inputs: ClassVar[tuple[str, ...]] = ("session/event", "node/health")
    period_s = _PERSON_NS * 1e-9

    def __init__(self, context: NodeContext, note: Callable[..., None]) -> None:
        super().__init__(context)
        self._clients: list[tuple[CommandClient, str]] = []
        self._note = note
        # The force of a person who pushes the hand from a page, which sends it at each frame [N].
        self.pushes: Callable[[], float] | None = None
        self._ticks = PeriodicDeadline(self.clock.monotonic_ns(), _PERSON_NS)

    def give(self, commands: Sequence[Command], name: str) -> None:
        """Give commands one after the other."""
        client = CommandClient(self.clock, self.publish, commands, token=self.context.machine.token, retry_ns=10**9)
        self._clients.append((client, name))
        targets = [command.target for command in commands]
        self._note("command", name=name, targets=targets, sender=client._sender, console=self.context.key)

    def deadline_ns(self) -> int:
        return self._ticks.deadline_ns

    def on_message(self, received: Received) -> None:
        if isinstance(received.message, SessionEvent):
            for client, _ in self._clients:
                client.on_event(received.message)

    def on_deadline(self, now_ns: int) -> None:
        self._ticks.advance(now_ns)
        if self.pushes is not None:
            self.publish("operator/force", force_n=(0.0, 0.0, -self.pushes()))
        for client, name in [one for one in self._clients if one[0].advance()]:
            self._clients.remove((client, name))
            self._note("answered", name=name, sender=client._sender, failure=client.failure, void=client.void)

    def make_safe(self) -> None:
        """Do nothing: a console moves no device."""


class _Press(NamedTuple):
    """An emergency stop that is sent until each device has answered: its id, target, devices and time of begin [ns]."""

    id: str
    target: str
    devices: frozenset[str]
    begun_ns: int


class StopNode(Node):
    """Acts like `telenano estop` at a site: keeps a stop in files, and sends it until the devices have answered."""

    inputs: ClassVar[tuple[str, ...]] = ("session/event",)
    period_s = _STOP_NS * 1e-9

    def __init__(self, context: NodeContext, note: Callable[..., None]) -> None:
        super().__init__(context)
        self._presses: list[tuple[_Press, set[str]]] = []
        self._note = note
        self._ticks = PeriodicDeadline(self.clock.monotonic_ns(), _STOP_NS)

    def press(self, target: str) -> None:
        """Stop the devices that a target addresses: at this site, and from the master's site also through the link."""
        site = site_of(self.context.key)
        devices = frozenset(
            node for node in (HAND, TIP) if is_meant(node, target) and (site == "master" or site_of(node) == site)
        )
        press = _Press(self.context.machine.token(12), target, devices, self.clock.monotonic_ns())
        self._presses.append((press, set()))
        kept = self._keep(press)
        self._note("press", id=press.id, site=site, devices=sorted(devices), kept=kept)
        self._send(press)

    def deadline_ns(self) -> int:
        return self._ticks.deadline_ns

    def on_message(self, received: Received) -> None:
        event = received.message
        if isinstance(event, SessionEvent) and event.kind == "ack":
            for press, answered in self._presses:
                if event.id == press.id:
                    answered.add(event.src)

    def on_deadline(self, now_ns: int) -> None:
        self._ticks.advance(now_ns)
        for press, answered in list(self._presses):
            is_late = self.clock.monotonic_ns() - press.begun_ns >= _STOP_PATIENCE_NS
            if press.devices <= answered or is_late:
                self._presses.remove((press, answered))
                missing = sorted(press.devices - answered)
                kept = self._keep(press) if missing else []
                self._note("pressed", id=press.id, missing=missing, kept=kept)
            else:
                self._send(press)

    def make_safe(self) -> None:
        """Do nothing: this node moves no device."""

    def _send(self, press: _Press) -> None:
        self.publish("session/control", id=press.id, command="estop", target=press.target, parameters={})

    def _keep(self, press: _Press) -> list[str]:
        """Keep a stop for devices of this site, and at the link for the tip; return the nodes that have it."""
        site = site_of(self.context.key)
        keepers = [node for node in press.devices if site_of(node) == site]
        if TIP in press.devices and site == "master":
            keepers.append(LINK)
        stop = SessionControl(
            seq=0, t_ns=self.clock.now_ns(), src=self.context.key, v=1, id=press.id, command="estop",
            target=press.target, parameters={},
        )  # fmt: skip
        return [node for node in sorted(keepers) if not kept_stop.keep(kept_path(node), encode(stop))]


class FaultyRig(SimulatedRig):
    """A session of a plan under a schedule of faults."""

    def __init__(self, plan: Plan, schedule: Schedule) -> None:
        """Prepare the session; files of kept stops are in the working directory."""
        self.schedule = schedule
        self.history: list[dict[str, Any]] = []
        # Every message sent: its publisher, topic, number, stamp, the time of the rig, and a checksum.
        self.ledger: list[tuple[str, str, int, int, int, int]] = []
        # What a device was told and gave, at each step, after its name and the time of the rig.
        self.world: list[tuple[Any, ...]] = []
        self.ways = {name: Way(schedule.seed, name, schedule.delay_s) for name in ("forward", "backward")}
        self._machines: dict[str, MachineClock] = {}
        # Nodes that were started before, and by endpoint the time from which on a recorder hears it again [ns].
        self._begun: set[str] = set()
        self._connected_ns: dict[str, int] = {}
        # The nodes of each process that has several, by each of them.
        self._mates = {key: keys for keys in plan.joined.values() for key in keys}
        self._clock_event: Event = next((one for one in schedule.events if one["kind"] == "clock"), {})
        self._sets_clocks = any(one["kind"] in ("clock", "site_restart") for one in schedule.events)
        self._doomed: dict[str, int] = {}
        self._faults: dict[str, tuple[str, float]] = {}
        self._fate: tuple[bytes, list[Any]] = (b"", [])
        self._newest_turn, self._repeats = ("", 0), 0
        disk = FaultyDisk(lambda: self.now_s, self._stall_recorder)
        super().__init__(plan, schedule.seed, timing=_TIMING, disk=disk, far=True)
        self.faulty_disk = disk
        self.people: dict[str, PersonNode] = {}
        self.stops: dict[str, StopNode] = {}
        for key in ("console@master", PAGE):
            bus = VirtualBus(self, key, PersonNode.inputs)
            self.people[key] = PersonNode(self.wiring(key).context(bus), self.note)
            self.run_node(key, self.people[key], bus)
        if schedule.operator == "page":
            self.people[PAGE].pushes = lambda: _pushed_n(self.now_s)
        for key in ("estop@master", "estop@slave"):
            bus = VirtualBus(self, key, StopNode.inputs)
            self.stops[key] = StopNode(self.wiring(key).context(bus), self.note)
            self.run_node(key, self.stops[key], bus)

    @property
    def now_s(self) -> float:
        """Time since the processes were started [s]."""
        return (self.clock.monotonic_ns() - BEGIN_NS) * 1e-9

    def account(self, device: str, *told: Any) -> None:
        """Add a step of a device to the account of the world."""
        self.world.append((device, self.clock.monotonic_ns() - BEGIN_NS, *told))

    def note(self, what: str, **facts: Any) -> None:
        """Add an outside action, or an answer to a person, to the history."""
        self.history.append({"t_ns": self.clock.monotonic_ns() - BEGIN_NS, "what": what, **facts})

    def clock_of(self, key: str) -> Clock:
        machine = "master" if name_of(key) == name_of(LINK) else site_of(key)
        if machine == "master" or not self._sets_clocks:
            return self.clock
        if machine not in self._machines:
            given = self._clock_event
            self._machines[machine] = MachineClock(
                self.clock, round(1e9 * given.get("ahead_s", 0.0)), given.get("drift_ppm", 0.0)
            )
        return self._machines[machine]

    def wiring(self, key: str, given: NodeContext | None = None) -> VirtualWiring:
        usual = super().wiring(key, given)
        return _KeepingWiring(**{field.name: getattr(usual, field.name) for field in dataclasses.fields(usual)})

    def mates(self, key: str) -> tuple[str, ...]:
        """Return the nodes that share the process of a node, itself among them."""
        return self._mates.get(key, (key,))

    def fault_of(self, device: str) -> str:
        """Return the present fault of a device; empty if there is none."""
        fault, until_s = self._faults.get(device, ("", 0.0))
        return fault if self.now_s < until_s else ""

    def run_schedule(self) -> Outcome:
        """Run the session to its end, with the events of the schedule."""
        self.plan.prepare_folder()
        loop = self.loops[LAUNCHER]
        collects = gc.isenabled()
        gc.disable()
        try:
            self.launcher.launch()
            for at_s, act in self._acts():
                self.advance(BEGIN_NS + round(1e9 * at_s))
                if self.is_over:
                    break
                self.clock.advance_ns(max(0, BEGIN_NS + round(1e9 * at_s) - self.clock.monotonic_ns()))
                act()
            self.advance(BEGIN_NS + round(1e9 * _LONGEST_S))
        finally:
            if collects:
                gc.enable()
            self.note("end", over=self.is_over)
            self._due_of.pop(LAUNCHER, None)
            self._doomed.clear()
            self.is_over = False
            loop.end()
            self.close()
        self.faulty_disk.write_out()
        return outcome_of(self.launcher, self.plan)

    def _acts(self) -> Iterator[tuple[float, Callable[[], None]]]:
        for event in sorted(self.schedule.events, key=lambda one: one["at_s"]):
            yield event["at_s"], lambda event=event: self._happen(event)  # type: ignore[misc]
        calm_s = self.schedule.calm_s
        # A force profile continues, unless it or its process was stopped.
        stopped = any(one["kind"] == "stop" or HAND in self.mates(one.get("node", "")) for one in self.schedule.events)
        again = (ARM_HAND, PLACE_TIP, *([START] if stopped else []))
        yield calm_s, lambda: self.people["console@master"].give(again, "recover")
        yield calm_s + RECOVERY_S, lambda: self.note("recovered")

    def _happen(self, event: Event) -> None:
        self.note("event", event=event)
        getattr(self, f"_on_{event['kind']}")(event)

    def _on_delay(self, event: Event) -> None:
        for name, way in self.ways.items():
            way.delay_s = event[f"{name}_s"]

    def _ways_of(self, event: Event) -> list[Way]:
        return [way for name, way in self.ways.items() if event["direction"] in (name, "both")]

    def _on_line(self, event: Event) -> None:
        for way in self._ways_of(event):
            way.spoil(event, self.now_s)

    def _on_partition(self, event: Event) -> None:
        for way in self._ways_of(event):
            way.cut(self.now_s, event["for_s"])

    def _on_narrow(self, event: Event) -> None:
        for way in self._ways_of(event):
            way.narrow(self.now_s, event["for_s"], event["bytes_per_s"])

    def _on_clock(self, event: Event) -> None:
        """Do nothing: the slave's clock has this offset from its start on."""

    def _on_site_restart(self, event: Event) -> None:
        before = self._machines.get("slave")
        ahead_ns = round(1e9 * event["ahead_s"])
        for key in [
            key for key in self.loops if site_of(key) == "slave" and name_of(key) not in ("estop", name_of(LINK))
        ]:
            self._kill(key, 0.0)
        after = MachineClock(
            self.clock, (before.epoch_offset_ns - self.clock.epoch_offset_ns if before else 0) + ahead_ns
        )
        self._machines["slave"] = after

    def _on_disk(self, event: Event) -> None:
        self.faulty_disk.begin(event["site"], event["fault"], event["for_s"])

    def _on_kill(self, event: Event) -> None:
        how = event.get("how", "killed")
        if how == "replaced":
            self._replace(event["node"])
        elif how != "killed":
            self._end(event["node"], failed=how == "failed")
        elif event["after"]:
            self._doomed[event["node"]] = event["after"]
        else:
            self._kill(event["node"], event["torn"])

    def _on_stall(self, event: Event) -> None:
        for key in self.mates(event["node"]):
            if key in self.loops:
                self.note("stalled", node=key, for_s=event["for_s"])
        if event["node"] in self.loops:
            self.stall(event["node"], event["for_s"])

    def _on_device(self, event: Event) -> None:
        self._faults[event["device"]] = event["fault"], self.now_s + event["for_s"]

    def _on_press(self, event: Event) -> None:
        self.stops[f"estop@{event['site']}"].press(event["target"])

    def _on_arm(self, event: Event) -> None:
        tip = PLACE_TIP if event["place"] else ARM_TIP
        commands = {"hand": (ARM_HAND,), "tip": (tip,), "both": (ARM_HAND, tip)}[event["target"]]
        busy = [key for key, one in self.people.items() if one._clients]
        console = PAGE if "console@master" in busy else "console@master"
        self.people[console].give(commands, "arm")

    def _on_start(self, event: Event) -> None:
        self.people["console@master"].give((START,), "start")

    def _on_stop(self, event: Event) -> None:
        self.people["console@master"].give((Command("stop", "*", (HAND,)),), "stop")

    def _on_law(self, event: Event) -> None:
        command = Command("set", "controller", ("controller@master", "controller@slave"), {"law": event["law"]})
        self.people["console@master"].give((command,), "law")

    def _on_link(self, event: Event) -> None:
        given = {f"{way}.delay_s": event["delay_s"] for way in self.ways}
        given |= {f"{way}.loss.probability": event["loss"] for way in self.ways}
        self.people[PAGE].give((Command("set", "delay_node", (LINK,), given),), "link")

    def stall(self, key: str, duration_s: float) -> None:
        for mate in self.mates(key):
            until_ns = self._stalled_until_ns.get(mate, 0)
            super().stall(mate, duration_s)
            self._stalled_until_ns[mate] = max(self._stalled_until_ns[mate], until_ns)

    def _stall_recorder(self, key: str, duration_s: float) -> None:
        if key in self.loops:
            self.stall(key, duration_s)

    def _kill(self, key: str, torn: float) -> None:
        for mate in self.mates(key) if key in self.loops else ():
            self.note("killed", node=mate)
            if name_of(mate) == name_of(RECORDER):
                self.faulty_disk.tear(site_of(mate), torn)
            self._doomed.pop(mate, None)
            self.leave(mate)
            self._processes.died(mate, _KILLED)

    def _end(self, key: str, *, failed: bool) -> None:
        """End a process in order, as a signal does, or by an error in one of its turns."""
        if key not in self.loops:
            return
        if failed:
            self.loops[key].report_failure(RuntimeError("an error of the schedule"))
        self.end(key)
        for mate in self.mates(key):
            self._processes.died(mate, EXIT_DIED if failed else 0)

    def _replace(self, key: str) -> None:
        """End a process in order and start another one at once, as who runs the processes does for a new version."""
        if key in self.loops:
            self.end(key)
            self.start(key, starting_period_ns=STARTING_PERIOD_NS)
            self.stall(key, self.draw(self.timing.start, "start", key) * 1e-9)

    def _hears(self, endpoint: str, sent_ns: int) -> bool:
        """Return whether recorders are connected to an endpoint; to one that came back, some time after it sends."""
        if self._connected_ns.get(endpoint) == NEVER_NS:
            self._connected_ns[endpoint] = sent_ns + self.draw(_CONNECTING_NS, "connecting", endpoint)
        return sent_ns >= self._connected_ns.get(endpoint, 0)

    def start(self, key: str, takes_ns: int = 0, **options: Any) -> Node:
        """Start the process of a node, with new endpoints, unless it runs for another node already."""
        for mate in self.mates(key) if key not in self.loops else ():
            if mate == LINK:
                self._endpoints.pop(LINK_ENDPOINT, None)
            if mate in self._begun:
                self._connected_ns |= dict.fromkeys((LINK, LINK_ENDPOINT) if mate == LINK else (mate,), NEVER_NS)
            self._begun.add(mate)
            self.note("started", node=mate)
            super().start(mate, takes_ns, **options)
        return self.loops[key].node

    def turn(self, key: str, loop: NodeLoop) -> None:
        place = (key, self.clock.monotonic_ns())
        self._repeats = self._repeats + 1 if place == self._newest_turn else 0
        self._newest_turn = place
        if self._repeats > _MOST_TURNS:
            raise StandsStillError(f"{key} takes turn after turn at {self.now_s:.3f} s")
        try:
            super().turn(key, loop)
        except Killed:
            self._kill(key, 0.5)
        else:
            if key not in self.loops:
                # A turn that has failed has ended the process, of which the engine knows this node alone.
                for mate in self.mates(key):
                    self._processes.died(mate)

    def end(self, key: str) -> None:
        """End the process of a node: each node of it, in the order in which a site ends them."""
        for mate in sorted(self.mates(key), key=STOP_ORDER.index):
            if mate in self.loops:
                self._doomed.pop(mate, None)
                self.note("ended", node=mate)
                super().end(mate)

    def _due_ns(self, key: str) -> int:
        loop = self.loops[key]
        clock = loop.node.context.clock
        if not isinstance(clock, MachineClock):
            return super()._due_ns(key)
        own_ns = clock.on_rig_ns(min(loop.node.deadline_ns(), loop.health_due_ns))
        arrives_ns = self.buses[key].next_ns()
        return max(min(own_ns, arrives_ns) + self._late_ns[key], self._stalled_until_ns[key])

    def carry(self, topic: str, message: Message, payload: bytes, sent_ns: int) -> None:
        src = message.src
        if src in self._doomed:
            self._doomed[src] -= 1
            if self._doomed[src] < 0:
                del self._doomed[src]
                raise Killed
        self._enter(topic, payload, src, message.seq, message.t_ns, sent_ns)
        super().carry(topic, message, payload, sent_ns)

    def _enter(self, topic: str, payload: bytes, src: str, seq: int, t_ns: int, sent_ns: int) -> None:
        self.ledger.append((src, topic, seq, t_ns, sent_ns - BEGIN_NS, zlib.crc32(payload)))

    def forward(self, endpoint: str, topic: str, payload: bytes) -> None:
        if topic == "session/control" and payload not in self.messages and payload not in self._older:
            # A copy of a stop kept by the link is a new message.
            seq, t_ns, src = read_header(topic, payload)
            self._enter(topic, payload, src, seq, t_ns, self.clock.monotonic_ns())
        super().forward(endpoint, topic, payload)

    def _crossing(self, way: str, topic: str, payload: bytes, sent_ns: int) -> list[Any]:
        is_stream = TOPICS[topic].delivery != "latest"
        at_s = (sent_ns - BEGIN_NS) * 1e-9
        return self.ways[way].arrivals(at_s, len(payload), is_stream=is_stream)

    def _record(self, src: str, topic: str, payload: bytes, sent_ns: int) -> None:
        """Deliver a message to the recorders; messages of the link reach the slave's recorder over the network."""
        is_heard = self._hears(src, sent_ns)
        if src != LINK_ENDPOINT:
            if is_heard:
                super()._record(src, topic, payload, sent_ns)
            return
        # The readers at the slave's site get the same copies.
        self._fate = (payload, self._crossing("forward", topic, payload, sent_ns))
        for bus, way in self._recording(src, topic) if is_heard else ():
            near = bus.key != FAR_RECORDER
            for copy in self._fate[1] if not near else [None]:
                self._order += 1
                arrives_ns = sent_ns + way.draw() + (0 if copy is None else copy.after_ns)
                if near or TOPICS[topic].delivery != "latest":
                    arrives_ns = max(arrives_ns, bus.newest_ns.get(src, 0))
                    bus.newest_ns[src] = arrives_ns
                if not bus.coming:
                    self._unknown.add(bus.key)
                received = payload[: len(payload) // 2] if copy is not None and copy.damaged else payload
                bus.coming.append((arrives_ns, self._order, _as_received(way), received))

    def _deliver(
        self, sender: str, key: str, topic: str, payload: bytes, sent_ns: int, message: Message | None
    ) -> None:
        if sender in self.mates(key):
            # Within a process a message is handed over in memory.
            self._put(key, topic, payload, message, sent_ns)
            return
        if sender == LINK_ENDPOINT and site_of(key) == "slave":
            copies = self._fate[1]
        elif key == LINK and site_of(sender) == "slave" and name_of(sender) != name_of(LINK):
            copies = self._crossing("backward", topic, payload, sent_ns)
        else:
            super()._deliver(sender, key, topic, payload, sent_ns, message)
            return
        for copy in copies:
            at_ns = sent_ns + copy.after_ns
            if TOPICS[topic].delivery != "latest":
                super()._deliver(sender, key, topic, payload, at_ns, message)
            elif copy.damaged:
                self._put(key, topic, payload[: len(payload) // 2], None, at_ns)
            else:
                self._put(key, topic, payload, message, at_ns + self.draw(self.timing.site, "network", sender, key))


def _as_received(way: RecorderWay) -> RecorderWay:
    return way


def _pushed_n(at_s: float) -> float:
    """Return the force of a person at the page, who holds that of each corner of the profile [N]."""
    corner = bisect_right(_PROFILE, (at_s, 0.0)) - 1
    return _PROFILE[corner][1] if corner >= 0 else 0.0


def scenario_of(schedule: Schedule) -> dict[str, Any]:
    """Return the scenario of a session: a hand presses with two forces and lets go."""
    points = [{"time_s": time_s, "force_n": force_n} for time_s, force_n in _PROFILE]
    profile = {"kind": "force_profile", "points": points}
    return {
        "name": "faults",
        "description": "A hand presses the tip onto mica twice, while faults happen",
        "duration_s": schedule.session_s,
        "realtime": {"rate_hz": schedule.rate_hz, "processes": schedule.processes},
        "haptic_node": {"operator": {"kind": "interactive"} if schedule.operator == "page" else profile},
        "controller": {"law": schedule.law},
        "afm_node": {"rest_distance_m": 10.0e-9, "safety": {"force_limit_n": schedule.force_limit_n}},
        "delay_node": {way: {"delay_s": schedule.link_s} for way in ("forward", "backward")},
    }


def run(schedule: Schedule, folder: Path) -> Outcome:
    """Run a schedule in an empty folder, and leave the input of the judge there."""
    folder.mkdir(parents=True, exist_ok=True)
    folder = folder.absolute()
    scenario = folder / "given.yaml"
    scenario.write_text(json.dumps(scenario_of(schedule)), encoding="utf-8")
    request = SimulateRequest(scenario=str(scenario), out=folder, both_sites=True, seed=schedule.seed)
    plan = plan_of(request, folder)
    with contextlib.chdir(folder):
        KEPT.mkdir()
        rig = FaultyRig(plan, schedule)
        with _faulty_devices(rig):
            outcome = rig.run_schedule()
        kept = sorted(path.name.removesuffix(".estop.kept") for path in KEPT.iterdir())
    (folder / "schedule.json").write_text(schedule.text(), encoding="utf-8")
    history: Mapping[str, Any] = {
        "epoch_ns": EPOCH_OFFSET_NS + BEGIN_NS,
        "failure": outcome.failure,
        "missing": list(outcome.missing),
        "restarts": outcome.restarts,
        "kept": kept,
        "acts": rig.history,
        "stood": {name: way.stood() for name, way in rig.ways.items()},
    }
    (folder / "history.json").write_text(json.dumps(history), encoding="utf-8")
    (folder / "ledger.msgpack").write_bytes(msgpack.packb(rig.ledger))
    (folder / "world.msgpack").write_bytes(msgpack.packb(rig.world))
    return outcome


@contextlib.contextmanager
def _faulty_devices(rig: FaultyRig) -> Iterator[None]:
    """Wrap each simulated device that is built in one that can fail."""
    make_hand, make_tip = haptic_process.device_of, afm_process.driver_of
    period_s = 1.0 / rig.schedule.rate_hz

    def hand(*given: Any) -> Any:
        return FaultyHand(make_hand(*given), lambda: rig.fault_of("hand"), period_s, partial(rig.account, "hand"))

    def tip(*given: Any) -> Any:
        return FaultyTip(make_tip(*given), lambda: rig.fault_of("tip"), period_s, partial(rig.account, "tip"))

    with mock.patch.object(haptic_process, "device_of", hand), mock.patch.object(afm_process, "driver_of", tip):
        yield
