"""Fetch the recording of the other site piece by piece after a session, and merge it with this site's (ADR 0075)."""

import hashlib
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import zmq

from telenano.recording import Recording, SessionFolder
from telenano.runtime import AddressBook, Command, Participant
from telenano.wire import LINK, EndpointError, RecordingError, RecordingPiece, RigError, Scalar
from telenano_wide_area.piece_sender import BYTES, FILE, HEAD_BYTES, OFFSET, RATE, TOPIC
from telenano_wide_area.relay.site_end import at_relay

SENDER = "launcher@slave"
# The folder within that of a session for the files of the other site.
FOLDER_NAME = "far"
# The rate of a fetch beside a running rig: a fifth of the rate of the loop [kbit/s].
BESIDE_KBIT_PER_S = 1000.0
_WINDOW_BYTES = 1 << 20
_POLL_MS = 50
# The other end is asked again after a silence of this length [ns].
_ASK_AGAIN_NS = 2_000_000_000
# The fetch is given up after a silence of this length [ns].
PATIENCE_NS = 15_000_000_000
# This part of a disk stays free [bytes].
_SPARE_BYTES = 64 << 20

Progress = Callable[[str, int, int], None]


class PartialFile:
    """A file that is being fetched: its content so far is correct, and a piece is checked before it is added."""

    def __init__(self, folder: Path, name: str) -> None:
        """Continue the file that an earlier attempt left, if any; OSError if the folder cannot be written."""
        self.name = name
        self.target = folder / name
        self._part = folder / f"{name}.part"
        folder.mkdir(parents=True, exist_ok=True)
        self._file: BinaryIO = self._part.open("ab+")
        self.offset = self._part.stat().st_size
        self.size: int | None = None

    @property
    def is_whole(self) -> bool:
        """Whether all bytes that the file had at the first request are here."""
        return self.size is not None and self.offset >= self.size

    def add(self, piece: RecordingPiece) -> bool:
        """Add a piece; return whether it is the next one.

        Raises:
            RecordingError: The other site sends a piece that was not requested, or that contradicts itself.
        """
        data = piece.data.to_numpy().tobytes()
        who = f"{piece.src} sends {piece.file!r}"
        if piece.file != self.name:
            raise RecordingError(f"{who} where {self.name} was requested: refused")
        if piece.data.dtype != "u1" or hashlib.sha256(data).hexdigest() != piece.sha256:
            raise RecordingError(f"{who} with a piece at {piece.offset_bytes} that its digest contradicts: refused")
        if piece.offset_bytes + len(data) > piece.size_bytes:
            raise RecordingError(f"{who} with {len(data)} bytes at {piece.offset_bytes} of {piece.size_bytes}: refused")
        if self.size is None:
            self._begin(piece, who)
        elif piece.size_bytes < self.size:
            raise RecordingError(f"{who} as of {piece.size_bytes} bytes after {self.size}: refused")
        if piece.offset_bytes != self.offset or not data:
            return False
        self._file.write(data)
        self._file.flush()
        self.offset += len(data)
        return True

    def finish(self) -> None:
        """Give the file its name; RecordingError if the fetched bytes are no recording."""
        self.close()
        try:
            Recording(self._part)
        except RecordingError:
            self._part.unlink()
            raise
        self._part.replace(self.target)

    def close(self) -> None:
        """Close the file, and keep its content."""
        self._file.close()

    def _begin(self, piece: RecordingPiece, who: str) -> None:
        free = shutil.disk_usage(self._part.parent).free
        needed = piece.size_bytes - self.offset
        if needed > free - _SPARE_BYTES:
            raise RecordingError(f"{who} of {piece.size_bytes} bytes, and {self._part.parent} has room for {free}")
        self._file.seek(0)
        head = self._file.read(HEAD_BYTES)
        if piece.size_bytes < self.offset or (
            len(head) == HEAD_BYTES and hashlib.sha256(head).hexdigest() != piece.head_sha256
        ):
            raise RecordingError(f"{self._part}: is of another recording than {who}: remove it, and fetch again")
        self.size = piece.size_bytes


def fetch(
    book: AddressBook,
    names: Sequence[str],
    folder: Path,
    kbit_per_s: float | None = None,
    progress: Progress = lambda name, done, size: None,
) -> list[Path]:
    """Fetch parts of the other site's recording into a folder, and return them; files that are there already stay.

    Args:
        book: The addresses of the rig.
        names: The names of the parts.
        folder: The folder for them. A part that is not complete ends in `.part`, and a later call continues it.
        kbit_per_s: The greatest rate of the fetch [kbit/s]; None for 1000 beside a running rig, else 50 000.
        progress: Called with the name, the number of bytes that are here, and that of the whole file.

    Raises:
        RecordingError: The other site contradicts itself, has no such file, or sent no recording.
        RigError: The other site does not answer.
        ConfigError: This machine lacks a key that the rig demands.
    """
    absent = [name for name in names if not (folder / name).exists()]
    if absent:
        with _asking(book) as (ask, beside):
            rate = kbit_per_s or (BESIDE_KBIT_PER_S if beside else 50_000.0)
            for name in absent:
                try:
                    part = PartialFile(folder, name)
                except OSError as error:
                    raise RecordingError(f"{folder}: cannot be written: {error.strerror}") from error
                try:
                    _fetch_file(ask, part, rate, progress)
                except OSError as error:
                    raise RecordingError(f"{part.target}: cannot be written: {error.strerror}") from error
                finally:
                    part.close()
                part.finish()
    return [folder / name for name in names]


class _Asking(NamedTuple):
    """The sockets by which the other site is asked."""

    participant: Participant
    publish: Callable[..., Any]
    subscribers: Sequence[Any]


@contextmanager
def _asking(book: AddressBook) -> Iterator[tuple[_Asking, bool]]:
    """Open the sockets, and yield them with whether a rig runs here.

    The link of a running rig carries the commands; else this process takes the link's place. The same holds for this
    site's end at the relay, if there is one: it has ended with the rig, so this process is that end during the fetch.
    """
    for beside in (False, True):
        opened = Participant.at_console(book, "master") if beside else Participant.open(f"{LINK}@slave", book)
        with opened as participant:
            try:
                publisher = participant.bind(participant.key)
            except EndpointError:
                if beside:
                    raise
                continue
            # At the endpoint of the link, a command has the name of the console whose command the link would carry.
            publish = publisher.publish if beside else partial(publisher.publish, src="console@master")
            readers = participant.subscribers({SENDER: ["session/event", TOPIC]})
            with nullcontext() if beside else at_relay(book):
                yield _Asking(participant, publish, readers), beside
            return


def _fetch_file(asking: _Asking, part: PartialFile, rate: float, progress: Progress) -> None:
    clock = asking.participant.clock
    heard_ns = clock.monotonic_ns()
    while not part.is_whole:
        begin, asked_ns = part.offset, clock.monotonic_ns()
        wanted: dict[str, Scalar] = {FILE: part.name, OFFSET: begin, BYTES: _WINDOW_BYTES, RATE: rate}
        command = Command("set", SENDER, (SENDER,), wanted, deadline_ns=_ASK_AGAIN_NS)
        client = asking.participant.command_client([command], asking.publish)
        is_answered = False
        newest_ns = asked_ns
        while part.offset < begin + _WINDOW_BYTES and not part.is_whole:
            is_answered = is_answered or client.advance()
            if client.refusals:
                raise RecordingError(f"{SENDER} refuses: {client.refusals[0].text}")
            now = clock.monotonic_ns()
            if now - newest_ns >= _ASK_AGAIN_NS:
                break
            for message in _received(asking):
                client.on_event(message)
                if isinstance(message, RecordingPiece) and message.src == SENDER:
                    if message.file != part.name and SENDER not in client.answers:
                        # Pieces before the answer to this command belong to the previous one.
                        continue
                    if part.add(message):
                        heard_ns = newest_ns = now
                        progress(part.name, part.offset, part.size or 0)
                    elif part.is_whole:
                        heard_ns = now
        if clock.monotonic_ns() - heard_ns >= PATIENCE_NS:
            raise RigError(
                f"{SENDER} has sent nothing of {part.name} for {PATIENCE_NS * 1e-9:.0f} s, after {part.offset} bytes: "
                "does the slave's site run?"
            )


def _received(asking: _Asking) -> Iterator[Any]:
    zmq.select([reader.socket for reader in asking.subscribers], [], [], _POLL_MS * 1e-3)
    asking.participant.network.process_events()
    for reader in asking.subscribers:
        for received in reader.receive():
            yield received.message


class FetchProgress:
    """Shows the progress of a fetch, one line a second."""

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._next_s = time.monotonic() + 1.0

    def __call__(self, name: str, done: int, size: int) -> None:
        if time.monotonic() >= self._next_s:
            self._next_s += 1.0
            self._show(f"fetching {name} of the slave's site: {done / 1e6:.1f} of {size / 1e6:.1f} MB")


def fetch_and_merge(
    book: AddressBook,
    session: SessionFolder,
    kbit_per_s: float | None,
    show: Callable[[str], None],
    names: Sequence[str] | None = None,
) -> Path:
    """Fetch the other site's recording of a session, merge it with this site's, and return the merged recording.

    Args:
        book: The addresses of the rig.
        session: The folder of the session.
        kbit_per_s: The greatest rate of the fetch [kbit/s]; None for the rate that does no harm.
        show: Called with each line for the user.
        names: The names of the other site's parts; None for those that the folder has noted.

    Raises:
        TelenanoError: As `fetch`, and as the methods of the folder.
    """
    far = session.far() if names is None else names
    show(f"fetching what the slave's site recorded: {', '.join(far)}")
    fetched = fetch(book, far, session.path / FOLDER_NAME, kbit_per_s, FetchProgress(show))
    show("merging the recordings of both sites")
    return session.merge(fetched)
