"""The declaration of this package's transport; the modules of an end are loaded only when it is opened."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from telenano.recording import SessionFolder
from telenano.runtime import AddressBook, LinkSide, LinkTransport, StructuredLog
from telenano_wide_area.settings import DatagramSettings

if TYPE_CHECKING:
    from telenano_wide_area.line_check import LineCheck
    from telenano_wide_area.piece_sender import PieceSender


class DatagramTransport(LinkTransport):
    """Sealed datagrams between two machines, a relay for both, and the fetch of the slave's recording."""

    settings = DatagramSettings
    reaches_relay = True
    fetches = True

    def open_end(self, side: LinkSide) -> None:
        """Open the end of a side, and a second TCP connection for it."""
        from telenano_wide_area.link_end import open_end

        open_end(side)

    def run_beside(self, book: AddressBook, site: str, log: StructuredLog) -> None:
        """Run the end of a site at the relay until SIGTERM or SIGINT."""
        from telenano_wide_area.relay.site_end import site_end, until_stopped

        until_stopped(site_end(book, site, log).run())

    def line_check(self, monotonic_ns: Callable[[], int]) -> "LineCheck":
        """Return the check of the line by the reports of both ends."""
        from telenano_wide_area.line_check import LineCheck

        return LineCheck(monotonic_ns)

    def sender(self, folder: Path, publish: Callable[..., Any]) -> "PieceSender":
        """Return the sender of a folder's files, in pieces."""
        from telenano_wide_area.piece_sender import PieceSender

        return PieceSender(folder, publish)

    def fetch(
        self, book: AddressBook, session: SessionFolder, kbit_per_s: float | None, show: Callable[[str], None]
    ) -> Path:
        """Fetch the slave's site's recording, merge it with the master's, and return the merged recording."""
        from telenano_wide_area.far_recording import fetch_and_merge

        return fetch_and_merge(book, session, kbit_per_s, show)


DATAGRAM = DatagramTransport()
