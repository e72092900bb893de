"""A way of your own between two machines, beside or in place of TCP; docs/extending/io.md has an example.

The entry of a package is an object of a subclass of `LinkTransport`. The runtime of a node and the launcher call it;
two processes have an end of the link, and pass it a `LinkSide`.
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

# A `set` of the link with this key is no setting: it measures what the line between two machines carries.
TRAIN = "line.train"
_NEAR_END = f"{LINK}@slave"


class LinkEnds(NamedTuple):
    """What one of the two processes that the link ends in has of a transport, all of it by default nothing.

    Attributes:
        readers: What the loop of the process reads as it reads its subscribers.
        carry: Called with topic and bytes of every message that the process publishes. It sends those that cross
            otherwise than by TCP, and returns what goes before the topic of one that is sent by TCP once more.
        measure: Measures what the line carries, and returns whether it could.
    """

    readers: Sequence[Reader] = ()
    carry: Callable[[str, bytes], bytes | None] | None = None
    measure: Callable[[], bool] | None = None


class _BesideConnection(Subscriber):
    """A further connection to the other machine; a callable returns what of its messages the reader receives."""

    def __init__(self, side: "LinkSide", take: Callable[[Sequence[Taken]], list[Received]]) -> None:
        super().__init__(side.network.context, side.clock, {}, connect=False)
        self._take = take

    def receive(self, *, signalled: bool = False) -> list[Received]:
        """Return the messages that have arrived, as the callable returns them."""
        waiting = self.receive_raw(signalled=signalled)
        return self._take(waiting) if waiting else []


class LinkSide:
    """One of the two processes that the link ends in, as a transport has it for its end.

    Attributes:
        network: The sockets of the process, with the keys of the machines (`network.access_control`).
        clock: The clock of the node.
        book: The address book, with the settings (`book.link.read(MySettings)`).
        is_master: Whether this is the end at the master's site.
        machine: The other machine.
        reader: Receives from it over TCP. What came otherwise is handed to its method `take`, which judges it alike.
    """

    # It has no socket of its own that would become readable.
    sockets = ()

    def __init__(
        self, network: Transport, outgoing: ZmqPublisher, reports: ZmqPublisher, reader: Subscriber, *, is_master: bool
    ) -> None:
        """Stand at one end.

        Args:
            network: The network of the process.
            outgoing: What the process publishes for the other machine with.
            reports: What it publishes the status of the network with, at its own site.
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
        """Return the side of a node; None where nothing is received from another machine."""
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
    def endpoint(self) -> str:
        """The TCP endpoint of the link: at the master where it is bound, at the slave where it is reached."""
        near = self.book.bind_endpoint(_NEAR_END) if self.is_master else None
        return near or self.book.connect_endpoint(_NEAR_END, self.network.machine)

    def publish(self, topic: str, **fields: Any) -> Message:
        """Send a message that the other end subscribes to."""
        return self._outgoing.publish(topic, **fields)

    def report(self, topic: str, **fields: Any) -> Message:
        """Send a message about the network at this site."""
        return self._reports.publish(topic, **fields)

    def tell(self, level: str, text: str, data: Mapping[str, bool | float | str]) -> None:
        """Report in a sentence what has happened to the connection; it becomes a session/event of the node."""
        self._events.append(ConnectionEvent(level, text, dict(data)))

    def connect_beside(self, take: Callable[[Sequence[Taken]], list[Received]]) -> Subscriber:
        """Connect to the other machine once more, and return the reader of that connection.

        Args:
            take: Called with the frames of what has arrived by it, each with the time of reception [ns]; returns the
                messages for the loop.
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
        """Have an end take part in the process.

        Args:
            *readers: What the loop reads as it reads its subscribers.
            carry: Called with topic and bytes of every message that the process publishes. It sends those that cross
                otherwise than by TCP, and returns what goes before the topic of one that is sent by TCP once more, or
                None.
            measure: Measures what the line carries, and returns whether it could.
            permissions_changed: Called when the list of allowed keys has changed.
            close: Called when the process ends.
        """
        self.ends = LinkEnds(readers, carry, measure)
        self._permissions_changed, self._close = permissions_changed, close
        self.network.look_after(self)

    def process_events(self) -> bool:
        """Do nothing: what has happened is noted where it happens."""
        return False

    def take_events(self) -> list[ConnectionEvent]:
        """Return what was reported since the last call."""
        events, self._events = self._events, []
        return events

    def apply_permissions(self) -> None:
        """Hand on that the list of allowed keys has changed."""
        self._permissions_changed()

    def close(self) -> None:
        """Close the end."""
        self._close()


class PieceSender(Protocol):
    """What `LinkTransport.sender` returns."""

    def request(self, parameters: Mapping[str, Any], now_ns: int) -> str:
        """Take what the other site asks for by a command `set`; return in words what is done.

        Raises:
            RefusedError: What is wrong with the command.
        """

    def send_due(self, now_ns: int) -> None:
        """Send what is due at a time [ns]."""

    def close(self) -> None:
        """End what is being sent."""


class LineCheck(Protocol):
    """What `LinkTransport.line_check` returns: whether the line between the sites carries a session."""

    def record(self, message: Message) -> None:
        """Take note of a message, a link/network or another one."""

    def settled(self) -> bool:
        """Return whether the line is known, or nothing more is to be expected."""

    def refusal(self) -> str:
        """Return why there can be no session; empty where there can, or where that is in doubt."""

    def advice(self) -> list[str]:
        """Return what becomes of a session on a line that is narrow, in sentences."""


class LinkTransport(SiteFileTransport, ABC):
    """What an entry of the kind `transports` is an object of.

    Every process of two machines may read it, so its methods import what they need. One with `reaches_relay` has
    `run_beside`, and one with `fetches` has `sender` and `fetch`.
    """

    @abstractmethod
    def open_end(self, side: LinkSide) -> None:
        """Open an end of the link, and call `side.opened` with it; without that call there is none.

        Raises:
            OSError, ValueError, ConfigError: There can be no end; the log has the reason, and TCP carries everything.
        """

    def line_check(self, monotonic_ns: Callable[[], int]) -> LineCheck | None:
        """Return what judges the line at the start of a session, by a monotonic clock [ns]; None where nothing does."""
        return None

    def run_beside(self, book: AddressBook, site: str, log: StructuredLog) -> None:
        """Reach the relay of the site file for the nodes of a site, in a process of its own, until SIGTERM or SIGINT.

        Raises:
            TelenanoError: It cannot begin.
        """
        raise NotImplementedError

    def sender(self, folder: Path, publish: Callable[..., Any]) -> PieceSender:
        """Return what sends the recording of the slave's site from a folder, by what publishes for the launcher."""
        raise NotImplementedError

    def fetch(
        self, book: AddressBook, session: SessionFolder, kbit_per_s: float | None, show: Callable[[str], None]
    ) -> Path:
        """Fetch the files that the slave's site recorded, merge them with the own ones, and return the result.

        Args:
            book: The addresses of the rig.
            session: The folder of the session.
            kbit_per_s: The most that is fetched [kbit/s]; None is as much as does no harm.
            show: Called with each line for the user.

        Raises:
            TelenanoError: The own recording is kept, and the error is reported as what is missing.
        """
        raise NotImplementedError


def link_transport(name: str) -> LinkTransport:
    """Return the transport of a name as `named` does; ConfigError where there is none."""
    return _complete(named(name))


def fetching_transport() -> LinkTransport | None:
    """Return the installed transport that fetches the other site's recording; None without any."""
    transport = fetching()
    return None if transport is None else _complete(transport)


def _complete(transport: SiteFileTransport) -> LinkTransport:
    if not isinstance(transport, LinkTransport):
        raise ConfigError(f"the transport {type(transport).__name__} is no LinkTransport of telenano.runtime")
    return transport
