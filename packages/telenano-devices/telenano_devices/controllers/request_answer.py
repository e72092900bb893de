"""Cuts messages out of a stream of bytes, for wires on which each request has one answer, strictly in turn."""

from collections.abc import Callable, Generator

from telenano.wire import TelenanoError

# The largest message. Answers to a loop are short; an image has some megabytes.
LARGEST_BYTES = 64 * 2**20


class WireError(TelenanoError, ValueError):
    """The bytes received are no message of the protocol: the connection has to be made again."""


# Function that returns the length of the first message of a stream [bytes], 0 while it is incomplete; may raise
# WireError.
Cut = Callable[[bytes], int]

# Generator of a driver's requests, each sent when the answer to the previous one has come; None lets a tick pass.
Talk = Generator[bytes | None, bytes, None]


class Incoming:
    """Collects a stream of bytes, and returns its messages.

    Args:
        cut: The function of the protocol that finds the length of a message.
    """

    def __init__(self, cut: Cut) -> None:
        self._cut = cut
        self._bytes = b""

    def add(self, received: bytes) -> None:
        self._bytes += received

    def take(self) -> bytes | None:
        """Return the next whole message, or None while there is none; raise WireError if the bytes are no message."""
        size = self._cut(self._bytes)
        if not size:
            return None
        message, self._bytes = self._bytes[:size], self._bytes[size:]
        return message

    @property
    def pending(self) -> int:
        """Return the number of bytes that wait for the rest of their message."""
        return len(self._bytes)
