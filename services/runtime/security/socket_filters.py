"""Filters of the kernel in front of sockets: what they drop costs a process nothing.

One limits how many connections an endpoint accepts; another drops datagrams that do not begin with a known tag.

To accept a connection and to fail its handshake takes this process up to a millisecond, half of it in the thread that
moves its messages. libzmq accepts whatever comes. So where connections come too fast, a socket filter on the listening
socket drops the packets that ask for one (SYN), as a firewall would. The other side tries again after a second.
"""

import contextlib
import ctypes
import ipaddress
import socket
import struct
from collections.abc import Collection, Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

# connections accepted at once, and a second: a site that comes back makes a handful
BURST, PER_S = 20.0, 10.0

_SO_ATTACH_FILTER, _SO_DETACH_FILTER = 26, 27
# The instructions of classic BPF: load a byte or a word, shift right, jump if a bit is set or if equal, return.
_LOAD_BYTE, _LOAD_WORD, _SHIFT_RIGHT, _JUMP_IF_SET, _JUMP_IF_EQUAL, _RETURN = 0x30, 0x20, 0x74, 0x45, 0x15, 0x06
# offsets: flags in the TCP header, which a filter begins at; SKF_NET_OFF, by which it reaches the IP header
_TCP_FLAGS, _SYN, _IP_HEADER = 13, 0x02, 0xFFF00000
_IPV4_SOURCE, _IPV6_SOURCE = _IP_HEADER + 12, _IP_HEADER + 8
_PASS, _DROP = 0x40000, 0
# This field of struct sk_meminfo counts the datagrams that the socket's filter or its full buffer dropped.
_SO_MEMINFO, _DROPS_PLACE, _MEMINFO_WORDS = 55, 8, 9
# the filter of a UDP socket begins at the UDP header
_UDP_HEADER_BYTES = 8
# a jump of a filter spans 255 instructions
_MOST_ADDRESSES = 20


class Admission(IntEnum):
    """Whose connections are accepted."""

    EVERYBODY = 0
    KNOWN_MACHINES = 1
    NOBODY = 2


class Instruction(NamedTuple):
    """An instruction of a socket filter: `struct sock_filter`."""

    code: int
    if_true: int
    if_false: int
    value: int


class AcceptLimiter:
    """The limit of one endpoint: a token bucket for everybody, then another one for the machines of the site file."""

    def __init__(self, known_addresses: Collection[str], now_ns: int) -> None:
        self.admission = Admission.EVERYBODY
        self._addresses = sorted(known_addresses)[:_MOST_ADDRESSES]
        # connections that may be accepted now: in all, and of known machines when there are none left in all
        self._everybody = self._known = BURST
        self._at_ns = now_ns
        self._listener: socket.socket | None = None

    @property
    def calm(self) -> bool:
        """Whether connections have come slowly for so long that a burst would be accepted again."""
        return min(self._everybody, self._known) >= BURST

    def watch(self, descriptor: int, port: int) -> None:
        """Limit the listening socket of a port, which its owner may have closed meanwhile."""
        self.close()
        with contextlib.suppress(OSError):
            found = socket.fromfd(descriptor, socket.AF_INET, socket.SOCK_STREAM)
            listens = found.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
            if not (listens and found.getsockname()[1] == port):
                found.close()
                return
            self._listener, self.admission = found, Admission.EVERYBODY

    def count(self, accepted: int, now_ns: int) -> None:
        """Count connections accepted since the last call, and change who is admitted; OSError where that is refused."""
        refill = (now_ns - self._at_ns) * 1e-9 * PER_S
        self._at_ns = now_ns
        # Connections that were under way when it closed still come in, and are paid for before it opens again.
        self._everybody = _bounded(self._everybody - accepted + refill)
        self._known += refill if self.admission is Admission.EVERYBODY else refill - accepted
        self._known = _bounded(self._known)
        if self._everybody >= 1.0:
            wanted = Admission.EVERYBODY
        elif self._known >= 1.0:
            wanted = Admission.KNOWN_MACHINES
        else:
            wanted = Admission.NOBODY
        if wanted != self.admission and self._listener is not None:
            self._admit(wanted, self._listener)

    def close(self) -> None:
        """Let go of the listening socket; its port is free once its owner has closed it too."""
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def _admit(self, wanted: Admission, listener: socket.socket) -> None:
        if wanted is Admission.EVERYBODY:
            listener.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)
            self.admission = wanted
            return
        attach(listener, list(syn_filter(self._addresses if wanted is Admission.KNOWN_MACHINES else ())))
        self.admission = wanted


def attach(sock: socket.socket, program: Sequence[Instruction]) -> None:
    """Put a filter in front of a socket, in the place of any before; OSError where the kernel refuses."""
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *instruction) for instruction in program))
    sock.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HP", len(program), ctypes.addressof(code)))


def admit_tags(sock: socket.socket, tags: Sequence[bytes]) -> None:
    """Let only datagrams whose first four bytes are one of `tags` reach a socket; OSError where the kernel refuses."""
    program = [Instruction(_LOAD_WORD, 0, 0, _UDP_HEADER_BYTES)]
    for tag in tags:
        program += [Instruction(_JUMP_IF_EQUAL, 0, 1, int.from_bytes(tag, "big")), Instruction(_RETURN, 0, 0, _PASS)]
    attach(sock, [*program, Instruction(_RETURN, 0, 0, _DROP)])


def dropped_datagrams(sock: socket.socket) -> int:
    """Return how many datagrams the kernel has dropped at a socket: by its filter, or because nobody took them."""
    found = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 4 * _MEMINFO_WORDS)
    return int(struct.unpack(f"={len(found) // 4}I", found)[_DROPS_PLACE]) if len(found) >= 4 * _MEMINFO_WORDS else 0


def _bounded(tokens: float) -> float:
    return max(-BURST, min(BURST, tokens))


def syn_filter(addresses: Sequence[str]) -> Iterator[Instruction]:
    """Yield a socket filter that drops requests for connections, but for those from some addresses.

    Connections that are accepted while it is in place have it too, so it lets everything else pass.
    """
    parsed = [ipaddress.ip_address(address) for address in addresses]
    words = [struct.unpack(f"!{len(address.packed) // 4}I", address.packed) for address in parsed]
    yield Instruction(_LOAD_BYTE, 0, 0, _TCP_FLAGS)
    yield Instruction(_JUMP_IF_SET, 1, 0, _SYN)
    yield Instruction(_RETURN, 0, 0, _PASS)
    for version, length, source in ((4, 1, _IPV4_SOURCE), (6, 4, _IPV6_SOURCE)):
        block = [step for address in words if len(address) == length for step in _passes(address, source)]
        yield Instruction(_LOAD_BYTE, 0, 0, _IP_HEADER)
        yield Instruction(_SHIFT_RIGHT, 0, 0, 4)
        yield Instruction(_JUMP_IF_EQUAL, 0, len(block), version)
        yield from block
    yield Instruction(_RETURN, 0, 0, _DROP)


def _passes(address: Sequence[int], source: int) -> Iterator[Instruction]:
    """Yield instructions that let a packet from an address pass, and go on behind them with any other."""
    for place, word in enumerate(address):
        yield Instruction(_LOAD_WORD, 0, 0, source + 4 * place)
        yield Instruction(_JUMP_IF_EQUAL, 0, 2 * (len(address) - 1 - place) + 1, word)
    yield Instruction(_RETURN, 0, 0, _PASS)
