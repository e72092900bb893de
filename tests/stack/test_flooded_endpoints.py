"""Garbage at every endpoint that a program of the same user may take: no node ends, and a stop comes through."""

import fcntl
import random
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from statistics import mean, median
from typing import Any

import machine
import pytest
import zmq
from empty_loop import EmptyLoops
from ledger import record
from stack_rig import CONSTANT_PUSH, Rig

from telenano.recording.reader import Recording
from telenano.wire.nodes import START_ORDER

PER_S, FLOOD_S, AT_ONCE = 10_000, 3.0, 20
# every node connects to these, because commands may come from there, and nobody has bound them in this session
FREE = ("console@master", "player@master", "view@master", "experiment@master")
TOPICS = (b"session/control", b"node/health", b"haptic/command", b"operator/force", b"experiment/trial", b"")
LOOPS = ("haptic_node@master", "controller@master", "controller@slave", "afm_node@slave")


def garbage(count: int) -> list[list[bytes]]:
    """Return messages of random bytes under topics that nodes subscribe to, some of too many parts or too few."""
    draw = random.Random(7)
    sizes, parts = (1, 20, 200, 1000), (1, 1, 1, 0, 3)
    return [
        [draw.choice(TOPICS), *(draw.randbytes(draw.choice(sizes)) for _ in range(draw.choice(parts)))]
        for _ in range(count)
    ]


@contextmanager
def door(context: "zmq.Context[Any]", rig: Rig, name: str, kind: int = zmq.PUB) -> Iterator["zmq.Socket[Any]"]:
    """Bind a free endpoint as any program may, with its lock, or connect to where a node takes emergency stops."""
    with ExitStack() as stack:
        socket = stack.enter_context(context.socket(kind))
        socket.set(zmq.LINGER, 0)
        address = f"ipc://{rig.sockets}/{name}"
        if name in FREE:
            lock = stack.enter_context((rig.sockets / f"{name}.lock").open("a+"))
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


@pytest.mark.endurance
def test_garbage_at_the_endpoints_that_are_open_to_others_ends_nothing(rig: Rig) -> None:
    rig.start("--duration", "300", "--set", CONSTANT_PUSH)
    rig.wait_until(rig.running, "a running session")
    before = {node: rig.process_of(node) for node in (*START_ORDER, "recorder@master")}
    inlets = sorted(path.name for path in rig.sockets.glob("*.estop"))
    assert len(inlets) == 4
    messages, sent_hz = garbage(500), []
    with zmq.Context[Any]() as context, EmptyLoops() as loops:
        first_ns = time.time_ns()
        for name in (*FREE, *inlets):
            with door(context, rig, name) as socket:
                sent_hz.append(flood(socket, messages))
        last_ns = time.time_ns()
        with door(context, rig, FREE[0]) as socket:
            flood(socket, messages)
            stopped = rig.telenano("estop")
        share = loops.share(first_ns, last_ns)
    assert stopped.returncode == 0, stopped.stderr
    assert {node: rig.process_of(node) for node in before} == before, rig.logs()
    assert not rig.log_has("launcher@master", "was started again")
    rig.stop()
    reports = [
        (message.src, message.fields())
        for message in Recording(rig.out / "session.mcap").messages(["node/health"])
        if first_ns <= message.publish_ns <= last_ns and message.src in LOOPS
    ]
    rates_hz = {node: mean(fields["rate_hz"] for src, fields in reports if src == node) for node in LOOPS}
    refused = max(sum(fields["rejected"].values()) for _, fields in reports)
    assert refused > 1000
    if share < 0.9:
        machine.note(f"garbage at free endpoints: {share:.0%} of the processors were to be had, no rate is judged")
        return
    assert min(rates_hz.values()) > 0.95 * share * 250.0, (rates_hz, share)
    record(
        "garbage at every endpoint that is open to others",
        f"{median(sent_hz):.0f} a second for {FLOOD_S:.0f} s at each of {len(sent_hz)}; no process ended; least rate "
        f"{min(rates_hz.values()) / 2.5:.1f} %; up to {refused} refused and counted by a node; both devices stopped",
    )
