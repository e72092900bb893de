"""The datagrams of a page between gateway and rig: the force of its hand one way, what is felt the other.

Each is sealed with the keys that gateway and rig share, and bound to its way and to the connection of the page, whose
number precedes it. What a datagram has is a frame of the page, which has a number of its own: the newest counts.
"""

from telenano.runtime import KeyPair
from telenano_wide_area.relay.protocol import SharedKeys
from telenano_wide_area.sealed import RejectedError

# The context from which the keys of the datagrams are derived.
TO_GATEWAY = b"telenano page behind a gateway, version 1"
NUMBER_BYTES = 8
# The largest frame in a datagram [bytes]; a frame of the hand or of what is felt has less than a half of it.
MOST_FRAME_BYTES = 512
# The beginnings of the frames that cross by datagrams: maps of msgpack whose first key is their kind.
_KEY = b"\xa1k"
HAND, PROBE, FELT = b"\xa4hand", b"\xa5probe", b"\xa4felt"


def is_of(frame: bytes, *kinds: bytes) -> bool:
    """Return whether a frame is small enough for a datagram and of one of these kinds, by its beginning."""
    return len(frame) <= MOST_FRAME_BYTES and frame[1:3] == _KEY and any(frame[3:].startswith(kind) for kind in kinds)


class PageDatagrams:
    """Seals and opens the datagrams between a gateway and one rig, at either of them."""

    def __init__(self, own: KeyPair, peer_public: bytes, *, is_gateway: bool) -> None:
        """Derive the keys; ValueError for a public key of 32 bytes that gives no shared secret."""
        self._keys = SharedKeys(own, peer_public, TO_GATEWAY)
        self._out, self._in = (b"down", b"up") if is_gateway else (b"up", b"down")

    def seal(self, number: bytes, frame: bytes) -> bytes:
        """Return the datagram of a frame of the page with this number."""
        return number + self._keys.seal(frame, self._out + number)

    def open(self, datagram: bytes) -> tuple[bytes, bytes]:
        """Return number and frame of a datagram; RejectedError for one that the other end did not send."""
        number, sealed = datagram[:NUMBER_BYTES], datagram[NUMBER_BYTES:]
        if len(number) < NUMBER_BYTES:
            raise RejectedError("malformed")
        return number, self._keys.open(sealed, self._in + number)
