"""Start of the nodes of a site in one process from a command line: one ZeroMQ context, clock and signal handler."""

import functools
import signal
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import FrameType
from typing import cast

import zmq

from telenano.runtime.bus.bus import Bus, Reader, Subscriber, ZmqBus
from telenano.runtime.bus.holders import STOP_SIGNAL
from telenano.runtime.bus.publisher import Publisher, ZmqPublisher
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.machine import SharedMachine
from telenano.runtime.loop.node import NodeContext
from telenano.runtime.loop.node_loop import STARTING_PERIOD_NS, NodeLoop
from telenano.runtime.loop.realtime import (
    apply_realtime,
    freeze_garbage,
    on_one_processor,
    ordinary_scheduling,
    use_huge_pages,
)
from telenano.runtime.site.shared_tasks import NodeTasks
from telenano.runtime.site.site_bus import Exchange, NearReader, SiteBus, SitePublisher
from telenano.runtime.site.site_loop import Member, SharedGuard, SiteLoop
from telenano.runtime.wiring.main import (
    NodeArguments,
    StartingFiles,
    Wiring,
    exit_code_of,
    node_kind,
    parse_arguments,
)
from telenano.runtime.wiring.participant import SITES, Participant, StopSignals, is_brief
from telenano.settings.scenario import LoadedScenario
from telenano.wire.errors import ConfigError, known_names
from telenano.wire.nodes import DEVICES, JOINED, LINK, endpoints_of, name_of


@dataclass(frozen=True, kw_only=True)
class SiteWiring(Wiring):
    """The argument of a node's builder: it opens sockets to other processes, and memory readers within this one."""

    publisher_class = SitePublisher
    site: SiteLoop = field(repr=False)
    # The node whose loop checks the paths and connections of the process.
    keeper: str

    def bind(self, key: str, kind: int = zmq.PUB, *, ends: bool = False) -> ZmqPublisher:
        publisher = cast(SitePublisher, super().bind(key, kind, ends=ends))
        publisher.hand_over = self.site.exchange.hand_over
        self.site.exchange.publishers.append(publisher)
        return publisher

    def subscribers(
        self,
        connections: Mapping[str, Sequence[str]],
        *,
        apart: bool = False,
        newest_only: bool = False,
        shared: bool = False,
    ) -> list[Subscriber]:
        exchange = self.site.exchange
        near = {node: topics for node, topics in connections.items() if node in exchange.endpoints}
        far = {node: topics for node, topics in connections.items() if node not in near}
        opened = super().subscribers(far, apart=apart, newest_only=newest_only, shared=shared) if far else []
        if near:
            topics = {topic for topics in near.values() for topic in topics}
            memory = NearReader(self.clock, topics, newest_only=newest_only)
            exchange.connect(self.key, memory, near)
            opened.insert(0, cast(Subscriber, memory))
        return opened

    def bus_of(self, publisher: Publisher, subscribers: Sequence[Reader]) -> ZmqBus:
        note = functools.partial(self.site.note_received, self.key)
        bus = SiteBus(publisher, subscribers, self.clock, self.wake_descriptor, note)
        bus.is_brief = is_brief(self.book, self.key)
        return bus

    def context(self, bus: Bus) -> NodeContext:
        context = super().context(bus)
        if self.key != self.keeper:
            context.places = context.hearing = None
        context.deferred = NodeTasks(self.site.tasks, self.key, self.clock)
        return context


def run_site(arguments: Sequence[str] | None = None) -> int:
    """Run the nodes of a site that the command line names until they stop; return the exit code, 2 if none ran."""
    read = parse_arguments("site", SITES, arguments, joins=True)
    log = StructuredLog(f"site@{read.site}")
    return exit_code_of(lambda: _run(read, log), log)


def _run(read: NodeArguments, log: StructuredLog) -> None:
    keys = _members(read)
    files = StartingFiles.read(read)
    check_simulated(files.loaded, keys)
    # The process runs on the processor of its last node, the device, or else the half of the controller.
    first = keys[-1]
    scenario = files.loaded.scenario
    # The scheduling is set before the ZeroMQ context exists, because the context's threads inherit it.
    status = apply_realtime(on_one_processor(scenario.realtime_in_force(), keys, first), log, first)
    signals = StopSignals()
    with Participant.open(first, files.book, signals.descriptor) as participant:
        ends = frozenset(end for key in keys for end in endpoints_of(key))
        exchange = Exchange(ends, next((key for key in keys if name_of(key) == LINK), ""))
        site = SiteLoop(keys, participant.clock, exchange, log.error)
        guard = SharedGuard(keys)
        members = []
        for key in keys:
            further = {"key": key, "log": StructuredLog(key), "site": site, "keeper": first}
            machine = SharedMachine([other for other in keys if other != key])
            wiring = files.wiring(participant, SiteWiring, **further, machine=machine)
            node, bus = node_kind(name_of(key)).open(wiring, files.loaded)
            alive = functools.partial(guard.note, key)
            loop = NodeLoop(node, bus, status, starting_period_ns=STARTING_PERIOD_NS, note_alive=alive)
            members.append(Member(key, node, cast(SiteBus, bus), loop))
        for publisher in exchange.publishers:
            publisher.yields = False
        # All sockets are open now; the node that checks the paths also processes the network events.
        members[-1].bus.look_after(participant.network)
        site.open(members, signals.descriptor)
        signals.interrupt(*site.nodes)
        if members[-1].key in DEVICES:
            _take_stops(site, members[-1].loop)
        # This takes tens of ms in a large process, and other processes on this processor must keep their periods.
        with ordinary_scheduling():
            huge_pages = use_huge_pages() if scenario.realtime.huge_pages else 0
            freeze_garbage()
        for member in members:
            facts = {"realtime": status.fifo, "memory_locked": status.memory_locked, "huge_pages": huge_pages}
            member.node.context.log.info("ready", **facts)
        site.run(guard)
    log.info("stopped")


def _members(read: NodeArguments) -> tuple[str, ...]:
    """Return the nodes that a command line names, in building order; raise ConfigError for an unknown one."""
    known = JOINED[f"site@{read.site}"]
    for node in read.node:
        if node not in known:
            raise ConfigError(f"--node {node}: is not a node of this process, {known_names(node, known)}")
    return tuple(key for key in known if key in read.node)


def check_simulated(loaded: LoadedScenario, keys: Collection[str]) -> None:
    """Raise ConfigError if one of these nodes drives a real device, which needs a separate process."""
    for key in keys:
        kind = node_kind(name_of(key))
        config = loaded.section(kind.name, kind.config)
        if not getattr(config, "simulated", True):
            text = f"{key} drives a real device ({kind.name}.driver: {config.driver})"
            raise ConfigError(f"{text}, which needs a process of its own, so that no other node can block it")


def _take_stops(site: SiteLoop, device: NodeLoop) -> None:
    """Obey an emergency stop at STOP_SIGNAL; the next turn reads the byte that the signal has written."""

    def stop(number: int, frame: FrameType | None) -> None:
        device.note_stop_signal()
        site.note_signal()

    if STOP_SIGNAL is not None:
        signal.signal(STOP_SIGNAL, stop)
