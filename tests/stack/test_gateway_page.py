"""A rig's page through a gateway: who gets in, by which way hand and force go, and what a dead gateway leaves."""

import asyncio
import importlib.util
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import websockets
from browser_page import needs_browser, open_page, until
from gateway_rig import GatewayRig, behind_gateway, unverified
from page_without_rig import OBSERVER_TOKEN, TOKEN

pytestmark = [
    pytest.mark.check("starts two processes, and Chromium"),
    pytest.mark.timeout(300),
    pytest.mark.skipif(importlib.util.find_spec("aioquic") is None, reason="aioquic is not installed"),
]


@pytest.fixture
def gateway(tmp_path: Path) -> Iterator[GatewayRig]:
    with behind_gateway(tmp_path) as found:
        yield found


class Client:
    """A page without a browser, which has no datagrams."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket

    async def send(self, **fields: Any) -> None:
        await self._socket.send(msgpack.packb(fields))

    async def take(self, *kinds: str) -> dict[str, Any]:
        """Return the next frame of one of these kinds."""
        async with asyncio.timeout(30.0):
            while True:
                frame: dict[str, Any] = msgpack.unpackb(await self._socket.recv(), strict_map_key=False)
                if frame["k"] in kinds:
                    return frame


def with_client(gateway: GatewayRig, work: Any, *, address: str = "", origin: str = "") -> Any:
    """Return what a coroutine returns that is given a client of the gateway."""

    async def run() -> Any:
        options: dict[str, Any] = {"origin": origin or gateway.origin, "max_size": None, "ssl": unverified()}
        async with websockets.connect(address or gateway.bus, **options) as socket:
            return await work(Client(socket))

    return asyncio.run(run())


def test_a_rig_decides_who_gets_in_and_who_may_press(gateway: GatewayRig) -> None:
    async def hello(client: Client, token: str) -> dict[str, Any]:
        await client.send(k="hello", token=token, protocol=1)
        return await client.take("snapshot", "refused")

    async def observe(client: Client) -> dict[str, Any]:
        assert (await hello(client, OBSERVER_TOKEN))["role"] == "observer"
        await client.send(k="hand", force_n=1.0, held=True, number=1, stamp_s=1.0)
        return await client.take("hand", "felt")

    async def guess(client: Client) -> dict[str, Any]:
        return await hello(client, "operator-token-0124")

    async def press(client: Client) -> dict[str, Any]:
        assert (await hello(client, TOKEN))["role"] == "operator"
        offer = await client.take("datagrams")
        assert len(offer["hash"]) == 32
        assert offer["path"].startswith("way/")
        await client.send(k="hand", force_n=1.25, held=True, number=1, stamp_s=7.0)
        return await client.take("hand", "felt")

    assert "token is wrong" in with_client(gateway, guess)["text"]
    assert with_client(gateway, observe)["text"] == "this page cannot hold the hand"
    assert gateway.rig._force_n == 0.0
    felt = with_client(gateway, press)
    assert (felt["k"], felt["number"], felt["stamp_s"]) == ("felt", 1, 7.0)
    assert 0.0 <= felt["age_s"] < 30.0
    # Its connection has ended, and with it the force.
    until(lambda: gateway.rig._force_n == 0.0, "a hand that is let go")


def test_another_rig_and_another_origin_are_refused(gateway: GatewayRig) -> None:
    async def refused(client: Client) -> str:
        return str((await client.take("refused"))["text"])

    elsewhere = gateway.bus.replace("lab_a", "lab_b")
    assert "'lab_b' is not at this gateway" in with_client(gateway, refused, address=elsewhere)
    with pytest.raises(websockets.InvalidStatus):
        with_client(gateway, refused, origin="https://elsewhere.example")


@pytest.mark.browser
@needs_browser
def test_a_browser_presses_by_datagrams_and_a_killed_gateway_takes_the_force_away(
    chromium: Any, gateway: GatewayRig
) -> None:
    page = open_page(chromium, f"{gateway.address}#{TOKEN}", ignore_https_errors=True)
    page.until("telenano.store.hand", "a page that may press")
    page.value("telenano.cockpit.hand.holdHere(), telenano.cockpit.hand.lower(5e-3), 0")
    page.until("telenano.store.felt?.isDatagram", "a force by datagrams")
    until(lambda: gateway.rig._force_n > 0.1, "a hand that presses")
    page.until("document.querySelector('#felt-age').textContent.includes('ms old, by datagrams')", "the age of it")
    gateway.kill("relay")
    killed_s = time.monotonic()
    until(lambda: gateway.rig._force_n == 0.0, "a hand that is let go")
    assert time.monotonic() - killed_s < 1.0
    page.until("document.body.dataset.link !== 'open'", "a page that says that it is not connected")
    gateway.start_gateway()
    page.until("document.body.dataset.link === 'open'", "a page that is back")
    # What was lost does not come back by itself.
    assert gateway.rig._force_n == 0.0
