"""Two ends of the link over a network that is made here: delay, loss and blocks of each way, in virtual time.

The ends are those of the product, with every datagram and every message over TCP carried by a `Way`. TCP is what it is
to a sample: in order, and late by the time of a retransmission where a packet is lost, so that what follows waits.
"""

import heapq
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import zmq
from telenano_wide_area.datagram.pacing import NETWORK_BYTES
from telenano_wide_area.doubles.datagram_bench import SOURCES, Side, SocketLog

from telenano.testing import payload

MS, S = 1_000_000, 1_000_000_000
DEADLINE_S, WITHDRAWN_S = 0.05, 0.25
# What a message over TCP takes beside its bytes [bytes]; a lost packet is sent again after a round trip and a quarter.
_TCP_BYTES = 150
_AGAIN = 1.25
_QUEUE_BYTES = 64_000
# Between two times nothing of UDP gets through that way; [ns], from the beginning of the session.
Block = tuple[int, int]


@dataclass(frozen=True)
class Network:
    """What holds between the sites: `blocks` by direction, `delay_s` each way, `rate_bit_per_s` 0 where unlimited."""

    delay_s: float
    loss: float
    rate_bit_per_s: float
    blocks: dict[str, Block]
    seed: int = 0


@dataclass
class Way:
    """One direction: a bottleneck that both kinds of packets wait for, then the delay."""

    network: Network
    block: Block
    draw: random.Random
    free_ns: int = 0
    # When the newest message of each connection of TCP arrives.
    tcp_ns: list[int] = field(default_factory=lambda: [0, 0])
    tcp_is_cut: bool = False
    sent: int = 0
    # How often the unluckiest packet of TCP was sent again.
    worst_again: int = 0
    datagrams: deque[tuple[int, bytes]] = field(default_factory=deque)
    messages: list[tuple[int, int, Callable[[], None]]] = field(default_factory=list)

    def _through(self, size_bytes: int, now_ns: int) -> int | None:
        """Return when a packet has passed the bottleneck and the delay; None where its queue is full."""
        if not self.network.rate_bit_per_s:
            return now_ns + round(self.network.delay_s * S)
        begin_ns = max(now_ns, self.free_ns)
        if (begin_ns - now_ns) * 1e-9 * self.network.rate_bit_per_s / 8.0 > _QUEUE_BYTES:
            return None
        self.free_ns = begin_ns + round(8e9 * size_bytes / self.network.rate_bit_per_s)
        return self.free_ns + round(self.network.delay_s * S)

    def datagram(self, data: bytes, now_ns: int) -> None:
        if self.block[0] <= now_ns < self.block[1] or self.draw.random() < self.network.loss:
            return
        at_ns = self._through(len(data) + NETWORK_BYTES, now_ns)
        if at_ns is not None:
            self.datagrams.append((at_ns, data))

    def message(self, size_bytes: int, act: Callable[[], None], now_ns: int, connection: int = 0) -> None:
        """Carry a message over TCP and act when it has arrived; nothing overtakes another one of its connection."""
        if self.tcp_is_cut and self.block[0] <= now_ns < self.block[1]:
            now_ns = self.block[1]
        at_ns, again = self._through(size_bytes + _TCP_BYTES, now_ns), 0
        while at_ns is None or self.draw.random() < self.network.loss:
            at_ns = (at_ns or now_ns + round(self.network.delay_s * S)) + round(_AGAIN * 2.0 * self.network.delay_s * S)
            again += 1
        self.worst_again = max(self.worst_again, again)
        self.tcp_ns[connection] = at_ns = max(self.tcp_ns[connection], at_ns)
        self.sent += 1
        heapq.heappush(self.messages, (at_ns, self.sent, act))

    def arrived(self, now_ns: int) -> None:
        while self.messages and self.messages[0][0] <= now_ns:
            heapq.heappop(self.messages)[2]()


class Port:
    """Stands for the UDP socket of an end."""

    def __init__(self, out: Way, into: Way, clock: Any) -> None:
        self._out, self._into, self._clock = out, into, clock

    def sendto(self, datagram: bytes, address: object) -> int:
        self._out.datagram(datagram, self._clock.monotonic_ns())
        return len(datagram)

    def recvfrom(self, most: int) -> tuple[bytes, tuple[str, int]]:
        if not self._into.datagrams or self._into.datagrams[0][0] > self._clock.monotonic_ns():
            raise BlockingIOError
        return self._into.datagrams.popleft()[1], ("127.0.0.1", 1)

    def close(self) -> None:
        pass


class Log(SocketLog):
    """Carries subscriptions to the other end, where they hold once they have arrived."""

    def __init__(self, way: Way, clock: Any, connection: int) -> None:
        super().__init__([])
        self.there: set[bytes] = set()
        self._way, self._clock, self._connection = way, clock, connection

    def subscribe(self, topic: bytes) -> None:
        self._way.message(40, lambda: self.there.add(topic), self._clock.monotonic_ns(), self._connection)

    def unsubscribe(self, topic: bytes) -> None:
        self._way.message(40, lambda: self.there.discard(topic), self._clock.monotonic_ns(), self._connection)


class Session:
    """Both ends over a network; `silences_s` are those between two samples that an end took, once it had one."""

    def __init__(self, network: Network, rate_hz: float, **link: Any) -> None:
        self.network, self.period_ns = network, round(S / rate_hz)
        self._context: Any = zmq.Context()
        common = {"master_port": _free_port(), "host": "127.0.0.1", "ahead_ns": 0, **link}
        self.master, self.slave = (Side(self._context, is_master=first, **common) for first in (True, False))
        begin_ns = self.master.clock.monotonic_ns()
        self.ways = {}
        self.logs: dict[str, tuple[Log, Log]] = {}
        for place, name in enumerate(("forward", "backward")):
            first, last = network.blocks.get(name, (1, 0))
            way = Way(network, (begin_ns + first, begin_ns + last), random.Random(2 * network.seed + place))
            self.ways[name] = way
        for side, out, into in ((self.master, "forward", "backward"), (self.slave, "backward", "forward")):
            side.end.socket.close()
            side.end.socket = Port(self.ways[out], self.ways[into], side.clock)  # type: ignore[assignment]
            side.log = Log(self.ways[out], side.clock, 0)
            side.subscriber.socket = side.log  # type: ignore[assignment]
            # Whose end it is has the same name here, whatever it subscribes to.
            logs = self.logs[side.outgoing] = (side.log, Log(self.ways[out], side.clock, 1))
            side.end.connect_beside(logs[1])  # type: ignore[arg-type]
        self.silences_s: dict[str, list[tuple[float, float]]] = {"master": [], "slave": []}
        self._newest_ns: dict[str, int] = {}
        self._keys = {"master": 0, "slave": 0}
        self.begin_ns = begin_ns

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s * S / self.period_ns)):
            self._turn()

    def _turn(self) -> None:
        sides = (("master", self.master, self.slave, "forward"), ("slave", self.slave, self.master, "backward"))
        for _, side, _, _ in sides:
            side.clock.advance_ns(self.period_ns)
        now = self.master.clock.monotonic_ns()
        for name, side, other, out in sides:
            way = self.ways[out]
            published = [message for topic, message in side.outlet.sent[self._keys[name] :] if topic == "link/key"]
            self._keys[name] = len(side.outlet.sent)
            for message in published:
                way.message(300, lambda m=message, o=other: o.end._hear_offer(m), now)  # type: ignore[misc]
            made = payload(side.outgoing, SOURCES[side.outgoing], side.seq)
            side.seq += 1
            sparse, topic = side.end.carry(side.outgoing, made), side.outgoing.encode()
            for frame in (topic, (sparse or b"none/") + topic):
                for connection, log in enumerate(self.logs[other.outgoing]):
                    if frame in log.there:
                        self._publish(way, other, connection, [frame, made], now)
        for way in self.ways.values():
            way.arrived(now)
        for name, side, _, _ in sides:
            side.received += side.end.receive(signalled=True)
            taken = [received for received in side.received if received.topic == side.incoming]
            if taken:
                before_ns = self._newest_ns.get(name)
                if before_ns is not None:
                    self.silences_s[name].append(((now - self.begin_ns) * 1e-9, (now - before_ns) * 1e-9))
                self._newest_ns[name] = now
            side.received.clear()

    @staticmethod
    def _publish(way: Way, to: Side, connection: int, frames: list[bytes], now_ns: int) -> None:
        def act() -> None:
            to.received += to.end.take_sparse([(frames, to.clock.now_ns())])

        way.message(len(frames[-1]), act, now_ns, connection)

    @property
    def worst_again(self) -> int:
        """How often the unluckiest packet of TCP was sent again since the last `forget`."""
        return max(way.worst_again for way in self.ways.values())

    @property
    def epoch_ns(self) -> int:
        return self.begin_ns + self.master.clock.epoch_offset_ns

    def end_trains(self) -> None:
        """Send no further trains of the start, each of which fills a narrow line for a moment."""
        self.master.end._trains = 0

    def forget(self) -> None:
        """Measure from now on."""
        for name, way in zip(self.silences_s, self.ways.values(), strict=True):
            self.silences_s[name].clear()
            way.worst_again = 0

    def end_of(self, way: str) -> Any:
        """Return the end that receives a direction."""
        return (self.slave if way == "forward" else self.master).end

    def said_of(self, way: str) -> list[Any]:
        """Return the reports of the end that receives a direction."""
        side = self.slave if way == "forward" else self.master
        return [message for topic, message in side.outlet.sent if topic == "link/network"]

    def longest_s(self, name: str) -> float:
        """Return the longest silence of an end, the one that lasts included [s]."""
        lasting = (self.master.clock.monotonic_ns() - self._newest_ns.get(name, self.begin_ns)) * 1e-9
        return max([silence_s for _, silence_s in self.silences_s[name]] + [lasting])

    def close(self) -> None:
        for side in (self.master, self.slave):
            side.end.close()
            side.real_socket.close()
        self._context.term()


def _free_port() -> int:
    from telenano.testing import free_ports

    return free_ports(1)[0]
