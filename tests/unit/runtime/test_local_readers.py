"""How many programs of this machine may read a node, and what becomes of one that reads nothing."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
import zmq
from test_memory_without_descriptors import room_for

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import ConnectionEvent
from telenano.runtime.bus.local_readers import MOST_IN_ALL, MOST_OF_ONE, accepted, unread
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.realtime import raise_file_limit
from telenano.runtime.wiring.transport import Transport, open_context
from telenano.settings import DEFAULT_SITE_FILE
from telenano.testing import VirtualClock

TIP = "afm_node@slave"
LOOK_NS = 500_000_000
PATIENCE_S = 30.0
# Opens plain connections one after the other, as a program does that forgets to close them.
CONNECTS = """
import socket, sys
held = []
for _ in range(int(sys.argv[2])):
    one = socket.socket(socket.AF_UNIX)
    one.connect(sys.argv[1])
    held.append(one)
print("connected", flush=True)
sys.stdin.read()
"""
# Subscribes to everything, and reads nothing, or all; may also listen where observers connect.
SUBSCRIBES = """
import socket, sys, zmq
if sys.argv[3] == "serves observers":
    door = socket.socket(socket.AF_UNIX)
    door.bind(sys.argv[1].removeprefix("ipc://") + ".fan")
    door.listen()
context = zmq.Context()
sockets = [context.socket(zmq.SUB) for _ in range(int(sys.argv[2]))]
for one in sockets:
    one.subscribe(b"")
    one.set(zmq.RCVHWM, 10)
    one.set(zmq.RECONNECT_IVL, -1)
    one.connect(sys.argv[1])
print("connected", flush=True)
if sys.argv[3] == "reads":
    while True:
        for one in sockets:
            one.recv_multipart()
sys.stdin.read()
"""


class Served:
    """A node with its endpoint, on a clock of its own."""

    def __init__(self, stack: ExitStack) -> None:
        raise_file_limit()
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=10**18)
        book = AddressBook.load(DEFAULT_SITE_FILE)
        context = stack.enter_context(open_context(serves_network=False))
        self.network = stack.enter_context(closing(Transport(context, self.clock, book, "")))
        self.publisher: ZmqPublisher = stack.enter_context(closing(self.network.publisher(TIP)))
        self.path = (book.local_endpoint(TIP) or "").removeprefix("ipc://")
        self.events: list[ConnectionEvent] = []
        self._stack = stack

    def look(self, count: int = 1) -> None:
        for _ in range(count):
            self.clock.advance_ns(LOOK_NS)
            self.events += self.network.process_events()

    def program(self, text: str, *arguments: object) -> "subprocess.Popen[str]":
        """Start a program that connects, and return it once it has."""
        words = [sys.executable, "-c", text, *map(str, arguments)]
        process = self._stack.enter_context(
            subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        )
        self._stack.callback(process.kill)
        assert process.stdout is not None and process.stdout.readline() == "connected\n"
        return process

    def connections(self, process: "subprocess.Popen[str] | None" = None) -> int:
        return sum(process is None or each.process == process.pid for each in accepted({self.path}))

    def until(self, count: int, process: "subprocess.Popen[str] | None" = None) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while self.connections(process) != count:
            assert time.monotonic() < end_s, self.connections(process)
            time.sleep(0.02)


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "r"))
    monkeypatch.delenv("TELENANO_RIG", raising=False)
    with ExitStack() as stack:
        yield Served(stack)


def test_of_too_many_connections_of_a_program_the_oldest_are_closed_and_the_others_read_on(served: Served) -> None:
    reader = served.program(SUBSCRIBES, f"ipc://{served.path}", 1, "reads")
    leaking = served.program(CONNECTS, served.path, MOST_OF_ONE + 100)
    served.until(MOST_OF_ONE + 100, leaking)
    served.look()
    served.until(MOST_OF_ONE, leaking)
    assert served.connections(reader) == 1
    [event] = served.events
    assert (event.level, event.data) == ("warning", {"process": leaking.pid, "count": 100})
    served.look(3)
    assert (served.connections(leaking), len(served.events)) == (MOST_OF_ONE, 1)


def test_of_too_many_in_all_those_of_who_has_most_are_closed(served: Served) -> None:
    programs = [served.program(CONNECTS, served.path, count) for count in (500, 400, 300)]
    served.until(1200)
    served.look()
    served.until(MOST_IN_ALL)
    assert [served.connections(each) for each in programs[1:]] == [400, 300]


def test_where_few_files_may_be_open_half_of_what_is_left_may_be_connections(served: Served) -> None:
    with room_for(200):
        leaking = served.program(CONNECTS, served.path, 150)
        served.until(150, leaking)
        served.look()
        end_s = time.monotonic() + PATIENCE_S
        while served.connections(leaking) > 110:
            assert time.monotonic() < end_s
            time.sleep(0.02)


def send(served: Served, count: int) -> None:
    for _ in range(count):
        served.publisher.send("afm/state", bytes(1000))


@pytest.mark.parametrize(
    "kind", ["stands still", "reads", "node", "node whose lock file is removed", "serves observers"]
)
def test_a_stranger_that_reads_nothing_is_cut_off_and_no_other(
    served: Served, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = served.program(SUBSCRIBES, f"ipc://{served.path}", 1, kind)
    lock = Path(served.path).parent / "recorder@master.lock"
    if kind.startswith("node"):
        lock.write_text(f"{reader.pid}\nrecorder@master\n\n")
    served.until(1, reader)
    time.sleep(0.1)
    if kind == "node whose lock file is removed":
        served.look()
        lock.unlink()
        # What is known of the readers is asked again as soon as there is another one.
        served.program(CONNECTS, served.path, 1)
    for _ in range(12):
        send(served, 500)
        time.sleep(0.05)
        served.look()
    assert served.connections(reader) == (0 if kind == "stands still" else 1)
    assert [event.data for event in served.events if event.data["process"] == reader.pid] == (
        [{"process": reader.pid, "count": 1}] if kind == "stands still" else []
    )


def test_a_stranger_that_is_idle_because_nothing_is_sent_stays(served: Served) -> None:
    reader = served.program(SUBSCRIBES, f"ipc://{served.path}", 1, "")
    served.until(1, reader)
    send(served, 5)
    end_s = time.monotonic() + PATIENCE_S
    while any(unread(each) for each in accepted({served.path})):
        assert time.monotonic() < end_s
        time.sleep(0.02)
    served.look(12)
    assert (served.connections(reader), served.events) == (1, [])


def test_nodes_keep_their_connections_however_few_files_may_be_open_and_also_where_they_are_not_known(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    lock = Path(served.path).parent / "recorder@master.lock"
    node, leaking = (served.program(CONNECTS, served.path, count) for count in (60, 40))
    lock.write_text(f"{node.pid}\nrecorder@master\n\n")
    served.until(100)
    monkeypatch.setattr("telenano.runtime.wiring.descriptors.descriptor_limit", lambda: 0)
    with room_for(0), pytest.raises(OSError, match="Too many open files"):
        served.look()
    assert served.connections() == 100
    served.look()
    served.until(16, leaking)
    assert served.connections(node) == 60


def test_connections_are_not_taken_for_other_open_files(served: Served) -> None:
    assert served.connections() == 0
    with zmq.Context() as context, context.socket(zmq.PAIR) as other:
        other.bind("inproc://x")
        served.look(3)
    assert served.events == []
