"""The connections of other processes of this machine to the ipc endpoints of this one, within limits.

libzmq accepts every local connection, and it aborts the process if no descriptor is left for one. It also queues the
messages of ten seconds for each reader that stands still, whoever that is. So a loop looks at these connections with
each report: of too many the oldest are closed, and so is one whose reader does not keep up, unless that is a node of
the site file or the process that serves the observers. A reader that goes on connects again by itself.

The system says all of this of an open descriptor, so libzmq is not asked, and no node waits for another one. The module
imports no models, because the fan-out starts with each session.
"""

import contextlib
import os
import socket as sockets
import struct
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from telenano.files.optional_modules import optional_module
from telenano.runtime.bus.local_endpoint import path_of
from telenano.runtime.bus.open_files import listed_descriptors, open_descriptors

# Windows has neither this module nor ipc endpoints.
fcntl = optional_module("fcntl")
# Most connections of one process, and of all together, as at a relay.
MOST_OF_ONE, MOST_IN_ALL = 512, 1024
# As many are kept in any case, for a console and the process that serves the observers.
_LEAST_IN_ALL = 16
# Number of looks in a row at which a connection holds the same bytes, after which its reader counts as standing still.
_STANDING_LOOKS = 4
# Most processes that are reported at once.
_MOST_REPORTED = 64
# Number of bytes sent and not read yet; the constant of Linux that Python does not have.
_SIOCOUTQ = 0x5411


class Accepted(NamedTuple):
    """A connection that this process has accepted: descriptor, inode number, and process of the reader."""

    descriptor: int
    inode: int
    process: int


class Closed(NamedTuple):
    """Connections of a process that were closed: their number, and the reason in words."""

    process: int
    number: int
    reason: str


class LocalReaders:
    """The connections to the ipc endpoints of this process.

    Args:
        holders: Returns the processes for which messages are queued in full: those of the nodes of the site file, and
            the one that serves the observers.
        room: Returns the number of descriptors of this process that are left for connections; None if unlimited.
    """

    def __init__(self, holders: Callable[[], Collection[int]], room: Callable[[], int | None]) -> None:
        self.paths: set[str] = set()
        self._holders, self._room = holders, room
        # Bytes not read on the connection of each stranger, and number of looks since they changed.
        self._standing: dict[Accepted, tuple[int, int]] = {}
        self._open_files = -1
        # The processes that were found to be nodes of the site file: their lock files may be removed under way.
        self._nodes: set[int] = set()
        self._reported: set[tuple[int, str]] = set()

    def add(self, endpoint: str | None) -> None:
        """Also look after the connections to an endpoint; any but an ipc one is ignored."""
        if endpoint is not None and endpoint.startswith("ipc://"):
            self.paths.add(str(path_of(endpoint)))

    def look(self) -> list[Closed]:
        """Close connections beyond the limits, and those whose reader stands still; return what to report of that.

        The connections of nodes of the site file are left alone. The same is reported of a process once.

        Raises:
            OSError: Which processes are nodes of the site file cannot be found out.
        """
        count = open_descriptors() if self.paths else None
        if count is None:
            return []
        closed: list[Closed] = []
        # A connection was made or has ended since the last look.
        if count != self._open_files:
            found = list(accepted(self.paths))
            # A process that has gone, whose number another one may have, is forgotten.
            self._nodes &= {each.process for each in found}
            self._nodes.update(self._holders())
            self._open_files = count
            strangers = [each for each in found if each.process not in self._nodes]
            before = self._standing
            self._standing = {each: before.get(each, (0, 0)) for each in strangers}
            closed = self._close_surplus(strangers)
        closed += self._close_standing()
        news = [each for each in closed if (each.process, each.reason) not in self._reported]
        self._reported.update((each.process, each.reason) for each in news)
        return news[:_MOST_REPORTED]

    def _close_surplus(self, found: Collection[Accepted]) -> list[Closed]:
        room = self._room()
        most = MOST_IN_ALL if room is None else min(MOST_IN_ALL, max(room // 2, _LEAST_IN_ALL))
        by_process: dict[int, list[Accepted]] = {}
        for each in found:
            by_process.setdefault(each.process, []).append(each)
        total, closed = len(found), []
        for process, connections in sorted(by_process.items(), key=lambda item: -len(item[1])):
            surplus = max(len(connections) - MOST_OF_ONE, min(total - most, len(connections) - 1), 0)
            if surplus:
                total -= surplus
                gone = sum(self._close(each) for each in connections[:surplus])
                closed.append(Closed(process, gone, f"of one process {MOST_OF_ONE} are kept, of all {most}"))
        return closed

    def _close_standing(self) -> list[Closed]:
        gone: dict[int, int] = {}
        for each, (before, looks) in list(self._standing.items()):
            waiting = unread(each)
            looks = looks + 1 if waiting and waiting == before else 0
            self._standing[each] = waiting, looks
            if looks >= _STANDING_LOOKS and self._close(each):
                gone[each.process] = gone.get(each.process, 0) + 1
        return [
            Closed(process, count, "their reader does not keep up with what is sent") for process, count in gone.items()
        ]

    def _close(self, connection: Accepted) -> bool:
        self._standing.pop(connection, None)
        with opened(connection.descriptor) as socket:
            if socket is None or os.fstat(connection.descriptor).st_ino != connection.inode:
                return False
            with contextlib.suppress(OSError):
                # libzmq owns the descriptor: it finds the end of the connection, and closes it.
                socket.shutdown(sockets.SHUT_RDWR)
        return True


def accepted(paths: Collection[str]) -> Iterator[Accepted]:
    """Yield the connections that this process has accepted at paths, the one with the lowest descriptor first."""
    for descriptor in listed_descriptors():
        with opened(descriptor) as socket, contextlib.suppress(OSError):
            if socket is None or socket.family != sockets.AF_UNIX or socket.getsockname() not in paths:
                continue
            if not socket.getsockopt(sockets.SOL_SOCKET, sockets.SO_ACCEPTCONN):
                process, _, _ = struct.unpack("3i", socket.getsockopt(sockets.SOL_SOCKET, sockets.SO_PEERCRED, 12))
                yield Accepted(descriptor, os.fstat(descriptor).st_ino, process)


@contextlib.contextmanager
def opened(descriptor: int) -> Iterator[sockets.socket | None]:
    """Yield the socket of a descriptor, which stays open; None if the descriptor has no socket."""
    try:
        socket = sockets.socket(fileno=descriptor)
    except OSError:
        yield None
        return
    try:
        yield socket
    finally:
        socket.detach()


def holders_of(locks: Iterable[Path]) -> set[int]:
    """Return the processes that hold endpoints, from the first line of their lock files.

    Raises:
        OSError: A file cannot be read, so that its process would pass for a stranger.
    """
    found = set()
    for lock in locks:
        with contextlib.suppress(FileNotFoundError, ValueError, IndexError):
            found.add(int(lock.read_text().split()[0]))
    return found


def unread(connection: Accepted) -> int:
    """Return the number of bytes that were sent on a connection and that its reader has not read yet."""
    try:
        answer = fcntl.ioctl(connection.descriptor, _SIOCOUTQ, bytes(4))
    except OSError:
        return 0
    return int(struct.unpack("i", answer)[0])
