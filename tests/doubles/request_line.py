"""A connection between a driver and an emulated instrument that answers requests, in virtual time."""

from collections.abc import Callable, Mapping
from typing import Any

from telenano.testing import afm_node

MS = 1_000_000


class RequestLine:
    """The network, with the instrument at its end; time passes in `pass_ms`.

    A part of the test replaces `to_host`, what the network does with an answer, or says that the instrument is not
    reachable, does not run, or is not accepting.
    """

    resolved = True
    model: Any
    driver: Any

    def __init__(self) -> None:
        self.now_ns = 10**9
        self.reachable = self.running = self.accepting = True
        self.latency_ms = 0.0
        self.to_host: Callable[[bytes], bytes] = lambda sent: sent
        self.opened = self.closed = 0
        self._waiting: list[tuple[int, bytes]] = []

    def connect(self, host: str, port: int) -> Any:
        if not self.reachable:
            raise OSError(111, "Connection refused")
        self.opened += 1
        self._waiting.clear()
        return self

    def ready(self) -> bool:
        return self.accepting

    def answer(self, sent: bytes) -> int:
        """Have an answer arrive when the latency has passed; give when that is [ns]."""
        due_ns = self.now_ns + round(self.latency_ms * MS)
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
            self.now_ns += MS
            self.guard()
            self.model.pass_time(self.now_ns)

    def guard(self) -> None:
        """Do what is due in between."""

    def follow(self, base_m: float, count: int) -> Any:
        """Have the driver follow to a place for a number of periods, and return the last sample."""
        for _ in range(count):
            self.pass_ms(1)
            sample = self.driver.exchange(base_m)
        return sample

    @property
    def clock(self) -> dict[str, Any]:
        """Return what a driver gets in the place of the real clock and the real network."""
        return {
            "connect": self.connect,
            "now_ns": lambda: self.now_ns,
            "sleep": lambda duration_s: self.pass_ms(max(1, round(duration_s * 1e3))),
        }


class InstrumentRig:
    """An AFM node with an emulated instrument on a bench."""

    def __init__(self, bench: Any, line: Any, section: Mapping[str, Any] | None = None) -> None:
        self.bench, self.line = bench, line
        self.node = afm_node(bench, line.driver, section)

    def tick(self, count: int = 1, x_s_m: float = 0.0, place: tuple[float, float] = (0.0, 0.0)) -> None:
        for _ in range(count):
            self.bench.advance_ms(1)
            self.line.pass_ms(1)
            fields = {"mode": "position", "base_position_m": (*place, 0.0 - x_s_m), "hand_seq": 7, "hand_armed": True}
            fields["hand_t_ns"] = self.bench.clock.now_ns()
            self.node.on_message(self.bench.received("afm/command", "controller@slave", **fields))

    def control(self, command: str, **parameters: Any) -> str:
        fields = {"id": "a", "command": command, "target": "afm_node", "parameters": parameters}
        return str(self.node.on_control(self.bench.make("session/control", "console@slave", **fields)))
