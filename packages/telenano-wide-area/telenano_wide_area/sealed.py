"""The exception for sealed data from another machine that is refused."""


class RejectedError(Exception):
    """A datagram or frame was refused; `cause` is the word under which refusals are counted."""

    def __init__(self, cause: str) -> None:
        super().__init__(cause)
        self.cause = cause
