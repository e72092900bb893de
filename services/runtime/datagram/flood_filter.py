"""A filter in the kernel that drops what does not begin with a known tag: a flood of it costs the process nothing."""

import socket
import struct
from collections.abc import Sequence

from services.runtime.security.accept_limiter import DROP, JUMP_IF_EQUAL, LOAD_WORD, PASS, RETURN, Instruction, attach

# This field of struct sk_meminfo counts the datagrams that the socket's filter or its full buffer dropped.
_SO_MEMINFO, _DROPS_PLACE, _MEMINFO_WORDS = 55, 8, 9
# the filter of a UDP socket begins at the UDP header
_UDP_HEADER_BYTES = 8


def admit(sock: socket.socket, tags: Sequence[bytes]) -> None:
    """Let only datagrams whose first four bytes are one of `tags` reach a socket; OSError where the kernel refuses."""
    program = [Instruction(LOAD_WORD, 0, 0, _UDP_HEADER_BYTES)]
    for tag in tags:
        program += [Instruction(JUMP_IF_EQUAL, 0, 1, int.from_bytes(tag, "big")), Instruction(RETURN, 0, 0, PASS)]
    attach(sock, [*program, Instruction(RETURN, 0, 0, DROP)])


def dropped(sock: socket.socket) -> int:
    """Return how many datagrams the kernel has dropped at a socket: by its filter, or because nobody took them."""
    found = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 4 * _MEMINFO_WORDS)
    return int(struct.unpack(f"={len(found) // 4}I", found)[_DROPS_PLACE]) if len(found) >= 4 * _MEMINFO_WORDS else 0
