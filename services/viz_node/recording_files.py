"""The files of a recording for operators to download, as far as they are written, by addresses that are valid once.

A page names a file of the list that it was given. No path comes from a page or from the bus, so none leads elsewhere.
"""

import asyncio
import os
import re
import secrets
import stat
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from urllib.parse import quote

from services.viz_node.page_session import Session
from services.viz_node.page_threads import in_thread
from telenano.recording.mcap_scan import MAGIC
from telenano.wire.errors import RefusedError

# Validity of an address [s], and most of them at once; a further one replaces the oldest.
VALID_S = 60.0
_MOST_TICKETS = 16
_TICKET_BYTES = 24
# Most simultaneous downloads, and most simultaneous requests for the list, each of which takes a thread.
MOST_DOWNLOADS = 2
_MOST_LISTS = 4
# Size of the pieces of a download [bytes], and the rest after each, in which the pages get their frames [s]: 50 MB/s.
PIECE_BYTES = 1 << 18
_REST_S = 0.005
# Longest wait for a browser that takes nothing of its download [s].
STALLED_S = 30.0
ELSEWHERE = (
    "The file is where the recorder runs, and this server has no access to it: "
    "`telenano session set record.status=true --target recorder` says where it is. "
    "Copy it from that machine, from a container with `docker cp`; "
    "the part of the far site comes with `telenano bag fetch FOLDER`"
)


class OpenFile(NamedTuple):
    """A recording that was opened: its file, its size [bytes], and whether the recorder has finished it."""

    file: BinaryIO
    size_bytes: int
    is_finished: bool

    def name(self, path: Path) -> str:
        """Return the name for a copy, which says whether it ends where the recorder was just writing."""
        return path.name if self.is_finished else f"{path.stem}.unfinished{path.suffix}"


class _Ticket(NamedTuple):
    path: Path
    session: Session
    due_s: float


class RecordingFiles:
    """Lists the files of a recording, and opens one for each address that it gave."""

    def __init__(self, find: Callable[[], Sequence[Path]] = tuple, clock: Callable[[], float] = time.monotonic) -> None:
        """Prepare to offer the files that `find` returns, from the oldest to the newest; by default none."""
        self._find = find
        self._clock = clock
        self._lists = 0
        self._tickets: dict[str, _Ticket] = {}

    @classmethod
    def of_recorder(cls, directory: Path | None, file_name: str) -> "RecordingFiles":
        """Return the files that a recorder writes under a name in a folder; none if the folder is unknown (None)."""
        if directory is None or not directory.is_absolute():
            return cls()
        stem, suffix = Path(file_name).stem, Path(file_name).suffix
        pattern = re.compile(rf"{re.escape(stem)}(?:_([0-9]{{1,9}}))?{re.escape(suffix)}")

        def find() -> list[Path]:
            try:
                names = [path.name for path in directory.iterdir()]
            except OSError:
                return []
            numbers = {name: int(found[1] or 0) for name in names if (found := pattern.fullmatch(name))}
            return [directory / name for name in sorted(numbers, key=numbers.__getitem__)]

        return cls(find)

    @classmethod
    def of_paths(cls, paths: Sequence[Path]) -> "RecordingFiles":
        """Return the files that the owner of the page has named, with symbolic links followed now."""
        resolved = [path.resolve() for path in paths]
        return cls(lambda: resolved)

    async def answer(self, session: Session, name: str) -> Mapping[str, Any]:
        """Return the list of the files if `name` is empty, else an address for the file of this name.

        Raises RefusedError if there is no such file, it cannot be read, or too many lists are being made.
        """
        if self._lists >= _MOST_LISTS:
            raise RefusedError("the files are already being listed: try again in a moment")
        self._lists += 1
        try:
            if not name:
                return await asyncio.wrap_future(in_thread(self._list))
            path = await asyncio.wrap_future(in_thread(partial(self._path_of, name)))
        finally:
            self._lists -= 1
        return {"address": f"recording/{self._ticket(path, session)}"}

    def redeem(self, ticket: str, is_there: Callable[[Session], bool]) -> tuple[Path, Session] | None:
        """Return the file of an address and the page that asked for it; None if it is no longer valid, or never was.

        An address is valid once, for `VALID_S`, and while its page is there.
        """
        found = self._tickets.pop(ticket, None)
        return (
            (found.path, found.session)
            if found is not None and self._clock() < found.due_s and is_there(found.session)
            else None
        )

    def _list(self) -> Mapping[str, Any]:
        rows: list[dict[str, Any]] = []
        for path in self._find():
            row: dict[str, Any] = {"name": path.name, "size_bytes": 0, "is_finished": False, "why": ""}
            try:
                opened = open_recording(path)
            except RefusedError as error:
                row["why"] = str(error)
            else:
                opened.file.close()
                row |= {"size_bytes": opened.size_bytes, "is_finished": opened.is_finished}
            rows.append(row)
        return {"files": rows, "why": "" if rows else ELSEWHERE}

    def _path_of(self, name: str) -> Path:
        path = next((path for path in self._find() if path.name == name), None)
        if path is None:
            raise RefusedError(f"{name[:80]!r} is not a file of this recording")
        open_recording(path).file.close()
        return path

    def _ticket(self, path: Path, session: Session) -> str:
        now_s, ticket = self._clock(), secrets.token_urlsafe(_TICKET_BYTES)
        kept = [(key, each) for key, each in self._tickets.items() if now_s < each.due_s]
        self._tickets = dict([*kept[1 - _MOST_TICKETS :], (ticket, _Ticket(path, session, now_s + VALID_S))])
        return ticket


def open_recording(path: Path) -> OpenFile:
    """Open a recording at its beginning; raise RefusedError for what is no regular file with the head of one."""
    # A symbolic link is not followed, and a pipe is not waited for.
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        descriptor = os.open(path, flags)
    except OSError as error:
        text = "is a symbolic link, which is not followed" if path.is_symlink() else f"cannot be read: {error.strerror}"
        raise RefusedError(f"{path.name} {text}") from error
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        raise RefusedError(f"{path.name} is no regular file")
    file = os.fdopen(descriptor, "rb", buffering=0)
    try:
        if file.read(len(MAGIC)) != MAGIC:
            raise RefusedError(f"{path.name} is no recording: it does not begin as one")
        file.seek(max(len(MAGIC), status.st_size - len(MAGIC)))
        is_finished = file.read(len(MAGIC)) == MAGIC
        file.seek(0)
    except OSError as error:
        file.close()
        raise RefusedError(f"{path.name} cannot be read: {error.strerror}") from error
    except RefusedError:
        file.close()
        raise
    return OpenFile(file, status.st_size, is_finished)


class Download:
    """The response that sends a recording in pieces, up to the size that it had when it was opened."""

    def __init__(self, opened: OpenFile, name: str, may_go_on: Callable[[], bool], drop: Callable[[], None]) -> None:
        """Prepare to send an opened file under a name.

        Args:
            opened: The file, which is closed at the end.
            name: The name under which the browser saves it.
            may_go_on: Whether the person may still have it, which is asked before each piece.
            drop: Drops the connection, so that a download that was broken off does not look complete.
        """
        self._opened, self._may_go_on, self._drop = opened, may_go_on, drop
        self._headers = [
            (b"content-type", b"application/octet-stream"),
            (b"content-length", str(opened.size_bytes).encode()),
            (b"content-disposition", f"attachment; filename*=UTF-8''{quote(name, safe='')}".encode()),
            (b"accept-ranges", b"none"),
        ]

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        gone = asyncio.create_task(_disconnected(receive))
        try:
            await send({"type": "http.response.start", "status": 200, "headers": self._headers})
            if await self._send_pieces(send, gone):
                await send({"type": "http.response.body", "body": b"", "more_body": False})
            else:
                self._drop()
                # The web server reports a response that ends early, unless it knows that the connection has ended.
                await asyncio.wait({gone}, timeout=1.0)
        finally:
            gone.cancel()
            self._opened.file.close()

    async def _send_pieces(self, send: Any, gone: "asyncio.Task[None]") -> bool:
        """Send the file; return False if it was cut, the browser has gone or stalls, or the person may not have it."""
        left = self._opened.size_bytes
        while left:
            try:
                piece = await asyncio.wrap_future(in_thread(partial(self._opened.file.read, min(left, PIECE_BYTES))))
                if not piece or gone.done() or not self._may_go_on():
                    return False
                sent = send({"type": "http.response.body", "body": piece, "more_body": True})
                await asyncio.wait_for(sent, STALLED_S)
            except OSError:
                # The file cannot be read further, or the browser stalls: the error of a timeout is one of these.
                return False
            left -= len(piece)
            await asyncio.sleep(_REST_S)
        return True


async def _disconnected(receive: Any) -> None:
    """Wait until the browser has gone."""
    while (await receive())["type"] != "http.disconnect":
        pass
