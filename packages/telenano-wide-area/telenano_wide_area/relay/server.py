"""A relay between sites that can only dial out: it joins their connections in pairs, and forwards their datagrams.

Its only state is which site is connected from where. It cannot decrypt the data that it carries, because it has no keys
for it, and it opens no connection itself: each connection that it joins was dialled by a site whose key it lists, to a
site that named that key in turn.
"""

import asyncio
import contextlib
import secrets
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any

from telenano.runtime import AccessControl, KeyPair, StructuredLog, check_descriptors
from telenano.wire import ConfigError, EndpointError
from telenano_wide_area.relay.channel import CHUNK_BYTES, HELLO_S, Budget, Channel, Gone, abort, meet, splice, tend
from telenano_wide_area.relay.forwarder import Forwarder
from telenano_wide_area.relay.protocol import key_text
from telenano_wide_area.sealed import RejectedError

DEFAULT_PORT = 5750
# The most strangers: connections that have not proved a key yet.
_MOST_STRANGERS = 1024
# Descriptors of the relay itself: both ports, those of the event loop, and for a moment the list of keys.
_FILES_OF_A_RELAY = 16
# Descriptors of two sites with one session: their own connections, and some 25 joined ones with two each.
_FILES_OF_A_SESSION = 64
# The most strangers from one address. A class of ten rigs behind one address makes some 500 connections when it begins.
_MOST_FROM_ADDRESS = 512
# The burst of connections from one address without a listed key. A listed key returns its token; beyond the burst, a
# connection has to claim a listed key before its proof is checked.
_BURST = 600.0
# The rate of such connections after a burst.
_PER_S = 20.0
# The shortest interval between log entries on one reason and one address or key [s].
_REMIND_S = 60.0
_MOST_ADDRESSES = 4096
# The most joined connections of a site at once.
_MOST_STREAMS = 128
# The most connections, for each connected site, that wait for the other site.
_MOST_WAITING = 64
# The most sites that are connected, and the most sites that one site wants to meet.
_MOST_SITES = 64
# The time that the other site has to dial [s].
_JOIN_S = 4.0
# A site that sends nothing for this time is disconnected [s].
_SITE_SILENCE_S = 15.0
# The interval at which changed keys and unused places are looked for [s].
_TIDY_S = 0.5
_REFUSALS = {
    "unlisted": "the relay does not list this key: run `telenano keys allow NAME KEY --role relay` there",
    "role": "the relay lists this key without the role relay",
    "revoked": "the relay has revoked this key",
    "expired": "this key has expired at the relay",
}


@dataclass(eq=False)
class Site:
    """A connected site: its name at the relay, its key, and the keys of the sites that it wants to meet."""

    name: str
    key: str
    channel: Channel
    meets: frozenset[str]
    present: list[str] = field(default_factory=list)


class Relay:
    """One relay; its sites are known by their public keys in hexadecimal."""

    def __init__(self, access: AccessControl, log: StructuredLog, mbit_per_s: float = 50.0) -> None:
        """Begin without a site; ConfigError if this machine has no key.

        Args:
            access: The keys of the machines that may use the relay, in the role `relay`.
            log: Logs the sites that connect, leave or are refused.
            mbit_per_s: The greatest rate for each site, of connections and of datagrams separately [Mbit/s].
        """
        if access.own is None:
            raise ConfigError("a relay needs a key: `telenano keys new relay`")
        self.own: KeyPair = access.own
        self.sites: dict[str, Site] = {}
        self.refused: Counter[str] = Counter()
        self.streams: Counter[str] = Counter()
        self._access, self._log = access, log
        self._bytes_per_s = mbit_per_s * 125e3
        self._budgets: dict[tuple[str, str], Budget] = {}
        # Connections that have not proved a listed key, the oldest first, with their addresses.
        self._strangers: dict[asyncio.StreamWriter, str] = {}
        self._most_strangers = _MOST_STRANGERS
        self._arrivals: dict[str, Budget] = {}
        # Connections that wait for the other site to dial, by number: the key of that site, and the future for its
        # channel.
        self._waiting: dict[str, tuple[str, asyncio.Future[Channel]]] = {}
        self._open: dict[Channel, str] = {}
        self._server: asyncio.Server | None = None
        # The time of the last log entry on a refusal, by its reason and the refused address or key.
        self._reported_s: dict[tuple[str, str], float] = {}
        self.forwarder: Forwarder

    async def start(self, host: str, port: int) -> None:
        """Listen on TCP and UDP.

        Raises:
            EndpointError: The port cannot be bound, or this process may open fewer files than one session needs here.
        """
        further = check_descriptors("a relay", _FILES_OF_A_RELAY + _FILES_OF_A_SESSION)
        if further is not None:
            # Strangers replace one another before they use up the descriptors of sites.
            self._most_strangers = max(1, min(_MOST_STRANGERS, further // 2))
        now_s = asyncio.get_running_loop().time
        self.forwarder = Forwarder(
            self.own,
            lambda public: not self._authorize(key_text(public))[1],
            lambda public: self._budget("datagrams", public.hex()),
            now_s,
        )
        try:
            self._server = await asyncio.start_server(self._serve, host, port, limit=CHUNK_BYTES)
            self.forwarder.open(host, port)
        except OSError as error:
            await self.close()
            raise EndpointError(f"the relay cannot listen on {host} port {port}: {error.strerror}") from error

    async def run(self) -> None:
        """Apply changed keys and remove unused places, until cancelled."""
        while True:
            await asyncio.sleep(_TIDY_S)
            try:
                changed = self._access.reload()
            except ConfigError as error:
                self._log.error(f"the list of keys was not reloaded: {error}")
                continue
            if changed:
                for channel, key in list(self._open.items()):
                    if self._authorize(key_text(bytes.fromhex(key)))[1]:
                        channel.close()
            self.forwarder.tidy()

    async def close(self) -> None:
        """Stop listening and close every connection."""
        self.forwarder.close()
        for channel in list(self._open):
            channel.close()
        if self._server is not None:
            self._server.close()

    # --- who connects ---

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        address = str((writer.get_extra_info("peername") or ("gone",))[0])
        is_calm = self._admit(writer, address)
        tend(writer)
        channel = None
        try:
            async with asyncio.timeout(HELLO_S):
                key, name, channel, request = await self._identify(reader, writer, address, is_calm=is_calm)
            self._open[channel] = key
            await self._answer(Site(name, key, channel, frozenset()), request)
        except RejectedError as error:
            self.refused[error.cause] += 1
            if error.cause == "flood":
                text = f"connections from {address} are refused: too many of them have shown no key that is listed here"
                self._tell("flood", address, text)
        except Gone:
            self.refused["handshake"] += channel is None
        finally:
            self._strangers.pop(writer, None)
            if channel is not None:
                self._open.pop(channel, None)
            abort(writer)

    def _admit(self, writer: asyncio.StreamWriter, address: str) -> bool:
        """Add a stranger, replacing the oldest if there are too many; return whether its address is within its rate."""
        now_s = asyncio.get_running_loop().time()
        if len(self._arrivals) >= _MOST_ADDRESSES:
            self._arrivals.clear()
        crowd = [writer for writer, address_of_writer in self._strangers.items() if address_of_writer == address]
        if len(crowd) < _MOST_FROM_ADDRESS:
            crowd = list(self._strangers) if len(self._strangers) >= self._most_strangers else []
        for oldest in crowd[:1]:
            del self._strangers[oldest]
            abort(oldest)
        self._strangers[writer] = address
        return self._arrivals.setdefault(address, Budget(_PER_S, _BURST, now_s)).take(1.0, now_s)

    def _tell(self, reason: str, who: str, text: str) -> None:
        """Log a refusal with the number of refusals for that reason so far, unless it was logged lately."""
        now_s = asyncio.get_running_loop().time()
        if now_s - self._reported_s.get((reason, who), -_REMIND_S) >= _REMIND_S:
            if len(self._reported_s) >= _MOST_ADDRESSES:
                self._reported_s.clear()
            self._reported_s[reason, who] = now_s
            self._log.warning(f"{text} ({reason}, {self.refused[reason]} in all)")

    async def _identify(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, address: str, *, is_calm: bool
    ) -> tuple[str, str, Channel, dict[str, Any]]:
        def refuse(public: bytes) -> None:
            if not is_calm and self._authorize(key_text(public))[1]:
                raise RejectedError("flood")

        public, channel = await meet(reader, writer, self.own, refuse)
        request = await channel.receive()
        name, reason = self._authorize(key_text(public))
        if reason:
            who = f"{name or 'an unknown machine'} ({address}) with the key {key_text(public)}"
            self._tell(reason, key_text(public), f"{who} is refused")
            await channel.send(refused=reason, text=_REFUSALS[reason])
            raise RejectedError(reason)
        # With a listed key, the connection is no stranger any more, and its address gets the token back.
        self._strangers.pop(writer, None)
        if is_calm and (arrivals := self._arrivals.get(address)) is not None:
            arrivals.take(-1.0, asyncio.get_running_loop().time())
        return public.hex(), name, channel, request

    def _authorize(self, key: str) -> tuple[str, str]:
        name, reason = self._access.authorize(key)
        if reason in ("", "relay"):
            return name, "" if "relay" in self._access.roles(name) else "role"
        return name, reason

    def _budget(self, kind: str, key: str) -> Budget:
        burst = max(self._bytes_per_s * 0.1, CHUNK_BYTES)
        now_s = asyncio.get_running_loop().time()
        return self._budgets.setdefault((kind, key), Budget(self._bytes_per_s, burst, now_s))

    # --- requests of a site ---

    async def _answer(self, site: Site, request: dict[str, Any]) -> None:
        wants = {"site": self._be_site, "open": self._open_stream, "accept": self._accept_stream, "look": self._look}
        try:
            await wants[request["want"]](site, request)
        except (KeyError, TypeError, OverflowError):
            raise RejectedError("malformed") from None

    async def _look(self, site: Site, request: dict[str, Any]) -> None:
        await site.channel.send(ok=True, name=site.name, present=sorted(self._meeting(site.key)))
        with contextlib.suppress(*Gone):
            async with asyncio.timeout(HELLO_S):
                await site.channel.receive()

    async def _be_site(self, site: Site, request: dict[str, Any]) -> None:
        """Keep the connection of a site, through which it learns of requests to reach it."""
        site.meets = frozenset(map(str, request["meets"][:_MOST_SITES]))
        before = self.sites.get(site.key)
        if before is None and len(self.sites) >= _MOST_SITES:
            self.refused["full"] += 1
            self._tell("full", site.key, f"{site.name} is refused: there are {_MOST_SITES} sites already")
            await site.channel.send(refused="full", text=f"the relay has {_MOST_SITES} sites already")
            return
        if before is not None:
            with contextlib.suppress(*Gone):
                await before.channel.send(replaced=True)
            before.channel.close()
        self.sites[site.key] = site
        self._log.info(f"{site.name} is connected")
        try:
            await site.channel.send(ok=True)
            await self._tell_who_is_here()
            while True:
                async with asyncio.timeout(_SITE_SILENCE_S):
                    message = await site.channel.receive()
                target, handed = self._waiting.get(str(message.get("refused")), ("", None))
                if target == site.key and handed is not None and not handed.done():
                    handed.set_exception(RejectedError("absent"))
                await site.channel.send(alive=True)
        finally:
            if self.sites.get(site.key) is site:
                del self.sites[site.key]
                self._log.info(f"{site.name} is gone")
                await self._tell_who_is_here()

    def _meeting(self, key: str) -> set[str]:
        """Return the keys of the connected sites that want to meet a site and that it wants to meet."""
        here = self.sites.get(key)
        wanted = frozenset[str]() if here is None else here.meets
        return {other for other in wanted if other in self.sites and key in self.sites[other].meets}

    async def _tell_who_is_here(self) -> None:
        for site in list(self.sites.values()):
            present = sorted(self._meeting(site.key))
            if present != site.present:
                site.present = present
                with contextlib.suppress(*Gone):
                    await site.channel.send(present=present)

    async def _open_stream(self, site: Site, request: dict[str, Any]) -> None:
        """Join a connection with one that the other site is asked to dial."""
        to, port = str(request["to"]), int(request["port"])
        if to not in self._meeting(site.key):
            await site.channel.send(refused="absent")
            return
        if self.streams[site.key] >= _MOST_STREAMS or len(self._waiting) >= _MOST_WAITING * len(self.sites):
            self.refused["streams"] += 1
            text = f"a site may have {_MOST_STREAMS} connections here, {_MOST_WAITING} of them waiting"
            self._tell("streams", site.key, f"a connection of {site.name} is refused: {text}")
            await site.channel.send(refused="streams", text=text)
            return
        self.streams[site.key] += 1
        try:
            async with self.dialled(to, site.key, port) as (_, far):
                await site.channel.send(ok=True)
                near = (site.channel.reader, site.channel.writer)
                await splice(near, (far.reader, far.writer), self._budget("streams", site.key))
        except (RejectedError, TimeoutError):
            await site.channel.send(refused="absent")
        finally:
            self.streams[site.key] -= 1

    @contextlib.asynccontextmanager
    async def dialled(self, to: str, source: str, port: int) -> AsyncIterator[tuple[str, Channel]]:
        """Ask a connected site to dial; yield the number of the connection and its channel, which the block closes.

        Args:
            to: The key of the site, in hexadecimal.
            source: The key of the machine that it is to be joined with.
            port: The port of its node.

        Raises:
            RejectedError: `absent`: the site is not connected, or does not want to be joined.
            TimeoutError: It has not dialled in time.
        """
        if to not in self.sites:
            raise RejectedError("absent")
        number = secrets.token_hex(8)
        handed: asyncio.Future[Channel] = asyncio.get_running_loop().create_future()
        self._waiting[number] = (to, handed)
        far = None
        try:
            await self.sites[to].channel.send(open=number, source=source, port=port)
            async with asyncio.timeout(_JOIN_S):
                far = await handed
            yield number, far
        finally:
            del self._waiting[number]
            if far is not None:
                far.close()

    async def _accept_stream(self, site: Site, request: dict[str, Any]) -> None:
        """Pass a connection to the one that waits for it, and keep it open until that one ends."""
        target, handed = self._waiting.get(str(request["number"]), ("", None))
        if target != site.key or handed is None or handed.done():
            await site.channel.send(refused="late")
            return
        await site.channel.send(ok=True)
        handed.set_result(site.channel)
        await site.channel.writer.wait_closed()
