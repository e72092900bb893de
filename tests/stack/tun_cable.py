"""A cable in user space between two network namespaces: each IP packet is delayed and dropped by itself, from a seed.

    python tests/stack/tun_cable.py NAMESPACE_A ADDRESS_A NAMESPACE_B ADDRESS_B [--delay-s S] [--loss P] [--seed N]

Each end is a TUN device `wan0` with its address (`10.78.0.1/24`, or IPv6), in a namespace that exists. A line of JSON
on standard input changes what holds from then on, such as `{"delay_s": 0.05, "block_udp_there": true}`; the
answer on standard output is a line with the packets taken, delivered and dropped so far, how late the cable was itself,
and what it did as an attacker. It needs root.

The kernel's own tools are not everywhere: `netem` is a module that many kernels lack. What is delayed by a constant
stays in order, so a loss is all that TCP has to bear, and a datagram never waits for another.

A process that carries packets needs a processor, and may get one too late. What it handed over late, and when it was
held up, is in every answer: a measurement over a cable that was late says nothing about the network.

With `rate_bit_per_s` it has a bottleneck each way: packets wait for it in a queue of `queue_bytes`, beyond which they
are dropped. With `fair` each flow (protocol and ports) has a queue of its own, and they are served by turns, byte for
byte.

With `jitter_s` the delay of each packet is drawn evenly from so much less to so much more; with `in_order` no packet is
delivered before one that was sent earlier. With `burst` losses come in runs of so many packets on the mean (Gilbert).

With `tamper` it is the attacker on the line as well: of that share of the datagrams it delivers, by turns, a second
copy, a changed one, a cut one, one that is too long, and one that begins with no known key, all from the sender's
address; or it holds the genuine one back until others have overtaken it. With `flip_tcp` it alters one bit of the data
in that share of the packets of TCP, and makes the checksum right, as a bad middlebox may.
"""

import argparse
import contextlib
import ctypes
import fcntl
import heapq
import itertools
import json
import os
import random
import select
import struct
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_CLONE_NEWNET = 0x40000000
DEVICE = "wan0"
_TCP, _UDP = 6, 17
_PRIORITY = 70
_NS = 1_000_000_000
# handed over later than this after its time, a packet is late; held up for longer than this, the cable is
LATE_NS, HELD_UP_NS = 1_000_000, 2_000_000
# while packets flow it looks this often, so that a time in which it got no processor shows whatever it waited for
_LOOK_NS, _FLOWING_NS = 1_000_000, 100_000_000
_MOST_TOLD = 1000
# of what the attacker does: behind so many milliseconds of others, and longer than any datagram of the link
_BEHIND_NS, _OVERSIZED_BYTES = 5_000_000, 1201


@dataclass
class Impairment:
    """What holds for each packet from now on, in both directions."""

    delay_s: float = 0.0
    loss: float = 0.0
    # What is sent from the first end and from the second.
    block_udp_there: bool = False
    block_udp_back: bool = False
    cut: bool = False
    tamper: float = 0.0
    flip_tcp: float = 0.0
    rate_bit_per_s: float = 0.0
    queue_bytes: int = 64_000
    fair: bool = False
    jitter_s: float = 0.0
    in_order: bool = False
    burst: float = 1.0


class Bottleneck:
    """A line of a rate in one direction, with a queue before it."""

    def __init__(self) -> None:
        self._queues: dict[bytes, deque[bytes]] = {}
        self._waiting_bytes: dict[bytes, int] = {}
        # What each flow has had, what the one that was served last had, and when the packet on the line has left it.
        self._served: dict[bytes, int] = {}
        self._turn = self._free_ns = 0

    def offer(self, packet: bytes, now_ns: int, rules: Impairment) -> bool:
        """Queue a packet; return whether there was room."""
        flow = flow_of(packet) if rules.fair else b""
        waiting = self._waiting_bytes.get(flow, 0)
        if waiting + len(packet) > rules.queue_bytes:
            return False
        if not waiting:
            # who comes back has saved up nothing
            self._served[flow] = max(self._served.get(flow, 0), self._turn)
        if not self._queues:
            self._free_ns = max(self._free_ns, now_ns)
        self._queues.setdefault(flow, deque()).append(packet)
        self._waiting_bytes[flow] = waiting + len(packet)
        return True

    def next_ns(self) -> int | None:
        """Return when the next packet gets onto the line; None where none waits."""
        return self._free_ns if self._queues else None

    def take(self, now_ns: int, rules: Impairment) -> Iterator[tuple[int, bytes]]:
        """Yield the packets that have got onto the line by now, each with the time at which it has left it."""
        while self._queues and self._free_ns <= now_ns:
            flow = min(self._queues, key=lambda key: self._served.get(key, 0))
            packet = self._queues[flow].popleft()
            self._waiting_bytes[flow] -= len(packet)
            self._turn = self._served.get(flow, 0)
            self._served[flow] = self._turn + len(packet)
            if not self._queues[flow]:
                del self._queues[flow]
            self._free_ns += round(len(packet) * 8e9 / rules.rate_bit_per_s) if rules.rate_bit_per_s else 0
            yield self._free_ns, packet


@dataclass
class Counts:
    """Packets since the start, both directions.

    late: handed over more than LATE_NS after their time; held_up: when the cable got no processor for more than
    HELD_UP_NS, and for how long [ns of the epoch, ms]; cpu_s: processor time used [s]; attacks: what was done to those
    for each end, by what its reader should call it.
    """

    taken: int = 0
    delivered: int = 0
    dropped: int = 0
    late: int = 0
    cpu_s: float = 0.0
    bytes_taken: list[int] = field(default_factory=lambda: [0, 0])
    held_up: list[tuple[int, float]] = field(default_factory=list)
    attacks: list[dict[str, int]] = field(default_factory=lambda: [{}, {}])


def open_end(namespace: str, address: str) -> int:
    """Return the descriptor of a TUN device made in a namespace, with an address there."""
    libc = ctypes.CDLL(None, use_errno=True)
    with Path("/proc/self/ns/net").open() as own, Path(f"/run/netns/{namespace}").open() as there:
        if libc.setns(there.fileno(), _CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), f"the namespace {namespace} cannot be entered")
        try:
            end = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(end, _TUNSETIFF, struct.pack("16sH22x", DEVICE.encode(), _IFF_TUN | _IFF_NO_PI))
        finally:
            libc.setns(own.fileno(), _CLONE_NEWNET)
    for command in (
        ["addr", "add", address, "dev", DEVICE],
        ["link", "set", DEVICE, "up"],
        ["link", "set", "lo", "up"],
    ):
        nodad = ["nodad"] if command[0] == "addr" and ":" in address else []
        subprocess.run(["ip", "-n", namespace, *command, *nodad], check=True)
    return end


def is_udp(packet: bytes) -> bool:
    """Return whether an IPv4 packet, or an IPv6 packet without extension headers, is a datagram of UDP."""
    return packet[9] == _UDP if packet[0] >> 4 == 4 else packet[6] == _UDP


def flow_of(packet: bytes) -> bytes:
    """Return what tells the flow of an IPv4 packet from others: protocol and ports."""
    head = (packet[0] & 0x0F) * 4
    return packet[9:10] + packet[head : head + 4]


def with_payload(packet: bytes, payload: bytes) -> bytes:
    """Return an IPv4 packet of UDP with another payload, checksums made anew; without one for UDP, as IPv4 permits."""
    head = (packet[0] & 0x0F) * 4
    header = bytearray(packet[:head])
    header[2:4] = (head + 8 + len(payload)).to_bytes(2, "big")
    header[10:12] = bytes(2)
    total = sum(struct.unpack(f"!{head // 2}H", header))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    header[10:12] = (~total & 0xFFFF).to_bytes(2, "big")
    ports = packet[head : head + 4]
    return bytes(header) + ports + (8 + len(payload)).to_bytes(2, "big") + bytes(2) + payload


def with_flipped_bit(packet: bytes, draw: random.Random) -> bytes:
    """Return an IPv4 packet of TCP with one bit of its data altered and the checksum made right (RFC 1624)."""
    head = (packet[0] & 0x0F) * 4
    data = head + (packet[head + 12] >> 4) * 4
    if len(packet) <= data:
        return packet
    changed, at = bytearray(packet), draw.randrange(data, len(packet))
    word = at - (at - head) % 2

    def value(of: bytes | bytearray) -> int:
        return int.from_bytes(bytes(of[word : word + 2]).ljust(2, b"\0"), "big")

    changed[at] ^= 1 << draw.randrange(8)
    total = (
        (~int.from_bytes(packet[head + 16 : head + 18], "big") & 0xFFFF) + (~value(packet) & 0xFFFF) + value(changed)
    )
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    changed[head + 16 : head + 18] = (~total & 0xFFFF).to_bytes(2, "big")
    return bytes(changed)


def payload_of(packet: bytes) -> bytes:
    """Return the payload of an IPv4 packet of UDP."""
    return packet[(packet[0] & 0x0F) * 4 + 8 :]


# what a reader should call it, and what becomes of the payload; the genuine datagram is delivered as well
ATTACKS: dict[str, Callable[[bytes], bytes]] = {
    "replayed": lambda payload: payload,
    "forged": lambda payload: payload[:-1] + bytes((payload[-1] ^ 1,)),
    "truncated": lambda payload: payload[:20],
    "oversized": lambda payload: payload.ljust(_OVERSIZED_BYTES, b"\0"),
    "unknown_key": lambda payload: bytes(byte ^ 0xFF for byte in payload[:4]) + payload[4:],
}
REORDERED = "reordered"


class Cable:
    """Both ends, and what is under way between them."""

    def __init__(self, ends: tuple[int, int], impairment: Impairment, seed: int) -> None:
        self.impairment = impairment
        self.counts = Counts()
        self._ends = ends
        self._draws = (random.Random(f"{seed} there"), random.Random(f"{seed} back"))
        self._attacks = tuple(random.Random(f"{seed} attacks {place}") for place in range(2))
        self._jitter = tuple(random.Random(f"{seed} jitter {place}") for place in range(2))
        self._flips = tuple(random.Random(f"{seed} flips {place}") for place in range(2))
        self._losing, self._latest_ns = [False, False], [0, 0]
        self._by_turns = tuple(itertools.cycle([*ATTACKS, REORDERED]) for _ in range(2))
        self._under_way: list[tuple[int, int, int, bytes]] = []
        self._order = itertools.count()
        self._bottlenecks = (Bottleneck(), Bottleneck())

    def run(self) -> None:
        """Carry packets until standard input ends."""
        flowed_ns = time.monotonic_ns()
        while True:
            now = time.monotonic_ns()
            due_ns = self._under_way[0][0] if self._under_way else now + _NS
            for bottleneck in self._bottlenecks:
                due_ns = min(due_ns, bottleneck.next_ns() or due_ns)
            until_ns = min(due_ns, now + (_LOOK_NS if now - flowed_ns < _FLOWING_NS else _NS))
            # slept and not spun: at real-time priority that would take a processor from the rig
            ready, _, _ = select.select([*self._ends, 0], [], [], max(0, until_ns - now) * 1e-9)
            if 0 in ready and not self._obey():
                return
            taken = self.counts.taken
            for place, end in enumerate(self._ends):
                if end in ready:
                    self._take(place, end)
            for place, bottleneck in enumerate(self._bottlenecks):
                for left_ns, packet in bottleneck.take(time.monotonic_ns(), self.impairment):
                    self._send(place, packet, left_ns + round(self.impairment.delay_s * 1e9))
            self._deliver()
            awake_ns = time.monotonic_ns()
            if taken != self.counts.taken:
                flowed_ns = awake_ns
            held_up_ns = awake_ns - max(until_ns, now)
            if held_up_ns > HELD_UP_NS and len(self.counts.held_up) < _MOST_TOLD:
                self.counts.held_up.append((time.time_ns(), held_up_ns * 1e-6))

    def _obey(self) -> bool:
        """Change what the line on standard input says, and answer; False when there is none any more."""
        line = sys.stdin.readline()
        if not line:
            return False
        for key, value in json.loads(line).items():
            setattr(self.impairment, key, value)
        self.counts.cpu_s = time.process_time()
        _say(json.dumps(vars(self.counts)))
        return True

    def _take(self, place: int, end: int) -> None:
        for _ in range(64):
            try:
                packet = os.read(end, 65535)
            except BlockingIOError:
                return
            now = time.monotonic_ns()
            counts, rules = self.counts, self.impairment
            counts.taken += 1
            counts.bytes_taken[place] += len(packet)
            # drawn for every packet, so that a change of one rule does not change the draws of the others
            lost = self._is_lost(place)
            if self._flips[place].random() < rules.flip_tcp and packet[0] >> 4 == 4 and packet[9] == _TCP:
                packet = with_flipped_bit(packet, self._flips[place])
                counts.attacks[1 - place]["flipped"] = counts.attacks[1 - place].get("flipped", 0) + 1
            blocked = rules.block_udp_back if place else rules.block_udp_there
            if lost or rules.cut or (blocked and is_udp(packet)):
                counts.dropped += 1
                continue
            if rules.rate_bit_per_s:
                counts.dropped += not self._bottlenecks[place].offer(packet, now, rules)
                continue
            due_ns = now + round(rules.delay_s * 1e9)
            if rules.tamper and packet[0] >> 4 == 4 and is_udp(packet):
                due_ns += self._tamper(place, packet, due_ns)
            self._send(place, packet, due_ns)

    def _is_lost(self, place: int) -> bool:
        draw, rules = self._draws[place].random(), self.impairment
        if rules.burst <= 1.0:
            return draw < rules.loss
        # A run of losses ends with the first chance, and begins with the one that gives the share of losses.
        ends = 1.0 / rules.burst
        begins = min(1.0, ends * rules.loss / (1.0 - rules.loss))
        self._losing[place] = draw >= ends if self._losing[place] else draw < begins
        return self._losing[place]

    def _send(self, place: int, packet: bytes, due_ns: int) -> None:
        rules = self.impairment
        if rules.jitter_s:
            due_ns += round(self._jitter[place].uniform(-rules.jitter_s, rules.jitter_s) * 1e9)
        if rules.in_order:
            due_ns = self._latest_ns[place] = max(due_ns, self._latest_ns[place])
        heapq.heappush(self._under_way, (due_ns, next(self._order), 1 - place, packet))

    def _tamper(self, place: int, packet: bytes, due_ns: int) -> int:
        """Attack with a datagram, perhaps; return by how much the genuine one is held back [ns]."""
        if self._attacks[place].random() >= self.impairment.tamper:
            return 0
        attack, done = next(self._by_turns[place]), self.counts.attacks[1 - place]
        done[attack] = done.get(attack, 0) + 1
        if attack == REORDERED:
            return _BEHIND_NS
        # a copy is one once the genuine datagram has arrived
        later_ns = _BEHIND_NS if attack == "replayed" else 0
        self._send(place, with_payload(packet, ATTACKS[attack](payload_of(packet))), due_ns + later_ns)
        return 0

    def _deliver(self) -> None:
        while self._under_way and self._under_way[0][0] <= time.monotonic_ns():
            due_ns, _, place, packet = heapq.heappop(self._under_way)
            # with no delay at all it is due at the moment at which it was taken
            self.counts.late += time.monotonic_ns() - due_ns > LATE_NS
            try:
                os.write(self._ends[place], packet)
                self.counts.delivered += 1
            except OSError:
                self.counts.dropped += 1


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main() -> None:
    """Open both ends, say so, and carry packets."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    for name in ("namespace_a", "address_a", "namespace_b", "address_b"):
        parser.add_argument(name)
    parser.add_argument("--delay-s", type=float, default=0.0, help="delay each way [s]")
    parser.add_argument("--loss", type=float, default=0.0, help="share of the packets that is dropped, each way")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    # before the nodes of a rig: a network does not wait for a processor
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    ends = (open_end(given.namespace_a, given.address_a), open_end(given.namespace_b, given.address_b))
    _say("ready")
    Cable(ends, Impairment(given.delay_s, given.loss), given.seed).run()


if __name__ == "__main__":
    main()
