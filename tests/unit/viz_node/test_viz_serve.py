"""The server at a port of its own, against connections as they should not be: nobody else notices."""

import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from typing import Any

import msgpack
import pytest

pytest.importorskip("uvicorn")
pytest.importorskip("websockets")
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from services.viz_node import server
from services.viz_node.access import Access
from services.viz_node.feed import Seen
from services.viz_node.hub import Hub
from services.viz_node.requests import LARGEST_FRAME, PROTOCOL
from services.viz_node.serve import bind, make_server
from services.viz_node.source import NoTransport

ACCESS = Access("operator-token-0123", "observer-token-0123")
# far beyond what is expected: only keeps a broken server from holding the suite
PATIENCE_S = 30.0


class Source(NoTransport):
    """A rig that says something whenever it is asked."""

    def __init__(self) -> None:
        self.polled = 0

    def poll(self, *, watched: bool) -> list[Seen]:
        self.polled += 1
        fields = {"kind": "mode", "level": "info", "text": str(self.polled), "seq": self.polled, "data": {}}
        return [Seen("session/event", "afm_node@slave", 10**18 + self.polled, fields)]

    def about(self) -> Mapping[str, Any]:
        return {"kind": "live", "name": "test"}

    def close(self) -> None:
        pass


@pytest.fixture
def address() -> Iterator[str]:
    with bind(port=0) as bound:
        found = make_server(server.make_app(Hub(Source()), ACCESS, None))
        running = threading.Thread(target=found.run, kwargs={"sockets": [bound]})
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


def test_huge_frames_and_fifty_silent_connections_disturb_no_page(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
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
        silent = [opened(stack, address) for _ in range(50)]
        refused = [taken(socket, "refused")["text"] for socket in silent[server._MOST_STRANGERS :]]
        assert len(refused) == 50 - server._MOST_STRANGERS
        assert set(refused) == {"8 connections have shown no token yet, which is as many as may wait: try again"}
        assert is_told_on(page)
        # those that wait are sent away in their turn, and there is room again
        for socket in silent[: server._MOST_STRANGERS]:
            socket.close()
        taken(opened(stack, address, ACCESS.observer_token), "snapshot")
