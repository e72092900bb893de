"""What crossing between two machines costs: plain TCP, CURVE, sealed datagrams, with a Unix socket as the floor.

    python benchmarks/network.py [--rounds N] [--messages N] [--json]

Two processes on this machine take the places of the two machines. They send checked messages as the rig does, at 1 kHz:
the first sends teleop/forward, the second answers each with teleop/backward, and the first measures the time from its
send to the answer. The five ways alternate in short runs, so that other load on the machine affects all alike. The
processor time is that of both processes, including their ZeroMQ threads.
"""

import argparse
import asyncio
import json
import multiprocessing
import os
import socket
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import zmq
from link import ANSWER, SIGNAL
from telenano_wide_area.relay.protocol import RELAY, split_host_port
from telenano_wide_area.relay.server import Relay
from telenano_wide_area.relay.site_end import SiteEnd

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.realtime import ahead_of_others, apply_realtime, freeze_garbage, shallow_idle
from telenano.runtime.security.access_control import AccessControl
from telenano.runtime.security.keyring import KEYS_DIRECTORY_VARIABLE, Keyring
from telenano.runtime.wiring.participant import Participant
from telenano.runtime.wiring.transport import Transport, open_context
from telenano.settings.scenario import RealtimeConfig
from telenano.signals import children
from telenano.timing.clock import SystemClock

PERIOD_NS = 1_000_000
# The two ends of the link between the machines.
MASTER, SLAVE = "delay_node@slave", "controller@slave"
WAYS = ("ipc", "plain", "curve", "datagram", "relayed")
WARM_UP = 200
# A run ends early after twenty times this without an answer [s].
LOST_S = 1.0


def book_of(way: str, folder: Path, ports: tuple[int, int]) -> AddressBook:
    """Return the address book of the two processes for a way of transport."""
    if way == "ipc":
        return AddressBook(nodes={node: f"ipc://{folder}/{node}" for node in (MASTER, SLAVE)})
    nodes = {node: f"tcp://127.0.0.1:{port}" for node, port in zip((MASTER, SLAVE), ports, strict=True)}
    if way == "relayed":
        # Two ends on one machine would find the direct path past the relay at once.
        link = {"transport": "datagram", "direct": False}
        return AddressBook(nodes=nodes, link=link, relay=f"127.0.0.1:{free_port()}")
    link = {"transport": "datagram" if way == "datagram" else "stream"}
    return AddressBook(nodes=nodes, insecure=way == "plain", link=link)


def carry(book: AddressBook) -> None:
    """Run the relay, and the ends of both machines that dial it, until killed."""
    ahead_of_others()
    asyncio.run(_carry(book))


async def _carry(book: AddressBook) -> None:
    relay = Relay(AccessControl(RELAY, Keyring(), requires_keys=True), StructuredLog(RELAY))
    await relay.start(*split_host_port(book.relay))
    ends = []
    for machine in ("master", "slave"):
        access = AccessControl(machine, Keyring(), requires_keys=True)
        ends.append(SiteEnd(book, machine, access, StructuredLog(machine)).run())
    await asyncio.gather(*ends)


def exchange(node: str, peer: str, book: AddressBook, messages: int, pipe: Connection) -> None:
    """Run one of the two machines; send round trips [ns] (none if it answers) and processor time [s] through `pipe`."""
    own_cpu = RealtimeConfig(cpus={node: 0 if node == MASTER else os.cpu_count() - 1})
    apply_realtime(own_cpu, StructuredLog(node), node)
    with open_context(serves_network=book.spans_machines) as context:
        clock = SystemClock()
        network = Transport(context, clock, book, book.machine_of(node))
        publisher = network.publisher(node)
        topic = "teleop/backward" if node == MASTER else "teleop/forward"
        readers = [reader for reader in network.subscribers({peer: [topic]}) if reader.topics]
        log = StructuredLog(node)
        participant = Participant(key=node, book=book, clock=clock, log=log, network=network, wake_descriptor=-1)
        ends = participant.link_ends(publisher, publisher, readers)
        poller = zmq.Poller()
        for descriptor in (*(reader.socket for reader in (*ends.readers, *readers)), *network.descriptors):
            poller.register(descriptor, zmq.POLLIN)
        freeze_garbage()
        pipe.send("ready")
        trips: list[int] = []
        count, deadline, cpu_s = 0, clock.monotonic_ns() + 50 * PERIOD_NS, 0.0
        silent_since = time.monotonic()
        asking = node == MASTER
        while count < messages and not (not asking and pipe.poll()):
            if asking:
                # A late tick is not made up for: back-to-back sending is another load, and more than the link's send
                # budget.
                deadline = max(deadline + PERIOD_NS, clock.monotonic_ns())
                time.sleep(max(0, deadline - clock.monotonic_ns()) * 1e-9)
                sent_ns = clock.monotonic_ns()
                publisher.publish("teleop/forward", **SIGNAL)
            answered = False
            until = time.monotonic() + (0.02 if asking else 0.1)
            while not answered and time.monotonic() < until:
                ready = {found for found, _ in poller.poll(20)}
                network.process_events()
                for reader in (*ends.readers, *readers):
                    for _ in reader.receive(signalled=reader.descriptor in ready):
                        answered = True
            if answered and asking:
                trips.append(clock.monotonic_ns() - sent_ns)
                count += 1
                if count == WARM_UP:
                    cpu_s = time.process_time()
                silent_since = time.monotonic()
            elif answered:
                publisher.publish("teleop/backward", **ANSWER)
                count += 1
                cpu_s = cpu_s or time.process_time()
            # The loop of a node asks its end in every turn, even without a message, because the end then does its due
            # work.
            for end in ends.readers:
                end.receive()
            if asking and time.monotonic() - silent_since > 20 * LOST_S:
                break
        pipe.send((trips[WARM_UP:], time.process_time() - cpu_s))
        publisher.close()
        for reader in readers:
            reader.close()
        network.close()


def run(way: str, folder: Path, messages: int) -> tuple[list[int], float]:
    """Return the round trips [ns] of a run and the processor time of both processes [s]."""
    book = book_of(way, folder, (free_port(), free_port()))
    spawn = multiprocessing.get_context("spawn")
    pipes = [spawn.Pipe() for _ in (MASTER, SLAVE)]
    pairs = ((MASTER, SLAVE), (SLAVE, MASTER))
    processes = [
        spawn.Process(target=exchange, args=(node, peer, book, messages if node == MASTER else 1 << 40, end))
        for (node, peer), (_, end) in zip(pairs, pipes, strict=True)
    ]
    relay = [spawn.Process(target=carry, args=(book,), daemon=True)] if book.relay else []
    with children.spawning_workers():
        for process in (*relay, *processes):
            process.start()
    for mine, _ in pipes:
        mine.recv()
    trips, cpu_s = pipes[0][0].recv()
    pipes[1][0].send("stop")
    _, answering_s = pipes[1][0].recv()
    for process in relay:
        process.kill()
    for process in processes:
        process.join()
    return trips, cpu_s + answering_s


def free_port() -> int:
    """Return a TCP port that is free at the moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def make_keys(folder: Path) -> None:
    """Create keys so that both machines and the relay know each other."""
    os.environ[KEYS_DIRECTORY_VARIABLE] = str(folder)
    ring = Keyring(folder)
    for name in ("master", "slave", RELAY):
        ring.allow(name, ring.create(name).public.decode(), ["data", "relay"])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=3, help="runs of each way")
    parser.add_argument("--messages", type=int, default=3000, help="messages a run")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    if given.smoke:
        given.rounds, given.messages = 1, 1000
    trips: dict[str, list[int]] = {way: [] for way in WAYS}
    cpu_s = dict.fromkeys(WAYS, 0.0)
    with tempfile.TemporaryDirectory() as name, shallow_idle():
        make_keys(Path(name) / "keys")
        for _ in range(given.rounds):
            for way in WAYS:
                found, used_s = run(way, Path(name), given.messages)
                trips[way] += found
                cpu_s[way] += used_s
    ms = {way: np.array(values) * 1e-6 for way, values in trips.items()}
    p50, p99 = ({way: float(np.percentile(ms[way], q)) for way in WAYS} for q in (50, 99))
    report = {
        "round_trip_p50_ms": p50,
        "round_trip_p99_ms": p99,
        "cpu_us_a_round_trip": {way: cpu_s[way] / len(trips[way]) * 1e6 for way in WAYS},
        "curve_to_plain": {
            "p50": p50["curve"] / p50["plain"],
            "p99": p99["curve"] / p99["plain"],
            "cpu": (cpu_s["curve"] / len(trips["curve"])) / (cpu_s["plain"] / len(trips["plain"])),
        },
        "datagram_to_curve": {
            "p50": p50["datagram"] / p50["curve"],
            "p99": p99["datagram"] / p99["curve"],
            "cpu": (cpu_s["datagram"] / len(trips["datagram"])) / (cpu_s["curve"] / len(trips["curve"])),
        },
        # The processor time of the relay is not included here.
        "relayed_to_datagram": {
            "p50": p50["relayed"] / p50["datagram"],
            "p99": p99["relayed"] / p99["datagram"],
            "cpu": (cpu_s["relayed"] / len(trips["relayed"])) / (cpu_s["datagram"] / len(trips["datagram"])),
        },
    }
    if given.json:
        print(json.dumps(report))
        return
    for key, value in report.items():
        print(f"{key:22}" + "  ".join(f"{way} {figure:.3f}" for way, figure in value.items()))


if __name__ == "__main__":
    main()
