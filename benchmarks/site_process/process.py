"""Run the nodes of one site in one process and one thread, each with its sockets, for `loop.py --processes`.

`rig.py` starts this process in the place of the processes of a site. Nothing changes on the wire: each node binds its
own endpoint and publishes all its messages there, in its own order. A message for another node of the same site is
encoded once, sent, and also handed over in memory; messages from elsewhere come from sockets. One poll waits for the
sockets and deadlines of all nodes, and the deferred work of all nodes shares the idle gap of the process.

This process is only for the measurement and no way to run a rig: a node that hangs here also holds up the device of its
site.
"""

import contextlib
import functools
import gc
import os
import select
import signal
import statistics
import sys
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import FrameType
from typing import Any, cast

import zmq

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import Bus, Reader, Subscriber, ZmqBus
from telenano.runtime.bus.holders import STOP_SIGNAL
from telenano.runtime.bus.publisher import Publisher, ZmqPublisher, version_of
from telenano.runtime.loop.deferred import PATIENCE_NS, Deferred, DeferredTasks, Task
from telenano.runtime.loop.hang_guard import HangGuard
from telenano.runtime.loop.log import StructuredLog, configure_logging
from telenano.runtime.loop.node import Node, NodeContext
from telenano.runtime.loop.node_loop import STARTING_PERIOD_NS, NodeLoop, install_stop_signals
from telenano.runtime.loop.realtime import (
    RealtimeStatus,
    apply_realtime,
    freeze_garbage,
    ordinary_scheduling,
    use_huge_pages,
)
from telenano.runtime.wiring.main import EXIT_BAD_START, Wiring, node_kind, parse_arguments
from telenano.runtime.wiring.participant import Participant
from telenano.settings.included import DEFAULT_SITE_FILE, find_scenario, site_file_named
from telenano.settings.scenario import LoadedScenario
from telenano.signals.children import die_with_parent
from telenano.timing.clock import NEVER_NS, Clock
from telenano.virtual.bus import VirtualReader
from telenano.wire import Message, compose
from telenano.wire.errors import TelenanoError
from telenano.wire.nodes import DEVICES, HAND, LINK, STOP_ORDER, TIP, name_of, site_of
from telenano.wire.received import Received

# The nodes of each site, in the order in which they are built.
_LINK_NODE = f"{LINK}@master"
MEMBERS = {"master": (_LINK_NODE, "controller@master", HAND), "slave": (TIP, "controller@slave")}
# After one of these messages the tick is at the other site, or over, for longest, so the idle gap begins.
_IDLE_AFTER = {(HAND, "haptic/command"), ("controller@slave", "afm/state")}
# After this number of turns for messages from memory alone, the sockets are checked again.
_MOST_TURNS = 64
# The number of messages received by the link whose decoded form is kept, by their bytes.
_KNOWN = 256
# So many turns are ten seconds of a kind of turn that comes six times a tick.
_MOST_TRACED = 60_000
# If this variable is set, the median time of each kind of turn is written to the log at the end.
TRACE_VARIABLE = "TELENANO_SITE_TRACE"


class MemoryReader(VirtualReader):
    """Receives the messages of nodes in the same process, each with its bytes as it was published."""

    def __init__(self, clock: Clock, topics: Iterable[str], *, newest_only: bool) -> None:
        super().__init__(clock, topics, newest_only=newest_only)
        self.inbox: list[tuple[int, int, str, bytes, Message | None]] = []

    def receive(self, *, signalled: bool = False) -> list[Received]:
        if not self.inbox:
            return []
        waiting, self.inbox = self.inbox, []
        return self.arrived(waiting, self._clock.now_ns())


class SitePublisher(ZmqPublisher):
    """A PUB socket that also hands each message to its readers in this process."""

    site: "Site"

    def publish(self, topic: str, **fields: Any) -> Message:
        seq = self._sequence.get(topic, 0)
        header = {"seq": seq, "t_ns": self._clock.now_ns(), "src": self.node, "v": version_of(topic)}
        message, payload = compose(topic, {**header, **fields}, self.on_limited)
        ZmqPublisher.send(self, topic, payload)
        self._sequence[topic] = seq + 1
        self.site.deliver(self.node, topic, payload, message)
        return message

    def send(self, topic: str, payload: bytes) -> None:
        ZmqPublisher.send(self, topic, payload)
        self.site.deliver(self.node, topic, payload, None)


class SiteBus(ZmqBus):
    """The bus of a node of a site; it does not wait itself, because the process waits for all nodes."""

    def __init__(self, site: "Site", key: str, publisher: Publisher, readers: Sequence[Reader], **given: Any) -> None:
        self.near = [reader for reader in readers if isinstance(reader, MemoryReader)]
        self.sockets = [reader for reader in readers if isinstance(reader, Subscriber)]
        super().__init__(publisher, self.sockets, **given)
        for reader in self.near:
            self.subscribers.insert(0, cast(Subscriber, reader))
            self.count(reader)
        # The descriptors of the sockets to read at the next `receive`.
        self.asked: list[int] = []
        self._site, self._key = site, key

    @property
    def own_descriptors(self) -> list[int]:
        return [*(reader.descriptor for reader in self.sockets), *self._network_descriptors]

    def wait(self, deadline_ns: int) -> None:
        """Return at once, because the process has already waited."""

    def wake(self, descriptor: int) -> None:
        """Have a socket read at the next `receive`, or the events of the network processed."""
        if descriptor in self._network_descriptors:
            self._events_pending = True
        self.asked.append(descriptor)

    def receive(self) -> Iterable[Received]:
        received: list[Received] = []
        for reader in self.near:
            if reader.inbox:
                received += reader.receive()
        if self.asked:
            asked, self.asked = self.asked, []
            for socket in self.sockets:
                if socket.descriptor in asked:
                    received += socket.receive(signalled=socket.drained)
                elif socket.shared:
                    received += socket.receive()
        if received:
            self._site.note_received(self._key, received)
        return received

    def has_arrived(self) -> bool:
        return self._site.has_arrived()


class NodeTasks:
    """The tasks of one node among those of its process, which runs them."""

    # The process, not the node, checks which tasks are due.
    due_ns = NEVER_NS

    def __init__(self, shared: "SiteTasks", key: str) -> None:
        self._shared, self._key = shared, key
        self.note_run = shared.note_run

    def add(self, task: Task, *, is_turn: bool = False, within_ns: int = PATIENCE_NS) -> None:
        self._shared.owners[task] = self._key
        self._shared.add(task, is_turn=is_turn, within_ns=within_ns)

    def note_event(self, begin_ns: int, end_ns: int, *, is_last: bool) -> None:
        """Do nothing, because the events of the process count."""

    @property
    def has_turns(self) -> bool:
        return any(task.is_turn and task.latest_ns < NEVER_NS for task in self._own())

    def forget_unneeded(self) -> None:
        for task in self._own():
            if task.latest_ns == NEVER_NS:
                self._shared.remove(task)

    def take_turn(self) -> Task | None:
        turn = next((task for task in self._own() if task.is_turn), None)
        if turn is None:
            return None
        self._shared.remove(turn)
        return turn.run

    def _own(self) -> list[Deferred]:
        return [task for task in self._shared.waiting if self._shared.owners[task.run] == self._key]


class SiteTasks(DeferredTasks):
    """The tasks of all nodes of a process, which share its idle gap."""

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock)
        self.owners: dict[Task, str] = {}

    @property
    def waiting(self) -> list[Deferred]:
        return list(self._waiting)

    def remove(self, task: Deferred) -> None:
        self._waiting.remove(task)
        self._schedule(self._now_ns())


@dataclass(frozen=True, kw_only=True)
class SiteWiring(Wiring):
    """The wiring for the builder of a node: sockets to other processes, and memory within this one."""

    site: "Site" = field(repr=False)

    def bind(self, key: str, kind: int = zmq.PUB, *, ends: bool = False) -> ZmqPublisher:
        publisher = super().bind(key, kind, ends=ends)
        publisher.__class__ = SitePublisher
        self.site.publishers[key] = site_publisher = cast(SitePublisher, publisher)
        site_publisher.site = self.site
        return publisher

    def subscribers(
        self,
        connections: Mapping[str, Sequence[str]],
        *,
        apart: bool = False,
        newest_only: bool = False,
        shared: bool = False,
    ) -> list[Subscriber]:
        near = {node: topics for node, topics in connections.items() if node in self.site.endpoints}
        far = {node: topics for node, topics in connections.items() if node not in near}
        opened = super().subscribers(far, apart=apart, newest_only=newest_only, shared=shared) if far else []
        if near:
            topics = {topic for topics in near.values() for topic in topics}
            memory = MemoryReader(self.clock, topics, newest_only=newest_only)
            self.site.connect(self.key, memory, near)
            opened.insert(0, cast(Subscriber, memory))
        return opened

    def bus_of(self, publisher: Publisher, subscribers: Sequence[Reader]) -> ZmqBus:
        network = self.network if self.key == self.site.keys[0] else None
        given = {"clock": self.clock, "wake_descriptor": self.wake_descriptor, "network": network}
        bus = SiteBus(self.site, self.key, publisher, subscribers, **given)
        bus.is_brief = self.book.spans_machines and site_of(self.key) == "slave"
        return bus

    def context(self, bus: Bus) -> NodeContext:
        context = super().context(bus)
        if self.key not in DEVICES:
            # The node of the device handles the paths and connections of the process.
            context.places = context.hearing = None
        context.deferred = cast(DeferredTasks, NodeTasks(self.site.tasks, self.key))
        return context


class Member:
    """A node of the site, with its bus and its loop."""

    def __init__(self, key: str, node: Node, bus: SiteBus, loop: NodeLoop) -> None:
        self.key, self.node, self.bus, self.loop = key, node, bus, loop
        self.deadline_ns = node.deadline_ns


class Site:
    """The nodes of a site, with one poll and one order of turns."""

    def __init__(self, keys: Sequence[str], clock: Clock) -> None:
        self.keys = tuple(keys)
        # The link has an endpoint at each site, and its process binds both.
        self.endpoints = {*keys, *(f"{LINK}@slave" for key in keys if name_of(key) == LINK)}
        self.tasks = SiteTasks(clock)
        self.members: dict[str, Member] = {}
        self.publishers: dict[str, SitePublisher] = {}
        self.trace: dict[str, list[int]] | None = defaultdict(list) if TRACE_VARIABLE in os.environ else None
        self._monotonic_ns = clock.monotonic_ns
        self._routes: dict[tuple[str, str], list[tuple[str, MemoryReader]]] = defaultdict(list)
        # The nodes that have messages in memory, in the order in which the first message of each was published.
        self._pending: deque[str] = deque()
        # The latest messages of the link from sockets, by their bytes: the link sends them on unchanged.
        self._known: dict[bytes, Message] = {}
        self._was_last = False
        self._order: list[Member] = []
        self._descriptors: list[int] = []
        self._owner: dict[int, Member] = {}
        self._sockets: list[tuple[Subscriber, SiteBus]] = []
        self._readable: Sequence[int] = ()
        self._wake = -1

    def connect(self, key: str, reader: MemoryReader, plan: Mapping[str, Sequence[str]]) -> None:
        for endpoint, topics in plan.items():
            for topic in topics:
                self._routes[endpoint, topic].append((key, reader))

    def open(self, members: Iterable[Member], wake_descriptor: int) -> None:
        self.members = {member.key: member for member in members}
        # A tick of the hand comes before the messages that arrived at sockets meanwhile.
        self._order = sorted(self.members.values(), key=lambda member: member.key not in DEVICES)
        self._owner = {number: member for member in self._order for number in member.bus.own_descriptors}
        self._sockets = [(socket, member.bus) for member in self._order for socket in member.bus.sockets]
        self._descriptors, self._wake = [*self._owner, wake_descriptor], wake_descriptor

    def deliver(self, endpoint: str, topic: str, payload: bytes, message: Message | None) -> None:
        """Hand a message that was just sent to its readers in this process."""
        if message is None:
            message = self._known.get(payload)
        for key, reader in self._routes.get((endpoint, topic), ()):
            if not reader.inbox:
                self._pending.append(key)
            reader.inbox.append((0, 0, topic, payload, message))

    def note_received(self, key: str, received: Sequence[Received]) -> None:
        """Note the messages that a node received: whether the idle gap begins, and those that the link may send on."""
        if (key, received[-1].topic) in _IDLE_AFTER:
            self._was_last = True
        elif key == _LINK_NODE:
            if len(self._known) > _KNOWN:
                self._known.clear()
            for one in received:
                self._known[one.payload] = one.message

    def has_arrived(self) -> bool:
        """Return whether a message may have arrived since the last wait, in memory or at a socket."""
        self._readable, _, _ = select.select(self._descriptors, (), (), 0)
        return bool(self._pending or self._readable)

    def next_ns(self) -> int:
        """Return the time of the next deadline or health report of a node, on the monotonic clock [ns]."""
        next_ns = NEVER_NS
        for member in self._order:
            next_ns = min(next_ns, member.deadline_ns(), member.loop._health_ns)
        return next_ns

    def turn(self) -> None:
        """Wait for the next event, then let every node concerned take its turn, and those that get messages from it."""
        readable = self._wait()
        woken_ns, all_wake, pending = self._monotonic_ns(), False, self._pending
        for number in readable:
            if number in self._owner:
                self._owner[number].bus.wake(number)
            else:
                # A signal may stand for an emergency stop.
                all_wake = True
        for socket, bus in self._sockets:
            if not socket.drained:
                bus.wake(socket.descriptor)
        self._was_last, is_event = False, False
        for member in self._order:
            if all_wake or member.bus.asked or member.deadline_ns() <= woken_ns or member.loop._health_ns <= woken_ns:
                is_event = True
                self._take(member)
        for _ in range(_MOST_TURNS):
            if not pending:
                break
            self._take(self.members[pending.popleft()])
        if is_event:
            self.tasks.note_event(woken_ns, self._monotonic_ns(), is_last=self._was_last)
        if self.tasks.due_ns < NEVER_NS:
            self._run_deferred()

    def _wait(self) -> Sequence[int]:
        if self._readable:
            readable, self._readable = self._readable, ()
            return readable
        remaining_ns = 0
        if not self._pending and all([socket.drained for socket, _ in self._sockets]):
            remaining_ns = max(0, min(self.next_ns(), self.tasks.due_ns) - self._monotonic_ns())
        readable, _, _ = select.select(self._descriptors, (), (), remaining_ns * 1e-9)
        return readable

    def _take(self, member: Member) -> None:
        if self.trace is None:
            member.loop.turn()
            return
        near = [row[2] for reader in member.bus.near for row in reader.inbox]
        brought = near[-1] if near else "a socket" if member.bus.asked else "its deadline"
        begun_ns = time.perf_counter_ns()
        member.loop.turn()
        spent = self.trace[f"{member.key}, by {brought}"]
        if len(spent) < _MOST_TRACED:
            spent.append(time.perf_counter_ns() - begun_ns)

    def _run_deferred(self) -> None:
        """Run the tasks that are due, until a message arrives."""
        while not self._pending and (now_ns := self._monotonic_ns()) >= self.tasks.due_ns:
            if (task := self.tasks.take(now_ns, self.next_ns())) is not None:
                self.members[self.tasks.owners[task.run]].loop._run_task(task)

    def run(self) -> None:
        """Run until a stop is requested, then leave every node in a safe state whatever happened."""
        members = self.members.values()
        try:
            while not any(member.node.context.stop_requested for member in members):
                self.turn()
        finally:
            with contextlib.ExitStack() as ends:
                for key in reversed([key for key in STOP_ORDER if key in self.members]):
                    ends.callback(self.members[key].loop.end)
            if self.trace is not None:
                rows = {name: [len(ns), statistics.median(ns) * 1e-3] for name, ns in sorted(self.trace.items())}
                StructuredLog(self.keys[0]).info("turns of this process: number, median [us]", turns=rows)


def _guarded(guard: HangGuard, keys: Sequence[str]) -> Callable[[str], None]:
    """Return a function that notes a report of a node and renews the limit of processor time once all have reported."""
    waiting = set(keys)

    def note(key: str) -> None:
        waiting.discard(key)
        if not waiting:
            waiting.update(keys)
            guard.renew()

    return note


@contextlib.contextmanager
def opened(arguments: Any, keys: Sequence[str], wake_descriptor: int) -> Iterator[tuple[Site, RealtimeStatus]]:
    """Build the nodes of a site for the duration of the block; yield the site and the real-time status."""
    site_file = site_file_named(arguments.site_file) or DEFAULT_SITE_FILE
    scenario_file = find_scenario(str(arguments.scenario))
    book, loaded = AddressBook.load(site_file), LoadedScenario.load(scenario_file, arguments.set)
    device = next(key for key in keys if key in DEVICES)
    status = apply_realtime(loaded.scenario.realtime_in_force(), StructuredLog(device), device)
    with Participant.open(device, book, wake_descriptor) as participant:
        site = Site(keys, participant.clock)
        guard = HangGuard()
        note_alive = _guarded(guard, keys)
        members = []
        for key in keys:
            kind = node_kind(name_of(key))
            values = {**vars(participant), "period_s": loaded.scenario.period_s, "key": key, "log": StructuredLog(key)}
            wiring = SiteWiring(**values, site_file=site_file, scenario_file=scenario_file, site=site)
            node, bus = kind.build(wiring, loaded.section(kind.name, kind.config))
            for publisher in site.publishers.values():
                # The turns for messages in memory come first, and the process waits soon after.
                publisher.yields = False
            alive = functools.partial(note_alive, key)
            loop = NodeLoop(node, bus, status, starting_period_ns=STARTING_PERIOD_NS, note_alive=alive)
            members.append(Member(key, node, cast(SiteBus, bus), loop))
        site.open(members, wake_descriptor)
        with ordinary_scheduling():
            huge_pages = use_huge_pages() if loaded.scenario.realtime.huge_pages else 0
            freeze_garbage()
        for member in members:
            member.node.context.log.info("ready", realtime=status.fifo, huge_pages=huge_pages)
        with guard:
            yield site, status


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the nodes of the site named on the command line until they are stopped; return an exit code."""
    read = parse_arguments("site", tuple(MEMBERS), arguments)
    gc.freeze()
    gc.enable()
    configure_logging()
    if read.with_parent:
        die_with_parent(signal.SIGTERM)
    sites: list[Site] = []
    asked: list[bool] = []

    def interrupt() -> None:
        asked.append(True)
        for site in sites:
            for member in site.members.values():
                member.node.interrupt()

    descriptor = install_stop_signals(interrupt)
    keys = MEMBERS[read.site]
    try:
        with opened(read, keys, descriptor) as (site, _):
            sites.append(site)
            device = next(site.members[key] for key in keys if key in DEVICES)

            def stop(number: int, frame: FrameType | None) -> None:
                device.loop.note_stop_signal()
                with contextlib.suppress(BlockingIOError):
                    os.read(descriptor, 64)

            if STOP_SIGNAL is not None:
                signal.signal(STOP_SIGNAL, stop)
            if asked:
                interrupt()
            site.run()
    except TelenanoError as error:
        StructuredLog(keys[0]).error(str(error))
        return EXIT_BAD_START
    return 0


if __name__ == "__main__":
    sys.exit(run())
