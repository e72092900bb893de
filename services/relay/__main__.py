"""The end of one site that reaches the other one through the relay of the site file: `python -P -m services.relay`."""

import asyncio
import contextlib
import signal
import sys
from collections.abc import Coroutine, Sequence
from typing import Any

from telenano.runtime.bus.address_book import load_site
from telenano.runtime.loop.log import StructuredLog, configure_logging
from telenano.runtime.loop.realtime import ahead_of_others, raise_file_limit
from telenano.runtime.relay.site_end import site_end
from telenano.runtime.wiring.main import EXIT_BAD_START, parse_arguments
from telenano.signals.children import die_with_parent
from telenano.wire.errors import TelenanoError


async def until_stopped(work: Coroutine[Any, Any, None]) -> None:
    """Run until SIGINT or SIGTERM, or until the work ends by an error, which is raised."""
    task = asyncio.ensure_future(work)
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await task


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
        asyncio.run(until_stopped(site_end(load_site(given.site_file), given.site, log).run()))
    except TelenanoError as error:
        log.error(str(error))
        return EXIT_BAD_START
    return 0


if __name__ == "__main__":
    sys.exit(main())
