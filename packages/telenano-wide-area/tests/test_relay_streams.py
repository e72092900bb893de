"""The connections that a relay joins: who may, to whom, how many, and what is left when one of the three is gone."""

import asyncio
import contextlib
import math
import os
import socket
from collections import deque
from collections.abc import AsyncIterator, Callable
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from relay_bench import ring
from telenano_wide_area.relay import channel as channels
from telenano_wide_area.relay import server, site_end
from telenano_wide_area.relay.channel import Channel, Gone, dial
from telenano_wide_area.relay.protocol import PUBLIC_BYTES, raw_key
from telenano_wide_area.relay.server import Relay
from telenano_wide_area.relay.site_end import SiteEnd
from telenano_wide_area.sealed import RejectedError

from telenano.runtime import AccessControl, AddressBook, StructuredLog
from telenano.testing import free_ports
from telenano.wire import ConfigError, EndpointError

pytestmark = pytest.mark.anyio
PATIENCE_S = 30.0
HOST = "127.0.0.1"
AFM, LINK = "afm_node@slave", "delay_node@slave"


class Bench:
    """The keys of a relay and two sites, and what runs of them."""

    def __init__(self, folder: Path, other: "Bench | None" = None) -> None:
        """Make the keys; with another rig, use its relay."""
        self.port, self.afm_port, self.link_port = free_ports(3)
        self.rings = {name: ring(folder, name) for name in ("relay", "master", "slave", "stranger")}
        self.keys = {name: found.create(name).public for name, found in self.rings.items()}
        if other is not None:
            self.port, self.rings["relay"], self.keys["relay"] = other.port, other.rings["relay"], other.keys["relay"]
        for name in ("master", "slave"):
            self.rings[name].allow("relay", self.keys["relay"].decode(), ["relay"])
            listed = f"lab_{name}" if other is None else f"{folder.name}_{name}"
            self.rings["relay"].allow(listed, self.keys[name].decode(), ["relay"])
        self.rings["master"].allow("slave", self.keys["slave"].decode(), ["data"])
        self.rings["slave"].allow("master", self.keys["master"].decode(), ["data", "control"])
        nodes = {
            AFM: {"local": f"ipc://{folder}/a", "network": f"tcp://{{slave}}:{self.afm_port}"},
            LINK: {"local": f"ipc://{folder}/l", "network": f"tcp://{{master}}:{self.link_port}"},
        }
        machines = {"master": "10.0.0.1", "slave": "10.0.0.2"}
        self.book = AddressBook.model_validate({"machines": machines, "nodes": nodes, "relay": f"{HOST}:{self.port}"})
        self.relay: Relay
        self.ends: list[SiteEnd] = []
        self._tasks: dict[str, asyncio.Task[None]] = {}

    async def start_relay(self) -> Relay:
        access = AccessControl("relay", self.rings["relay"], requires_keys=True)
        self.relay = Relay(access, StructuredLog("relay"))
        await self.relay.start(HOST, self.port)
        self._tasks["relay"] = asyncio.create_task(self.relay.run())
        return self.relay

    async def stop_relay(self) -> None:
        await self._stop("relay")
        await self.relay.close()

    def start_site(self, name: str) -> None:
        access = AccessControl(name, self.rings[name], requires_keys=True)
        end = SiteEnd(self.book, name, access, StructuredLog(f"relay@{name}"))
        self.ends.append(end)
        self._tasks[name] = asyncio.create_task(end.run())

    async def _stop(self, name: str) -> None:
        task = self._tasks.pop(name)
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task

    async def dial(self, name: str, **request: Any) -> Channel:
        pair = self.rings[name].own(name)
        return await dial(HOST, self.port, pair, raw_key(self.keys["relay"]), request)

    async def said_to(self, name: str, **request: Any) -> dict[str, Any]:
        """Return the first answer to a request, None of a connection that is closed."""
        found = await self.dial(name, **request)
        try:
            return await found.receive()
        finally:
            found.close()

    def hex(self, name: str) -> str:
        return raw_key(self.keys[name]).hex()

    async def together(self) -> None:
        """Start everything and wait until the sites know of one another."""
        if "relay" not in vars(self):
            await self.start_relay()
        for name in ("master", "slave"):
            self.start_site(name)
        await until(lambda: all(end._servers for end in self.ends))
        await until(lambda: all(server.is_serving() for end in self.ends for server in end._servers.values()))

    async def close(self) -> None:
        for name in [name for name in self._tasks if name != "relay"]:
            await self._stop(name)
        if "relay" in self._tasks:
            await self.stop_relay()
        await asyncio.sleep(0)


async def until(condition: Callable[[], bool]) -> None:
    """Wait for a condition."""
    async with asyncio.timeout(PATIENCE_S):
        while not condition():
            await asyncio.sleep(0.01)


@contextlib.asynccontextmanager
async def bench(folder: Path, other: Bench | None = None) -> AsyncIterator[Bench]:
    folder.mkdir(exist_ok=True)
    found = Bench(folder, other)
    try:
        yield found
    finally:
        await found.close()


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[Bench]:
    async with bench(tmp_path) as found:
        yield found


@contextlib.asynccontextmanager
async def echo(host: str, port: int) -> AsyncIterator[list[bytes]]:
    """A node that says back whatever it is told."""
    heard: list[bytes] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while data := await reader.read(65536):
                heard.append(data)
                writer.write(data)
                await writer.drain()
        except OSError:
            pass
        finally:
            writer.transport.abort()

    running = await asyncio.start_server(serve, host, port)
    try:
        yield heard
    finally:
        running.close()


async def echoed(host: str, port: int, text: bytes) -> bytes:
    """Return what comes back of a text within a connection of its own; empty where it is closed before."""
    try:
        reader, writer = await asyncio.open_connection(host, port)
    except OSError:
        return b""
    try:
        writer.write(text)
        async with asyncio.timeout(PATIENCE_S):
            return await reader.readexactly(len(text))
    except asyncio.IncompleteReadError:
        return b""
    except OSError:
        return b""
    finally:
        writer.close()


async def eventually_echoed(host: str, port: int, text: bytes) -> None:
    """Connect again and again, as ZeroMQ does, until a text comes back."""
    async with asyncio.timeout(PATIENCE_S):
        while await echoed(host, port, text) != text:
            await asyncio.sleep(0.05)


async def test_a_node_of_the_other_site_is_reached_though_both_only_dial(rig: Bench) -> None:
    await rig.together()
    # the slave's nodes are reached at the address of its machine, and bind another one
    assert rig.book.network_endpoint(AFM) == f"tcp://127.77.0.2:{rig.afm_port}"
    assert rig.book.bind_endpoint(AFM) == f"tcp://127.0.0.1:{rig.afm_port}"
    async with echo(HOST, rig.afm_port), echo(HOST, rig.link_port):
        long = bytes(range(256)) * 4000
        assert await echoed("127.77.0.2", rig.afm_port, long) == long
        assert await echoed("127.77.0.1", rig.link_port, b"and back") == b"and back"
        several = [echoed("127.77.0.2", rig.afm_port, b"number %d" % number) for number in range(20)]
        assert await asyncio.gather(*several) == [b"number %d" % number for number in range(20)]
    await until(lambda: not +rig.relay.streams)


class Flood:
    """Strangers of the same address that connect without end, 200 at a time: silent ones, and some that claim a key."""

    def __init__(self, port: int) -> None:
        self.count = 0
        self._task = asyncio.create_task(self._run(port))

    async def _run(self, port: int) -> None:
        opened: deque[asyncio.StreamWriter] = deque()
        try:
            while True:
                _, writer = await asyncio.open_connection(HOST, port)
                if self.count % 2:
                    writer.write(os.urandom(PUBLIC_BYTES))
                self.count += 1
                opened.append(writer)
                if len(opened) > 200:
                    opened.popleft().transport.abort()
        finally:
            for writer in opened:
                writer.transport.abort()

    async def end(self) -> None:
        assert not self._task.done()
        self._task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._task


@pytest.mark.parametrize(
    "flooded", [pytest.param(False, marks=pytest.mark.endurance, id="alone"), pytest.param(True, id="among strangers")]
)
def test_ten_rigs_behind_one_address_are_joined_without_a_refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flooded: bool
) -> None:
    # Each has 25 connections, as a rig with a page has, and each is two at the relay, which refuses none of them. One
    # that this process serves too late, as it is all of the rigs, is tried again.
    if flooded:
        # The strangers have used up what their address may before the first rig comes.
        monkeypatch.setattr(server, "_BURST", 5.0)
        monkeypatch.setattr(server, "_PER_S", 1.0)

    async def run() -> None:
        async with contextlib.AsyncExitStack() as stack:
            rigs = [await stack.enter_async_context(bench(tmp_path / "rig0"))]
            for number in range(1, 10):
                rigs.append(await stack.enter_async_context(bench(tmp_path / f"rig{number}", rigs[0])))
            relay = await rigs[0].start_relay()
            if flooded:
                flood = Flood(rigs[0].port)
                stack.push_async_callback(flood.end)
                await until(lambda: relay.refused["flood"] > 5)
            for rig in rigs:
                rig.relay = relay
            await asyncio.gather(*(rig.together() for rig in rigs))
            for rig in rigs:
                for port in (rig.afm_port, rig.link_port):
                    await stack.enter_async_context(echo(HOST, port))
            texts = [b"number %d" % number for number in range(25)]
            said = [
                eventually_echoed(host, port, text)
                for rig in rigs
                for host, port, mine in (
                    ("127.77.0.2", rig.afm_port, texts[:13]),
                    ("127.77.0.1", rig.link_port, texts[13:]),
                )
                for text in mine
            ]
            await asyncio.gather(*said)
            # a handshake that this process had no time for is no limit of the relay
            strangers = {"flood", "unlisted", "malformed"} if flooded else set()
            assert {reason for reason, count in relay.refused.items() if count} <= {"handshake", *strangers}

    asyncio.run(run())


async def test_a_refusal_is_logged_at_both_ends_once(
    rig: Bench, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(server, "_BURST", 2.0)
    monkeypatch.setattr(server, "_PER_S", 0.01)

    async def pushed_out(*_: Any, **__: Any) -> None:
        raise RejectedError("flood")

    await rig.together()
    flood = Flood(rig.port)
    await until(lambda: rig.relay.refused["flood"] > 2)
    await flood.end()
    # so many of them that a site has not said who it is before it has to give way
    monkeypatch.setattr(rig.relay, "_identify", pushed_out)
    before = rig.relay.refused["flood"]
    async with echo(HOST, rig.afm_port):
        for _ in range(3):
            waiting = asyncio.create_task(echoed("127.77.0.2", rig.afm_port, b"hello"))
            await until(lambda: rig.relay.refused["flood"] > before + 2)
            waiting.cancel()
    told = caplog.text
    assert told.count("connections from 127.0.0.1 are refused") == 1
    assert told.count("has ended a connection without an answer") == 1


async def test_who_waits_for_a_half_that_is_refused_is_told_at_once(
    rig: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_JOIN_S", 10.0 * PATIENCE_S)
    await rig.together()
    async with echo(HOST, rig.afm_port):
        opening = await rig.dial("master", want="open", to=rig.hex("slave"), port=rig.afm_port)
        # the other site can dial no second time: it says so in the place of silence
        dialled, rig.ends[1]._dial = rig.ends[1]._dial, _refused  # type: ignore[method-assign]
        async with asyncio.timeout(PATIENCE_S):
            assert await opening.receive() == {"refused": "absent"}
        rig.ends[1]._dial = dialled  # type: ignore[method-assign]
        opening.close()


async def _refused(**request: Any) -> Channel:
    raise ConnectionResetError


async def test_a_node_that_begins_a_moment_later_is_waited_for(rig: Bench) -> None:
    await rig.together()
    waiting = asyncio.create_task(echoed("127.77.0.2", rig.afm_port, b"hello"))
    await asyncio.sleep(0.3)
    assert not waiting.done()
    async with echo(HOST, rig.afm_port):
        assert await waiting == b"hello"


async def test_a_relay_that_is_gone_and_comes_back_is_found_again(rig: Bench) -> None:
    await rig.together()
    async with echo(HOST, rig.afm_port):
        reader, writer = await asyncio.open_connection("127.77.0.2", rig.afm_port)
        writer.write(b"before")
        assert await reader.readexactly(6) == b"before"
        await rig.stop_relay()
        async with asyncio.timeout(PATIENCE_S):
            with contextlib.suppress(OSError):
                assert await reader.read(1) == b""
        writer.close()

        async def refused() -> bool:
            try:
                _, late = await asyncio.open_connection("127.77.0.2", rig.afm_port)
            except ConnectionRefusedError:
                return True
            late.close()
            return False

        # as where the other machine does not run: nobody waits for a handshake
        while not await refused():
            await asyncio.sleep(0.01)
        await rig.start_relay()
        await eventually_echoed("127.77.0.2", rig.afm_port, b"after")


async def test_who_is_not_listed_is_told_what_to_do_and_joins_nothing(rig: Bench) -> None:
    relay = await rig.start_relay()
    said = await rig.said_to("stranger", want="site", meets=[])
    assert said["refused"] == "unlisted"
    assert "telenano keys allow NAME KEY --role relay" in said["text"]
    rig.rings["relay"].allow("guest", rig.keys["stranger"].decode(), ["observe"])
    await until(lambda: relay._authorize(rig.keys["stranger"].decode())[1] == "role")
    assert (await rig.said_to("stranger", want="site", meets=[]))["refused"] == "role"
    assert relay.sites == {}


async def test_nobody_learns_whether_a_key_is_there_that_does_not_want_to_meet_it(rig: Bench) -> None:
    rig.rings["relay"].allow("other_lab", rig.keys["stranger"].decode(), ["relay"])
    await rig.together()
    control = await rig.dial("stranger", want="site", meets=[rig.hex("slave"), "00" * 32])
    assert (await control.receive())["ok"]
    for to in (rig.hex("slave"), "00" * 32):
        said = await rig.said_to("stranger", want="open", to=to, port=rig.afm_port)
        assert said == {"refused": "absent"}
    assert (await rig.said_to("stranger", want="look"))["present"] == []
    assert (await rig.said_to("master", want="look"))["present"] == [rig.hex("slave")]
    # a connection that was opened for the slave cannot be accepted by another
    async with echo(HOST, rig.link_port):
        assert (await rig.said_to("stranger", want="accept", number="0" * 16))["refused"] == "late"
    control.close()


async def test_only_ports_of_the_site_file_are_reached(rig: Bench) -> None:
    await rig.together()
    (other,) = free_ports(1)
    async with echo(HOST, other) as heard:
        said = await rig.said_to("master", want="open", to=rig.hex("slave"), port=other)
        assert said["refused"] == "absent"
        assert heard == []


@pytest.mark.parametrize("how", ["revoked", "expired"])
async def test_a_key_that_ends_is_cut_off(rig: Bench, how: str) -> None:
    today = [date(2027, 3, 1)]
    keys = rig.rings["relay"]
    keys.today = lambda: today[0]
    keys.allow("lab_slave", rig.keys["slave"].decode(), ["relay"], date(2027, 3, 1))
    await rig.together()
    async with echo(HOST, rig.afm_port):
        reader, writer = await asyncio.open_connection("127.77.0.2", rig.afm_port)
        writer.write(b"before")
        assert await reader.readexactly(6) == b"before"
        if how == "revoked":
            keys.revoke("lab_slave")
        else:
            today[0] = date(2027, 3, 2)
        async with asyncio.timeout(PATIENCE_S):
            with contextlib.suppress(OSError):
                assert await reader.read(1) == b""
        writer.close()
    await until(lambda: rig.hex("slave") not in rig.relay.sites)
    assert (await rig.said_to("slave", want="look"))["refused"] == how


async def test_a_second_process_with_the_key_of_a_site_takes_its_place_and_the_first_is_told(rig: Bench) -> None:
    await rig.start_relay()
    first = await rig.dial("master", want="site", meets=[])
    assert (await first.receive())["ok"]
    second = await rig.dial("master", want="site", meets=[])
    assert (await second.receive())["ok"]
    assert await first.receive() == {"replaced": True}
    first.close()
    await until(lambda: len(rig.relay.sites) == 1)
    second.close()
    await until(lambda: not rig.relay.sites)


@pytest.mark.parametrize("most", ["_MOST_FROM_ADDRESS", "_MOST_STRANGERS"])
async def test_strangers_are_few_and_the_oldest_gives_way(
    rig: Bench, monkeypatch: pytest.MonkeyPatch, most: str
) -> None:
    # Nobody is let go for his silence here.
    monkeypatch.setattr(server, "HELLO_S", 10 * PATIENCE_S)
    monkeypatch.setattr(server, most, 4)
    relay = await rig.start_relay()
    opened = []
    for _ in range(10):
        opened.append(await asyncio.open_connection(HOST, rig.port))
        # Each is greeted, and so waits for its turn to give way.
        assert len(await opened[-1][0].readexactly(24)) == 24
    await until(lambda: relay.refused["handshake"] == 6)
    assert await asyncio.gather(*(_all_of(reader) for reader, _ in opened[:6])) == [b""] * 6
    assert not any(reader.at_eof() for reader, _ in opened[6:])
    # A site comes in at its first try though strangers hold every place, and those who are in stay.
    kept = await rig.dial("slave", want="site", meets=[])
    assert (await kept.receive())["ok"]
    for _ in range(8):
        opened.append(await asyncio.open_connection(HOST, rig.port))
        assert (await rig.said_to("master", want="look"))["ok"]
    assert list(relay.sites) == [rig.hex("slave")]
    kept.close()
    for _, writer in opened:
        writer.close()


async def test_who_is_silent_is_let_go_and_who_comes_too_fast_has_to_claim_a_listed_key(
    rig: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "HELLO_S", 0.5)
    monkeypatch.setattr(server, "_BURST", 4.0)
    monkeypatch.setattr(server, "_PER_S", 1e-3)
    relay = await rig.start_relay()
    opened = [await asyncio.open_connection(HOST, rig.port) for _ in range(10)]
    greeted = [await asyncio.wait_for(_all_of(reader), PATIENCE_S) for reader, _ in opened]
    assert list(map(len, greeted)) == [24] * 10
    for _, writer in opened:
        writer.close()
    await until(lambda: relay.refused["handshake"] == 10)
    # A stranger with a key is not answered, and a site is; who claims its key has to prove that all the same.
    with pytest.raises(Gone):
        await rig.said_to("stranger", want="look")
    assert (await rig.said_to("slave", want="look"))["ok"]
    reader, writer = await asyncio.open_connection(HOST, rig.port)
    writer.write(raw_key(rig.keys["slave"]) + b"\x00\x20" + bytes(32))
    assert len(await asyncio.wait_for(_all_of(reader), PATIENCE_S)) == 24
    writer.close()
    assert +relay.refused == {"handshake": 10, "flood": 1, "forged": 1}


async def _all_of(reader: asyncio.StreamReader) -> bytes:
    try:
        return await reader.read(-1)
    except OSError:
        return b""


@pytest.mark.parametrize(
    "request_",
    [
        {}, {"want": "nothing"}, {"want": "site"}, {"want": "open", "to": 1}, {"want": []},
        {"want": "open", "to": "x", "port": math.inf},
    ],
)  # fmt: skip
async def test_a_request_that_is_none_ends_its_connection_alone(rig: Bench, request_: dict[str, Any]) -> None:
    relay = await rig.start_relay()
    found = await rig.dial("master", **request_)
    with pytest.raises(Gone):
        while (await found.receive()) != {}:
            pass
    found.close()
    await until(lambda: relay.refused["malformed"] == 1)
    assert (await rig.said_to("master", want="look"))["ok"]


async def test_a_false_relay_is_not_believed(rig: Bench) -> None:
    # it has a key of its own, and not the one that is listed
    rig.rings["relay"].create("relay", replace=True)
    await rig.start_relay()
    with pytest.raises(Gone):
        await rig.said_to("master", want="look")
    await until(lambda: rig.relay.refused["forged"] == 1)


async def test_a_frame_is_good_once_and_in_its_place(rig: Bench) -> None:
    await rig.start_relay()
    caught: list[bytes] = []
    found = await rig.dial("master", want="site", meets=[])
    write = found.writer.write
    found.writer.write = lambda data: (caught.append(data), write(data))[1]  # type: ignore[method-assign]
    await found.send(ping=True)
    assert (await found.receive())["ok"]
    assert (await found.receive())["alive"]
    write(caught[0])
    with pytest.raises(Gone):
        await found.receive()
    await until(lambda: rig.relay.refused["forged"] == 1)
    found.close()


def test_a_site_without_the_key_of_the_relay_names_the_command(tmp_path: Path) -> None:
    rig = Bench(tmp_path)
    rig.rings["master"].revoke("relay")
    with pytest.raises(ConfigError, match="telenano keys allow relay KEY --role relay"):
        rig.start_site("master")


async def test_a_channel_refuses_what_is_too_long(rig: Bench) -> None:
    await rig.start_relay()
    found = await rig.dial("master", want="site", meets=[])
    found.writer.write(b"\xff\xff")
    await until(lambda: rig.relay.refused["oversized"] == 1)
    found.close()
    assert channels.HELLO_S > site_end._NODE_S
    assert issubclass(RejectedError, Gone)


def limited(monkeypatch: pytest.MonkeyPatch, more: int) -> None:
    """Let this process open so many more files than it has open."""
    taken = sum(1 for _ in Path("/dev/fd").iterdir()) - 1
    monkeypatch.setattr("telenano.runtime.wiring.descriptors.open_descriptors", lambda: taken)
    monkeypatch.setattr("telenano.runtime.wiring.descriptors.descriptor_limit", lambda: taken + more)


async def test_a_relay_that_may_open_too_few_files_says_so_before_it_listens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path)
    limited(monkeypatch, 60)
    with pytest.raises(EndpointError, match=r"a relay needs \d+ open files, and may have \d+: raise `ulimit -n`"):
        await bench.start_relay()
    with contextlib.closing(socket.socket()) as free:
        free.bind((HOST, bench.port))


async def test_strangers_leave_a_session_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(tmp_path)
    limited(monkeypatch, 100)
    relay = await bench.start_relay()
    crowd = [await asyncio.open_connection(HOST, bench.port) for _ in range(30)]
    try:
        async with asyncio.timeout(PATIENCE_S):
            while sum(reader.at_eof() for reader, _ in crowd) < 20:
                for reader, _ in crowd:
                    with contextlib.suppress(TimeoutError, ConnectionError):
                        await asyncio.wait_for(reader.read(1), 0.01)
    finally:
        for _, writer in crowd:
            writer.close()
        await bench.stop_relay()
    assert relay.sites == {}
