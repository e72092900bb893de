"""The age of the newest sample at each tick over a bad network: ZeroMQ over TCP, bare datagrams, and the link's own.

    python benchmarks/wide_area.py [--delays-ms 10,50,100] [--losses 0,0.01,0.02,0.05,0.1] [--seconds S] [--json]

The cable of tests/stack/tun_cable.py joins two network namespaces. At one end a process sends teleop/forward at 1 kHz,
at the other end a process checks the age of the newest sample each millisecond. The benchmark needs root and the
command `ip`. Because the cable is a process too, the number of packets that it handed over more than a millisecond
late, and its longest time without a processor, are printed with each result.
"""

import argparse
import contextlib
import itertools
import json
import os
import secrets
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from telenano.signals import children

ROOT = Path(__file__).resolve().parents[1]
TUN_CABLE = ROOT / "tests" / "stack" / "tun_cable.py"
THERE, HERE = "10.78.0.1", "10.78.0.2"
PORT = 5704
WAYS = ("tcp", "bare", "link")
# The time before the ages count, for connections, keys, and TCP's first windows [s].
_WARM_UP_S = 2.0


@contextmanager
def cable(delay_s: float, loss: float, seed: int) -> Iterator[tuple[tuple[str, str], Callable[[], dict[str, Any]]]]:
    """Join two new namespaces; yield their names and a function that returns the counts of the cable."""
    token = secrets.token_hex(3)
    names = (f"wa{token}", f"wb{token}")
    for name in names:
        children.run(["ip", "netns", "add", name], check=True)
    wire = None
    try:
        command = [sys.executable, str(TUN_CABLE), names[0], f"{THERE}/24", names[1], f"{HERE}/24"]
        options = ["--delay-s", str(delay_s), "--loss", str(loss), "--seed", str(seed)]
        wire = children.start([*command, *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert wire.stdin is not None
        assert wire.stdout is not None
        assert wire.stdout.readline() == "ready\n"
        questions, answers = wire.stdin, wire.stdout

        def ask() -> dict[str, Any]:
            questions.write("{}\n")
            questions.flush()
            found: dict[str, Any] = json.loads(answers.readline())
            return found

        yield names, ask
    finally:
        if wire is not None:
            wire.kill()
            wire.wait()
        for name in names:
            children.run(["ip", "netns", "del", name], check=False)


def send(way: str, seconds: float, folder: Path) -> None:
    """Run the sending end."""
    from telenano.runtime.loop.realtime import shallow_idle

    with shallow_idle():
        if way == "link":
            _run_link(seconds, folder, sending=True)
        else:
            _send_plain(way)


def _send_plain(way: str) -> None:
    import zmq
    from link import SIGNAL

    from telenano.wire import compose

    payload = compose("teleop/forward", {"seq": 0, "t_ns": 0, "src": "controller@master", "v": 1, **SIGNAL}, print)[1]
    context = zmq.Context()
    publisher, bare = context.socket(zmq.PUB), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    publisher.bind(f"tcp://{THERE}:{PORT}")
    begin_ns = time.monotonic_ns()
    # The loop runs until the process is ended.
    for tick in itertools.count(1):
        time.sleep(max(0, begin_ns + tick * 1_000_000 - time.monotonic_ns()) * 1e-9)
        sample = time.monotonic_ns().to_bytes(8, "big") + payload
        if way == "tcp":
            publisher.send(sample)
        else:
            bare.sendto(sample, (HERE, PORT))


def receive(way: str, seconds: float, folder: Path) -> list[float]:
    """Run the receiving end; return the age of the newest sample at each millisecond [ms]."""
    from telenano.runtime.loop.realtime import shallow_idle

    with shallow_idle():
        return _run_link(seconds, folder, sending=False) if way == "link" else _receive_plain(way, seconds)


def _receive_plain(way: str, seconds: float) -> list[float]:
    import zmq

    context = zmq.Context()
    reader, bare = context.socket(zmq.SUB), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    reader.subscribe(b"")
    reader.connect(f"tcp://{THERE}:{PORT}")
    bare.bind((HERE, PORT))
    bare.setblocking(False)
    newest = 0

    def take() -> int:
        found = newest
        while True:
            try:
                data = reader.recv(zmq.DONTWAIT) if way == "tcp" else bare.recv(2048)
            except (zmq.Again, BlockingIOError):
                return found
            found = max(found, int.from_bytes(data[:8], "big"))

    ages: list[float] = []
    begin_ns = time.monotonic_ns()
    for tick in range(round((_WARM_UP_S + seconds) * 1e3)):
        due = begin_ns + tick * 1_000_000
        time.sleep(max(0, due - time.monotonic_ns()) * 1e-9)
        newest = take()
        if newest and tick >= _WARM_UP_S * 1e3:
            ages.append((time.monotonic_ns() - newest) * 1e-6)
    context.destroy(linger=0)
    return ages


def _run_link(seconds: float, folder: Path, *, sending: bool) -> list[float]:
    """Run an end of the link with keys agreed over CURVE as in a rig; return the ages of the newest sample [ms]."""
    from link import ANSWER, SIGNAL

    from telenano.runtime.bus.address_book import AddressBook
    from telenano.runtime.loop.log import StructuredLog
    from telenano.runtime.security.keyring import Keyring
    from telenano.runtime.wiring.participant import Participant
    from telenano.runtime.wiring.transport import Transport, open_context
    from telenano.timing.clock import SystemClock

    nodes = {"delay_node@slave": f"tcp://{THERE}:{PORT}", "controller@slave": f"tcp://{HERE}:{PORT + 7}"}
    book = AddressBook.model_validate({"machines": {"master": THERE, "slave": HERE}, "nodes": nodes})
    key, peer = ("delay_node@slave", "controller@slave") if sending else ("controller@slave", "delay_node@slave")
    topic, wanted = ("teleop/forward", "teleop/backward") if sending else ("teleop/backward", "teleop/forward")
    with open_context(serves_network=True) as context:
        clock, machine = SystemClock(0), "master" if sending else "slave"
        network = Transport(context, clock, book, machine, Keyring(folder / machine))
        participant = Participant(
            key=key, book=book, clock=clock, log=StructuredLog(key), network=network, wake_descriptor=-1
        )
        publisher = participant.bind(key)
        readers = participant.subscribers({peer: [wanted]}, newest_only=True)
        ends = participant.datagrams(publisher, publisher, readers)
        ages: list[float] = []
        newest = 0
        begin_ns = time.monotonic_ns()
        ticks = itertools.count(1) if sending else range(1, round((seconds + 2 * _WARM_UP_S) * 1e3))
        for tick in ticks:
            due = begin_ns + tick * 1_000_000
            time.sleep(max(0, due - time.monotonic_ns()) * 1e-9)
            for reader in (*ends, *readers):
                for received in reader.receive(signalled=reader in ends):
                    newest = max(newest, received.message.t_ns)
            if tick % 400 == 0:
                for event in network.process_events():
                    print(event.text, file=sys.stderr)
            publisher.publish(topic, **(SIGNAL if sending else ANSWER))
            if newest and tick > 2e3 * _WARM_UP_S:
                ages.append((time.monotonic_ns() - newest) * 1e-6)
        for socket_of in (*readers, publisher):
            socket_of.close()
        network.close()
    return ages


def measure(way: str, delay_s: float, loss: float, seconds: float) -> tuple[list[float], str]:
    """Return the ages [ms] of one way over one network, and the lateness of the cable itself in words."""
    with cable(delay_s, loss, seed=1) as (names, ask), tempfile.TemporaryDirectory() as folder:
        if way == "link":
            make_keys(Path(folder))
        base = [sys.executable, __file__, "--be"]
        common = ["--way", way, "--seconds", str(seconds), "--folder", folder]
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
        sender = children.start(["ip", "netns", "exec", names[0], *base, "send", *common], env=environment)
        receiver = ["ip", "netns", "exec", names[1], *base, "receive", *common]
        try:
            done = children.run(receiver, stdout=subprocess.PIPE, check=True, timeout=seconds + 60, env=environment)
            counts = ask()
        finally:
            sender.kill()
            sender.wait()
    held_up_ms = max((ms for _, ms in counts["held_up"]), default=0.0)
    late = f"cable: {counts['late']} of {counts['delivered']} late, {held_up_ms:.0f} ms at most"
    return [float(age) for age in json.loads(done.stdout)], late


def make_keys(folder: Path) -> None:
    """Create keys so that both machines know each other."""
    from telenano.runtime.security.keyring import Keyring

    rings = {name: Keyring(folder / name) for name in ("master", "slave")}
    public = {name: ring.create(name).public.decode() for name, ring in rings.items()}
    rings["master"].allow("slave", public["slave"], ["data"])
    rings["slave"].allow("master", public["master"], ["data", "control"])


def numbers(text: str) -> list[float]:
    """Return the numbers of a text in which commas separate them."""
    return [float(word) for word in text.split(",")]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--delays-ms", type=numbers, default=[10.0, 50.0, 100.0])
    parser.add_argument("--losses", type=numbers, default=[0.0, 0.01, 0.02, 0.05, 0.1])
    parser.add_argument("--seconds", type=float, default=5.0, help="measured time of each")
    parser.add_argument("--ways", default=",".join(WAYS), help="which of " + ",".join(WAYS))
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object a line")
    parser.add_argument("--be", choices=("send", "receive"), help=argparse.SUPPRESS)
    parser.add_argument("--way", choices=WAYS, help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.smoke:
        given.delays_ms, given.losses, given.seconds = [10.0], [0.0], 0.5
    if given.be is not None:
        # The nodes of a rig have this scheduling, too.
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    if given.be == "send":
        send(given.way, given.seconds, given.folder)
        return
    if given.be == "receive":
        print(json.dumps(receive(given.way, given.seconds, given.folder)))
        return
    if not given.json:
        print("age of the newest sample at each millisecond, p50 / p99 / max [ms]")
    for delay_ms in given.delays_ms:
        for loss in given.losses:
            row: dict[str, Any] = {"delay_ms": delay_ms, "loss": loss}
            for way in given.ways.split(","):
                ages, row[f"{way}_cable"] = measure(way, delay_ms * 1e-3, loss, given.seconds)
                row[way] = [round(float(np.percentile(ages, q)), 1) for q in (50, 99, 100)] if ages else []
            if given.json:
                print(json.dumps(row), flush=True)
            else:
                figures = (
                    f"{way} {' / '.join(map(str, row[way]))} ({row[f'{way}_cable']})" for way in given.ways.split(",")
                )
                print(f"{delay_ms:5.0f} ms {loss:5.1%}  " + "   ".join(figures), flush=True)


if __name__ == "__main__":
    main()
