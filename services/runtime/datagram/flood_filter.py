"""A filter in the kernel that drops what does not begin with a known tag: a flood of it costs the process nothing."""

import ctypes
import socket
import struct
from collections.abc import Sequence

from services.runtime.security.accept_limiter import Instruction

_SO_ATTACH_FILTER, _SO_MEMINFO = 26, 55
# This field of struct sk_meminfo counts the datagrams that the socket's filter or its full buffer dropped.
_DROPS_PLACE, _MEMINFO_WORDS = 8, 9
_LOAD_WORD, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x15, 0x06
# the filter of a UDP socket begins at the UDP header
_UDP_HEADER_BYTES = 8
_PASS, _DROP = 0x40000, 0


def tag_filter(tags: Sequence[bytes]) -> list[Instruction]:
    """Return a socket filter that passes datagrams whose first four bytes are one of `tags`."""
    program = [Instruction(_LOAD_WORD, 0, 0, _UDP_HEADER_BYTES)]
    for tag in tags:
        program += [
            Instruction(_JUMP_IF_EQUAL, 0, 1, int.from_bytes(tag, "big")),
            Instruction(_RETURN, 0, 0, _PASS),
        ]
    return [*program, Instruction(_RETURN, 0, 0, _DROP)]


def admit(sock: socket.socket, tags: Sequence[bytes]) -> None:
    """Let only datagrams with one of `tags` reach a socket; OSError where the kernel refuses."""
    program = tag_filter(tags)
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *instruction) for instruction in program))
    sock.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HP", len(program), ctypes.addressof(code)))


def dropped(sock: socket.socket) -> int:
    """Return how many datagrams the kernel has dropped at a socket: by its filter, or because nobody took them."""
    found = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 4 * _MEMINFO_WORDS)
    return int(struct.unpack(f"={len(found) // 4}I", found)[_DROPS_PLACE]) if len(found) >= 4 * _MEMINFO_WORDS else 0
