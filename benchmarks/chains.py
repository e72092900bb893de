"""Measure the loop's eight hops without the project: over Unix-domain sockets, and over bare ZeroMQ.

Five processes take the places of hand, master half, link, slave half and AFM. They pass bytes of the sizes of our
messages along the loop, paced at 1 kHz, and do nothing else. With `placed` they run under the scheduling that the rig's
nodes ask for (SCHED_FIFO, a processor for each side of the link). Each measurement returns cycles, from a deadline to
the answer.
"""

import multiprocessing
import multiprocessing.connection
import socket
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import zmq
from cycles import Cycle

from telenano.runtime.loop.deadlines import PeriodicDeadline
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.realtime import ahead_of_others, apply_realtime, freeze_garbage
from telenano.settings.scenario import RealtimeConfig
from telenano.wire import encode
from telenano.wire.messages import (
    AfmCommand,
    AfmState,
    HapticCommand,
    HapticState,
    Message,
    TeleopBackward,
    TeleopForward,
)

PERIOD_NS = 1_000_000
SPIN_NS = 100_000
# The time that the processes need to start and to connect.
_SETTLE_S = 1.0

# In the chain over ZeroMQ each process answers a topic with another topic, which it publishes at an endpoint.
ROUTES: dict[str, dict[str, tuple[str, str]]] = {
    "controller@master": {
        "haptic/state": ("teleop/forward", "controller@master"),
        "teleop/backward": ("haptic/command", "controller@master"),
    },
    "delay_node@master": {
        "teleop/forward": ("teleop/forward", "delay_node@slave"),
        "teleop/backward": ("teleop/backward", "delay_node@master"),
    },
    "controller@slave": {
        "teleop/forward": ("afm/command", "controller@slave"),
        "afm/state": ("teleop/backward", "controller@slave"),
    },
    "afm_node@slave": {"afm/command": ("afm/state", "afm_node@slave")},
}
# The endpoint from which each process receives each of its topics.
_SOURCES: dict[str, dict[str, str]] = {
    "controller@master": {"haptic_node@master": "haptic/state", "delay_node@master": "teleop/backward"},
    "delay_node@master": {"controller@master": "teleop/forward", "controller@slave": "teleop/backward"},
    "controller@slave": {"delay_node@slave": "teleop/forward", "afm_node@slave": "afm/state"},
    "afm_node@slave": {"controller@slave": "afm/command"},
    "haptic_node@master": {"controller@master": "haptic/command"},
}
_ENDPOINTS = ("haptic_node@master", *dict.fromkeys(end for way in ROUTES.values() for _, end in way.values()))
_CONTEXT = multiprocessing.get_context("fork")


def message_bytes() -> dict[str, bytes]:
    """Return a message of each topic of the loop, encoded."""
    vector = (0.0, 0.0, -7.123456789e-3)
    header = {"seq": 4321, "t_ns": 1_790_000_000_123_456_789, "src": "controller@master", "v": 1}
    hand = {"hand_seq": 4321, "hand_t_ns": 1_790_000_000_123_456_789}
    teleop = {
        "law": "virtual_impedance",
        "active": True,
        "position_m": vector,
        "velocity_m_per_s": vector,
        "force_n": vector,
        "wave_sqrt_w": None,
        "energy_j": None,
    }
    known = {"separation_m": 1e-9, "separation_valid": True, "in_contact": True}
    messages: dict[str, Message] = {
        "haptic/state": HapticState(
            **header,
            position_m=vector,
            velocity_m_per_s=vector,
            operator_force_n=vector,
            motor_force_n=vector,
            reference_m=vector,
            mode="position",
            estop=False,
            limited=False,
            session_s=1.234,
            answered_seq=4320,
            answered_t_ns=header["t_ns"],
            answered_at_ns=header["t_ns"],
            step_s=1e-3,
        ),
        "teleop/forward": TeleopForward(**header, **hand, **teleop),
        "afm/command": AfmCommand(**header, **hand, mode="position", base_position_m=vector),
        "afm/state": AfmState(
            **header,
            **hand,
            **known,
            command_seq=4321,
            base_position_m=vector,
            deflection_m=1.23456e-10,
            tip_force_n=vector,
            meniscus=True,
            mode="follow",
            limited=False,
            step_s=1e-3,
        ),
        "teleop/backward": TeleopBackward(**header, **hand, **teleop, **known),
        "haptic/command": HapticCommand(
            **header, **hand, mode="position", position_m=vector, velocity_m_per_s=vector, force_n=vector
        ),
    }
    return {topic: encode(message) for topic, message in messages.items()}


class End(Protocol):
    """One end of the link between two neighbours of the chain."""

    def recv(self, size: int, /) -> bytes:
        """Wait for a message and return it; empty if the other end is closed."""

    def send(self, payload: bytes, /) -> object:
        """Send a message."""


# Opens an end of a link in a process that already has its scheduling: number of the link, and which end (0, 1).
OpenEnd = Callable[[int, int], End]


def ages_ms(cycles: Sequence[Cycle]) -> list[float]:
    """Return the age of each answer on arrival [ms], in ascending order."""
    return sorted((cycle.ended_ns - cycle.begun_ns) * 1e-6 for cycle in cycles)


def measure_waiting(ticks: int) -> list[Cycle]:
    """Return `ticks` cycles of a single thread in the place of the hand that only waits for its deadlines."""
    given, result = _CONTEXT.Pipe(duplex=False)
    return _cycles_of([_CONTEXT.Process(target=_pace_nothing, args=(ticks, result), daemon=True)], given, ticks)


def measure_sockets(ticks: int, *, placed: bool) -> list[Cycle]:
    """Return `ticks` round trips over eight hops of Unix-domain sockets."""
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(4)]
    try:
        return measure_ends(lambda link, side: pairs[link][side], ticks, placed=placed)
    finally:
        for pair in pairs:
            for end in pair:
                end.close()


def measure_ends(open_end: OpenEnd, ticks: int, *, placed: bool) -> list[Cycle]:
    """Return `ticks` round trips over eight hops, along the four links between neighbours."""
    sizes = {topic: bytes(len(topic) + len(payload)) for topic, payload in message_bytes().items()}
    there = [sizes["teleop/forward"], sizes["teleop/forward"], sizes["afm/command"]]
    back = [sizes["haptic/command"], sizes["teleop/backward"], sizes["teleop/backward"]]
    relays = enumerate(("controller@master", "delay_node@master", "controller@slave"))
    tasks = [(node, placed, open_end, hop, there[hop], back[hop]) for hop, node in relays]
    workers = [_CONTEXT.Process(target=_relay_ends, args=task, daemon=True) for task in tasks]
    workers.append(_CONTEXT.Process(target=_turn_ends, args=(placed, open_end, sizes["afm/state"]), daemon=True))
    given, result = _CONTEXT.Pipe(duplex=False)
    task = (placed, open_end, sizes["haptic/state"], ticks, result)
    workers.append(_CONTEXT.Process(target=_pace_ends, args=task, daemon=True))
    return _cycles_of(workers, given, ticks)


def measure_zeromq(ticks: int, *, placed: bool) -> list[Cycle]:
    """Return `ticks` round trips over eight hops of ZeroMQ's PUB and SUB sockets.

    Topics, sizes and connections are those of the rig; in the place of the recorder one subscriber receives everything.
    """
    messages = message_bytes()
    given, result = _CONTEXT.Pipe(duplex=False)
    with tempfile.TemporaryDirectory() as folder:
        tasks = [(node, placed, folder, messages) for node in ROUTES]
        workers = [_CONTEXT.Process(target=_relay_zeromq, args=task, daemon=True) for task in tasks]
        workers.append(_CONTEXT.Process(target=_drain_zeromq, args=(folder,), daemon=True))
        task = (placed, folder, messages["haptic/state"], ticks, result)
        workers.append(_CONTEXT.Process(target=_pace_zeromq, args=task, daemon=True))
        return _cycles_of(workers, given, ticks)


def _cycles_of(
    workers: list[multiprocessing.context.ForkProcess], given: "multiprocessing.connection.Connection", ticks: int
) -> list[Cycle]:
    for worker in workers:
        worker.start()
    try:
        if not given.poll(60.0 + 10.0 * ticks * PERIOD_NS * 1e-9):
            raise RuntimeError("the chain of processes gave no result: one of them has ended")
        return [Cycle(*times_ns) for times_ns in given.recv()]
    finally:
        for worker in workers:
            worker.terminate()
        for worker in workers:
            worker.join()


def _prepare(node: str, placed: bool) -> None:
    """Apply the scheduling of the rig's nodes if the process is to be placed, and freeze the garbage collector."""
    if placed:
        apply_realtime(RealtimeConfig(), StructuredLog("floor"), node)
    freeze_garbage()


def _wait_until(deadline_ns: int) -> int:
    """Wait for a deadline as the haptic node does, and return the time [ns]."""
    time.sleep(max(0, deadline_ns - SPIN_NS - time.monotonic_ns()) * 1e-9)
    while (now := time.monotonic_ns()) < deadline_ns:
        pass
    return now


def _paced(ticks: int, turn: Callable[[], object]) -> list[tuple[int, ...]]:
    """Take a turn at each deadline and return the cycles; missed deadlines are skipped, as in the haptic node."""
    grid = PeriodicDeadline(time.monotonic_ns() + 200 * PERIOD_NS, PERIOD_NS)
    cycles: list[tuple[int, ...]] = []
    for _ in range(ticks):
        begun_ns = _wait_until(grid.deadline_ns)
        grid.advance(begun_ns)
        turn()
        cycles.append((grid.deadline_ns - PERIOD_NS, begun_ns, time.monotonic_ns()))
    return cycles


def _pace_nothing(ticks: int, result: "multiprocessing.connection.Connection") -> None:
    """Wait for deadlines as the haptic node does, without any work at them."""
    _prepare("haptic_node@master", True)
    result.send(_paced(ticks, lambda: None))


def _relay_ends(node: str, placed: bool, open_end: OpenEnd, hop: int, there: bytes, back: bytes) -> None:
    """Pass each message on and its answer back, until the near side closes."""
    _prepare(node, placed)
    near, far = open_end(hop, 1), open_end(hop + 1, 0)
    while near.recv(4096):
        far.send(there)
        far.recv(4096)
        near.send(back)


def _turn_ends(placed: bool, open_end: OpenEnd, answer: bytes) -> None:
    """Answer every message."""
    _prepare("afm_node@slave", placed)
    near = open_end(3, 1)
    while near.recv(4096):
        near.send(answer)


def _pace_ends(
    placed: bool,
    open_end: OpenEnd,
    payload: bytes,
    ticks: int,
    result: "multiprocessing.connection.Connection",
) -> None:
    """Send on an absolute grid as the haptic node does, and time the answers."""
    _prepare("haptic_node@master", placed)
    near = open_end(0, 0)
    time.sleep(_SETTLE_S)

    def turn() -> None:
        near.send(payload)
        near.recv(4096)

    result.send(_paced(ticks, turn))


def _publisher(context: "zmq.Context[zmq.Socket[bytes]]", folder: str, endpoint: str) -> "zmq.Socket[bytes]":
    publisher = context.socket(zmq.PUB)
    publisher.bind(_endpoint(folder, endpoint))
    return publisher


def _subscriber(
    context: "zmq.Context[zmq.Socket[bytes]]", folder: str, sources: Mapping[str, str]
) -> "zmq.Socket[bytes]":
    subscriber = context.socket(zmq.SUB)
    subscriber.set(zmq.RECONNECT_IVL, 50)
    for topic in sources.values():
        subscriber.subscribe(topic)
    for endpoint in sources:
        subscriber.connect(_endpoint(folder, endpoint))
    return subscriber


def _endpoint(folder: str, endpoint: str) -> str:
    return f"ipc://{Path(folder, endpoint)}"


def _relay_zeromq(node: str, placed: bool, folder: str, messages: Mapping[str, bytes]) -> None:
    """Answer each message with the next one of the loop."""
    _prepare(node, placed)
    context = zmq.Context()
    routes = ROUTES[node]
    publishers = {end: _publisher(context, folder, end) for end in {end for _, end in routes.values()}}
    answers = {
        topic.encode(): (publishers[end], [answer.encode(), messages[answer]])
        for topic, (answer, end) in routes.items()
    }
    subscriber = _subscriber(context, folder, _SOURCES[node])
    while True:
        publisher, answer = answers[subscriber.recv_multipart()[0]]
        publisher.send_multipart(answer)


def _drain_zeromq(folder: str) -> None:
    """Receive everything that is published, with the priority of the recorder."""
    ahead_of_others()
    subscriber = _subscriber(zmq.Context(), folder, dict.fromkeys(_ENDPOINTS, ""))
    while True:
        subscriber.recv_multipart()


def _pace_zeromq(
    placed: bool, folder: str, payload: bytes, ticks: int, result: "multiprocessing.connection.Connection"
) -> None:
    """Send on an absolute grid as the haptic node does, and time the answers."""
    _prepare("haptic_node@master", placed)
    context = zmq.Context()
    publisher = _publisher(context, folder, "haptic_node@master")
    subscriber = _subscriber(context, folder, _SOURCES["haptic_node@master"])
    state = [b"haptic/state", payload]
    time.sleep(_SETTLE_S)
    while not subscriber.poll(100):
        # Repeat it until the whole chain has connected.
        publisher.send_multipart(state)
    while subscriber.poll(100):
        subscriber.recv_multipart()

    def turn() -> None:
        publisher.send_multipart(state)
        subscriber.recv_multipart()

    result.send(_paced(ticks, turn))
