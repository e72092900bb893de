"""Serves an emulated vendor's service over WebSocket, and obeys the lines that a person types to put faults in."""

import asyncio
import json
import logging
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from telenano.extend.hands import DeviceError
from telenano_devices.impedance.vendor_service import NEEDS_WEBSOCKETS


class EmulatedService(NamedTuple):
    """The behaviour of an emulated service.

    name: the service in words. connected: returns the first message to every client. answer: returns the answer to a
    message at a time [s]. late_s: returns the present delay of answers [s]. version: data that HTTP returns at
    /version. format: name of the format of its messages.
    """

    name: str
    connected: Callable[[], dict[str, Any]]
    answer: Callable[[bytes | str, float], dict[str, Any]]
    late_s: Callable[[], float]
    version: dict[str, str]
    format: str


async def serve_service(
    service: EmulatedService,
    at: tuple[str, int],
    ready: Callable[[int], None],
    lines: "asyncio.Queue[str] | None" = None,
    obey: Callable[[str], str] = str,
    say: Callable[[str], None] = print,
) -> None:
    """Serve until cancelled.

    Args:
        service: The service.
        at: The address to serve on and its port, 0 for any.
        ready: The function that is called once, with the port.
        lines: The lines that a person types.
        obey: The function that carries out a line and returns a sentence about it.
        say: The function that prints this sentence.

    Raises:
        DeviceError: websockets is not installed.
    """
    try:
        from websockets.asyncio.server import ServerConnection, serve
        from websockets.exceptions import ConnectionClosed
        from websockets.http11 import Request, Response
    except ImportError as error:
        raise DeviceError(f"{service.name} {NEEDS_WEBSOCKETS}") from error

    async def converse(connection: ServerConnection) -> None:
        try:
            await connection.send(json.dumps(service.connected()))
            async for message in connection:
                reply = json.dumps(service.answer(message, time.monotonic()))
                if (late_s := service.late_s()) > 0.0:
                    await asyncio.sleep(late_s)
                await connection.send(reply)
        except ConnectionClosed:
            return
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            say(f"a message that {service.format} does not have has ended the session: {error}")

    def http(connection: ServerConnection, request: Request) -> Response | None:
        if "Upgrade" in request.headers:
            return None
        is_version = request.path == "/version"
        body = {"ok": True, "data": service.version} if is_version else {"ok": False, "error": "no such route"}
        return connection.respond(200 if is_version else 404, json.dumps(body))

    async def listen() -> None:
        while lines is not None:
            say(obey(await lines.get()))

    # A person reads the actions of the service here, so the log of each connection is suppressed.
    logging.getLogger("websockets.server").setLevel(logging.WARNING)
    options: dict[str, Any] = {"compression": None, "ping_interval": None, "process_request": http}
    async with serve(converse, *at, **options) as server:
        ready(next(iter(server.sockets)).getsockname()[1])
        listener = asyncio.create_task(listen())
        try:
            await asyncio.Future()
        finally:
            listener.cancel()


def typed_lines() -> "asyncio.Queue[str]":
    """Return a queue of the lines that a person types from now on; call it in a running event loop."""
    lines: asyncio.Queue[str] = asyncio.Queue()
    loop, begun = asyncio.get_running_loop(), bytearray()

    def read() -> None:
        typed = whole_lines(sys.stdin.fileno(), begun)
        if typed is None:
            loop.remove_reader(sys.stdin)
        for line in typed or ():
            lines.put_nowait(line)

    # An event loop cannot wait for a file or the null device, so these give no lines.
    if not sys.stdin.closed and (sys.stdin.isatty() or Path("/dev/stdin").is_fifo()):
        loop.add_reader(sys.stdin, read)
    return lines


def whole_lines(descriptor: int, begun: bytearray) -> list[str] | None:
    """Return all complete lines that wait at a descriptor, None at its end; `begun` keeps the part of a further line.

    A file object would return the first line and buffer the others, for which the event loop would not wake up.
    """
    data = os.read(descriptor, 65_536)
    begun += data
    *lines, rest = bytes(begun).split(b"\n")
    begun[:] = rest
    return [line.decode(errors="replace") for line in lines] if data else None
