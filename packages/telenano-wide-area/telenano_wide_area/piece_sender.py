"""Send the recording of this site to the other one on request, in pieces and at the requested rate (ADR 0075)."""

import contextlib
import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from telenano.recording import SessionFolder
from telenano.wire import Array, RefusedError, Scalar

TOPIC = "recording/piece"
# The parameters of a request for a piece.
FILE = "recording.file"
OFFSET = "recording.offset"
BYTES = "recording.bytes"
RATE = "recording.kbit_per_s"
# The most bytes of a file in a message.
PIECE_BYTES = 1 << 16
# A file is identified by the digest of this number of its first bytes.
HEAD_BYTES = 1024
# The most bytes in a request.
MOST_BYTES = 1 << 24
# The least and greatest rate in a request [kbit/s].
_RATES = (64.0, 1e6)


class PieceSender:
    """Sends one part of one file at a time; a new request replaces the previous one."""

    def __init__(self, folder: Path, publish: Callable[..., Any]) -> None:
        """Prepare to send files of a folder by `publish`."""
        self._folder = folder
        self._publish = publish
        self._file: BinaryIO | None = None
        self._name = self._head = ""
        self._next = self._end = 0
        self._bytes_per_ns = self._allowance = 0.0
        self._ns = 0

    def request(self, parameters: Mapping[str, Scalar], now_ns: int) -> str:
        """Begin to send the requested part of a file; return a sentence about it. RefusedError says what is wrong."""
        name, offset, count = parameters.get(FILE), parameters.get(OFFSET), parameters.get(BYTES)
        rate = parameters.get(RATE)
        unknown = sorted(set(parameters) - {FILE, OFFSET, BYTES, RATE})
        if unknown or type(name) is not str or not SessionFolder.is_part(name):
            here = ", ".join(sorted(path.name for path in self._folder.glob("session*.mcap"))) or "nothing"
            raise RefusedError(f"{', '.join(unknown) or name!r} is not a part of the recording here, which has {here}")
        if type(offset) is not int or offset < 0 or type(count) is not int or not 0 < count <= MOST_BYTES:
            raise RefusedError(f"{OFFSET} and {BYTES} must be whole numbers from 0 and from 1 to {MOST_BYTES}")
        if not isinstance(rate, int | float) or not _RATES[0] <= rate <= _RATES[1]:
            raise RefusedError(f"{RATE} must be a number from {_RATES[0]:g} to {_RATES[1]:g}")
        try:
            with contextlib.ExitStack() as half_open:
                file = half_open.enter_context((self._folder / name).open("rb"))
                head = hashlib.sha256(file.read(HEAD_BYTES)).hexdigest()
                half_open.pop_all()
        except OSError as error:
            raise RefusedError(f"{name} cannot be read: {error.strerror}") from error
        # A command that was refused has left the present transfer as it was.
        self.close()
        self._file, self._head = file, head
        self._name, self._next, self._end = name, offset, offset + count
        self._bytes_per_ns, self._allowance, self._ns = rate * 1e3 / 8.0 * 1e-9, float(PIECE_BYTES), now_ns
        return f"sending {name} from {offset} on"

    def send_due(self, now_ns: int) -> None:
        """Send the pieces that the rate allows by now [ns]."""
        if self._file is None:
            return
        self._allowance += (now_ns - self._ns) * self._bytes_per_ns
        self._ns = now_ns
        while self._file is not None and self._allowance >= min(PIECE_BYTES, self._end - self._next):
            self._send(self._file)

    def close(self) -> None:
        """End the present transfer."""
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _send(self, file: BinaryIO) -> None:
        try:
            size = file.seek(0, 2)
            file.seek(self._next)
            data = file.read(min(PIECE_BYTES, self._end - self._next))
        except OSError:
            # The other site asks again, and is then refused with the reason.
            self.close()
            return
        self._publish(
            TOPIC,
            file=self._name,
            size_bytes=size,
            head_sha256=self._head,
            offset_bytes=self._next,
            sha256=hashlib.sha256(data).hexdigest(),
            data=Array.from_numpy(np.frombuffer(data, dtype="u1")),
        )
        self._next += len(data)
        self._allowance -= len(data)
        if not data or self._next >= min(self._end, size):
            self.close()
