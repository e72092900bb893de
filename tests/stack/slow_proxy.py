"""A reverse proxy that has a server in a sub-folder, as laboratories have, and can hold back what pages send."""

import asyncio
import contextlib

from loop_thread import LoopThread

_HEAD_END = b"\r\n\r\n"


class SlowProxy(LoopThread):
    """Serves a server of this machine at `http://127.0.0.1:PORT/FOLDER/` while the block runs.

    It passes `Host`, `Origin` and the upgrade of a connection on as they are, and what a page sends after `delay_s`
    [s], in order, as a queue before a narrow line does.
    """

    def __init__(self, target_port: int, folder: str) -> None:
        super().__init__()
        self.delay_s = 0.0
        self.port = 0
        self.refused = 0
        self._target_port, self._folder = target_port, folder.encode()

    def address(self, of_server: str) -> str:
        """Return an address of the server as it is behind the proxy, with its token."""
        return f"http://127.0.0.1:{self.port}/{self._folder.decode()}/#{of_server.partition('#')[2]}"

    async def begin(self) -> None:
        """Listen at a free port."""
        self.servers.append(await asyncio.start_server(self._connection, "127.0.0.1", 0))
        self.port = self.servers[0].sockets[0].getsockname()[1]

    async def _connection(self, page: asyncio.StreamReader, to_page: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            head = await page.readuntil(_HEAD_END)
            method, path, rest = head.split(b" ", 2)
            if not path.startswith(b"/" + self._folder + b"/"):
                self.refused += 1
                to_page.write(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
                to_page.close()
                return
            server, to_server = await asyncio.open_connection("127.0.0.1", self._target_port)
            path = path.removeprefix(b"/" + self._folder)
            if b"upgrade: websocket" not in rest.lower():
                # one request for each connection, so that only its first head has to be changed
                lines = [line for line in rest.split(b"\r\n") if not line.lower().startswith(b"connection:")]
                rest = b"\r\n".join([lines[0], b"Connection: close", *lines[1:]])
            to_server.write(b" ".join((method, path, rest)))
            try:
                await asyncio.gather(self._there(page, to_server), self._back(server, to_page))
            finally:
                to_server.close()
                to_page.close()

    async def _there(self, page: asyncio.StreamReader, to_server: asyncio.StreamWriter) -> None:
        queue: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

        async def hand_over() -> None:
            while True:
                at_s, data = await queue.get()
                await asyncio.sleep(at_s - self.loop.time())
                if not data:
                    to_server.close()
                    return
                to_server.write(data)

        handing = asyncio.create_task(hand_over())
        newest_s = 0.0
        data = b"-"
        while data:
            with contextlib.suppress(OSError):
                data = await page.read(65536)
            newest_s = max(newest_s, self.loop.time() + self.delay_s)
            queue.put_nowait((newest_s, data))
        await handing

    @staticmethod
    async def _back(server: asyncio.StreamReader, to_page: asyncio.StreamWriter) -> None:
        while data := await server.read(65536):
            to_page.write(data)
            await to_page.drain()
        to_page.close()
