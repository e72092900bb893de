"""A TCP forwarder within this machine that can fall silent, cut connections, and alter what passes.

While it is silent nothing passes, and neither end gets an error.

with TcpForwarder({port: target_port}) as cable: cable.silent = True
"""

import asyncio
import contextlib
from collections.abc import Callable, Mapping

from loop_thread import LoopThread

_LOOK_S = 0.01


class TcpForwarder(LoopThread):
    """Forwards connections from some ports to others, as long as it is not `silent`.

    `alter_there` and `alter_back` change the bytes that go to a target and that come from it.
    """

    def __init__(self, targets: Mapping[int, int]) -> None:
        """Prepare to forward; `targets` maps each listening port to its target port."""
        super().__init__()
        self.silent = False
        self.alter_there: Callable[[bytes], bytes] = bytes
        self.alter_back: Callable[[bytes], bytes] = bytes
        self._targets = dict(targets)
        self._open: list[asyncio.StreamWriter] = []

    async def begin(self) -> None:
        """Listen at the ports."""
        self.servers += [
            await asyncio.start_server(lambda near, out, port=target: self._join(near, out, port), "127.0.0.1", port)
            for port, target in self._targets.items()
        ]

    def cut(self) -> None:
        """Abort every connection; new ones are forwarded again."""
        asyncio.run_coroutine_threadsafe(self.ended(), self.loop).result()

    async def ended(self) -> None:
        """Abort every connection."""
        while self._open:
            self._open.pop().transport.abort()
        await asyncio.sleep(0.05)

    async def _join(self, near: asyncio.StreamReader, to_near: asyncio.StreamWriter, target: int) -> None:
        self._open.append(to_near)
        await self._free()
        try:
            far, to_far = await asyncio.open_connection("127.0.0.1", target)
        except OSError:
            to_near.transport.abort()
            return
        self._open.append(to_far)
        with contextlib.suppress(OSError):
            await asyncio.gather(
                self._carry(near, to_far, lambda piece: self.alter_there(piece)),
                self._carry(far, to_near, lambda piece: self.alter_back(piece)),
            )

    async def _carry(
        self, source: asyncio.StreamReader, target: asyncio.StreamWriter, altered: Callable[[bytes], bytes]
    ) -> None:
        try:
            while piece := await source.read(65_536):
                await self._free()
                target.write(altered(piece))
                await target.drain()
        finally:
            target.close()

    async def _free(self) -> None:
        while self.silent:
            await asyncio.sleep(_LOOK_S)
