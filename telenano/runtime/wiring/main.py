"""The way from a command line to a running node: configuration, clock, bus, loop."""

import argparse
import gc
import importlib
import os
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NoReturn, Self, TypeVar

from pydantic import BaseModel

from telenano.files import held_files
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.local_endpoint import FIRST_RIG, RIG_VARIABLE
from telenano.runtime.loop.log import StructuredLog, configure_logging
from telenano.runtime.loop.node import Node, NodeBus, NodeContext
from telenano.runtime.loop.realtime import (
    ahead_of_others,
    apply_realtime,
    behind_others,
    ordinary_scheduling,
    raise_file_limit,
    use_huge_pages,
)
from telenano.runtime.security.private_files import check_rig_name
from telenano.runtime.wiring.participant import Participant, StopSignals
from telenano.settings.included import DEFAULT_SITE_FILE, find_scenario, site_file_named
from telenano.settings.plugins import fault_of_package
from telenano.settings.scenario import LoadedScenario, RealtimeConfig
from telenano.signals.children import die_with_parent
from telenano.wire.errors import TelenanoError
from telenano.wire.nodes import module_of, sites_of

C = TypeVar("C", bound=BaseModel)

EXIT_BAD_START = 2
EXIT_DIED = 1


@dataclass(frozen=True, kw_only=True)
class Wiring(Participant):
    """What a node's builder is given: its part in the bus, and the files that it is configured by."""

    site_file: Path
    scenario_file: Path


W = TypeVar("W", bound=Wiring)


@dataclass(frozen=True)
class NodeKind(Generic[C]):
    """A kind of node: its name in the table of nodes, its section of the scenario and how it is built.

    `realtime`, whether it is in the loop: what is not comes behind the others; `observer`, whether it shows what they
    do: it keeps the garbage collector.
    """

    name: str
    config: type[C]
    build: Callable[[Wiring, C], tuple[Node, NodeBus]]
    realtime: bool = True
    observer: bool = False

    @property
    def sites(self) -> tuple[str, ...]:
        return sites_of(self.name)

    def open(
        self, wiring: Wiring, loaded: LoadedScenario, adapt: Callable[[str, C], C] = lambda key, config: config
    ) -> tuple[Node, NodeBus]:
        """Build a node of this kind with its bus, from its section of a scenario.

        With sockets, in memory and from a recording it is opened alike; the wiring is what differs.

        Args:
            wiring: What the builder of the node is given.
            loaded: The scenario.
            adapt: Returns the section that the node with this key gets, from the one that stands there.

        Raises:
            ConfigError: Its section of the scenario cannot be used.
            EndpointError: An endpoint of it cannot be bound.
        """
        return self.build(wiring, adapt(wiring.key, loaded.section(self.name, self.config)))


def node_kind(name: str) -> NodeKind[Any]:
    """Return the kind that a service declares for itself, so that a check and the node's own cannot differ."""
    module = importlib.import_module(f"{module_of(name)}.__main__")
    return next(value for value in vars(module).values() if isinstance(value, NodeKind))


def ordinary(node: Callable[[NodeContext, C], Node], inputs: Sequence[str]) -> Callable[..., tuple[Node, NodeBus]]:
    """Return the builder of a node of the loop that has one bus."""

    def build(wiring: Wiring, config: C) -> tuple[Node, NodeBus]:
        bus = wiring.bus(inputs, newest_only=True)
        return node(wiring.context(bus), config), bus

    return build


class NodeArguments(argparse.Namespace):
    """What a node is started with."""

    site_file: Path
    scenario: Path
    site: str
    set: list[str]
    rig: str | None
    with_parent: bool
    held: int | None
    node: list[str]


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Exit with an error of the command line in one sentence."""
        self.exit(EXIT_BAD_START, f"{self.prog}: {message} (`{self.prog} --help` explains)\n")


def parse_arguments(
    name: str, sites: Sequence[str], arguments: Sequence[str] | None, *, joins: bool = False
) -> NodeArguments:
    """Read the command line of a node, or of a process that `joins` several."""
    parser = _Parser(prog=f"telenano node {name}", description=f"Run one {name} of the rig.")
    about = "address book of the rig: a known name or a YAML file; default: local, all on this machine"
    parser.add_argument("--site-file", type=Path, default=DEFAULT_SITE_FILE, metavar="NAME|FILE", help=about)
    about = "scenario with this node's section: a known name or a YAML file"
    parser.add_argument("--scenario", type=Path, required=True, metavar="NAME|FILE", help=about)
    parser.add_argument("--site", choices=sites, default=sites[0], help="site that this process belongs to")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE", help="change one key")
    about = f"rig of several on this machine; default: {RIG_VARIABLE}, else the first one, {FIRST_RIG}"
    parser.add_argument("--rig", metavar="NAME", help=about)
    parser.add_argument("--with-parent", action="store_true", help="stop when the process that started this one ends")
    if joins:
        parser.add_argument("--node", action="append", required=True, metavar="NODE", help="run this node (repeatable)")
    # What a launcher holds for its nodes is a descriptor, which nobody types.
    parser.add_argument("--held", type=int, help=argparse.SUPPRESS)
    read = parser.parse_args(arguments, namespace=NodeArguments())
    if read.held is not None:
        held_files.receive(read.held)
    return read


def beside_the_loop() -> None:
    """Prepare a process that has to keep up with the loop: log, descriptors, and a priority above ordinary ones."""
    configure_logging()
    raise_file_limit()
    ahead_of_others()


@dataclass(frozen=True)
class StartingFiles:
    """What the nodes of a process are configured by: address book and scenario, and the files that they are from."""

    site_file: Path
    scenario_file: Path
    book: AddressBook
    loaded: LoadedScenario

    @classmethod
    def read(cls, arguments: NodeArguments) -> Self:
        """Read what a command line names, and obey what else it says of the process.

        Raises:
            ConfigError: A file or a key of it cannot be used.
        """
        if arguments.with_parent:
            die_with_parent(signal.SIGTERM)
        if arguments.rig is not None:
            os.environ[RIG_VARIABLE] = check_rig_name(arguments.rig)
        site_file = site_file_named(arguments.site_file) or DEFAULT_SITE_FILE
        scenario_file = find_scenario(str(arguments.scenario))
        book = AddressBook.load(site_file)
        return cls(site_file, scenario_file, book, LoadedScenario.load(scenario_file, arguments.set))

    def wiring(self, participant: Participant, make: Callable[..., W], **further: Any) -> W:
        """Return the wiring of a node, of a class `make` with these further fields."""
        values = {**vars(participant), "period_s": self.loaded.scenario.period_s, **further}
        return make(**values, site_file=self.site_file, scenario_file=self.scenario_file)


def exit_code_of(run: Callable[[], None], log: StructuredLog) -> int:
    """Run the nodes of a process until they are stopped; return its exit code, 2 when it could not start."""
    # What was imported stays, so that no later collection has to look through it.
    gc.freeze()
    gc.enable()
    configure_logging()
    try:
        run()
    except TelenanoError as error:
        log.error(str(error))
        return EXIT_BAD_START
    except (Exception, SystemExit) as error:
        if not (text := fault_of_package(error)):
            raise
        log.error(text)
        # The exit code of a package that ends the program is not passed on, because 2 means a fault of the
        # configuration in this project.
        if isinstance(error, SystemExit):
            return EXIT_DIED
        raise
    return 0


def run_node(kind: NodeKind[C], arguments: Sequence[str] | None = None) -> int:
    """Run a node until it is stopped; return the exit code, 2 when it could not start."""
    arguments_read = parse_arguments(kind.name, kind.sites, arguments)
    log = StructuredLog(f"{kind.name}@{arguments_read.site}")
    return exit_code_of(lambda: _run(kind, arguments_read, log), log)


def _run(kind: NodeKind[C], arguments: NodeArguments, log: StructuredLog) -> None:
    files = StartingFiles.read(arguments)
    scenario = files.loaded.scenario
    # A section that cannot be used is told before anything of the process is changed.
    files.loaded.section(kind.name, kind.config)
    wanted = scenario.realtime_in_force() if kind.realtime else RealtimeConfig(scheduler="normal", memory_lock="off")
    if not kind.realtime:
        behind_others()
    # It comes before the ZeroMQ context exists, whose threads inherit the scheduling.
    key = f"{kind.name}@{arguments.site}"
    status = apply_realtime(wanted, log, key)
    signals = StopSignals()
    with Participant.open(key, files.book, signals.descriptor) as participant:
        node, bus = kind.open(files.wiring(participant, Wiring), files.loaded)
        # This takes tens of ms for a large process, in which the others on its processor have their periods to keep.
        with ordinary_scheduling():
            huge_pages = use_huge_pages() if scenario.realtime.huge_pages else 0
        log.info("ready", realtime=status.fifo, memory_locked=status.memory_locked, huge_pages=huge_pages)
        signals.run(node, bus, status, freeze=not kind.observer, guarded=kind.realtime)
    log.info("stopped")
