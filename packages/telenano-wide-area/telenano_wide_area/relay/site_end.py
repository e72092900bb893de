"""The end of a site that reaches the other one through a relay: it dials out, and the nodes here connect to it.

For each node of another machine it listens on an address of this machine, which the address book gives the nodes here
instead of the real one. It joins each client that connects, through the relay, with the node itself. Like the relay it
sees encrypted CURVE connections only.
"""

import asyncio
import contextlib
import signal
from collections.abc import Coroutine, Iterator, Mapping
from concurrent.futures import Future
from threading import Thread
from typing import Any

from telenano.runtime import AccessControl, AddressBook, StructuredLog
from telenano.wire import ConfigError, EndpointError
from telenano_wide_area.relay.channel import CHUNK_BYTES, Channel, Gone, abort, splice
from telenano_wide_area.relay.protocol import RELAY, raw_key, split_host_port
from telenano_wide_area.relay.relay_client import AGAIN_S, RelayClient

# A node that does not listen yet is tried for this time; the node that waits for it gives up a little later [s].
_NODE_S = 3.0
# The interval of these attempts [s].
_NODE_AGAIN_S = 0.1
# A node here that waits for one there gives up after 5 s and connects again; its connection is closed before that [s].
_JOIN_S = 4.5


class SiteEnd(RelayClient):
    """The end of one machine."""

    def __init__(self, book: AddressBook, machine: str, access: AccessControl, log: StructuredLog) -> None:
        """Read the nodes to reach from the address book; ConfigError if the key of the relay is not listed."""
        assert book.relay is not None
        super().__init__(book.relay, access, log)
        ends = {
            node: _host_port(endpoint) for node in book.nodes if (endpoint := book.network_endpoint(node)) is not None
        }
        self._here = {ends[node][1] for node in ends if book.machine_of(node) == machine}
        self._bind = next((_host_port(book.bind_endpoint(node) or "")[0] for node in ends), "")
        self._there: Mapping[tuple[str, int], str] = {
            end: book.machine_of(node) for node, end in ends.items() if book.machine_of(node) != machine
        }
        self._servers: dict[tuple[str, int], asyncio.Server] = {}

    async def run(self) -> None:
        """Listen, and keep the connection to the relay, until cancelled; EndpointError if a port cannot be bound."""
        try:
            for end in self._there:
                await self._bound(end)
            self._start(self._reload())
            await self._keep_connected()
        finally:
            self._end()
            for server in self._servers.values():
                server.close()

    def _meets(self) -> set[str]:
        """Return the keys of the other machines that have a valid one, in hexadecimal."""
        return set(map(self._key, set(self._there.values()))) - {""}

    async def _see(self, present: frozenset[str]) -> None:
        """Listen for the nodes of the sites that are at the relay, and of no others."""
        if present == self._present:
            return
        self._present = present
        self._log.info("the other site is at the relay" if present else "the other site is not at the relay")
        for end, machine in self._there.items():
            server = self._servers[end]
            if self._key(machine) in present:
                await server.start_serving()
            elif server.is_serving():
                server.close()
                await self._bound(end)

    async def _bound(self, end: tuple[str, int]) -> None:
        """Bind the address for a node without listening; EndpointError if that fails."""
        handler = self._handler(self._there[end], end[1])
        try:
            self._servers[end] = await asyncio.start_server(handler, *end, limit=CHUNK_BYTES, start_serving=False)
        except OSError as error:
            text = f"{end[0]} port {end[1]}, for {self._there[end]}, cannot be bound: {error.strerror}"
            raise EndpointError(text) from error

    def _key(self, machine: str) -> str:
        """Return the valid key of a machine in hexadecimal; empty if it has none."""
        key = self._access.server_key(machine)
        return "" if key is None else raw_key(key).hex()

    # --- from here to there ---

    def _handler(self, machine: str, port: int) -> Any:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            try:
                channel = await self._opened(machine, port)
                await splice((reader, writer), (channel.reader, channel.writer))
            except Gone:
                pass
            finally:
                abort(writer)

        return serve

    async def _opened(self, machine: str, port: int) -> Channel:
        """Return a connection to a port of another machine; TimeoutError if there is none in time."""
        async with asyncio.timeout(_JOIN_S):
            while True:
                channel = None
                try:
                    channel = await self._dial(want="open", to=self._key(machine), port=port)
                    message = await channel.receive()
                    if "ok" in message:
                        joined, channel = channel, None
                        return joined
                    if "text" in message:
                        self._tell("warning", f"the relay {self._relay} refuses: {message['text']}", "connection")
                except Gone as error:
                    # The time-out around this loop limits all attempts together.
                    self._tell_of_end(error)
                finally:
                    if channel is not None:
                        channel.close()
                await asyncio.sleep(AGAIN_S)

    # --- from there to here ---

    async def _accept(self, control: Channel, message: dict[str, Any]) -> None:
        """Connect to the node here that a client there wants to reach, and dial the relay to be joined."""
        number, port = str(message.get("open")), message.get("port")
        with contextlib.suppress(*Gone):
            if port not in self._here or message.get("source") not in self._meets():
                await control.send(refused=number)
                return
            try:
                node = await self._connected(port)
            except (OSError, TimeoutError):
                await control.send(refused=number)
                return
            channel = None
            try:
                try:
                    channel = await self._dial(want="accept", number=number)
                    async with asyncio.timeout(_JOIN_S):
                        joined = "ok" in await channel.receive()
                except Gone as error:
                    # The refusal lets the client there try again at once, instead of after its time-out.
                    self._tell_of_end(error)
                    await control.send(refused=number)
                    return
                if joined:
                    await splice(node, (channel.reader, channel.writer))
            finally:
                abort(node[1])
                if channel is not None:
                    channel.close()

    async def _connected(self, port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Connect to a node of this machine that may be about to start; OSError or TimeoutError if there is none."""
        async with asyncio.timeout(_NODE_S):
            while True:
                try:
                    return await asyncio.open_connection(self._bind, port, limit=CHUNK_BYTES)
                except ConnectionRefusedError:
                    await asyncio.sleep(_NODE_AGAIN_S)


def _host_port(endpoint: str) -> tuple[str, int]:
    return split_host_port(endpoint.removeprefix("tcp://"))


def until_stopped(work: Coroutine[Any, Any, None]) -> None:
    """Run work until SIGINT or SIGTERM, or until it ends; its error is raised."""

    async def run() -> None:
        task = asyncio.ensure_future(work)
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, task.cancel)
        with contextlib.suppress(asyncio.CancelledError):
            await task

    asyncio.run(run())


def site_end(book: AddressBook, site: str, log: StructuredLog) -> SiteEnd:
    """Return the end of a site; ConfigError if the site file has no relay, or a key is missing."""
    if book.relay is None:
        raise ConfigError("the site file has no `relay: host:port`")
    return SiteEnd(book, site, AccessControl(site), log)


@contextlib.contextmanager
def at_relay(book: AddressBook) -> Iterator[None]:
    """Run the end of the master's site at the relay of the site file, if there is one, in a thread during a block.

    If another process of this machine is that end already, this one does nothing.

    Raises:
        ConfigError: A key is missing.
    """
    if book.relay is None:
        yield
        return
    end = site_end(book, "master", StructuredLog(f"{RELAY}@master"))
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
        # An event loop that has ended takes no calls.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(lambda: task is not None and task.cancel())
        thread.join()
