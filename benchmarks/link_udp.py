"""What `telenano link udp` adds to datagrams, beside a bare forwarder of them.

The benchmark sends datagrams that carry their time of sending at a fixed rate through the link, with the network
`clean`, and in turn through a process that only reads and sends on. Each round takes the same time for both. The
forwarders have one processor, sender and receiver another one.

python benchmarks/link_udp.py
"""

import argparse
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from telenano.signals import children

SIZE_BYTES = 200
_STAMP = struct.Struct("<Q")
_SETTLE_S, _TAIL_S = 0.5, 0.5
_QUANTILES = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}

BARE = """
import select, socket, sys
listening, target = int(sys.argv[1]), int(sys.argv[2])
here, there = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
here.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
here.bind(("127.0.0.1", listening))
there.connect(("127.0.0.1", target))
here.setblocking(False)
print("ready", flush=True)
try:
    while True:
        select.select([here], [], [])
        try:
            while True:
                there.send(here.recv(65536))
        except (BlockingIOError, ConnectionRefusedError):
            pass
except KeyboardInterrupt:
    pass
"""


def main() -> None:
    """Print a row for each forwarder."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rate", type=float, default=5000.0, help="datagrams a second; 5000")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each round; 10")
    parser.add_argument("--rounds", type=int, default=3, help="rounds; 3")
    parser.add_argument("--smoke", action="store_true", help="one round of a second at a fifth of the rate")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    if given.smoke:
        given.rate, given.seconds, given.rounds = 1000.0, 1.0, 1
    found: dict[str, list[dict[str, float]]] = {"bare": [], "link": []}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(given.rounds):
            for name, rows in found.items():
                rows.append(measured(name, Path(folder), given.rate, given.seconds))
    median = {
        name: {key: float(np.median([row[key] for row in rows])) for key in rows[0]} for name, rows in found.items()
    }
    ratio = {key: median["link"][f"{key}_ms"] / median["bare"][f"{key}_ms"] for key in _QUANTILES}
    added = {key: median["link"][f"{key}_ms"] - median["bare"][f"{key}_ms"] for key in _QUANTILES}
    if given.json:
        print(json.dumps({"median": median, "ratio": ratio, "added_ms": added, "rate_per_s": given.rate}))
        return
    for name, row in median.items():
        print(f"{name:5s}" + "".join(f"  {key} {value:.3f}" for key, value in row.items()))
    print("added" + "".join(f"  {key}_ms {value:.3f}" for key, value in added.items()))


def measured(name: str, folder: Path, rate_per_s: float, seconds: float) -> dict[str, float]:
    """Return quantiles of the delay of a datagram [ms], the share lost, and the forwarder's share of a processor."""
    processors = sorted(os.sched_getaffinity(0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        receiver.bind(("127.0.0.1", 0))
        listening, target = free_port(), receiver.getsockname()[1]
        with started(name, folder, listening, target) as process:
            os.sched_setaffinity(process.pid, processors[-1:])
            os.sched_setaffinity(0, processors[:1])
            try:
                process_s = processor_time_s(process.pid)
                ways_ms, sent = exchanged(receiver, listening, rate_per_s, seconds)
                used = (processor_time_s(process.pid) - process_s) / seconds
            finally:
                os.sched_setaffinity(0, processors)
                process.send_signal(signal.SIGINT)
                process.wait(20.0)
    quantiles = {f"{key}_ms": float(np.quantile(ways_ms, share)) for key, share in _QUANTILES.items()}
    return {**quantiles, "lost": 1.0 - len(ways_ms) / sent, "processor": used}


def started(name: str, folder: Path, listening: int, target: int) -> "subprocess.Popen[str]":
    """Start a forwarder and return its process once it is ready; SystemExit if it does not begin."""
    command = [sys.executable, "-c", BARE, str(listening), str(target)]
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(folder)}
    if name == "link":
        command = [sys.executable, "-m", "telenano", "link", "udp", str(listening), f"127.0.0.1:{target}"]
    process = children.start(command, env=environment, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    if not process.stdout.readline():
        raise SystemExit(f"{name}: did not begin")
    time.sleep(_SETTLE_S)
    return process


def exchanged(
    receiver: socket.socket, listening: int, rate_per_s: float, seconds: float
) -> tuple["np.ndarray[Any, np.dtype[np.float64]]", int]:
    """Send stamped datagrams at a rate; return the delays of those that arrived [ms], and the number sent.

    Raises SystemExit if no datagram arrived.
    """
    receiver.setblocking(False)
    padding = bytes(SIZE_BYTES - _STAMP.size)
    taken_ns: list[int] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", listening))
        begun_ns, sent, total = time.perf_counter_ns(), 0, round(rate_per_s * seconds)
        end_ns = begun_ns + round((seconds + _TAIL_S) * 1e9)
        while (now_ns := time.perf_counter_ns()) < end_ns:
            if sent < total and now_ns >= begun_ns + round(sent * 1e9 / rate_per_s):
                sender.send(_STAMP.pack(now_ns) + padding)
                sent += 1
            try:
                while True:
                    stamp_ns = _STAMP.unpack_from(receiver.recv(65536))[0]
                    taken_ns.append(time.perf_counter_ns() - stamp_ns)
            except BlockingIOError:
                pass
    if not taken_ns:
        raise SystemExit("no datagram arrived")
    return np.array(taken_ns) * 1e-6, sent


def processor_time_s(pid: int) -> float:
    """Return the processor time used by a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))


def free_port() -> int:
    """Return a UDP port that is free at the moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


if __name__ == "__main__":
    main()
