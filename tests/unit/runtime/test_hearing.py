"""Whether a reader hears who sends: readers, publishers and ways to lose a connection as one table.

Each reader has the connections of a kind of process. The clock of its looks is a virtual one, the sockets are real.
"""

import contextlib
import random
import shutil
import socket as sockets
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path

import pytest
import zmq
from network_bench import payload

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import ConnectionEvent, Subscriber
from telenano.runtime.bus.hearing import BEACON
from telenano.runtime.bus.local_endpoint import fan_out_endpoint, is_bound
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.wiring.transport import Transport, open_context
from telenano.settings import DEFAULT_SITE_FILE
from telenano.testing import VirtualClock
from telenano.wire.nodes import name_of
from telenano.wire.received import Received

SENDERS = (
    "console@master",
    "launcher@master",
    "haptic_node@master",
    "delay_node@master",
    "player@master",
    "view@master",
)
LOOK_NS = 500_000_000
# A look of a loop and the beacon come twice a second: what is mended within two seconds takes so many looks.
LOOKS = 4
LARGE = bytes(20 << 20)
SITES = ("master", "slave")


class Reader:
    """One kind of process: its connections, and what it has received."""

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]", book: AddressBook, kind: str) -> None:
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=10**18)
        self.network = Transport(context, self.clock, book, "")
        self.readers = self.connect(book, kind)
        self.received: list[Received] = []
        self.events: list[ConnectionEvent] = []

    def connect(self, book: AddressBook, kind: str) -> list[Subscriber]:
        if kind in OBSERVERS:
            plan = book.observed("", ("master", "slave"))
            return self.network.subscribers(plan, apart=True, shared=kind == SHARED)
        if kind == "link":
            return self.network.subscribers(book.bridged_from("master"), newest_only=False)
        return self.network.subscribers(book.sources(*READERS[kind]), newest_only=kind != "console")

    def hears(self, node: str) -> bool:
        """Read what has come, and return whether something of a node was in it."""
        before = self.heard(node)
        for reader in self.readers:
            while True:
                self.received += reader.receive()
                if reader.drained:
                    break
        return self.heard(node) > before

    def heard(self, node: str) -> int:
        return sum(
            tracker.received for reader in self.readers for (_, src), tracker in reader.trackers.items() if src == node
        )

    def look(self) -> None:
        self.clock.advance_ns(LOOK_NS)
        self.events += self.network.process_events()

    def close(self) -> None:
        self.network.close()
        for reader in self.readers:
            reader.close()


READERS: Mapping[str, tuple[str, Sequence[str]]] = {
    "controller": ("controller@master", ("haptic/state", "teleop/backward", "link/delay", "session/control")),
    "hand": ("haptic_node@master", ("haptic/command", "operator/force", "session/control", BEACON)),
    "launcher": ("launcher@master", ("session/event", BEACON)),
    "console": ("console@master", ("session/event", BEACON)),
}
# An observer reads each node by itself, or what the process of the rig hands on that reads each node once for all.
SHARED = "observer of what is handed on"
OBSERVERS = ("observer", SHARED)
KINDS = (*READERS, "link", *OBSERVERS)


class Sender:
    """A publisher, which a process of another hand may stand in for."""

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]", book: AddressBook, node: str) -> None:
        self.context, self.node, self.endpoint = context, node, book.local_endpoint(node) or ""
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=10**18)
        self.sent = 0
        self.publisher: ZmqPublisher | None = None
        self.bind()

    @property
    def path(self) -> Path:
        return Path(self.endpoint.removeprefix("ipc://"))

    def bind(self) -> None:
        self.publisher = ZmqPublisher(self.context, self.clock, self.node, self.endpoint)
        self.publisher.socket.set(zmq.LINGER, 0)

    def send(self) -> None:
        if self.publisher is not None:
            self.publisher.send(BEACON, payload(BEACON, self.node, self.sent))
            self.sent += 1

    def close(self) -> None:
        if self.publisher is not None:
            self.publisher.close()
            self.publisher = None


def too_large(sender: Sender) -> None:
    assert sender.publisher is not None
    for topic in (b"session/control", b"node/health", b"session/event", b"teleop/forward"):
        sender.publisher.socket.send_multipart([topic, LARGE])


def garbage(sender: Sender) -> None:
    """Have something that speaks another protocol stand at the path for a while."""
    sender.close()
    with sockets.socket(sockets.AF_UNIX) as listening, contextlib.ExitStack() as accepted:
        listening.bind(str(sender.path))
        listening.listen(100)
        listening.settimeout(0.3)
        with contextlib.suppress(TimeoutError):
            while True:
                connection = accepted.enter_context(listening.accept()[0])
                connection.sendall(random.Random(1).randbytes(200))
        time.sleep(0.05)
    sender.path.unlink()
    sender.bind()


_GREETING = bytes((0xFF, 0, 0, 0, 0, 0, 0, 0, 0, 0x7F, 3, 0)) + b"NULL".ljust(20, b"\0") + bytes(32)
_READY = b"\x05READY\x0bSocket-Type\x00\x00\x00\x03PUB"


def malformed(sender: Sender) -> None:
    """Have something stand at the path that breaks the protocol only after its handshake."""
    sender.close()
    with sockets.socket(sockets.AF_UNIX) as listening, contextlib.ExitStack() as accepted:
        listening.bind(str(sender.path))
        listening.listen(100)
        listening.settimeout(0.3)
        with contextlib.suppress(TimeoutError):
            while True:
                connection = accepted.enter_context(listening.accept()[0])
                with contextlib.suppress(BrokenPipeError):
                    connection.sendall(_GREETING + bytes((4, len(_READY))) + _READY)
                    time.sleep(0.1)
                    connection.sendall(b"\x02" + b"\xff" * 8)
        time.sleep(0.05)
    sender.path.unlink()
    sender.bind()


def file_removed(sender: Sender) -> None:
    assert sender.publisher is not None
    sender.path.unlink()
    sender.publisher.make_again()


def restarted(sender: Sender) -> None:
    sender.close()
    time.sleep(0.1)
    sender.bind()


_STANDS_IN = """
import sys, time, zmq
socket = zmq.Context().socket(zmq.PUB)
socket.bind(sys.argv[1])
print("bound", flush=True)
time.sleep(60)
"""


def killed(sender: Sender) -> None:
    """Have a process at the endpoint killed with its connections open, and the next one take its place."""
    sender.close()
    time.sleep(0.1)
    with subprocess.Popen([sys.executable, "-c", _STANDS_IN, sender.endpoint], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stdout.readline() == b"bound\n"
        # The readers connect to it.
        time.sleep(0.3)
        process.kill()
    sender.bind()


def left_after_it(sender: Sender) -> None:
    """Break the connections and end; the next one comes later, as consoles do."""
    too_large(sender)
    time.sleep(0.1)
    sender.close()
    time.sleep(0.1)
    sender.bind()


WAYS: Mapping[str, Callable[[Sender], None]] = {
    "a frame that is too large": too_large,
    "garbage": garbage,
    "a frame of no known length behind a handshake": malformed,
    "the file removed and made again": file_removed,
    "ended and started again": restarted,
    "broken by one that ended": left_after_it,
    "killed": killed,
}


@pytest.fixture(scope="module")
def book(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AddressBook]:
    folder = tmp_path_factory.mktemp("r")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TELENANO_RUNTIME_DIR", str(folder))
        patch.delenv("TELENANO_RIG", raising=False)
        yield AddressBook.load(DEFAULT_SITE_FILE)
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def context() -> "Iterator[zmq.Context[zmq.Socket[bytes]]]":
    made = open_context(serves_network=False)
    yield made
    made.destroy(0)


def settled(reader: Reader, *senders: Sender) -> None:
    """Let a reader hear each sender once."""
    missing, deadline_s = {sender.node for sender in senders}, time.monotonic() + 20.0
    while missing:
        assert time.monotonic() < deadline_s, f"never heard: {missing}"
        for sender in senders:
            sender.send()
        time.sleep(0.02)
        reader.hears("")
        missing = {node for node in missing if not reader.heard(node)}


def looks_until_heard(reader: Reader, sender: Sender, *others: Sender, apart_s: float = 0.16) -> int:
    """Return after how many looks a reader hears a sender, which sends a beacon before each."""
    for look in range(3 * LOOKS):
        for each in (sender, *others):
            each.send()
        time.sleep(apart_s - 0.1)
        if reader.hears(sender.node):
            reader.look()
            return look
        reader.look()
        # libzmq connects in a thread of its own
        time.sleep(0.1)
    return -1


def reads(kind: str, node: str) -> bool:
    """Return whether a kind of process connects to a node."""
    book = AddressBook.load(DEFAULT_SITE_FILE)
    if kind in OBSERVERS:
        return node in book.observed("", ("master", "slave"))
    return node in (book.bridged_from("master") if kind == "link" else book.sources(*READERS[kind]))


CASES = [case for case in product(KINDS, SENDERS, WAYS) if reads(*case[:2])]
# One row of each way and one of each reader run with each change, the whole table on demand.
DRAWN = random.Random(95).sample(CASES, 12)


@contextlib.contextmanager
def handed_on(*endpoints: str) -> Iterator[None]:
    """Run the process that reads nodes once for all observers."""
    command = [sys.executable, "-m", "services.fan_out", *endpoints]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as process:
        while not all(is_bound(fan_out_endpoint(endpoint)) for endpoint in endpoints):
            assert process.poll() is None
            time.sleep(0.02)
        yield
        process.communicate()


def mended(context: "zmq.Context[zmq.Socket[bytes]]", book: AddressBook, kind: str, node: str, way: str) -> None:
    """Have a connection lost in a way; raise unless it is made again in time and nothing else is lost by it."""
    other = next(each for each in SENDERS if each != node and name_of(each) != "delay_node" and reads(kind, each))
    with contextlib.ExitStack() as stack:
        sender, beside = (Sender(context, book, each) for each in (node, other))
        for each in (sender, beside):
            stack.callback(each.close)
        if kind == SHARED:
            stack.enter_context(handed_on(sender.endpoint, beside.endpoint))
        reader = Reader(context, book, kind)
        stack.callback(reader.close)
        settled(reader, sender, beside)
        before = lost(reader, but=node)
        WAYS[way](sender)
        # The process that hands on has a clock of its own, and what it was deaf to the observer was as well.
        apart_s, looks = (0.5, 2 * LOOKS) if kind == SHARED else (0.16, LOOKS)
        assert 0 <= looks_until_heard(reader, sender, beside, apart_s=apart_s) <= looks
        assert lost(reader, but=node) == before
        assert not reader.network.hearing.deaf()


@pytest.mark.check("takes 10 s")
@pytest.mark.drawn(0.3)
@pytest.mark.parametrize(("kind", "node", "way"), DRAWN)
def test_a_reader_hears_who_sends_within_two_seconds(
    context: "zmq.Context[zmq.Socket[bytes]]", book: AddressBook, kind: str, node: str, way: str
) -> None:
    mended(context, book, kind, node, way)


@pytest.mark.check("takes 15 s")
@pytest.mark.drawn(0.4, "telenano/runtime/bus/", "telenano/runtime/wiring/")
@pytest.mark.parametrize("way", WAYS)
def test_an_observer_hears_again_what_is_handed_on(
    context: "zmq.Context[zmq.Socket[bytes]]", book: AddressBook, way: str
) -> None:
    mended(context, book, SHARED, "launcher@master", way)


@pytest.mark.endurance("takes 4 min")
def test_every_reader_hears_every_publisher_again(context: "zmq.Context[zmq.Socket[bytes]]", book: AddressBook) -> None:
    for case in CASES:
        mended(context, book, *case)


def test_what_a_reader_was_deaf_to_is_told_and_so_is_its_end(
    context: "zmq.Context[zmq.Socket[bytes]]", book: AddressBook
) -> None:
    sender = Sender(context, book, "console@master")
    with contextlib.closing(sender), contextlib.closing(Reader(context, book, "hand")) as reader:
        settled(reader, sender)
        too_large(sender)
        while not reader.network.hearing.deaf():
            assert not reader.hears(sender.node), "the connection was not lost"
            sender.send()
            time.sleep(0.06)
            reader.look()
        assert looks_until_heard(reader, sender) >= 0
    assert [event.data["connection"] for event in reader.events] == ["deaf", "up"]
    assert all("console@master" in event.text for event in reader.events)
    assert BEACON in {row.topic for row in reader.readers[0].input_health()}


@pytest.mark.parametrize("what", ["silent", "never there", "ended", "of another version", "somebody else"])
def test_who_sends_nothing_that_is_read_is_not_one_that_a_reader_is_deaf_to(
    context: "zmq.Context[zmq.Socket[bytes]]", book: AddressBook, what: str
) -> None:
    sender = Sender(context, book, "launcher@master")
    with contextlib.closing(sender), contextlib.closing(Reader(context, book, "controller")) as reader:
        if what == "never there":
            sender.close()
        else:
            settled(reader, sender)
        if what == "ended":
            sender.close()
        for number in range(4 * LOOKS):
            if what == "of another version" and sender.publisher is not None:
                sender.publisher.send(BEACON, b"\x80")
            if what == "somebody else" and sender.publisher is not None:
                sender.publisher.send(BEACON, payload(BEACON, "haptic_node@master", number))
            time.sleep(0.02)
            reader.hears(sender.node)
            reader.look()
        assert (reader.network.hearing.deaf(), reader.events) == ({}, [])
        if what == "silent":
            # What it sends first after its silence is not lost.
            sender.send()
            time.sleep(0.06)
            assert reader.hears(sender.node)
            assert lost(reader) == 0


def test_a_loop_that_stood_still_reads_what_waits_before_it_takes_anybody_for_silent(
    context: "zmq.Context[zmq.Socket[bytes]]", book: AddressBook
) -> None:
    sender = Sender(context, book, "launcher@master")
    with contextlib.closing(sender), contextlib.closing(Reader(context, book, "controller")) as reader:
        settled(reader, sender)
        for _ in range(4 * LOOKS):
            sender.send()
            time.sleep(0.01)
            reader.look()
        assert reader.hears(sender.node)
        assert (lost(reader), reader.events) == (0, [])


def test_the_beacon_is_no_input_of_a_node_that_does_not_read_it(
    context: "zmq.Context[zmq.Socket[bytes]]", book: AddressBook
) -> None:
    sender = Sender(context, book, "launcher@master")
    with contextlib.closing(sender), contextlib.closing(Reader(context, book, "controller")) as reader:
        settled(reader, sender)
        assert not reader.received
        assert BEACON not in {row.topic for one in reader.readers for row in one.input_health()}


def test_a_reader_that_is_closed_piece_by_piece_keeps_no_other_from_reading(
    context: "zmq.Context[zmq.Socket[bytes]]", book: AddressBook
) -> None:
    sender = Sender(context, book, "launcher@master")
    with contextlib.closing(sender), contextlib.closing(Reader(context, book, "console")) as reader:
        settled(reader, sender)
        reader.network.close()
        # Nobody reads any more that this connection ends.
        too_large(sender)
        time.sleep(0.1)
        with contextlib.closing(Reader(context, book, "hand")) as other:
            settled(other, sender)


def lost(reader: Reader, but: str = "") -> int:
    return sum(t.lost for r in reader.readers for (_, src), t in r.trackers.items() if src != but)
