"""The interface for transports of packages between two machines, beside or instead of TCP.

docs/extending/io.md has an example. The entry of a package is an object of a subclass of `LinkTransport`. The runtime
of a node and the launcher call it; the two processes at the ends of the link pass it a `LinkSide`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

from telenano.recording.session_folder import SessionFolder
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import ConnectionEvent, Reader, Subscriber, Taken
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.bus.transports import SiteFileTransport, fetching, named
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.wiring.transport import Transport
from telenano.wire.errors import ConfigError
from telenano.wire.messages import Message
from telenano.wire.nodes import FAR_END, LINK
from telenano.wire.received import Received

# A `set` of the link with this key changes no setting: it starts a measurement of the capacity of the line.
TRAIN = "line.train"
_NEAR_END = f"{LINK}@slave"


class LinkEnds(NamedTuple):
    """The parts of a transport in one of the two processes at the ends of the link; by default none.

    Attributes:
        readers: Further readers, which the loop of the process reads like its subscribers.
        carry: Called with topic and bytes of every message that the process publishes. It sends those that the
            transport carries, and returns the prefix of the topic for a message that TCP also sends a second time.
        measure: Measures the capacity of the line, and returns whether it could.
    """

    readers: Sequence[Reader] = ()
    carry: Callable[[str, bytes], bytes | None] | None = None
    measure: Callable[[], bool] | None = None


class _BesideConnection(Subscriber):
    """A second connection to the other machine; a callable selects and decodes the messages of its reader."""

    def __init__(self, side: "LinkSide", take: Callable[[Sequence[Taken]], list[Received]]) -> None:
        super().__init__(side.network.context, side.clock, {}, connect=False)
        self._take = take

    def receive(self, *, signalled: bool = False) -> list[Received]:
        """Return the messages that the callable makes of the frames that have arrived."""
        waiting = self.receive_raw(signalled=signalled)
        return self._take(waiting) if waiting else []


class LinkSide:
    """The interface of a transport to the process at one end of the link.

    Attributes:
        network: The sockets of the process, with the keys of the machines (`network.access_control`).
        clock: The clock of the node.
        book: The address book, with the settings (`book.link.read(MySettings)`).
        is_master: Whether this is the end at the master's site.
        machine: The other machine.
        reader: Receives from the other machine over TCP. Messages received by the transport are passed to its method
            `take`, which checks them in the same manner.
    """

    # This handler has no sockets of its own to wait for.
    sockets = ()

    def __init__(
        self, network: Transport, outgoing: ZmqPublisher, reports: ZmqPublisher, reader: Subscriber, *, is_master: bool
    ) -> None:
        """Make the interface of one end.

        Args:
            network: The network of the process.
            outgoing: The publisher of messages for the other machine.
            reports: The publisher of the status of the network, at the process's own site.
            reader: Receives from the other machine.
            is_master: Whether this is the end at the master's site.
        """
        self.network, self.clock, self.book = network, network.clock, network.book
        self.is_master, self.reader = is_master, reader
        self.machine = self.book.machine_of(FAR_END if is_master else _NEAR_END)
        self.ends = LinkEnds()
        self._outgoing, self._reports = outgoing, reports
        self._events: list[ConnectionEvent] = []
        self._permissions_changed: Callable[[], None] = lambda: None
        self._close: Callable[[], None] = lambda: None

    @classmethod
    def of(
        cls,
        key: str,
        network: Transport,
        outgoing: ZmqPublisher,
        reports: ZmqPublisher,
        readers: Sequence[Subscriber],
    ) -> Self | None:
        """Return the side of a node; None if no reader receives from another machine's end of the link."""
        book, is_master = network.book, key != FAR_END
        if not {_NEAR_END, FAR_END} <= set(book.nodes):
            return None
        machine = book.machine_of(FAR_END if is_master else _NEAR_END)
        reader = network.reader_of(machine, readers)
        if reader is None or machine == network.machine:
            return None
        return cls(network, outgoing, reports, reader, is_master=is_master)

    @property
    def is_allowed(self) -> bool:
        """Whether the key of the other machine is in the list, and has a role."""
        return bool(self.network.access_control.roles(self.machine))

    @property
    def is_connected(self) -> bool:
        """Whether some node of the other machine is connected over TCP now."""
        return self.network.is_connected_to(self.machine)

    @property
    def own_endpoint(self) -> str | None:
        """The TCP endpoint that this machine binds for the other end; None if it binds none."""
        return self.book.bind_endpoint(_NEAR_END if self.is_master else FAR_END)

    @property
    def endpoint(self) -> str:
        """The TCP endpoint of the link: at the master the bound one, at the slave the one to connect to."""
        near = self.book.bind_endpoint(_NEAR_END) if self.is_master else None
        return near or self.book.connect_endpoint(_NEAR_END, self.network.machine)

    def publish(self, topic: str, **fields: Any) -> Message:
        """Send a message that the other end subscribes to."""
        return self._outgoing.publish(topic, **fields)

    def report(self, topic: str, **fields: Any) -> Message:
        """Send a message about the network at this site."""
        return self._reports.publish(topic, **fields)

    def tell(self, level: str, text: str, data: Mapping[str, bool | float | str]) -> None:
        """Report an event of the connection as a sentence; it becomes a session/event of the node."""
        self._events.append(ConnectionEvent(level, text, dict(data)))

    def connect_beside(self, take: Callable[[Sequence[Taken]], list[Received]]) -> Subscriber:
        """Open a second connection to the other machine, and return its reader.

        Args:
            take: Called with the frames of the messages that have arrived by it, each with the time of reception [ns];
                returns the messages for the loop.
        """
        beside = _BesideConnection(self, take)
        self.network.connect_beside(FAR_END if self.is_master else _NEAR_END, beside)
        return beside

    def opened(
        self,
        *readers: Reader,
        carry: Callable[[str, bytes], bytes | None] | None = None,
        measure: Callable[[], bool] | None = None,
        permissions_changed: Callable[[], None] = lambda: None,
        close: Callable[[], None] = lambda: None,
    ) -> None:
        """Register an end of a transport in this process.

        Args:
            *readers: Further readers, which the loop reads like its subscribers.
            carry: Called with topic and bytes of every message that the process publishes. It sends those that the
                transport carries, and returns the prefix of the topic for a message that TCP also sends a second time,
                else None.
            measure: Measures the capacity of the line, and returns whether it could.
            permissions_changed: Called when the list of allowed keys has changed.
            close: Called when the process ends.
        """
        self.ends = LinkEnds(readers, carry, measure)
        self._permissions_changed, self._close = permissions_changed, close
        self.network.look_after(self)

    def process_events(self) -> bool:
        """Do nothing and return False: the transport reports its events by `tell`."""
        return False

    def take_events(self) -> list[ConnectionEvent]:
        """Return the events reported since the last call."""
        events, self._events = self._events, []
        return events

    def apply_permissions(self) -> None:
        """Tell the transport that the list of allowed keys has changed."""
        self._permissions_changed()

    def close(self) -> None:
        """Close the end."""
        self._close()


class PieceSender(Protocol):
    """Sender of the recording of the slave's site, as `LinkTransport.sender` returns it."""

    def request(self, parameters: Mapping[str, Any], now_ns: int) -> str:
        """Accept a request of the other site, made by a command `set`; return a sentence on its result.

        Raises:
            RefusedError: The command is invalid; the message has the reason.
        """

    def send_due(self, now_ns: int) -> None:
        """Send the pieces that are due at a time [ns]."""

    def close(self) -> None:
        """Stop sending."""


class LineCheck(Protocol):
    """Check whether the line between the sites can carry a session, as `LinkTransport.line_check` returns it."""

    def record(self, message: Message) -> None:
        """Record a message, a link/network or another one."""

    def settled(self) -> bool:
        """Return whether the capacity of the line is known, or no more information is expected."""

    def refusal(self) -> str:
        """Return the reason why no session is possible; empty if one is possible, or that is uncertain."""

    def advice(self) -> list[str]:
        """Return sentences on the effects that a narrow line will have on a session."""


class LinkTransport(SiteFileTransport, ABC):
    """Base class of the entries of the kind `transports`.

    Every process of two machines may import the module, so the methods import what they need. A transport with
    `reaches_relay` implements `run_beside`, and one with `fetches` implements `sender` and `fetch`.
    """

    @abstractmethod
    def open_end(self, side: LinkSide) -> None:
        """Open an end of the link, and register it by `side.opened`; without that call, TCP carries everything.

        Raises:
            OSError, ValueError, ConfigError: The end cannot be opened. The caller logs the reason, and TCP carries
                everything.
        """

    def line_check(self, monotonic_ns: Callable[[], int]) -> LineCheck | None:
        """Return the check of the line at the start of a session, or None; `monotonic_ns` returns the time [ns]."""
        return None

    def run_beside(self, book: AddressBook, site: str, log: StructuredLog) -> None:
        """Connect the nodes of a site to the relay of the site file, in a separate process, until SIGTERM or SIGINT.

        Raises:
            TelenanoError: The connection cannot be started.
        """
        raise NotImplementedError

    def sender(self, folder: Path, publish: Callable[..., Any]) -> PieceSender:
        """Return the sender of the slave's site's recording.

        Args:
            folder: The folder of the recording.
            publish: Publishes a message for the launcher.
        """
        raise NotImplementedError

    def fetch(
        self, book: AddressBook, session: SessionFolder, kbit_per_s: float | None, show: Callable[[str], None]
    ) -> Path:
        """Fetch the files recorded at the slave's site, merge them with the local ones, and return the result's path.

        Args:
            book: The addresses of the rig.
            session: The folder of the session.
            kbit_per_s: The greatest rate [kbit/s]; None for the greatest that disturbs nothing else.
            show: Called with each line for the user.

        Raises:
            TelenanoError: Files could not be fetched or merged. The caller keeps the local recording, and reports the
                error as what is missing.
        """
        raise NotImplementedError


def link_transport(name: str) -> LinkTransport:
    """Return the transport with a name as `named` does; raise ConfigError if there is none."""
    return _complete(named(name))


def fetching_transport() -> LinkTransport | None:
    """Return the installed transport that fetches the other site's recording; None if there is none."""
    transport = fetching()
    return None if transport is None else _complete(transport)


def _complete(transport: SiteFileTransport) -> LinkTransport:
    if not isinstance(transport, LinkTransport):
        raise ConfigError(f"the transport {type(transport).__name__} is not a LinkTransport of telenano.runtime")
    return transport
