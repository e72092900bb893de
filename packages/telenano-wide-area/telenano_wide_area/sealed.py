"""Sealed data from another machine: the greatest size of a datagram, and the exception for what is refused."""

# A size that every network carries in one piece, with the headers of a tunnel.
MOST_BYTES = 1200


class RejectedError(Exception):
    """A datagram or frame was refused; `cause` is the word under which refusals are counted."""

    def __init__(self, cause: str) -> None:
        super().__init__(cause)
        self.cause = cause
