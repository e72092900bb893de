"""Programs of the same user that treat a rig badly: one floods its endpoints, one subscribes to all and never reads.

Example:
    with standing_reader(sockets), flooded(sockets, every_s=60.0):
        rig.wait()
"""

import fcntl
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import zmq

from telenano.signals import children
from telenano.wire.nodes import START_ORDER

# Every node connects to these, because commands may come from there, and nobody has bound them in the session.
FREE = ("console@master", "player@master", "view@master", "experiment@master")
TOPICS = (b"session/control", b"node/health", b"haptic/command", b"operator/force", b"experiment/trial", b"")
PER_S, FLOOD_S, AT_ONCE = 10_000, 3.0, 20
# A rig that has not begun by then does not begin [s].
_BEGINS_S = 60.0
_READS = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from neighbours import read_all
read_all(Path(sys.argv[2]))
"""


def garbage(count: int) -> list[list[bytes]]:
    """Return messages of random bytes under topics that nodes subscribe to, some of too many parts or too few."""
    draw = random.Random(7)
    sizes, parts = (1, 20, 200, 1000), (1, 1, 1, 0, 3)
    return [
        [draw.choice(TOPICS), *(draw.randbytes(draw.choice(sizes)) for _ in range(draw.choice(parts)))]
        for _ in range(count)
    ]


@contextmanager
def door(context: "zmq.Context[Any]", sockets: Path, name: str, kind: int = zmq.PUB) -> Iterator["zmq.Socket[Any]"]:
    """Bind a free endpoint as any program may, with its lock, or connect to where a node takes emergency stops."""
    with ExitStack() as stack:
        socket = stack.enter_context(context.socket(kind))
        socket.set(zmq.LINGER, 0)
        address = f"ipc://{sockets}/{name}"
        if name in FREE:
            lock = stack.enter_context((sockets / f"{name}.lock").open("a+"))
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            socket.bind(address)
        else:
            socket.connect(address)
        yield socket


def flood(socket: "zmq.Socket[Any]", messages: list[list[bytes]]) -> float:
    """Send messages for a time; return how many a second."""
    begin_s, sent = time.monotonic(), 0
    while time.monotonic() - begin_s < FLOOD_S:
        for _ in range(AT_ONCE):
            socket.send_multipart(messages[sent % len(messages)])
            sent += 1
        time.sleep(max(0.0, begin_s + sent / PER_S - time.monotonic()))
    return sent / (time.monotonic() - begin_s)


@contextmanager
def flooded(sockets: Path, every_s: float) -> Iterator[list[float]]:
    """Flood each free endpoint and each inlet of stops in turn, one every `every_s` [s]; yield the rates so far [1/s].

    The endpoints are looked for when the first flood begins, because the rig may start at the same time.
    """
    ended, sent_hz = threading.Event(), list[float]()

    def run() -> None:
        messages, turn = garbage(500), 0
        with zmq.Context[Any]() as context:
            while not ended.wait(every_s):
                names = (*FREE, *sorted(path.name for path in sockets.glob("*.estop")))
                with door(context, sockets, names[turn % len(names)]) as socket:
                    sent_hz.append(flood(socket, messages))
                turn += 1

    flooding = threading.Thread(target=run, daemon=True)
    flooding.start()
    try:
        yield sent_hz
    finally:
        ended.set()
        flooding.join()


@contextmanager
def standing_reader(sockets: Path, reads_s: float = 5.0) -> Iterator[int]:
    """Run a process that subscribes to all that is published, and is stopped by a signal while it reads; yield its id.

    It waits until all nodes have bound their endpoints, and stands still `reads_s` [s] later; RuntimeError if none do.
    """
    command = [sys.executable, "-c", _READS, str(Path(__file__).parent), str(sockets)]
    with children.start(command, stdout=subprocess.PIPE, text=True) as reader:
        try:
            assert reader.stdout is not None
            if not reader.stdout.readline():
                raise RuntimeError(f"no rig has begun in {sockets} within {_BEGINS_S:g} s, so nobody can read it")
            time.sleep(reads_s)
            os.kill(reader.pid, signal.SIGSTOP)
            yield reader.pid
        finally:
            reader.kill()


def read_all(sockets: Path) -> None:
    """Subscribe to all that the nodes of a rig publish, tell so by a line, and read until the process ends."""
    context = zmq.Context[Any]()
    socket = context.socket(zmq.SUB)
    socket.subscribe(b"")
    begin_s = time.monotonic()
    while not all((sockets / name).exists() for name in START_ORDER):
        if time.monotonic() - begin_s > _BEGINS_S:
            return
        time.sleep(0.2)
    for name in START_ORDER:
        socket.connect(f"ipc://{sockets}/{name}")
    sys.stdout.write("reads\n")
    sys.stdout.flush()
    while True:
        socket.recv_multipart()
