"""What came sealed from another machine, and is refused."""


class RejectedError(Exception):
    """A datagram was refused; `cause` is the word that it is counted by."""

    def __init__(self, cause: str) -> None:
        super().__init__(cause)
        self.cause = cause
