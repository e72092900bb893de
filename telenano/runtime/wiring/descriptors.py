"""Check of the limit of open files against the needs of a process's sockets, before libzmq reaches the limit.

libzmq aborts the process, or retries for ever, if it gets no descriptor for a connection. So the descriptors of the
planned sockets are added up from the address book, and a process that may not open enough ends with an error message.
`telenano up` checks all of its nodes before it starts the first (`needed_by`).
"""

from collections.abc import Sequence

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.open_files import descriptor_limit, open_descriptors
from telenano.wire.errors import EndpointError
from telenano.wire.nodes import KEEPERS, LAUNCHER, LINK, NODES, PAGE, RECORDER, name_of, site_of

# Descriptors of a ZeroMQ context: each thread has a mailbox and an epoll; the context has a mailbox, and the two of its
# reaper thread.
_OF_A_THREAD, _OF_A_CONTEXT = 2, 3
# A socket of ZeroMQ has a mailbox. A reader has two further sockets, which report the ends of its connections.
_OF_A_SOCKET, _OF_A_READER = 1, 3
# A bound ipc endpoint has its listener, its lock, and the open inode that identifies its file.
_OF_AN_ENDPOINT = 3
# Files that a node opens only for a moment: its recording or lists, a table of the kernel, and the probe whether an
# endpoint is held.
_FOR_A_MOMENT = 3
# The parts of the table of nodes that run as long as the rig does.
_PARTS = ("rig", "endpoint", "launcher")


def descriptors_free() -> int | None:
    """Return the number of further files that this process may open; None if unknown or unlimited."""
    taken, limit = open_descriptors(), descriptor_limit()
    return None if taken is None or limit is None else limit - taken


def descriptors_beyond(needed: int) -> int | None:
    """Return the number of files that this process may open beyond `needed` in all; None if unlimited."""
    limit = descriptor_limit()
    return None if limit is None else limit - needed


def check_descriptors(owner: str, needed: int) -> int | None:
    """Return the number of files that this process may open beyond `needed` further ones; None if unknown.

    For a process that counts its connections itself.

    Raises:
        EndpointError: Fewer may be opened than needed; the message has the owner, the needed number and the limit.
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
    """The number of descriptors that the sockets of one process need, added up as they are opened."""

    def __init__(self, threads: int, held: int | None = None) -> None:
        """Begin with a context and the open files.

        Args:
            threads: The number of I/O threads of the ZeroMQ context.
            held: The number of files open in a process to come; None for those open in this process now.
        """
        self._held = open_descriptors() if held is None else held
        self.needed = (self._held or 0) + threads * _OF_A_THREAD + _OF_A_CONTEXT + _FOR_A_MOMENT

    def add_publisher(self, readers: int) -> None:
        """Add an endpoint to which this number of readers connect."""
        self.needed += _OF_A_SOCKET + _OF_AN_ENDPOINT + readers

    def add_reader(self, publishers: int) -> None:
        """Add a socket that connects to this number of publishers."""
        self.needed += _OF_A_READER + publishers

    def check(self, owner: str) -> None:
        """Raise EndpointError, which names the owner, if the sum exceeds the limit of open files."""
        limit = descriptor_limit()
        if self._held is not None and limit is not None:
            _check(owner, self.needed, limit)


def readers_of(book: AddressBook, key: str) -> int:
    """Return the number of processes that may be connected to an endpoint of node `key` at the same time.

    They are the other nodes of its site that run as long as the rig does, the nodes that show or record both sites, the
    process that reads each node once for all observers, and a console.
    """
    near = {row.key for row in NODES if row.part in _PARTS and site_of(row.key) == site_of(key)}
    return len(((near | {RECORDER, LAUNCHER, PAGE}) & set(book.nodes)) - {key}) + 2


def needed_by(book: AddressBook, key: str, held: int) -> Descriptors:
    """Return the descriptors that node `key` will need, if its process begins with `held` open files."""
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
    """Raise EndpointError if the limit of open files is too low for one of the nodes that this process will start.

    Args:
        book: The addresses of the rig.
        nodes: The nodes to start, as node@site; those not in the book are left out.
        held: The number of files that are open when a node begins.
    """
    needs = {node: needed_by(book, node, held) for node in nodes if node in book.nodes}
    if needs:
        most = max(needs, key=lambda node: needs[node].needed)
        needs[most].check(most)
