"""A relay and the ends that use it within one process, on a clock that a test advances."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import zmq
from telenano_wide_area.relay.channel import Budget
from telenano_wide_area.relay.forwarder import Forwarder
from telenano_wide_area.relay.path import RelayPath
from telenano_wide_area.relay.protocol import TO_RELAY, TO_SITE, SharedKeys, raw_key
from telenano_wide_area.sealed import RejectedError
from zmq.utils import z85

from telenano.runtime import KeyPair, Keyring

Address = tuple[Any, ...]
STEP_NS = 50_000_000
RELAY_ADDRESS = ("192.0.2.1", 5750)


def key_pair(number: int) -> KeyPair:
    """Return a key pair that is the same in each run."""
    secret = z85.encode(bytes([number]) * 32)
    return KeyPair(zmq.curve_public(secret), secret)


RELAY, MASTER, SLAVE, STRANGER = (key_pair(number) for number in (1, 2, 3, 4))


class End:
    """One end behind a router: the address that others see, and what arrived with no tag of the relay's."""

    def __init__(self, network: "Network", own: KeyPair, peer: KeyPair, address: Address, *, direct: bool) -> None:
        self.address = address
        self.network = network
        self.samples: list[bytes] = []
        self.refused: list[str] = []
        self.arrived_ns = 0
        self.path = RelayPath(
            RELAY_ADDRESS,
            SharedKeys(own, raw_key(RELAY.public), TO_RELAY),
            SharedKeys(own, raw_key(peer.public), TO_SITE),
            raw_key(own.public),
            raw_key(peer.public),
            direct=direct,
        )
        self.path.send = lambda datagram, to: network.carry(self, datagram, to)

    def take(self, datagram: bytes, address: Address) -> None:
        """Take a datagram as an end of the link does."""
        if datagram[:4] != self.path.tag:
            self.samples.append(datagram)
            self.arrived_ns = self.network.now_ns
            return
        try:
            self.path.take(datagram, address)
        except RejectedError as error:
            self.refused.append(error.cause)


class Network:
    """The relay, two ends, and what the routers between them let pass."""

    def __init__(self, *, direct: bool = True, mbit_per_s: float = 50.0) -> None:
        self.now_ns = 10**12
        self.allowed = {raw_key(MASTER.public), raw_key(SLAVE.public)}
        self.lets_pass: Callable[[End, Address], bool] = lambda end, to: True
        self.relay_runs = True
        self.sent: list[tuple[bytes, Address]] = []
        self._budgets: dict[bytes, Budget] = {}
        self._bytes_per_s = mbit_per_s * 125e3
        self.start_relay()
        self.master = End(self, MASTER, SLAVE, ("198.51.100.1", 1001), direct=direct)
        self.slave = End(self, SLAVE, MASTER, ("203.0.113.1", 1002), direct=direct)
        self.ends = (self.master, self.slave)

    def start_relay(self) -> None:
        """Begin with a relay that knows nobody's address."""
        self.forwarder = Forwarder(RELAY, self.allowed.__contains__, self._budget, lambda: self.now_ns * 1e-9)

    def _budget(self, public: bytes) -> Budget:
        return self._budgets.setdefault(public, Budget(self._bytes_per_s, 1e4, self.now_ns * 1e-9))

    def carry(self, end: End, datagram: bytes, to: Address) -> None:
        """Carry a datagram of an end to where it was sent, if that is let pass."""
        self.sent.append((datagram, to))
        if to == RELAY_ADDRESS:
            for found, address in self.forwarder.outgoing(datagram, end.address) if self.relay_runs else ():
                self.arrive(found, RELAY_ADDRESS, address)
        elif self.lets_pass(end, to):
            self.arrive(datagram, end.address, to)

    def arrive(self, datagram: bytes, source: Address, to: Address) -> None:
        for end in self.ends:
            if end.address == to:
                end.take(datagram, source)

    def turn(self, *, send: bool = True) -> None:
        """Go on by 50 ms: both ends look after their way, and send a sample."""
        self.now_ns += STEP_NS
        for end in self.ends:
            end.path.maintain(self.now_ns, self.now_ns - end.arrived_ns)
        for end in self.ends if send else ():
            if end.path.peer is not None:
                self.carry(end, b"\0\0\0\0 sample of " + str(end.address).encode(), end.path.peer)

    def turns(self, count: int) -> None:
        for _ in range(count):
            self.turn()


def ring(folder: Path, name: str) -> Keyring:
    """Return the folder of keys of one machine."""
    return Keyring(folder / f"keys-{name}")
