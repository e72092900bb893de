"""The age of the zero-delay loop, as a ratio to the same hops over bare Unix-domain sockets in the same run.

    python benchmarks/loop.py [--rounds N] [--duration S] [--json]

The floor: five processes pass bytes of the very sizes of our messages along the eight hops of the loop
(hand, master half, link, slave half, AFM, slave half, link, master half, hand) over connected Unix-domain sockets,
paced at 1 kHz, doing nothing else. It is measured twice: `plain`, as any program would run, and `placed`, under the
scheduling that the rig's nodes ask for (SCHED_FIFO, a processor for each side of the link). The rig: `telenano up
--scenario fig12`, the age of the loop as its own recording has it. All take turns, and the medians of the rounds are
compared.
"""

import argparse
import json
import multiprocessing
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from proto import encode
from proto.messages import (
    AfmCommand,
    AfmState,
    HapticCommand,
    HapticState,
    Message,
    TeleopBackward,
    TeleopForward,
)
from services.runtime.log import StructuredLog
from services.runtime.realtime import RealtimeConfig, apply_realtime, freeze_garbage, shallow_idle

PERIOD_NS = 1_000_000
SPIN_NS = 100_000


def hop_sizes() -> dict[str, int]:
    """Give the bytes of each message of the loop, topic frame included."""
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
    return {topic: len(topic) + len(encode(message)) for topic, message in messages.items()}


def relay(node: str, placed: bool, near: socket.socket, far: socket.socket, there: bytes, back: bytes) -> None:
    """Pass a message on and its answer back, until the near side closes."""
    prepare(node, placed)
    while near.recv(4096):
        far.send(there)
        far.recv(4096)
        near.send(back)


def turn(placed: bool, near: socket.socket, answer: bytes) -> None:
    """Answer every message."""
    prepare("afm_node@slave", placed)
    while near.recv(4096):
        near.send(answer)


def prepare(node: str, placed: bool) -> None:
    """Ask for the scheduling that the rig's nodes ask for, if it is wanted."""
    if placed:
        apply_realtime(RealtimeConfig(), StructuredLog("floor"), node)
    freeze_garbage()


def measure_floor(ticks: int, *, placed: bool) -> list[float]:
    """Give the age [ms] of each of `ticks` round trips over eight hops of Unix-domain sockets."""
    sizes = {topic: bytes(size) for topic, size in hop_sizes().items()}
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(4)]
    there = [sizes["teleop/forward"], sizes["teleop/forward"], sizes["afm/command"]]
    back = [sizes["haptic/command"], sizes["teleop/backward"], sizes["teleop/backward"]]
    context = multiprocessing.get_context("fork")
    relays = enumerate(("controller@master", "delay_node@master", "controller@slave"))
    tasks = [(node, placed, pairs[hop][1], pairs[hop + 1][0], there[hop], back[hop]) for hop, node in relays]
    workers = [context.Process(target=relay, args=task, daemon=True) for task in tasks]
    workers.append(context.Process(target=turn, args=(placed, pairs[3][1], sizes["afm/state"]), daemon=True))
    for worker in workers:
        worker.start()
    master = context.Pipe(duplex=False)
    pacer = context.Process(
        target=pace, args=(placed, pairs[0][0], sizes["haptic/state"], ticks, master[1]), daemon=True
    )
    pacer.start()
    ages: list[float] = master[0].recv()
    for process in (pacer, *workers):
        process.terminate()
        process.join()
    for pair in pairs:
        for end in pair:
            end.close()
    return ages


def pace(
    placed: bool, near: socket.socket, payload: bytes, ticks: int, result: "multiprocessing.connection.Connection"
) -> None:
    """Send on an absolute grid as the haptic node does and time the answers."""
    prepare("haptic_node@master", placed)
    ages = []
    deadline = time.monotonic_ns() + 200 * PERIOD_NS
    for _ in range(ticks):
        deadline += PERIOD_NS
        time.sleep(max(0, deadline - SPIN_NS - time.monotonic_ns()) * 1e-9)
        while time.monotonic_ns() < deadline:
            pass
        start = time.monotonic_ns()
        near.send(payload)
        near.recv(4096)
        ages.append((time.monotonic_ns() - start) * 1e-6)
    result.send(ages)


def measure_rig(duration_s: float) -> dict[str, float]:
    """Give p50, p99 and max [ms] of the age of the loop of one run of the rig."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "TELENANO_RUNTIME_DIR": folder}
        command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--json"]
        command += ["--duration", str(duration_s), "--out", str(Path(folder) / "out")]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    age: dict[str, float] = json.loads(done.stdout)["loop_age_ms"]
    return age


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=3, help="turns of floor and rig")
    parser.add_argument("--duration", type=float, default=5.0, help="length of each turn [s]")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    rounds: dict[str, list[dict[str, float]]] = {"plain": [], "placed": [], "rig": []}
    for _ in range(given.rounds):
        for floor in ("plain", "placed"):
            with shallow_idle():
                ages = sorted(measure_floor(round(given.duration * 1000), placed=floor == "placed"))
            rounds[floor].append({"p50": statistics.median(ages), "p99": ages[int(0.99 * len(ages))], "max": ages[-1]})
        rounds["rig"].append(measure_rig(given.duration))
    ages_ms = {
        name: {key: statistics.median(found[key] for found in turns) for key in ("p50", "p99", "max")}
        for name, turns in rounds.items()
    }
    ratios = {
        floor: {key: ages_ms["rig"][key] / ages_ms[floor][key] for key in ("p50", "p99", "max")}
        for floor in ("plain", "placed")
    }
    if given.json:
        print(json.dumps({"age_ms": ages_ms, "ratio": ratios}))
        return
    print(f"{'':28}{'p50':>9}{'p99':>9}{'max':>9}")
    for name, label in (("plain", "sockets, plain, ms"), ("placed", "sockets, placed, ms"), ("rig", "rig, ms")):
        print(f"{label:28}" + "".join(f"{value:9.3f}" for value in ages_ms[name].values()))
    for floor, ratio in ratios.items():
        print(f"{'rig / sockets, ' + floor:28}" + "".join(f"{value:9.2f}" for value in ratio.values()))


if __name__ == "__main__":
    main()
