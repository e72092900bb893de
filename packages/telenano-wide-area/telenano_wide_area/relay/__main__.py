"""The end of one site that reaches the other one through the relay of the site file: `python -P -m` of this package."""

import asyncio
import contextlib
import signal
import sys
from collections.abc import Coroutine, Sequence
from pathlib import Path
from typing import Any

from telenano.runtime import AddressBook, StructuredLog, run_beside
from telenano_wide_area.relay.site_end import site_end


async def until_stopped(work: Coroutine[Any, Any, None]) -> None:
    """Run until SIGINT or SIGTERM, or until the work ends by an error, which is raised."""
    task = asyncio.ensure_future(work)
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await task


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the end of a site until it is stopped; return the exit code, 2 where it could not start."""

    def serve(site_file: Path, site: str, log: StructuredLog) -> None:
        asyncio.run(until_stopped(site_end(AddressBook.load(site_file), site, log).run()))

    return run_beside("relay", serve, arguments)


if __name__ == "__main__":
    sys.exit(main())
