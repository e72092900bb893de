"""An event loop in a separate thread, for servers that run beside a test.

class Server(LoopThread):
    async def begin(self) -> None: ...

with Server() as server: ...
"""

import asyncio
import threading
from types import TracebackType
from typing import Self

_WAIT_S = 10.0


class LoopThread:
    """Runs `begin` in a thread when the block is entered, and ends all tasks and servers when it is left."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.servers: list[asyncio.Server] = []
        self._thread = threading.Thread(target=self.loop.run_forever, daemon=True)

    async def begin(self) -> None:
        """Start the servers, which are added to `servers`."""
        raise NotImplementedError

    async def ended(self) -> None:
        """Close the remaining resources after all tasks have ended."""

    def __enter__(self) -> Self:
        self._thread.start()
        asyncio.run_coroutine_threadsafe(self.begin(), self.loop).result(_WAIT_S)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        asyncio.run_coroutine_threadsafe(self._end(), self.loop).result(_WAIT_S)
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join()
        self.loop.close()

    async def _end(self) -> None:
        for server in self.servers:
            server.close()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)
        await self.ended()
