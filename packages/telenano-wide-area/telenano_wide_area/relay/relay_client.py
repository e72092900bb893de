"""The connection of a machine to a relay: it dials out, stays, and is told which other machines are there."""

import asyncio
import contextlib
import time
from abc import ABC, abstractmethod
from typing import Any

from telenano.runtime import AccessControl, StructuredLog
from telenano.wire import ConfigError
from telenano_wide_area.relay.channel import Channel, Gone, dial
from telenano_wide_area.relay.protocol import raw_key, relay_key, split_host_port

# The relay is pinged at this interval [s].
_PING_S = 4.0
# A relay that sends nothing for this time is lost [s].
_SILENCE_S = 12.0
# The relay is dialled again after this time, which doubles up to _AGAIN_MOST_S [s].
AGAIN_S = 0.5
_AGAIN_MOST_S = 5.0
# A site end that was replaced by another process dials again after this time [s].
_REPLACED_S = 20.0
# A lasting fault is reported again after this time [s].
_REMIND_S = 60.0
_RELOAD_S = 0.5


class RelayClient(ABC):
    """A machine at a relay."""

    def __init__(self, relay: str, access: AccessControl, log: StructuredLog) -> None:
        """Begin unconnected; ConfigError if the key of the relay is not listed, ValueError for no HOST:PORT."""
        assert access.own is not None
        self._host, self._port = split_host_port(relay)
        self._relay = relay
        self._own = access.own
        self._relay_key = raw_key(relay_key(access))
        self._access, self._log = access, log
        # The keys of the sites at the relay.
        self._present: frozenset[str] = frozenset()
        self._tasks: set[asyncio.Task[None]] = set()
        # The last log entry on the relay and on single connections, with its time [s].
        self._reported: dict[str, tuple[str, float]] = {}

    @abstractmethod
    def _meets(self) -> set[str]:
        """Return the keys of the machines that this one wants to meet, in hexadecimal."""

    @abstractmethod
    async def _see(self, present: frozenset[str]) -> None:
        """Take note of the machines among these that are at the relay; empty while that is not reached."""

    @abstractmethod
    async def _accept(self, control: Channel, message: dict[str, Any]) -> None:
        """Dial the relay to be joined with the machine that `open` of a message asks for, or refuse."""

    def _end(self) -> None:
        for task in list(self._tasks):
            task.cancel()

    async def _keep_connected(self) -> None:
        wait_s = AGAIN_S
        while True:
            began_s = time.monotonic()
            try:
                wait_s = await self._stay()
            except Gone as error:
                reason = str(error) or type(error).__name__
                self._tell("warning", f"the relay {self._relay} cannot be reached or was lost: {reason}; trying again")
            await self._see(frozenset())
            lasted = time.monotonic() - began_s > _SILENCE_S
            await asyncio.sleep(wait_s)
            wait_s = AGAIN_S if lasted else min(2.0 * wait_s, _AGAIN_MOST_S)

    async def _stay(self) -> float:
        """Keep one connection to the relay until it ends; return the wait before the next one [s]."""
        meets = self._meets()
        channel = await self._dial(want="site", meets=sorted(meets))
        pinging = self._start(self._ping(channel))
        try:
            while True:
                async with asyncio.timeout(_SILENCE_S):
                    message = await channel.receive()
                if self._meets() != meets:
                    # The list of keys has changed, which the relay learns by a new connection.
                    return 0.0
                if "refused" in message:
                    self._tell("error", f"the relay {self._relay} refuses this machine: {message.get('text')}")
                    return _AGAIN_MOST_S
                if "replaced" in message:
                    self._tell("error", f"another process with the key of {self._access.machine} uses {self._relay}")
                    return _REPLACED_S
                if "ok" in message:
                    self._tell("info", f"the relay {self._relay} is reached")
                if isinstance(message.get("present"), list):
                    await self._see(frozenset(map(str, message["present"])))
                if "open" in message:
                    self._start(self._accept(channel, message))
        finally:
            pinging.cancel()
            channel.close()

    async def _ping(self, channel: Channel) -> None:
        with contextlib.suppress(*Gone):
            while True:
                await asyncio.sleep(_PING_S)
                await channel.send(ping=True)

    async def _reload(self) -> None:
        """Reload the list of keys whenever it has changed."""
        while True:
            await asyncio.sleep(_RELOAD_S)
            try:
                self._access.reload()
            except ConfigError as error:
                self._log.error(f"the list of keys was not reloaded: {error}")

    async def _dial(self, **request: Any) -> Channel:
        return await dial(self._host, self._port, self._own, self._relay_key, request)

    def _tell_of_end(self, error: Exception) -> None:
        """Log that the relay ended a connection without an answer, as it does if there are too many."""
        if isinstance(error, EOFError | ConnectionError) and self._present:
            text = "has ended a connection without an answer; its own log says whether it refuses this address"
            self._tell("warning", f"the relay {self._relay} {text}", "connection")

    def _start(self, work: Any) -> "asyncio.Task[None]":
        task = asyncio.get_running_loop().create_task(work)
        # The event loop keeps weak references only.
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _tell(self, level: str, text: str, about: str = "relay") -> None:
        """Log a change about one matter; an unchanged text is repeated once a minute."""
        now_s = time.monotonic()
        last_text, reported_s = self._reported.get(about, ("", 0.0))
        if text != last_text or now_s - reported_s >= _REMIND_S:
            self._reported[about] = (text, now_s)
            self._log.write(level, text)
