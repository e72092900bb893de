"""Processor time of a turn of each node without bus and codec, of a message received, recorded and shown, by checkouts.

    python benchmarks/turns.py [--before FOLDER] [--pairs N] [--smoke] [--json] [PART ...]

A worker in this checkout and one in FOLDER, an earlier version (this one again without it, which shows the noise), take
turns, A B B A: each runs the same session in virtual time (`telenano.virtual`) and then has a part of it go
through what its node received, over and over. PART is a node, or `receive` (from a socket to a message), `record` (the
recorder's intake) or `show` (the feed of a page). A figure is the mean of the ratios of all pairs, with the interval
in which those of all parts are with 95 % (`versions.py`); a part whose interval is without 1 is said to differ.
"""

import argparse
import gc
import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from telenano.signals import children

HERE = Path(__file__).resolve().parents[1]
NODES = ("haptic_node@master", "controller@master", "controller@slave", "afm_node@slave", "delay_node@master")
PARTS = (*NODES, "receive", "record", "show")
SESSION_S = 1.5
# The slowest tenth of the turns is left out, because other work of the machine disturbed it.
KEPT_SHARE = 0.9
SHOWN = ("haptic/state", "haptic/command", "afm/state", "law/status")
# The end of a ZeroMQ context waits for open sockets, so the sessions are kept.
_sessions: list[Any] = []


def virtual() -> Any:
    """Return the module of the rig in virtual time, which belonged to the tests in earlier versions."""
    import importlib

    try:
        return importlib.import_module("telenano.virtual.rig")
    except ModuleNotFoundError:
        return importlib.import_module("virtual_rig")


def session() -> tuple[Any, dict[str, list[tuple[int, list[Any]]]]]:
    """Return a rig after a session, and by node the time [ns] of each turn and the messages received in it."""
    rig = virtual().VirtualRig(None, 7)
    turns: dict[str, list[tuple[int, list[Any]]]] = {key: [] for key in rig.nodes}
    for key, bus in rig.buses.items():

        def receive(taken: list[tuple[int, list[Any]]] = turns[key], ask: Callable[[], Any] = bus.receive) -> list[Any]:
            taken.append((rig.clock.monotonic_ns(), list(ask())))
            return taken[-1][1]

        bus.receive = receive
    _note_sent(rig)
    for until_s, command in ((0.15, ("arm", "*")), (0.3, ("start", "haptic_node"))):
        rig.run_until(until_s)
        rig.command(*command, **({"place": "hand"} if "arm" in command else {}))
    rig.run_until(SESSION_S)
    _sessions.append(rig)
    return rig, turns


def _note_sent(rig: Any) -> None:
    """Record the messages that every endpoint of a rig sends, for versions that do not record them."""
    if hasattr(rig, "_received"):
        return
    rig.sent, record, epoch_ns = [], rig._record, virtual().EPOCH_OFFSET_NS

    def note(endpoint: str, topic: str, payload: bytes, sent_ns: int) -> None:
        rig.sent.append((endpoint, topic, payload, sent_ns + epoch_ns))
        record(endpoint, topic, payload, sent_ns)

    rig._record = note


def sent(rig: Any) -> list[tuple[str, str, bytes, int]]:
    """Return endpoint, topic, bytes and time [ns] of each message sent."""
    if hasattr(rig, "sent"):
        return list(rig.sent)
    return [(endpoint, topic, payload, at) for at, _, endpoint, topic, payload in rig._received]


class CountingBus:
    """A bus that gives a node the messages of an earlier session, and numbers those that it sends."""

    def __init__(self, rig: Any, turns: list[tuple[int, list[Any]]]) -> None:
        self._rig, self._turns, self._numbers = rig, iter(turns), {}
        self._received: list[Any] = []

    def publish(self, topic: str, **fields: Any) -> Any:
        number = self._numbers[topic] = self._numbers.get(topic, -1) + 1
        return argparse.Namespace(seq=number)

    def send(self, topic: str, payload: bytes) -> None: ...

    def wait(self, deadline_ns: int) -> None:
        at_ns, self._received = next(self._turns)
        self._rig.clock.advance_ns(at_ns - self._rig.clock.monotonic_ns())

    def receive(self) -> list[Any]:
        return self._received

    def sequence_numbers(self) -> dict[str, int]:
        return dict(self._numbers)

    def input_health(self) -> tuple[()]:
        return ()

    def rejections(self) -> tuple[dict[str, int], str]:
        return {}, ""

    def process_events(self, *, now: bool = False) -> tuple[()]:
        return ()

    def has_arrived(self) -> bool:
        return False


def node_turns(key: str) -> Callable[[], float]:
    """Return a function that makes a new node take all turns, and returns the mean time of a turn [us]."""
    from telenano.runtime.loop.node import NodeContext
    from telenano.runtime.loop.node_loop import NodeLoop
    from telenano.runtime.loop.realtime import RealtimeStatus
    from telenano.testing import VirtualClock

    rig, turns = session()

    def run() -> float:
        rig.clock = VirtualClock(start_ns=turns[key][0][0], epoch_offset_ns=virtual().EPOCH_OFFSET_NS)
        bus = rig.buses[key] = CountingBus(rig, turns[key])
        context = NodeContext(key, rig.clock, bus, virtual().QuietLog(key), period_s=1e-3)
        if hasattr(rig, "build"):
            # Messages that the link sends at its own endpoint go nowhere, like those of the others.
            rig._endpoints[key] = bus
            node = rig.build(key, context)
        else:
            node = rig._node(context)
        loop = NodeLoop(node, bus, RealtimeStatus(fifo=True, memory_locked=False))
        return _mean_us(loop.turn for _ in turns[key])

    return run


def receiving() -> Callable[[], float]:
    """Return a function that takes messages from a socket, and returns the mean time of a message [us]."""
    import zmq

    from telenano.runtime.bus.bus import Subscriber, ZmqBus
    from telenano.runtime.bus.publisher import NullPublisher, ZmqPublisher
    from telenano.timing.clock import SystemClock

    clock, context = SystemClock(), zmq.Context[Any]()
    endpoint = f"ipc://{tempfile.mkdtemp()}/a"
    publisher = ZmqPublisher(context, clock, "afm_node@slave", endpoint)
    subscriber = Subscriber(context, clock, {endpoint: ["clock/ping"]}, newest_only=True)
    bus = ZmqBus(NullPublisher(clock, "controller@slave"), [subscriber], clock, os.pipe()[0])

    def arrived() -> Callable[[], Any]:
        for _ in range(200):
            publisher.publish("clock/ping")
            bus.wait(clock.monotonic_ns() + 20_000_000)
            if bus._readable:
                break
        return bus.receive

    return lambda: _mean_us(arrived() for _ in range(1000))


def recording() -> Callable[[], float]:
    """Return a function that records a session, and returns the mean time of a message [us]."""
    import zmq

    from services.recorder.intake import begin_recording
    from telenano.console.listener import Listener
    from telenano.recording.recorder_config import RecorderConfig
    from telenano.runtime.bus.bus import Subscriber
    from telenano.settings.included import SITE_DIRECTORY
    from telenano.timing.clock import SystemClock

    rows = [(endpoint, [topic.encode(), payload], at) for endpoint, topic, payload, at in sent(session()[0])]
    clock, context, number = SystemClock(), zmq.Context[Any](), itertools.count()
    folder = Path(tempfile.mkdtemp())
    subscriber = Subscriber(context, clock, {"inproc://nowhere": ["haptic/state"]}, connect=False)

    def run() -> float:
        config = RecorderConfig(directory=folder / str(next(number)))
        intake = begin_recording("recorder@master", clock, config, SITE_DIRECTORY / "local.yaml", None)
        listeners = {endpoint: Listener(endpoint, subscriber) for endpoint, _, _ in rows}
        begun_ns = time.process_time_ns()
        for endpoint, frames, received_ns in rows:
            intake.record(listeners[endpoint], frames, received_ns)
        intake.flush()
        took_ns = time.process_time_ns() - begun_ns
        intake.finish()
        return took_ns * 1e-3 / len(rows)

    return run


def showing() -> Callable[[], float]:
    """Return a function that feeds a session to a page, and returns the mean time of a message [us]."""
    from services.viz_node.feed import Feed, seen

    rig, _ = session()
    rows = [(topic, rig.messages[payload]) for _, topic, payload, _ in sent(rig) if topic in SHOWN]

    def run() -> float:
        feed = Feed()
        begun_ns = time.process_time_ns()
        for number, (topic, message) in enumerate(rows):
            feed.record(seen(topic, message.src, message.t_ns, message))
            if number % 100 == 99:
                feed.take()
        return (time.process_time_ns() - begun_ns) * 1e-3 / len(rows)

    return run


def _mean_us(calls: Any) -> float:
    spent_ns = []
    for call in calls:
        begun_ns = time.perf_counter_ns()
        call()
        spent_ns.append(time.perf_counter_ns() - begun_ns)
    return statistics.fmean(sorted(spent_ns)[: max(1, int(KEPT_SHARE * len(spent_ns)))]) * 1e-3


def work(part: str) -> None:
    """Print the time of a part for each line that arrives on standard input."""
    others = {"receive": receiving, "record": recording, "show": showing}
    run = others[part]() if part in others else node_turns(part)
    gc.collect()
    gc.freeze()
    gc.disable()
    for _ in sys.stdin:
        print(run(), flush=True)
    # The process ends at once, because the collection of a ZeroMQ context would wait for its sockets.
    os._exit(0)


class Worker:
    """A process that measures a part in a checkout."""

    def __init__(self, folder: Path, part: str) -> None:
        places = os.pathsep.join((str(folder), str(folder / "tests" / "replay")))
        self._process = children.start(
            [sys.executable, str(Path(__file__).resolve()), "--worker", part],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": places},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def measure(self) -> float:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return float(self._process.stdout.readline())

    def end(self) -> None:
        self._process.communicate()


def pairs_of(part: str, before: Path, pairs: int) -> list[tuple[float, float]]:
    """Return pairs of times of a part [us], here and in another checkout, measured one after the other."""
    here, other = Worker(HERE, part), Worker(before, part)
    found: list[tuple[float, float]] = []
    for number in range(pairs + 1):
        order = (here, other) if number % 2 else (other, here)
        times = [worker.measure() for worker in order]
        found.append((times[0], times[1]) if number % 2 else (times[1], times[0]))
    here.end()
    other.end()
    # The first pair is left out, because it finds the caches empty.
    return found[1:]


def main() -> None:
    """Print the time of each part and its ratio; `--smoke` takes one pair of two parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", default=PARTS)
    parser.add_argument("--before", type=Path, default=HERE)
    parser.add_argument("--pairs", type=int, default=30)
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    parser.add_argument("--smoke", action="store_true")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.worker:
        work(given.worker)
        return
    if given.smoke:
        given.parts, given.pairs = ("controller@master", "show"), 1
    # A worker runs in another checkout, which may not have the module.
    from versions import compared, shown

    measured = {part: pairs_of(part, given.before.resolve(), given.pairs) for part in given.parts}
    ratios = compared(measured)
    us = {part: statistics.median(mine for mine, _ in pairs) for part, pairs in measured.items()}
    if given.json:
        print(json.dumps({"parts": {part: {"us": us[part], **shown(ratio)} for part, ratio in ratios.items()}}))
        return
    for part, ratio in ratios.items():
        print(f"{part}: {us[part]:.2f} us, {ratio.told()} of before")


if __name__ == "__main__":
    main()
