"""Start of a node from its command line: configuration, clock, bus, loop."""

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
from telenano.runtime.wiring.trace_reader import TraceReader
from telenano.settings.included import DEFAULT_SITE_FILE, find_scenario, site_file_named
from telenano.settings.link_files import Traces
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
    """The argument of a node's builder: the node's part in the bus, and its configuration files."""

    site_file: Path
    scenario_file: Path

    def traces(self) -> Traces:
        """Return the reader of the files that the link names; once begun, it reads in a child process."""
        return TraceReader()


W = TypeVar("W", bound=Wiring)


@dataclass(frozen=True)
class NodeKind(Generic[C]):
    """A kind of node: its name in the table of nodes, the model of its section of the scenario, and its builder.

    `realtime`: the node belongs to the loop; others run at a lower priority. `observer`: the node displays the work of
    others, and keeps the garbage collector.
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

        Nodes with sockets, in memory and from a recording are opened in the same manner; only the wiring differs.

        Args:
            wiring: The argument of the node's builder.
            loaded: The scenario.
            adapt: Called with the key of the node and its section of the scenario; returns the section to use.

        Raises:
            ConfigError: The node's section of the scenario is invalid.
            EndpointError: An endpoint of the node cannot be bound.
        """
        return self.build(wiring, adapt(wiring.key, loaded.section(self.name, self.config)))


def node_kind(name: str) -> NodeKind[Any]:
    """Return the kind that a service declares in its `__main__`, so that checks and the node itself use the same."""
    module = importlib.import_module(f"{module_of(name)}.__main__")
    return next(value for value in vars(module).values() if isinstance(value, NodeKind))


def ordinary(node: Callable[[NodeContext, C], Node], inputs: Sequence[str]) -> Callable[..., tuple[Node, NodeBus]]:
    """Return the builder for a node of the loop with one bus.

    Args:
        node: Makes the node from its context and section.
        inputs: The topics that the node reads.
    """

    def build(wiring: Wiring, config: C) -> tuple[Node, NodeBus]:
        bus = wiring.bus(inputs, newest_only=True)
        return node(wiring.context(bus), config), bus

    return build


class NodeArguments(argparse.Namespace):
    """The command line of a node."""

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
    """Parse the command line of a node, or of a process that `joins` several nodes."""
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
    # The descriptor of files that a launcher holds for its nodes; no person types it.
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
    """The configuration of the nodes of a process: address book and scenario, and the files they were read from."""

    site_file: Path
    scenario_file: Path
    book: AddressBook
    loaded: LoadedScenario

    @classmethod
    def read(cls, arguments: NodeArguments) -> Self:
        """Read the files that a command line names, and apply its options `--with-parent` and `--rig`.

        Raises:
            ConfigError: A file or one of its keys is invalid.
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
        """Return the wiring of a node: an object of the class `make`, with these further fields."""
        values = {**vars(participant), "period_s": self.loaded.scenario.period_s, **further}
        return make(**values, site_file=self.site_file, scenario_file=self.scenario_file)


def exit_code_of(run: Callable[[], None], log: StructuredLog) -> int:
    """Run the nodes of a process until they are stopped.

    Returns:
        The exit code: 0, EXIT_BAD_START (2) after a TelenanoError, EXIT_DIED (1) if a package ended the program.
    """
    # Imported objects stay for good; frozen, they are not scanned by later collections.
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
    """Run a node until it is stopped; return its exit code, 2 if it could not start (see `exit_code_of`)."""
    arguments_read = parse_arguments(kind.name, kind.sites, arguments)
    log = StructuredLog(f"{kind.name}@{arguments_read.site}")
    return exit_code_of(lambda: _run(kind, arguments_read, log), log)


def _run(kind: NodeKind[C], arguments: NodeArguments, log: StructuredLog) -> None:
    files = StartingFiles.read(arguments)
    scenario = files.loaded.scenario
    # An invalid section is reported before anything of the process is changed.
    files.loaded.section(kind.name, kind.config)
    wanted = scenario.realtime_in_force() if kind.realtime else RealtimeConfig(scheduler="normal", memory_lock="off")
    if not kind.realtime:
        behind_others()
    # The scheduling is set before the ZeroMQ context exists, because the context's threads inherit it.
    key = f"{kind.name}@{arguments.site}"
    status = apply_realtime(wanted, log, key)
    signals = StopSignals()
    with Participant.open(key, files.book, signals.descriptor) as participant:
        node, bus = kind.open(files.wiring(participant, Wiring), files.loaded)
        # Huge pages take tens of ms in a large process, and other processes on this processor must keep their periods.
        with ordinary_scheduling():
            huge_pages = use_huge_pages() if scenario.realtime.huge_pages else 0
        log.info("ready", realtime=status.fifo, memory_locked=status.memory_locked, huge_pages=huge_pages)
        signals.run(node, bus, status, freeze=not kind.observer, guarded=kind.realtime)
    log.info("stopped")
