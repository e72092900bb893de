"""A rig in virtual time: real nodes and real loops on a bus in memory, without processes and sockets.

    with closing(VirtualRig(Path("out"), seed=7, settings=["controller.law=wave"])) as rig:
        rig.run_until(0.15)
        rig.command("arm", "*", place="hand")
        rig.run_until(0.3)
        rig.command("start", "haptic_node")
        rig.run_until(1.5)
        recording = rig.finish()

All delays come from one seed: the transit on a site and the lateness of a loop. Between the sites is the link, with the
impairments of the scenario. So a session takes less time than its duration, and has the same messages in every run.
With `constant_timing` nothing is random, and a constant delay replaces the link. `stall` lets a node stand still, while
messages to it wait.
"""

import gc
import heapq
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from telenano.recording.disk import OWN_DISK, Disk, FolderDisk
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.loop.node import HEALTH_PERIOD_NS, Node, NodeContext
from telenano.runtime.loop.node_loop import NodeLoop
from telenano.runtime.loop.realtime import RealtimeStatus
from telenano.runtime.wiring.main import node_kind
from telenano.settings import package_topics
from telenano.settings.config import flag_overrides, merge
from telenano.settings.included import DEFAULT_SITE_FILE
from telenano.settings.scenario import LoadedScenario
from telenano.timing.clock import Clock, VirtualClock
from telenano.virtual.bus import RecorderWay, RecordingBus, VirtualBus
from telenano.virtual.machine import QuietLog, VirtualMachine
from telenano.virtual.timing import RANDOM_TIMING, RandomStreams, Range, Timing
from telenano.virtual.wiring import VirtualWiring, network_of
from telenano.wire import Message
from telenano.wire.codec import WireError, accept
from telenano.wire.messages import DELAY_STEP_NS
from telenano.wire.nodes import FAR_RECORDER, HAND, LAUNCHER, LINK, RECORDER, is_estop, name_of, site_of
from telenano.wire.topics import Topic

# time of a message header minus the monotonic clock, which starts at one second [ns]
EPOCH_OFFSET_NS = 1_750_000_000_000_000_000
BEGIN_NS = 10**9
LINK_NODE, LINK_ENDPOINT = f"{LINK}@master", f"{LINK}@slave"
NODES = ("afm_node@slave", "controller@slave", "controller@master", "haptic_node@master")
RECORDERS = (RECORDER, FAR_RECORDER)
# times after the start at which `record_session` arms the tip and starts the force profile [s]
ARMED_S = 0.15
STARTED_S = 0.3
REALTIME = RealtimeStatus(fifo=True, memory_locked=False)
# additional lateness of a stalled turn [ns]
_STALL_NS = 3_000_000
# least number of newest messages that are kept, to recognise those that leave the link by their bytes
_LEAST_KNOWN = 20_000
# time after the last node in which a recorder still receives messages in transit [s]
_LAST_MESSAGES_S = 0.01
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


class Route(NamedTuple):
    """The route of a publisher's topic: readers at its site, whether it crosses the link, and goes to a link node."""

    readers: tuple[str, ...]
    crosses: bool
    to_link: bool


class Engine:
    """A bus in memory, its virtual clock, and the loops of the nodes on it.

    Args:
        loaded: The scenario.
        seed: The seed of all delays.
        timing: The delays.
        scenario_file: The path of the scenario; files that the link names are relative to its folder.
        site_file: The site file, whose nodes the recorders observe.
        disk: The disk of the recorders.
        keeps: Whether to keep every message, for `received`.
        counts_inputs: Whether node/health contains the inputs of a node, from which a launcher sees that it is ready.
        hears_recorders: Whether the nodes receive messages of recorders, as they do in a rig of processes. Otherwise,
            a session is the same to the bit whether or not it is recorded.
    """

    def __init__(
        self,
        loaded: LoadedScenario,
        seed: int,
        timing: Timing = RANDOM_TIMING,
        *,
        scenario_file: Path,
        site_file: Path = DEFAULT_SITE_FILE,
        disk: Disk = OWN_DISK,
        keeps: bool = False,
        counts_inputs: bool = False,
        hears_recorders: bool = True,
    ) -> None:
        self.loaded, self.timing, self.disk = loaded, timing, disk
        self.clock = VirtualClock(start_ns=BEGIN_NS, epoch_offset_ns=EPOCH_OFFSET_NS)
        self.streams = RandomStreams(seed)
        self.counts_inputs = counts_inputs
        self._hears_recorders = hears_recorders
        self.book = AddressBook.load(site_file)
        self.files = site_file, scenario_file
        # metadata of every recording, beside its versions
        self.facts = {
            "simulation": {
                "time": "virtual",
                "about": "real nodes on a bus in memory; no process, socket or device took part",
                "seed": str(seed),
                "delays_ns": json.dumps(asdict(timing)),
            }
        }
        self.buses: dict[str, VirtualBus] = {}
        self.loops: dict[str, NodeLoop] = {}
        self.logs: dict[str, QuietLog] = {}
        # Messages by their bytes: all of them if they are kept, otherwise those that may be in the link.
        self.messages: dict[bytes, Message] = {}
        self._older: dict[bytes, Message] = {}
        self._keeps = keeps
        self._published: dict[tuple[str, str], list[Message]] = {}
        self._endpoints: dict[str, VirtualBus] = {}
        self._recorders: list[RecordingBus] = []
        # By endpoint and topic, the recorders that record it, each with its connection.
        self._recorded: dict[tuple[str, str], list[tuple[RecordingBus, RecorderWay]]] = {}
        self._order = 0
        # By sender, reader and topic, a function that draws the transit of a message, and the arrival of the newest
        # one [ns], because a connection preserves the order of messages.
        self._connections: dict[tuple[str, str, str], tuple[Callable[[], int], list[int]]] = {}
        self._newest_ns: dict[tuple[str, str], list[int]] = {}
        # By node, in the order of names, the time of its next turn [ns]; the set has those whose time must be updated.
        self._due_of: dict[str, int] = {}
        self._unknown: set[str] = set()
        self._late_ns: dict[str, int] = {}
        self._stalled_until_ns: dict[str, int] = {}
        self._routes: dict[tuple[str, str], Route] = {}
        # Set to end `advance`: no node takes a further turn.
        self.is_over = False

    def start(self, key: str, takes_ns: int = 0, *, starting_period_ns: int = HEALTH_PERIOD_NS) -> Node:
        """Build a node by its row in the table of nodes, advance the time by takes_ns [ns], and run its loop from then.

        Raises:
            ConfigError: The section of the node in the scenario is invalid.
        """
        self._endpoints.pop(key, None)
        node, bus = self._built(key, None)
        self.clock.advance_ns(takes_ns)
        self.run_node(key, node, bus, starting_period_ns=starting_period_ns)
        return node

    def build(self, key: str, context: NodeContext) -> Node:
        """Return a further node of the kind of `key`, on the given context; it takes no turns here."""
        return self._built(key, context)[0]

    def _built(self, key: str, given: NodeContext | None) -> tuple[Node, Any]:
        return node_kind(name_of(key)).open(self.wiring(key, given), self.loaded, self.config_of)

    def config_of(self, key: str, config: Any) -> Any:
        """Return the section of node `key` as the node gets it; a subclass may change it."""
        return config

    def wiring(self, key: str, given: NodeContext | None = None) -> VirtualWiring:
        """Return the wiring for the builder of node `key`, with the context of a further node if one is given."""
        site_file, scenario_file = self.files
        return VirtualWiring(
            key=key,
            book=self.book,
            clock=self.clock_of(key),
            log=self.log_of(key),
            network=network_of(key),
            wake_descriptor=-1,
            period_s=self.loaded.scenario.period_s,
            machine=VirtualMachine(key, self.streams, self.disk),
            recorded_facts=self.facts,
            site_file=site_file,
            scenario_file=scenario_file,
            rig=self,
            given=given,
        )

    def clock_of(self, key: str) -> Clock:
        """Return the clock of a node: one for all, unless a subclass has a clock for each machine."""
        return self.clock

    def log_of(self, key: str) -> QuietLog:
        """Return the log of a node."""
        return self.logs.setdefault(key, QuietLog(key))

    def endpoint(self, key: str) -> VirtualBus:
        """Return the endpoint of a publisher, which the first call opens."""
        if key not in self._endpoints:
            self._endpoints[key] = VirtualBus(self, key)
        return self._endpoints[key]

    def run_node(self, key: str, node: Node, bus: Any, *, starting_period_ns: int = HEALTH_PERIOD_NS) -> None:
        """Run the loop of a node from now on; starting_period_ns: period of its reports while it starts [ns]."""
        self.buses[key] = bus
        self.loops[key] = NodeLoop(node, bus, REALTIME, starting_period_ns=starting_period_ns)
        self._late_ns[key] = self._stalled_until_ns[key] = 0
        self._due_of = dict.fromkeys(sorted([*self._due_of, key]), 0)
        self._unknown = set(self._due_of)
        self._routes.clear()
        self._note_recorders()

    def restart(self, key: str, away_ns: int = 0) -> Node:
        """Restart a node, as after a kill of its process, and return the new node.

        Args:
            key: The node, which ends now and loses everything that is not on a disk.
            away_ns: The time until the new process starts [ns].
        """
        self.leave(key)
        self.advance(self.clock.monotonic_ns() + away_ns)
        return self.start(key)

    def leave(self, key: str) -> None:
        """Remove a node, which takes no more turns, and close its bus."""
        self._due_of.pop(key, None)
        self._unknown.discard(key)
        self.loops.pop(key, None)
        self.buses.pop(key).close()
        self._routes.clear()
        self._note_recorders()

    def stall(self, key: str, duration_s: float) -> None:
        """Let a node stand still for a duration from now [s]: it takes no turn, and messages to it wait."""
        self._stalled_until_ns[key] = self.clock.monotonic_ns() + round(duration_s * 1e9)
        self._unknown.add(key)

    def received(self, topic: str, src: str) -> list[Any]:
        """Return the messages that a node has published on a topic so far; empty unless messages are kept."""
        return list(self._published.get((topic, src), ()))

    def advance(self, end_ns: int) -> None:
        """Run the nodes until a time on the monotonic clock [ns]."""
        # As in the process of a node, a turn creates nothing that needs the garbage collector.
        collects = gc.isenabled()
        gc.disable()
        try:
            self._advance(end_ns)
        finally:
            if collects:
                gc.enable()

    def _advance(self, end_ns: int) -> None:
        clock, streams, loops = self.clock, self.streams, self.loops
        wake, share = self.timing.wake, self.timing.stall_share
        late_of = {key: (streams.of(("stall", key)).random, streams.draws(wake, ("wake", key))) for key in loops}
        while not self.is_over:
            due_of, unknown = self._due_of, self._unknown
            for key in unknown:
                # A stopped node takes no turn, even if messages arrive.
                if key in due_of:
                    due_of[key] = self._due_ns(key)
            unknown.clear()
            now_ns = clock.monotonic_ns()
            # Nodes are in the order of their names, so the first of those that are due takes its turn.
            due_ns, key = end_ns + 1, ""
            for name, at_ns in due_of.items():
                if at_ns < due_ns:
                    if at_ns <= now_ns:
                        due_ns, key = now_ns, name
                        break
                    due_ns, key = at_ns, name
            if not key or due_ns > end_ns or self._is_last(key, end_ns):
                return
            clock.advance_ns(due_ns - now_ns)
            # Update its next turn; deliveries bring that of their readers forward.
            unknown.add(key)
            self.turn(key, loops[key])
            # A loop wakes up a little late, and now and then very late.
            if key not in late_of:
                late_of[key] = streams.of(("stall", key)).random, streams.draws(wake, ("wake", key))
            random, wakes = late_of[key]
            is_stalled = share > 0.0 and random() < share
            self._late_ns[key] = wakes() + _STALL_NS * is_stalled

    def _is_last(self, key: str, end_ns: int) -> bool:
        """Return whether `key` is a recorder that no node hears, and only such recorders are due until `end_ns` [ns].

        Their turns are postponed, so that the time at which a command is sent does not depend on a recorder.
        """
        if self._hears_recorders or key not in RECORDERS:
            return False
        others = [at_ns for name, at_ns in self._due_of.items() if name not in RECORDERS]
        return bool(others) and min(others) > end_ns

    def turn(self, key: str, loop: NodeLoop) -> None:
        """Run one turn of a node."""
        loop.turn_now()

    def draw(self, low_high: Range, *names: str) -> int:
        """Draw a delay [ns] from the stream of these names."""
        return self.streams.draw(low_high, names)

    def close(self) -> None:
        """Drop all messages that have not been received."""
        for bus in (*self.buses.values(), *self._endpoints.values()):
            bus.close()

    def carry(self, topic: str, message: Message, payload: bytes, sent_ns: int) -> None:
        """Deliver a message, sent at a time [ns], to its readers on its own site and into the link."""
        src = message.src
        self._record(src, topic, payload, sent_ns)
        if self._keeps:
            self._published.setdefault((topic, src), []).append(message)
        route = self._routes.get((topic, src)) or self._route(topic, message)
        if self._keeps or route.crosses:
            self._remember(payload, message)
        for key in route.readers:
            self._deliver(src, key, topic, payload, sent_ns, message)
        if route.to_link:
            self._deliver(src, LINK_NODE, topic, payload, sent_ns, message)
        elif route.crosses and self.timing.link is not None:
            far = LINK_ENDPOINT if site_of(src) == "master" else LINK_NODE
            arrives_ns = sent_ns + self.draw(self.timing.link, "link", src, topic)
            self._bring(far, topic, message, payload, arrives_ns)

    def forward(self, endpoint: str, topic: str, payload: bytes) -> None:
        """Deliver bytes that left the link to the readers at that endpoint, which reject damaged ones."""
        sent_ns = self.clock.monotonic_ns() + self.draw(self.timing.sending, "forwarding", endpoint, topic)
        message = self.messages.get(payload) or self._older.get(payload)
        if message is None:
            try:
                message = accept(topic, payload)
            except WireError:
                # The link has damaged the message, and its readers count it as rejected.
                self._record(endpoint, topic, payload, sent_ns)
                for key in self._subscribed(topic, site_of(endpoint)):
                    self._deliver(endpoint, key, topic, payload, sent_ns, None)
                return
        self._bring(endpoint, topic, message, payload, sent_ns)

    def _remember(self, payload: bytes, message: Message) -> None:
        if not self._keeps and len(self.messages) >= _LEAST_KNOWN:
            self._older, self.messages = self.messages, {}
        self.messages[payload] = message

    def _bring(self, endpoint: str, topic: str, message: Message, payload: bytes, sent_ns: int) -> None:
        if self._keeps:
            self.messages[payload] = message
        self._record(endpoint, topic, payload, sent_ns)
        for key in self._readers(topic, message, site_of(endpoint)):
            self._deliver(endpoint, key, topic, payload, sent_ns, message)

    def _record(self, endpoint: str, topic: str, payload: bytes, sent_ns: int) -> None:
        """Deliver a message to the recorders that observe an endpoint, with a delay of their own."""
        for bus, way in self._recording(endpoint, topic):
            self._order += 1
            arrives_ns = sent_ns + way.draw()
            last_ns = bus.newest_ns.get(endpoint, 0)
            if arrives_ns < last_ns:
                arrives_ns = last_ns
            bus.newest_ns[endpoint] = arrives_ns
            if not bus.coming:
                self._unknown.add(bus.key)
            bus.coming.append((arrives_ns, self._order, way, payload))

    def _recording(self, endpoint: str, topic: str) -> list[tuple[RecordingBus, RecorderWay]]:
        """Return the recorders that record a topic of an endpoint, each with its connection."""
        place = (endpoint, topic)
        found = self._recorded.get(place)
        if found is None:
            found = [(bus, way) for bus in self._recorders if (way := bus.way(endpoint, topic)) is not None]
            self._recorded[place] = found
        return found

    def _note_recorders(self) -> None:
        self._recorders = [bus for bus in self.buses.values() if isinstance(bus, RecordingBus)]
        self._recorded.clear()

    def _route(self, topic: str, message: Message) -> Route:
        src = message.src
        site = site_of(src)
        crosses = _row(topic).bridged in ("both", "forward" if site == "master" else "backward")
        # A sender of emergency stops connects to inlets, and the link has one at its own site.
        crosses = crosses and not (is_estop(src) and site == "slave")
        is_for_link = topic == "clock/pong" or (topic, src) == ("session/event", HAND)
        to_link = LINK_NODE in self.loops and name_of(src) != LINK and (crosses or is_for_link)
        is_heard = self._hears_recorders or src not in RECORDERS
        route = Route(tuple(self._readers(topic, message, site)) if is_heard else (), crosses, to_link and is_heard)
        self._routes[topic, src] = route
        return route

    def _readers(self, topic: str, message: Message, site: str) -> list[str]:
        return [key for key in self._subscribed(topic, site) if key != message.src]

    def _subscribed(self, topic: str, site: str) -> list[str]:
        return [
            key
            for key, loop in self.loops.items()
            if topic in loop.node.inputs and site_of(key) == site and key not in (LINK_NODE, *RECORDERS)
        ]

    def _deliver(
        self, sender: str, key: str, topic: str, payload: bytes, sent_ns: int, message: Message | None
    ) -> None:
        """Deliver a message from an endpoint to a reader; it is None if its bytes are damaged."""
        place = (sender, key, topic)
        connection = self._connections.get(place)
        if connection is None:
            draw = self.streams.draws(self.timing.site, ("site", *place))
            connection = self._connections[place] = draw, self._newest_ns.setdefault((sender, key), [0])
        draw, newest_ns = connection
        arrives_ns = sent_ns + draw()
        if arrives_ns < newest_ns[0]:
            arrives_ns = newest_ns[0]
        newest_ns[0] = arrives_ns
        self._put(key, topic, payload, message, arrives_ns)

    def _put(self, key: str, topic: str, payload: bytes, message: Message | None, arrives_ns: int) -> None:
        self._order += 1
        heapq.heappush(self.buses[key].inbox, (arrives_ns, self._order, topic, payload, message))
        # A message only brings the next turn of its reader forward: a node moves its deadline in its own turns alone.
        if (due_ns := self._due_of.get(key)) is not None:
            turn_ns = max(arrives_ns + self._late_ns[key], self._stalled_until_ns[key])
            if turn_ns < due_ns:
                self._due_of[key] = turn_ns

    def _due_ns(self, key: str) -> int:
        loop = self.loops[key]
        wanted_ns, report_ns, arrives_ns = loop.node.deadline_ns(), loop.health_due_ns, self.buses[key].next_ns()
        if report_ns < wanted_ns:
            wanted_ns = report_ns
        if arrives_ns < wanted_ns:
            wanted_ns = arrives_ns
        return max(wanted_ns + self._late_ns[key], self._stalled_until_ns[key])


class VirtualRig(Engine):
    """Two sites, the link between them, and a recorder, for tests and scripts that command them step by step.

    Args:
        folder: The folder of the recording, None for none.
        seed: The seed of all delays.
        settings: Dotted flags that override the scenario.
        timing: The delays.
        scenario: A scenario as read from a file; None lets a hand press the tip onto mica and let go.
        disk: The disk of the recorder.
        counts_inputs: Whether node/health contains the inputs of a node.
    """

    def __init__(
        self,
        folder: Path | None,
        seed: int,
        settings: Sequence[str] = (),
        timing: Timing = RANDOM_TIMING,
        scenario: Mapping[str, Any] | None = None,
        *,
        disk: Disk = OWN_DISK,
        counts_inputs: bool = False,
    ) -> None:
        document = merge(scenario or yaml.safe_load(_SCENARIO), flag_overrides(settings))
        loaded = LoadedScenario.of(document, "virtual")
        path = Path("scenario.yaml") if folder is None else folder / "scenario.yaml"
        super().__init__(
            loaded,
            seed,
            timing,
            scenario_file=path,
            disk=disk if folder is None else FolderDisk(folder, disk),
            keeps=True,
            counts_inputs=counts_inputs,
            hears_recorders=False,
        )
        self.folder = folder
        self._commands = 0
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_text(yaml.safe_dump(document), encoding="utf-8")
            self.start(RECORDER)
        self.nodes = NODES if timing.link is not None else (LINK_NODE, *NODES)
        for key in self.nodes:
            # Nodes start one after the other.
            self.start(key, self.draw(timing.start, "start", key))
        self._started_ns = self.clock.monotonic_ns()
        if timing.link is not None:
            self._declare(timing.link[0])

    def command(self, command: str, target: str, seen: Message | None = None, **parameters: Any) -> None:
        """Send a command twice, as a session does that has not received the answer yet.

        Args:
            command: The command.
            target: The node that shall obey it, or a pattern.
            seen: A message of the target, which proves to it that the command is fresh; None if it needs no proof.
            parameters: The parameters of the command.
        """
        self._commands += 1
        # The id has at least five letters, as that of a launcher.
        name = f"{command}{self._commands:04d}"
        proof = {} if seen is None else {"node_t_ns": {seen.src: seen.t_ns}}
        for _ in range(2):
            self.endpoint(LAUNCHER).publish(
                "session/control", id=name, command=command, target=target, parameters=parameters, **proof
            )

    def _declare(self, delay_ns: int) -> None:
        """Declare the constant delay that replaces the link [ns], as the link does."""
        declared = {"hand_t_ns": 0, "delay_ns": delay_ns - delay_ns % DELAY_STEP_NS, "transit_ns": 0}
        for endpoint, direction in (
            (LINK_ENDPOINT, "forward"),
            (LINK_NODE, "forward"),
            (LINK_NODE, "backward"),
        ):
            self.endpoint(endpoint).publish("link/delay", direction=direction, clock_ahead_ns=0, **declared)

    def run_until(self, time_s: float) -> None:
        """Run the nodes until a time since the start [s]."""
        self.advance(self._started_ns + round(time_s * 1e9))

    def finish(self) -> Path:
        """Stop the nodes, the recorder last, and return the path of its file; ValueError if the rig has no folder."""
        if self.folder is None:
            raise ValueError("nothing was to be recorded: give the rig a folder")
        for key in self.nodes:
            self.stop(key)
        recorder = self.loops[RECORDER].node
        self.advance(self.clock.monotonic_ns() + round(_LAST_MESSAGES_S * 1e9))
        path = self.folder / str(getattr(recorder, "path"))  # noqa: B009
        self.stop(RECORDER)
        self.close()
        return path

    def close(self) -> None:
        """Complete the file of a recording that was not finished, and drop all messages not received."""
        if RECORDER in self._due_of:
            self.stop(RECORDER)
        super().close()

    def stop(self, key: str) -> None:
        """Stop a node, as a signal to its process does."""
        loop = self.loops[key]
        loop.node.context.request_stop()
        loop.run()
        self._due_of.pop(key, None)
        self._unknown.discard(key)


def _row(topic: str) -> Topic:
    row = package_topics.row_of(topic)
    assert row is not None, topic
    return row


def record_session(
    folder: Path,
    seed: int,
    settings: Sequence[str] = (),
    duration_s: float = 1.5,
    scenario: Mapping[str, Any] | None = None,
) -> Path:
    """Record a session: arm, start, press, let go.

    Args:
        folder: The folder of the recording.
        seed: The seed of all delays.
        settings: Dotted flags that override the scenario.
        duration_s: The time for which the nodes run [s].
        scenario: A scenario as read from a file; see `VirtualRig`.

    Returns:
        The path of the recording.
    """
    rig = VirtualRig(folder, seed, settings, scenario=scenario)
    rig.run_until(ARMED_S)
    rig.command("arm", "*", place="hand")
    rig.run_until(STARTED_S)
    rig.command("start", "haptic_node")
    rig.run_until(duration_s)
    return rig.finish()
