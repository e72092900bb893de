"""A server for emulated controllers: one answer to each request, in turn, on connections that share one device."""

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from telenano_devices.controllers.request_answer import Cut, Incoming, WireError

_WATCH_S = 0.001
_READ_BYTES = 65536
_MOST_UNREAD_BYTES = 2**20


class PushedStream(NamedTuple):
    """A stream that a device pushes to every client of a port: take() returns its bytes since the last call."""

    port: int
    take: Callable[[], bytes]


async def serve_requests(
    cut: Cut,
    respond: Callable[[bytes, int], bytes | None],
    pass_time: Callable[[int], None],
    host: str,
    ports: Sequence[int],
    on_ready: Callable[[], None] = lambda: None,
    most_clients: int = 16,
    pushed: PushedStream | None = None,
) -> None:
    """Serve until the task is cancelled.

    Args:
        cut: The function of the protocol that finds the length of a message.
        respond: The function that returns the answer to a request received at a time of the monotonic clock [ns], None
            for no answer; an exception from it ends the server.
        pass_time: The function that advances the device to a time [ns].
        host: The address to listen at.
        ports: The TCP ports to listen at.
        on_ready: The function that is called once the ports are bound.
        most_clients: The largest number of connections at one port; a further one is closed at once.
        pushed: A stream on a port of its own, None for none.

    Raises:
        OSError: An address cannot be bound.
        Exception: The exception that `respond` has raised.
    """
    failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    clients: dict[int, int] = dict.fromkeys(ports, 0)
    writers: set[asyncio.StreamWriter] = set()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        port = writer.get_extra_info("sockname")[1]
        clients[port] += 1
        writers.add(writer)
        incoming = Incoming(cut)
        try:
            while clients[port] <= most_clients and (received := await reader.read(_READ_BYTES)):
                incoming.add(received)
                while (request := incoming.take()) is not None:
                    answer = respond(request, time.monotonic_ns())
                    if answer is not None:
                        writer.write(answer)
                        await writer.drain()
        except (WireError, ConnectionError):
            # Malformed bytes end their connection only.
            pass
        except Exception as error:  # noqa: BLE001
            # The exception ends the server, as it would end the process of the real device.
            if not failed.done():
                failed.set_exception(error)
        finally:
            clients[port] -= 1
            writers.discard(writer)
            writer.close()

    listeners: list[asyncio.StreamWriter] = []

    async def listen(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        listeners.append(writer)

    servers = [await asyncio.start_server(serve, host, port) for port in ports]
    if pushed is not None:
        servers.append(await asyncio.start_server(listen, host, pushed.port))
    on_ready()
    try:
        while not failed.done():
            pass_time(time.monotonic_ns())
            if pushed is not None and listeners:
                _push(listeners, pushed.take())
            await asyncio.sleep(_WATCH_S)
        failed.result()
    finally:
        for server in servers:
            server.close()
        for writer in (*writers, *listeners):
            writer.close()
        # This lets clients that wait for an answer see the end of their connection.
        await asyncio.sleep(_WATCH_S)


def _push(listeners: list[asyncio.StreamWriter], frames: bytes) -> None:
    """Write to each listener, and remove those that are gone or do not read."""
    for writer in list(listeners):
        if writer.is_closing() or writer.transport.get_write_buffer_size() > _MOST_UNREAD_BYTES:
            listeners.remove(writer)
            writer.close()
        elif frames:
            writer.write(frames)
