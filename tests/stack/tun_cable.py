"""A cable in user space between two network namespaces: each IP packet is delayed and dropped by itself, from a seed.

    python tests/stack/tun_cable.py NAMESPACE_A ADDRESS_A NAMESPACE_B ADDRESS_B [--delay-s S] [--loss P] [--seed N]

Each end is a TUN device `wan0` with its address (`10.78.0.1/24`, or IPv6), in a namespace that exists. A line of JSON
on standard input changes what holds from then on, such as `{"delay_s": 0.05, "loss": 0.02, "block_udp": true}`; the
answer on standard output is a line with the packets taken, delivered and dropped so far. It needs root.

The kernel's own tools are not everywhere: `netem` is a module that many kernels lack. What is delayed by a constant
stays in order, so a loss is all that TCP has to bear, and a datagram never waits for another.
"""

import argparse
import contextlib
import ctypes
import fcntl
import heapq
import json
import os
import random
import select
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_CLONE_NEWNET = 0x40000000
DEVICE = "wan0"
_UDP = 17
_PRIORITY = 70


@dataclass
class Impairment:
    """What holds for each packet from now on, in both directions."""

    delay_s: float = 0.0
    loss: float = 0.0
    block_udp: bool = False
    cut: bool = False


@dataclass
class Counts:
    """Packets since the start, both directions."""

    taken: int = 0
    delivered: int = 0
    dropped: int = 0
    bytes_taken: list[int] = field(default_factory=lambda: [0, 0])


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


class Cable:
    """Both ends, and what is under way between them."""

    def __init__(self, ends: tuple[int, int], impairment: Impairment, seed: int) -> None:
        self.impairment = impairment
        self.counts = Counts()
        self._ends = ends
        self._draws = (random.Random(f"{seed} there"), random.Random(f"{seed} back"))
        self._under_way: list[tuple[int, int, int, bytes]] = []

    def run(self) -> None:
        """Carry packets until standard input ends."""
        while True:
            due_ns = self._under_way[0][0] if self._under_way else None
            left_ns = 10**9 if due_ns is None else due_ns - time.monotonic_ns()
            # slept and not spun: at real-time priority that would take a processor from the rig
            wait_s = max(0, left_ns) * 1e-9
            ready, _, _ = select.select([*self._ends, 0], [], [], wait_s)
            for place, end in enumerate(self._ends):
                if end in ready:
                    self._take(place, end)
            self._deliver()
            if 0 in ready:
                line = sys.stdin.readline()
                if not line:
                    return
                for key, value in json.loads(line).items():
                    setattr(self.impairment, key, value)
                _say(json.dumps(vars(self.counts)))

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
            lost = self._draws[place].random() < rules.loss
            if lost or rules.cut or (rules.block_udp and is_udp(packet)):
                counts.dropped += 1
            else:
                heapq.heappush(self._under_way, (now + round(rules.delay_s * 1e9), counts.taken, 1 - place, packet))

    def _deliver(self) -> None:
        while self._under_way and self._under_way[0][0] <= time.monotonic_ns():
            _, _, place, packet = heapq.heappop(self._under_way)
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
