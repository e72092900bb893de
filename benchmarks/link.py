"""How exactly the link keeps a delay, and what it costs when it does nothing.

    python benchmarks/link.py [--duration S] [--json]

A source sends teleop/forward and teleop/backward at 3 kHz each (as much as six topics at 1 kHz) through a real
`delay_node` process; a sink subscribes to the source itself and to the link. At 100 ms the benchmark measures the error
of the delay: the time from the source's stamp to the sink's, less 100 ms, so it includes two hops. At 0 ms it measures
the median latency through the link as a ratio to that of the direct subscription, in the same run.
"""

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import yaml
import zmq

from telenano.runtime.bus.bus import Subscriber
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.realtime import apply_realtime, freeze_garbage, shallow_idle
from telenano.settings.scenario import RealtimeConfig
from telenano.signals import children
from telenano.timing.clock import EPOCH_OFFSET_VARIABLE, SystemClock

BURST = 3
PERIOD_NS = 1_000_000
DELAY_S = 0.100
VECTOR = (0.0, 0.0, -7.123456789e-3)
SIGNAL = {
    "law": "virtual_impedance",
    "active": True,
    "position_m": VECTOR,
    "velocity_m_per_s": VECTOR,
    "force_n": VECTOR,
    "wave_sqrt_w": None,
    "energy_j": None,
    "hand_seq": 0,
    "hand_t_ns": 0,
}
ANSWER = {**SIGNAL, "separation_m": 1e-9, "separation_valid": True, "in_contact": True}


def endpoints(folder: Path) -> dict[str, str]:
    """Return the address book of the three processes."""
    nodes = ("controller@master", "controller@slave", "delay_node@master", "delay_node@slave", "afm_node@slave")
    return {node: f"ipc://{folder}/{node}" for node in nodes}


def source(book: dict[str, str], ticks: int, go: Connection) -> None:
    """Send a burst of each topic at every tick of an absolute grid."""
    apply_realtime(RealtimeConfig(cpus="free"), StructuredLog("source"), "source@master")
    clock, context = SystemClock(), zmq.Context[zmq.Socket[bytes]]()
    master = ZmqPublisher(context, clock, "controller@master", book["controller@master"])
    slave = ZmqPublisher(context, clock, "controller@slave", book["controller@slave"])
    go.recv()
    freeze_garbage()
    deadline = clock.monotonic_ns()
    for _ in range(ticks):
        deadline += PERIOD_NS
        time.sleep(max(0, deadline - clock.monotonic_ns()) * 1e-9)
        for _ in range(BURST):
            master.publish("teleop/forward", **SIGNAL)
            slave.publish("teleop/backward", **ANSWER)
    go.recv()
    master.close()
    slave.close()
    context.term()


def sink(book: dict[str, str], result: Connection, go: Connection) -> None:
    """Stamp the messages from the source and from the link; send ages [ns] and losses by way through `result`."""
    apply_realtime(RealtimeConfig(cpus="free"), StructuredLog("sink"), "sink@slave")
    clock, context = SystemClock(), zmq.Context[zmq.Socket[bytes]]()
    plans = {
        "direct": {book["controller@master"]: ["teleop/forward"], book["controller@slave"]: ["teleop/backward"]},
        "link": {book["delay_node@slave"]: ["teleop/forward"], book["delay_node@master"]: ["teleop/backward"]},
    }
    readers = {way: Subscriber(context, clock, plan) for way, plan in plans.items()}
    ages: dict[str, list[int]] = {way: [] for way in readers}
    poller = zmq.Poller()
    for reader in readers.values():
        poller.register(reader.socket, zmq.POLLIN)
    result.send("listening")
    freeze_garbage()
    while not go.poll():
        poller.poll(50)
        for way, reader in readers.items():
            ages[way] += [received.received_ns - received.message.t_ns for received in reader.receive()]
    lost = {way: sum(tracker.lost for tracker in reader.trackers.values()) for way, reader in readers.items()}
    result.send((ages, lost))
    for reader in readers.values():
        reader.close()
    context.term()


def run(delay_s: float, duration_s: float) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    """Return the ages [ms] of a run through the link and past it, and the number of lost messages, by way."""
    with tempfile.TemporaryDirectory() as name, shallow_idle():
        folder = Path(name)
        book = endpoints(folder)
        (folder / "site.yaml").write_text(yaml.safe_dump({"nodes": book}))
        scenario: dict[str, Any] = {
            "name": "link",
            "description": "benchmark of the link",
            "duration_s": 1.0,
            "delay_node": {"forward": {"delay_s": delay_s}, "backward": {"delay_s": delay_s}},
        }
        (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario))
        os.environ[EPOCH_OFFSET_VARIABLE] = str(time.time_ns() - time.monotonic_ns())
        command = [sys.executable, "-m", "services.delay_node", "--with-parent"]
        command += ["--site-file", str(folder / "site.yaml"), "--scenario", str(folder / "scenario.yaml")]
        link = children.start(command, stderr=subprocess.DEVNULL)
        context = multiprocessing.get_context("spawn")
        pipes = [context.Pipe() for _ in range(3)]
        sender = context.Process(target=source, args=(book, round(duration_s * 1000), pipes[0][1]))
        receiver = context.Process(target=sink, args=(book, pipes[1][0], pipes[2][1]))
        with children.spawning_workers():
            sender.start()
            receiver.start()
        pipes[1][1].recv()
        time.sleep(2.0)
        pipes[0][0].send("go")
        time.sleep(duration_s + delay_s + 1.0)
        pipes[2][0].send("stop")
        ages, lost = pipes[1][1].recv()
        pipes[0][0].send("stop")
        for process in (sender, receiver):
            process.join()
        link.terminate()
        link.wait()
    return {way: np.array(values) * 1e-6 for way, values in ages.items()}, lost


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--duration", type=float, default=5.0, help="length of each run [s]")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    if given.smoke:
        given.duration = 0.5
    delayed, lost = run(DELAY_S, given.duration)
    clean, lost_clean = run(0.0, given.duration)
    error = delayed["link"] - DELAY_S * 1e3
    report = {
        "messages_per_s": 2 * BURST * 1000,
        "delay_error_ms": {"p50": float(np.median(error)), "p99": float(np.percentile(np.abs(error), 99))},
        "direct_ms": {"p50": float(np.median(clean["direct"])), "p99": float(np.percentile(clean["direct"], 99))},
        "through_ms": {"p50": float(np.median(clean["link"])), "p99": float(np.percentile(clean["link"], 99))},
        "ratio": float(np.median(clean["link"]) / np.median(clean["direct"])),
        "lost": lost["link"] + lost_clean["link"],
    }
    if given.json:
        print(json.dumps(report))
        return
    for key, value in report.items():
        print(f"{key:20}{value}")


if __name__ == "__main__":
    main()
