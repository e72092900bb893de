"""A guard between the rig and an AFM controller: it retracts the tip when the rig is silent while the tip is near.

A controller keeps z when its connection is lost, and has no watchdog. So this process runs on the controller's side: it
forwards requests and answers in turn, and takes each request as a sign of life. If there is none for the heartbeat time
while the tip is driven, or the connection ends then, it breaks the connection and sends the retraction itself, again
and again until the controller reports that z is there. Only then may a rig connect again.
"""

import contextlib
import selectors
import socket
import time
from collections.abc import Callable
from typing import Protocol

from telenano_devices.controllers.request_answer import Incoming, WireError

_POLL_S = 0.002
_RETRY_NS = 200_000_000
_READ_BYTES = 65536


class GuardedController(Protocol):
    """The guard's view of a controller: the meaning of its messages, and the request that retracts the tip."""

    heartbeat_s: float

    def cut(self, stream: bytes) -> int:
        """Return the length of the first message; see `request_answer.Cut`."""

    def answer(self, request: bytes, trips: int) -> bytes | None:
        """Return the guard's own answer, with its number of retractions `trips`; None for a request to forward."""

    def drives(self, request: bytes) -> bool | None:
        """Return whether the tip is driven after a request; None for a request that does not change that."""

    def retraction(self) -> bytes:
        """Return the request that retracts the tip."""

    def is_retracted(self, answer: bytes) -> bool:
        """Return whether the answer to `retraction` reports that the tip is retracted."""


class SilenceJudge:
    """Decides when the tip has to be retracted; the caller passes the time, so a test can run it in virtual time.

    Args:
        guarded: The controller.
    """

    def __init__(self, guarded: GuardedController) -> None:
        self._guarded = guarded
        self._heard_ns = 0
        self._owed = False
        # The guard does not know where an earlier guard left the tip, so it retracts the tip first.
        self.driven = self.due = True
        self.trips = 0

    def hear(self, request: bytes, now_ns: int) -> bytes | None:
        """Take a request of the rig; return the guard's own answer, or None for a request to forward."""
        self._heard_ns = now_ns
        if (answer := self._guarded.answer(request, self.trips)) is not None:
            return answer
        driven = self._guarded.drives(request)
        self.driven = self.driven if driven is None else driven
        self._owed = True
        return None

    def passed_back(self, now_ns: int) -> None:
        """Note that the rig has its answer; while it waits for one, its silence does not count."""
        self._owed, self._heard_ns = False, now_ns

    def judge(self, now_ns: int, *, connected: bool) -> bool:
        """Return whether to break the connection of the rig now; `due` becomes true when a retraction is needed."""
        silent = not self._owed and now_ns - self._heard_ns > self._guarded.heartbeat_s * 1e9
        if self.due or not self.driven or (connected and not silent):
            return False
        self.due, self._owed = True, False
        self.trips += 1
        return connected

    def take(self, answer: bytes) -> bool:
        """Take the answer to a retraction; return whether the tip is retracted."""
        if self._guarded.is_retracted(answer):
            self.due = self.driven = False
        return not self.due


class RetractGuard:
    """The guard between the socket of the rig and that of the controller.

    Args:
        guarded: The controller.
        controller: Its address and port.
        listen: The address and port of the guard.
        say: The function that shows a sentence to a person.
        now_ns: The monotonic clock [ns]; a test replaces it.
    """

    def __init__(
        self,
        guarded: GuardedController,
        controller: tuple[str, int],
        listen: tuple[str, int],
        say: Callable[[str], None],
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._now_ns = now_ns
        self._guarded, self._controller, self._say = guarded, controller, say
        self.judge = SilenceJudge(guarded)
        self._selector = selectors.DefaultSelector()
        self._listener = socket.create_server(listen)
        self._client: socket.socket | None = None
        self._server: socket.socket | None = None
        self._from_client, self._from_server = Incoming(guarded.cut), Incoming(guarded.cut)
        # Whose request the controller has still to answer: "rig", "guard", or "" for none.
        self._owed = ""
        self._retry_ns = 0
        self._last_text = ""

    def run(self, continues: Callable[[], bool]) -> None:
        """Guard until `continues` returns False, then retract the tip, for which the controller has one second."""
        try:
            while continues():
                self.step()
        finally:
            if self.judge.driven:
                self.judge.due = True
                end_ns = time.monotonic_ns() + 1_000_000_000
                while self.judge.due and time.monotonic_ns() < end_ns:
                    self.step()
            for each in (self._client, self._server, self._listener):
                if each is not None:
                    each.close()

    def step(self) -> None:
        """Forward the messages that have come, and judge the silence; this waits for 2 ms at most."""
        if self._server is None:
            self._reach(self._now_ns())
        for ready in self._ready():
            if ready is self._listener:
                self._accept()
            elif ready is self._server:
                self._hear_server()
            elif ready is self._client:
                self._hear_client(self._now_ns())
        due_before = self.judge.due
        if self.judge.judge(self._now_ns(), connected=self._client is not None):
            self._leave_client(
                f"the rig was silent for more than {self._guarded.heartbeat_s * 1e3:.0f} ms, and the tip is retracted"
            )
        elif self.judge.due and not due_before:
            self._tell("the rig's connection has ended while the tip was driven, and the tip is retracted")
        if self.judge.due and self._server is not None and not self._owed:
            self._send_server(self._guarded.retraction(), "guard")

    def _ready(self) -> list[socket.socket]:
        # A rig may connect only while the tip is known to be retracted, and only one at a time.
        wanted = [self._server, self._client]
        if self._client is None and self._server is not None and not self.judge.due:
            wanted.append(self._listener)
        ready = [each for each in wanted if each is not None]
        for each in ready:
            self._selector.register(each, selectors.EVENT_READ)
        try:
            return [key.fileobj for key, _ in self._selector.select(_POLL_S)]  # type: ignore[misc]
        finally:
            for each in ready:
                self._selector.unregister(each)

    def _reach(self, now_ns: int) -> None:
        if now_ns < self._retry_ns:
            return
        self._retry_ns = now_ns + _RETRY_NS
        try:
            self._server = socket.create_connection(self._controller, timeout=0.2)
        except OSError as error:
            self._tell(f"the controller at {self._controller[0]}:{self._controller[1]} is not reached: {error}")
            return
        self._server.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._from_server, self._owed = Incoming(self._guarded.cut), ""
        # The guard does not know what happened while the controller was not reached, so it retracts again.
        self.judge.driven = self.judge.due = True

    def _accept(self) -> None:
        self._client, (host, port, *_) = self._listener.accept()
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._from_client = Incoming(self._guarded.cut)
        self._tell(f"a rig at {host}:{port} is connected")

    def _hear_client(self, now_ns: int) -> None:
        received = _received(self._client)
        if not received:
            self._leave_client("")
            return
        try:
            self._from_client.add(received)
            while self._client is not None and (request := self._from_client.take()) is not None:
                own = self.judge.hear(request, now_ns)
                if own is not None:
                    self._send_client(own)
                elif self._owed or self._server is None:
                    self._leave_client("the rig has sent a request before it had the answer to the last one")
                else:
                    self._send_server(request, "rig")
        except WireError as error:
            self._leave_client(f"received bytes that are not a request: {error}")

    def _hear_server(self) -> None:
        received = _received(self._server)
        try:
            if not received:
                raise WireError("it has closed the connection")
            self._from_server.add(received)
            while (answer := self._from_server.take()) is not None:
                whose, self._owed = self._owed, ""
                if whose == "guard":
                    if self.judge.take(answer):
                        self._tell("the tip is retracted, and a rig may connect")
                elif self._client is not None:
                    self.judge.passed_back(self._now_ns())
                    self._send_client(answer)
        except WireError as error:
            if self._server is not None:
                self._server.close()
            self._server = None
            self._leave_client(f"the controller is lost: {error}")

    def _send_server(self, request: bytes, whose: str) -> None:
        self._owed = whose
        if self._server is not None:
            with contextlib.suppress(OSError):
                self._server.sendall(request)

    def _send_client(self, answer: bytes) -> None:
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.sendall(answer)

    def _leave_client(self, text: str) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None
        if text:
            self._tell(text)

    def _tell(self, text: str) -> None:
        if text != self._last_text:
            self._last_text = text
            self._say(text)


def _received(line: socket.socket | None) -> bytes:
    """Return the bytes that have come, empty if the connection has ended."""
    if line is None:
        return b""
    try:
        return line.recv(_READ_BYTES)
    except OSError:
        return b""
