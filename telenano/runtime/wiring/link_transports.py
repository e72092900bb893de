"""A way of your own between two machines, beside or in place of TCP; docs/extending.md has an example.

The entry of the package is a `LinkTransport` of `telenano.runtime`, and what it names has these shapes. The runtime of
a node and the launcher call it.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import Subscriber
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.wiring.participant import LinkEnds
from telenano.runtime.wiring.transport import Transport


class OpenEnds(Protocol):
    """`LinkTransport.ends`: opens an end of the link in one of the two processes that it ends in."""

    def __call__(
        self, key: str, network: Transport, outgoing: ZmqPublisher, reports: ZmqPublisher, readers: Sequence[Subscriber]
    ) -> LinkEnds:
        """Open the end, which takes part in the network of the process by `network.look_after`.

        Args:
            key: The node that opens it: `delay_node@master` at the master, `controller@slave` at the slave.
            network: The network of the process: its clock, its address book with the settings
                (`network.book.link.read(MySettings)`), the keys of the machines, and which of `readers` receives from
                the other machine (`network.reader_of`).
            outgoing: What the process publishes for the other machine with; its messages pass by `LinkEnds.carry`.
            reports: What it publishes `link/network` with, the status of the network.
            readers: What it receives with; messages that came otherwise are handed to one by its method `take`.

        Raises:
            OSError, ValueError, ConfigError: There can be no end; the log has the reason, and TCP carries everything.
        """


class SendsPieces(Protocol):
    """What `LinkTransport.sender` makes, called with the folder of recordings and with what publishes for the launcher.

    It sends the recording of the slave's site.
    """

    def request(self, parameters: Mapping[str, Any], now_ns: int) -> str:
        """Take what the other site asks for by a command `set`; return in words what is done.

        Raises:
            RefusedError: What is wrong with the command.
        """

    def send_due(self, now_ns: int) -> None:
        """Send what is due at a time [ns]."""

    def close(self) -> None:
        """End what is being sent."""


class FetchRecording(Protocol):
    """`LinkTransport.fetch`: fetches what the slave's site recorded and returns the recording of both sites."""

    def __call__(
        self,
        book: AddressBook,
        folder: Path,
        own: Sequence[Path],
        kbit_per_s: float | None,
        show: Callable[[str], None],
    ) -> Path:
        """Fetch the files that `far.json` in the folder of a session lists, and merge them with the own ones.

        Args:
            book: The addresses of the rig.
            folder: The folder of the session.
            own: The parts of the own recording.
            kbit_per_s: The most that is fetched [kbit/s].
            show: Called with each line for the user.

        Raises:
            TelenanoError: The own recording is kept, and the error is reported as what is missing.
        """
