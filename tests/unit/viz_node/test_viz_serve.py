"""The server at a port of its own, against connections as they should not be: nobody else notices."""

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import msgpack
import pytest
from made_source import MadeSource

from telenano.testing import PATIENCE_S, until

pytest.importorskip("uvicorn")
pytest.importorskip("websockets")
from test_viz_server import Rig
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from services.viz_node import hub as hubs
from services.viz_node import server
from services.viz_node.feed import SeenMessage
from services.viz_node.hub import Hub
from services.viz_node.page_server import PageServer
from services.viz_node.requests import PROTOCOL
from telenano.console import lease
from telenano.serving import connections as limits
from telenano.serving.access import Access
from telenano.serving.connections import MOST_CONNECTIONS, Connections
from telenano.serving.serve import LARGEST_FRAME, bind, make_server
from telenano.wire.errors import EndpointError

ACCESS = Access("operator-token-0123", "observer-token-0123")


class Source(MadeSource):
    """A rig that says something whenever it is asked."""

    polled = 0

    def poll(self, *, watched: bool) -> list[SeenMessage]:
        self.polled += 1
        fields = {"kind": "mode", "level": "info", "text": str(self.polled), "seq": self.polled, "data": {}}
        return [SeenMessage("session/event", "afm_node@slave", 10**18 + self.polled, fields)]


@pytest.fixture
def connections() -> Connections:
    return Connections()


@pytest.fixture
def address(connections: Connections) -> Iterator[str]:
    with bind(port=0) as bound:
        listener = bound.again(connections)
        found = make_server(server.make_app(Hub(Source()), ACCESS, None, connections))
        running = threading.Thread(target=found.run, kwargs={"sockets": [listener]})
        running.start()
        yield f"127.0.0.1:{bound.getsockname()[1]}"
        found.should_exit = True
        running.join(PATIENCE_S)


def opened(stack: ExitStack, address: str, token: str = "") -> ClientConnection:
    """Open a web socket as the page does, and say hello where there is a token."""
    socket = stack.enter_context(connect(f"ws://{address}/bus", origin=f"http://{address}"))  # type: ignore[arg-type]
    if token:
        socket.send(msgpack.packb({"k": "hello", "token": token, "protocol": PROTOCOL}))
    return socket


def taken(socket: ClientConnection, kind: str) -> dict[str, Any]:
    """Return the next frame of a kind."""
    while True:
        frame: dict[str, Any] = msgpack.unpackb(socket.recv(timeout=PATIENCE_S))
        if frame["k"] == kind:
            return frame


def is_told_on(page: ClientConnection) -> bool:
    """Return whether a page goes on to be told what is new, after all that was sent to it before."""
    page.send(msgpack.packb({"k": "transport", "id": "x", "action": "play", "value": 0.0}))
    taken(page, "answer")
    return bool(taken(page, "tick")["events"])


def test_huge_frames_disturb_no_page(address: str) -> None:
    with ExitStack() as stack:
        page = opened(stack, address, ACCESS.operator_token)
        taken(page, "snapshot")
        for size in (LARGEST_FRAME + 1, 1 << 24):
            huge = opened(stack, address, ACCESS.operator_token)
            with pytest.raises(ConnectionClosed) as closed:
                huge.send(bytes(size))
                taken(huge, "nothing")
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.code == 1009, "the code of a message that is too big"
        assert is_told_on(page)


# a page that holds control and presses, until it is killed
PRESSING = """
import sys, time, msgpack
from websockets.sync.client import connect
address, token, protocol = sys.argv[1:]
with connect(f"ws://{address}/bus", origin=f"http://{address}", max_size=None) as page:
    page.send(msgpack.packb({"k": "hello", "token": token, "protocol": int(protocol)}))
    while True:
        page.send(msgpack.packb({"k": "hand", "force_n": 1.0, "held": True}))
        time.sleep(0.01)
"""


def test_the_hand_of_a_page_that_is_killed_is_free_when_its_connection_ends_and_not_after_a_silence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # by silence nobody loses the hand here
    monkeypatch.setattr(lease, "VANISHED_NS", 10**15)
    monkeypatch.setattr(hubs, "HAND_FRESH_S", 1e6)
    rig, order = Rig(), list[str]()
    rig.hub.on_lease = lambda party: order.append(party.label if party else "nobody")
    with bind(port=0) as bound, ExitStack() as stack:
        found = make_server(server.make_app(rig.hub, ACCESS, None))
        running = threading.Thread(target=found.run, kwargs={"sockets": [bound]})
        running.start()
        stack.callback(running.join, PATIENCE_S)
        stack.callback(lambda: setattr(found, "should_exit", True))
        address = f"127.0.0.1:{bound.getsockname()[1]}"
        given = [sys.executable, "-c", PRESSING, address, ACCESS.operator_token, str(PROTOCOL)]
        page = subprocess.Popen(given)
        stack.callback(page.kill)
        until(lambda: rig.hub.desk.lease.presses and 1.0 in rig.hand)
        other = opened(stack, address, ACCESS.operator_token)
        taken(other, "snapshot")
        page.kill()
        page.wait(PATIENCE_S)
        # the tip is withdrawn for it, and the next one holds control by taking it
        until(lambda: [each[:2] for each in rig.commander.sent] == [("stop", "afm_node@slave")])
        assert rig.hand[-1] == 0.0
        other.send(msgpack.packb({"k": "lease", "id": "y", "action": "take"}))
        assert taken(other, "answer")["ok"] is True
        until(lambda: order == ["nobody", "window A", "nobody", "window B"])


def silent(stack: ExitStack, address: str, head: bytes = b"") -> socket.socket:
    """Open a connection that says no more than a part of a request."""
    host, _, port = address.partition(":")
    opened = stack.enter_context(socket.create_connection((host, int(port)), timeout=PATIENCE_S))
    opened.sendall(head)
    return opened


def is_closed(found: socket.socket) -> bool:
    found.settimeout(PATIENCE_S)
    try:
        return found.recv(1) == b""
    except ConnectionError:
        return True


@pytest.mark.parametrize("head", [b"", b"GET / HTTP/1.1\r\nHost: 127"], ids=["nothing", "half a head"])
def test_the_oldest_stranger_gives_way_and_an_open_page_does_not(address: str, head: bytes) -> None:
    with ExitStack() as stack:
        page = opened(stack, address, ACCESS.operator_token)
        taken(page, "snapshot")
        strangers = [silent(stack, address, head) for _ in range(3 * MOST_CONNECTIONS)]
        assert is_told_on(page)
        # whoever has a token gets in, again and again, while they hold on
        for _ in range(5):
            taken(opened(stack, address, ACCESS.operator_token), "snapshot")
        # the connections that were dropped are the oldest
        assert all(map(is_closed, strangers[:MOST_CONNECTIONS]))
        assert is_told_on(page)


def test_the_operator_gets_in_while_strangers_hold_sockets_that_never_say_hello_and_renew_them(address: str) -> None:
    with ExitStack() as stack:
        for _ in range(10):
            for _ in range(8):
                opened(stack, address)
            with ExitStack() as short:
                taken(opened(short, address, ACCESS.operator_token), "snapshot")


@pytest.mark.check("waits until a connection is closed")
def test_a_connection_that_says_nothing_is_closed_and_one_that_is_answered_is_not(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ExitStack() as stack:
        page = opened(stack, address, ACCESS.operator_token)
        taken(page, "snapshot")
        monkeypatch.setattr(limits, "SILENCE_S", 1.0)
        strangers = [silent(stack, address), silent(stack, address, b"GET / HT")]
        answered = silent(stack, address, f"GET /health HTTP/1.1\r\nHost: {address}\r\n\r\nGET /".encode())
        assert b"200 OK" in answered.recv(4096)
        for stranger in strangers:
            assert is_closed(stranger)
        while answered.recv(4096):
            pass
        assert is_told_on(page)


def test_a_page_behind_a_proxy_of_this_machine_is_none_that_says_nothing(
    address: str, connections: Connections
) -> None:
    forwarded = {"X-Forwarded-For": "127.0.0.7"}
    url = f"ws://{address}/bus"
    with connect(url, origin=f"http://{address}", additional_headers=forwarded) as page:  # type: ignore[arg-type]
        page.send(msgpack.packb({"k": "hello", "token": ACCESS.operator_token, "protocol": PROTOCOL}))
        taken(page, "snapshot")
        page_of = next(iter(connections._open.values()))
        assert (page_of.is_page, page_of.since_s) == (True, None)
        with pytest.raises(InvalidStatus) as refused:
            connect(url, origin=f"http://{address}", additional_headers={"X-Forwarded-For": "10.0.0.9"})  # type: ignore[arg-type]
        assert refused.value.response.status_code == 403


def test_there_are_no_more_connections_than_there_may_be(address: str, connections: Connections) -> None:
    with ExitStack() as stack:
        for _ in range(4 * MOST_CONNECTIONS):
            silent(stack, address)
        taken(opened(stack, address, ACCESS.operator_token), "snapshot")
        assert len(connections._open) <= MOST_CONNECTIONS + limits._CLOSING


def test_too_few_open_files_are_reported_before_the_page_is_served(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "descriptors_free", lambda: 150)
    with pytest.raises(EndpointError, match=r"needs 18 more open files .* raise `ulimit -n`"):
        limits.most_connections(24)
    monkeypatch.setattr(limits, "descriptors_free", lambda: 180)
    assert limits.most_connections(24) == 36


def test_what_ends_the_hub_ends_the_wait_of_the_node_that_serves_it() -> None:
    hub, ticks = Hub(Source()), [0]

    def count() -> None:
        ticks[0] += 1
        if ticks[0] > 1:
            raise OverflowError("int too large")

    hub.on_tick = count
    wake, signalled = socket.socketpair()
    with wake, signalled, bind(port=0) as bound:
        serving = PageServer(hub, ACCESS, bound, None, wake.fileno())
        with pytest.raises(OverflowError, match="int too large"):
            while True:
                serving.run(PATIENCE_S)
        serving.close()
    assert ticks == [2]


def test_a_signal_ends_the_wait_of_the_node_that_serves_the_page() -> None:
    wake, signalled = socket.socketpair()
    with wake, signalled, bind(port=0) as bound:
        serving = PageServer(Hub(Source()), ACCESS, bound, None, wake.fileno())
        signalled.send(b"\x0f")
        began_s = time.monotonic()
        serving.run(10.0 * PATIENCE_S)
        serving.close()
    assert time.monotonic() - began_s < 10.0 * PATIENCE_S


# A page whose commander hangs in a command, and whose emergency stop takes a while.
HANGING = """
import sys, threading, time
from telenano.runtime.wiring.participant import StopSignals
from telenano.serving.access import Access
from services.viz_node.hub import Hub
from services.viz_node.page_server import PageServer
from telenano.serving.serve import bind
from services.viz_node.source import NoTransport

class Source(NoTransport):
    def poll(self, *, watched): return []
    def about(self): return {"kind": "live", "name": "test"}
    def close(self): print("closed", flush=True)

class Commander:
    def send(self, *wanted):
        print("hangs", flush=True)
        threading.Event().wait()
    def estop(self, by):
        print("stopping", flush=True)
        time.sleep(0.5)
        print("stopped", flush=True)
        return {}

signals, hub = StopSignals(), Hub(Source(), Commander(), forms=threading.Event().wait)
with bind(port=0) as bound:
    serving = PageServer(hub, Access("operator-token-0123", "observer-token-0123"), bound, None, signals.descriptor)
    print(bound.getsockname()[1], flush=True)
    serving.run()
    serving.close()
    hub.close()
"""


@pytest.mark.check("takes 1.3 s")
def test_a_signal_ends_a_page_whose_commands_hang_and_an_emergency_stop_is_sent_before() -> None:
    process = subprocess.Popen([sys.executable, "-c", HANGING], stdout=subprocess.PIPE, text=True)
    with process, ExitStack() as stack:
        stack.callback(process.kill)
        assert process.stdout is not None
        page = opened(stack, f"127.0.0.1:{process.stdout.readline().strip()}", ACCESS.operator_token)
        taken(page, "snapshot")
        page.send(msgpack.packb({"k": "command", "id": "1", "command": "arm", "target": "*", "parameters": {}}))
        assert process.stdout.readline() == "hangs\n"
        page.send(msgpack.packb({"k": "estop", "id": "2"}))
        assert process.stdout.readline() == "stopping\n"
        process.terminate()
        process.wait(PATIENCE_S)
        assert process.stdout.read() == "stopped\nclosed\n"
