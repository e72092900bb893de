"""The end of one site that reaches the other one through the relay of the site file: `python -P -m services.relay`."""

import asyncio
import contextlib
import signal
import sys
from collections.abc import Coroutine, Iterator, Sequence
from concurrent.futures import Future
from threading import Thread
from typing import Any

from services.relay.site_end import SiteEnd
from telenano.runtime.bus.address_book import RELAY, AddressBook, load_site
from telenano.runtime.loop.log import StructuredLog, configure_logging
from telenano.runtime.loop.realtime import ahead_of_others, raise_file_limit
from telenano.runtime.security.access_control import AccessControl
from telenano.runtime.security.keyring import Keyring
from telenano.runtime.wiring.main import EXIT_BAD_START, parse_arguments
from telenano.signals.children import die_with_parent
from telenano.wire.errors import ConfigError, EndpointError, TelenanoError


async def until_stopped(work: Coroutine[Any, Any, None]) -> None:
    """Run until SIGINT or SIGTERM, or until the work ends by an error, which is raised."""
    task = asyncio.ensure_future(work)
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await task


async def run_site_end(book: AddressBook, site: str, log: StructuredLog) -> None:
    """Run the end of a site; ConfigError where the site file has no relay, or a key is missing."""
    await _site_end(book, site, log).run()


def _site_end(book: AddressBook, site: str, log: StructuredLog) -> SiteEnd:
    if book.relay is None:
        raise ConfigError("the site file has no `relay: host:port`")
    return SiteEnd(book, site, AccessControl(site, Keyring(), requires_keys=True), log)


@contextlib.contextmanager
def at_relay(book: AddressBook) -> Iterator[None]:
    """Be the end of the master's site at the relay of the site file, if it has one, in a thread while a block runs.

    Where another process of this machine is that end, this one leaves it to that.

    Raises:
        ConfigError: A key is missing.
    """
    if book.relay is None:
        yield
        return
    end = _site_end(book, "master", StructuredLog(f"{RELAY}@master"))
    running: Future[tuple[asyncio.AbstractEventLoop, asyncio.Task[None] | None]] = Future()

    async def run() -> None:
        running.set_result((asyncio.get_running_loop(), asyncio.current_task()))
        with contextlib.suppress(EndpointError, asyncio.CancelledError):
            await end.run()

    thread = Thread(target=lambda: asyncio.run(run()), name=f"{RELAY}@master", daemon=True)
    thread.start()
    try:
        yield
    finally:
        loop, task = running.result()
        # A loop that has ended by itself can be told nothing.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(lambda: task is not None and task.cancel())
        thread.join()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the end of a site until it is stopped; return the exit code, 2 where it could not start."""
    given = parse_arguments("relay", ("master", "slave"), arguments)
    configure_logging()
    log = StructuredLog(f"relay@{given.site}")
    if given.with_parent:
        die_with_parent(signal.SIGTERM)
    raise_file_limit()
    ahead_of_others()
    try:
        asyncio.run(until_stopped(run_site_end(load_site(given.site_file), given.site, log)))
    except TelenanoError as error:
        log.error(str(error))
        return EXIT_BAD_START
    return 0


if __name__ == "__main__":
    sys.exit(main())
