"""Wires on which one request has one answer, strictly in turn: how their messages are cut out of a stream of bytes."""

from collections.abc import Callable, Generator

from telenano.wire import TelenanoError

# A message of a controller that a loop asks is short; an image has some megabytes.
LARGEST_BYTES = 64 * 2**20


class WireError(TelenanoError, ValueError):
    """Bytes that are no message of the protocol: the connection has to be made again."""


# Returns the length of the first message of a stream [bytes], 0 while it has not come whole; raises WireError.
Cut = Callable[[bytes], int]

# The requests of a driver, each sent when the answer to the one before is there; None lets a tick pass.
Talk = Generator[bytes | None, bytes, None]


class Incoming:
    """Messages out of a stream of bytes.

    Args:
        cut: The rule of the protocol.
    """

    def __init__(self, cut: Cut) -> None:
        self._cut = cut
        self._bytes = b""

    def add(self, received: bytes) -> None:
        self._bytes += received

    def take(self) -> bytes | None:
        """Return the next whole message, None while there is none; WireError where the bytes are no message."""
        size = self._cut(self._bytes)
        if not size:
            return None
        message, self._bytes = self._bytes[:size], self._bytes[size:]
        return message

    @property
    def pending(self) -> int:
        """Return how many bytes wait for the rest of their message."""
        return len(self._bytes)
