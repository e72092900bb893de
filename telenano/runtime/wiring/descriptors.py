"""Whether a process may open as many files as its sockets take, before libzmq meets the limit.

libzmq ends the process, or tries for ever, where it gets no descriptor for a connection. So what the sockets of a
process take is added up as they are planned, from the address book, and a process that may not have it ends in a
sentence. `telenano up` asks for each of its nodes before it starts the first (`needed_by`).
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from telenano.files.optional_modules import optional_module
from telenano.runtime.bus.address_book import AddressBook
from telenano.wire.errors import EndpointError
from telenano.wire.nodes import KEEPERS, LAUNCHER, LINK, NODES, PAGE, RECORDER, name_of, site_of

# Windows has no such module.
resource = optional_module("resource")
_OPEN = Path("/dev/fd")
# Each thread of a context of ZeroMQ has a mailbox and an epoll; the reaper is one, and the context has a mailbox.
_OF_A_THREAD, _OF_A_CONTEXT = 2, 3
# A socket of ZeroMQ has a mailbox.
_OF_A_SOCKET = 1
# A bound ipc endpoint has its listener, its lock, and what tells its file from another one's.
_OF_AN_ENDPOINT = 3
# A node opens so many files for a moment while it runs: its recording or lists, a table of the kernel, and the further
# connection by which it finds that it is deaf, with its socket.
_FOR_A_MOMENT = 5
# What of the table of nodes runs as long as a rig does.
_PARTS = ("rig", "endpoint", "launcher")


def open_descriptors() -> int | None:
    """Return how many files this process has open; None where the system does not say."""
    try:
        return sum(1 for _ in _OPEN.iterdir()) - 1
    except OSError:
        return None


def descriptor_limit() -> int | None:
    """Return how many files this process may have open; None where there is no such limit."""
    if resource is None or sys.platform == "win32":
        return None
    limit: int = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return None if limit == resource.RLIM_INFINITY else limit


def descriptors_free() -> int | None:
    """Return how many more files this process may open; None where that is unknown."""
    taken, limit = open_descriptors(), descriptor_limit()
    return None if taken is None or limit is None else limit - taken


def check_descriptors(owner: str, needed: int) -> int | None:
    """Return how many more files this process may open than it needs beside those that are open; None: unknown.

    It is for a process that counts its connections itself.

    Raises:
        EndpointError: It may open fewer; the message names the owner, what it needs and what it may have.
    """
    taken, limit = open_descriptors(), descriptor_limit()
    if taken is None or limit is None:
        return None
    _check(owner, taken + needed, limit)
    return limit - taken - needed


def _check(owner: str, needed: int, limit: int) -> None:
    if needed > limit:
        raise EndpointError(
            f"{owner} needs {needed} open files, and may have {limit}: raise `ulimit -n` (LimitNOFILE of a "
            "unit, `ulimits: {nofile: 1024}` of a container)"
        )


class Descriptors:
    """What the sockets of one process take, added up as they are opened."""

    def __init__(self, threads: int, held: int | None = None) -> None:
        """Begin with a context of so many threads, and what is open already, or will be in a process to come."""
        self._held = open_descriptors() if held is None else held
        self.needed = (self._held or 0) + threads * _OF_A_THREAD + _OF_A_CONTEXT + _FOR_A_MOMENT

    def add_publisher(self, readers: int) -> None:
        """Add an endpoint that so many others connect to."""
        self.needed += _OF_A_SOCKET + _OF_AN_ENDPOINT + readers

    def add_reader(self, publishers: int) -> None:
        """Add a socket that connects to so many others."""
        self.needed += _OF_A_SOCKET + publishers

    def check(self, owner: str) -> None:
        """Raise EndpointError, which names the owner, where there is no room for what was added."""
        limit = descriptor_limit()
        if self._held is not None and limit is not None:
            _check(owner, self.needed, limit)


def readers_of(book: AddressBook, key: str) -> int:
    """Return how many processes may be connected to an endpoint at the same time.

    They are the others of its site that run as long as the rig does, those that show or record both sites, what reads
    each node once for observers, and a console.
    """
    near = {row.key for row in NODES if row.part in _PARTS and site_of(row.key) == site_of(key)}
    return len(((near | {RECORDER, LAUNCHER, PAGE}) & set(book.nodes)) - {key}) + 2


def needed_by(book: AddressBook, key: str, held: int) -> Descriptors:
    """Return what a node will need that begins with so many open files."""
    descriptors = Descriptors(2 if book.spans_machines else 1, held)
    ends = [f"{LINK}@{site}" for site in ("master", "slave")] if name_of(key) == LINK else [key]
    for end in ends:
        descriptors.add_publisher(readers_of(book, end))
    if key in KEEPERS or name_of(key) == name_of(RECORDER):
        descriptors.add_publisher(1)
    observed = [node for node in book.nodes if node != key]
    if name_of(key) in map(name_of, (RECORDER, PAGE)):
        for _ in observed:
            descriptors.add_reader(1)
    elif name_of(key) == LINK:
        descriptors.add_reader(len(observed))
    else:
        descriptors.add_reader(sum(site_of(node) == site_of(key) for node in observed))
    return descriptors


def check_rig(book: AddressBook, nodes: Sequence[str], held: int) -> None:
    """Raise EndpointError where a node that this process is about to start may not open what it will need."""
    needs = {node: needed_by(book, node, held) for node in nodes if node in book.nodes}
    if needs:
        most = max(needs, key=lambda node: needs[node].needed)
        needs[most].check(most)
