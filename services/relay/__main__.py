"""The process of a site that reaches the other site through a relay; it runs the transport of the link."""

import signal
import sys
from collections.abc import Sequence

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.wiring.link_transports import link_transport
from telenano.runtime.wiring.main import EXIT_BAD_START, beside_the_loop, parse_arguments
from telenano.runtime.wiring.participant import SITES
from telenano.signals.children import die_with_parent
from telenano.wire.errors import TelenanoError
from telenano.wire.nodes import RELAY


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the transport of the site file until it ends; return the exit code, 2 if it could not start."""
    arguments_read = parse_arguments(RELAY, SITES, arguments)
    log = StructuredLog(f"{RELAY}@{arguments_read.site}")
    if arguments_read.with_parent:
        die_with_parent(signal.SIGTERM)
    beside_the_loop()
    try:
        book = AddressBook.load(arguments_read.site_file)
        link_transport(book.link.transport).run_beside(book, arguments_read.site, log)
    except TelenanoError as error:
        log.error(str(error))
        return EXIT_BAD_START
    return 0


if __name__ == "__main__":
    sys.exit(main())
