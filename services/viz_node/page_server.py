"""The web server of the page, which runs in the thread of the node while that waits."""

import asyncio
import contextlib

from services.viz_node.hub import MOST_PAGES, Hub
from services.viz_node.server import make_app
from telenano.serving.access import Access
from telenano.serving.connections import Connections, Listener, most_connections
from telenano.serving.serve import Tls, make_server, page_folder
from telenano.wire.errors import RigError

# Connections without a page: a browser opens six at once.
_LEAST_STRANGERS = 8


class PageServer:
    """The web server of a hub in this thread: it serves while `run` waits."""

    def __init__(self, hub: Hub, access: Access, bound: Listener, tls: Tls | None, wake_descriptor: int) -> None:
        """Prepare to serve at a bound address; `run` returns as soon as `wake_descriptor` is readable."""
        # The web server closes its listener, so it gets a copy, and the page can be served again.
        listener = bound.again(Connections(most_connections(sum(MOST_PAGES.values()) + _LEAST_STRANGERS)))
        self._server = make_server(make_app(hub, access, page_folder(), listener.connections), tls)
        # The process handles the signals itself.
        self._server.capture_signals = contextlib.nullcontext  # type: ignore[method-assign, assignment]
        self._hub = hub
        hub.on_end = lambda: setattr(self._server, "should_exit", True)
        self._loop = asyncio.new_event_loop()
        self._woken = asyncio.Event()
        self._loop.add_reader(wake_descriptor, self._woken.set)
        self._serving = self._loop.create_task(self._server.serve(sockets=[listener]))

    def run(self, wait_s: float | None = None) -> None:
        """Serve for a time [s], or until the descriptor is readable; raise the error that has ended the server."""
        self._loop.run_until_complete(self._wait(wait_s))
        if self._serving.done():
            raise self._hub.fault or self._serving.exception() or RigError("the server of the page could not begin")

    async def _wait(self, wait_s: float | None) -> None:
        woken = asyncio.create_task(self._woken.wait())
        await asyncio.wait({self._serving, woken}, timeout=wait_s, return_when=asyncio.FIRST_COMPLETED)
        woken.cancel()

    def close(self) -> None:
        """End the server and the connections of its pages."""
        self._server.should_exit = True
        self._loop.run_until_complete(asyncio.wait({self._serving}))
        # Cancel pending requests, because their pages are closed.
        left = asyncio.all_tasks(self._loop)
        for task in left:
            task.cancel()
        if left:
            self._loop.run_until_complete(asyncio.wait(left))
        self._loop.close()
