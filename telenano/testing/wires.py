"""A wire between a driver and an emulated instrument that answers requests, in virtual time."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from telenano.devices.afm import modbus_line
from telenano.devices.afm.tcp_driver import TcpDriver

# The frames between a host and the handle.
from telenano.devices.hand import wire as handle_wire

if TYPE_CHECKING:
    import pytest

__all__ = ["RequestLine", "handle_wire", "shorten_waits"]
_MS = 1_000_000


class RequestLine:
    """A network connection with an emulated instrument at its end; time passes in `pass_ms`.

    The driver gets `clock`, with this connection and its time instead of real ones. The line to one kind of instrument
    may set `model`, whose `pass_time` is called with the time [ns], and `driver`, for `follow`. A test can disturb the
    line at any time: `latency_ms` delays answers, `to_host` replaces their bytes, and the instrument may not be
    `reachable`, not be `running`, or not be `accepting` requests.

    Args:
        respond: Returns the instrument's answer to a request, or None for none.
    """

    resolved = True
    model: Any = None
    driver: Any

    def __init__(self, respond: Callable[[bytes], bytes | None] = lambda request: None) -> None:
        self.now_ns = 10**9
        self.reachable = self.running = self.accepting = True
        self.latency_ms = 0.0
        self.to_host: Callable[[bytes], bytes] = lambda sent: sent
        self.opened = self.closed = 0
        self._respond = respond
        self._waiting: list[tuple[int, bytes]] = []

    def send(self, request: bytes) -> None:
        """Pass a request to the instrument, and send its answer; raise OSError if it is not reachable."""
        if not self.reachable:
            raise OSError(104, "Connection reset by peer")
        if self.running and (said := self._respond(request)) is not None:
            self.answer(said)

    def connect(self, host: str, port: int) -> Any:
        if not self.reachable:
            raise OSError(111, "Connection refused")
        self.opened += 1
        self._waiting.clear()
        return self

    def ready(self) -> bool:
        return self.accepting

    def answer(self, sent: bytes) -> int:
        """Let an answer arrive after the latency; return the time of arrival [ns]."""
        due_ns = self.now_ns + round(self.latency_ms * _MS)
        self._waiting.append((due_ns, self.to_host(sent)))
        return due_ns

    def receive(self) -> bytes:
        if not self.reachable:
            raise OSError(104, "Connection reset by peer")
        due = b"".join(sent for at_ns, sent in self._waiting if at_ns <= self.now_ns)
        self._waiting = [(at_ns, sent) for at_ns, sent in self._waiting if at_ns > self.now_ns]
        return due

    def close(self) -> None:
        self.closed += 1

    def pass_ms(self, duration_ms: int) -> None:
        for _ in range(duration_ms):
            self.now_ns += _MS
            self.guard()
            if self.model is not None:
                self.model.pass_time(self.now_ns)

    def guard(self) -> None:
        """Do the periodic work of the line; called each millisecond before the model."""

    def follow(self, base_m: float, count: int) -> Any:
        """Let the driver move the base to a position [m] for `count` periods of 1 ms, and return the last sample."""
        for _ in range(count):
            self.pass_ms(1)
            sample = self.driver.exchange(base_m)
        return sample

    @property
    def clock(self) -> dict[str, Any]:
        """The arguments with which a driver uses this line instead of the real clock and network."""
        return {
            "connect": self.connect,
            "now_ns": lambda: self.now_ns,
            "sleep": lambda duration_s: self.pass_ms(max(1, round(duration_s * 1e3))),
        }


def shorten_waits(monkeypatch: "pytest.MonkeyPatch", retry_ms: int, step_ms: int) -> None:
    """Shorten the times after which drivers of network instruments retry, and give up a step, to these [ms]."""
    monkeypatch.setattr(modbus_line, "RETRY_NS", retry_ms * _MS)
    for owner in (modbus_line, TcpDriver):
        monkeypatch.setattr(owner, "STEP_NS", step_ms * _MS)
