"""Ten minutes of the whole rig at 1 kHz: memory must not grow, nothing be lost, the rate hold.

    python benchmarks/soak.py [--duration S] [--rate HZ] [--page] [--neighbours] [--out DIR] [--json]

The benchmark runs `telenano up` with a hand that presses, holds and lets go every ten seconds, and judges the session
by its own recording. Loops that do nothing but keep deadlines (`empty_loop.py`) run beside it: the time that they lose
is lost by the machine, and the rig's rate is judged against theirs. A recorder that had to wait for a processor keeps
the memory of its queue from that time, so its growth counts from its longest wait on. A leak grows all the time, and
an allocator that takes a further arena does so once: the growth is the lesser of those of the two halves of the run.
The exit code is 1 if a bound is missed.

`processes` has the kernel's counts for each process of the rig, including the launcher and the server of the page:
resident memory at the end of the settling time and at the end of the run, its slope, and the least and greatest number
of open descriptors and threads. With `--page` an observer's page is open all the time. With `--neighbours` another
program floods one endpoint a minute with garbage, and a reader of all topics stands still (`neighbours.py`); no node
may then be deaf to another.
"""

import argparse
import asyncio
import contextlib
import json
import os
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import msgpack
import numpy as np
import yaml
from empty_loop import EmptyLoops
from neighbours import flooded, standing_reader

from services.viz_node.requests import PROTOCOL
from telenano.cli.exit_codes import EXIT_INCOMPLETE
from telenano.recording.reader import Recording
from telenano.runtime.bus.local_endpoint import runtime_directory
from telenano.settings.included import SCENARIO_DIRECTORY
from telenano.signals import children
from telenano.wire import TOPICS

# Caches, free lists and the recorder's buffers reach their size in the first part of a run [s].
SETTLED_S = 60.0
MOST_GROWTH_BYTES_PER_MIN = 250_000
# The recorder keeps the index of its chunks for the end of the file: 2 kB five times a second.
MOST_RECORDER_GROWTH_BYTES_PER_MIN = 1_000_000
LEAST_RATE_SHARE = 0.999
# The interval between two floods [s].
FLOOD_EVERY_S = 60.0
# The interval between two looks at the processes [s].
LOOK_S = 10.0
CYCLE = ((0.0, 0.0), (1.0, 1.0), (4.0, 1.0), (5.0, 2.0), (7.0, 2.0), (8.0, 0.0), (10.0, 0.0))


def scenario(duration_s: float) -> dict[str, Any]:
    """Return the scenario, which repeats the cycle of the hand."""
    document: dict[str, Any] = yaml.safe_load((SCENARIO_DIRECTORY / "fig12.yaml").read_text())
    cycles = range(int(duration_s // CYCLE[-1][0]) + 1)
    times = {round(CYCLE[-1][0] * n + at_s, 3): force_n for n in cycles for at_s, force_n in CYCLE}
    points = [{"time_s": at_s, "force_n": force_n} for at_s, force_n in times.items()]
    document |= {"name": "soak", "description": "endurance of the rig", "duration_s": duration_s}
    document["haptic_node"]["operator"] = {"kind": "force_profile", "points": points}
    return document


class Look(NamedTuple):
    """The kernel's counts for a process at a moment [s]; memory and size of its open regular files [bytes]."""

    at_s: float
    resident_bytes: int
    descriptors: int
    threads: int
    files_bytes: int


def look_at(number: int, at_s: float) -> Look:
    """Return the kernel's counts for a process; OSError if it has ended."""
    folder = Path(f"/proc/{number}")
    resident = int((folder / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    opened = list((folder / "fd").iterdir())
    files: dict[tuple[int, int], int] = {}
    for each in opened:
        # The file may have been closed in the meantime.
        with contextlib.suppress(OSError):
            found = each.stat()
            if stat.S_ISREG(found.st_mode):
                files[found.st_dev, found.st_ino] = found.st_size
    return Look(at_s, resident, len(opened), len(list((folder / "task").iterdir())), sum(files.values()))


def family(parent: int) -> dict[int, str]:
    """Return a process and its descendants by number, each with the name of the program that it runs."""
    below: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            above = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            below.setdefault(above, []).append(int(entry.name))
    found, wanted = {}, [parent]
    while wanted:
        number = wanted.pop()
        wanted += below.get(number, [])
        with contextlib.suppress(OSError):
            words = Path(f"/proc/{number}/cmdline").read_bytes().decode(errors="replace").split("\0")
            after = words[words.index("-m") + 1 :] if "-m" in words else words
            site = after[after.index("--site") + 1] if "--site" in after else ""
            module = after[0].removeprefix("services.")
            found[number] = f"telenano {after[1]}" if module == "telenano" else f"{module}@{site}" if site else module
    return found


class Watch:
    """Samples processes and their descendants while the block runs; `looks` has the samples by name and number."""

    def __init__(self) -> None:
        self.looks: dict[tuple[str, int], list[Look]] = {}
        self._parents: list[int] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def add(self, process_id: int) -> None:
        """Sample this process and its descendants from now on."""
        self._parents.append(process_id)

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def figures(self, settled_s: float) -> dict[str, dict[str, Any]]:
        """Return the statistics of each process from the settling time [s] on, while the recorder ran."""
        end_s = max(looks[-1].at_s for (name, _), looks in self.looks.items() if name.startswith("recorder"))
        rows = {}
        for (name, number), looks in sorted(self.looks.items()):
            late = [look for look in looks if settled_s <= look.at_s <= end_s]
            if len(late) > 2:
                t_s, size = np.array([(look.at_s, look.resident_bytes) for look in late], dtype=float).T
                rows[f"{name} {number}"] = {
                    "span_s": [round(late[0].at_s), round(late[-1].at_s)],
                    "resident_mb": [round(late[at].resident_bytes * 1e-6, 1) for at in (0, len(late) // 2, -1)],
                    "growth_mb_per_hour": round(3600e-6 * float(np.polyfit(t_s - t_s[0], size, 1)[0]), 2),
                    "descriptors": [min(look.descriptors for look in late), max(look.descriptors for look in late)],
                    "threads": [min(look.threads for look in late), max(look.threads for look in late)],
                    "files_mb": [round(look.files_bytes * 1e-6, 1) for look in (late[0], late[-1])],
                }
        return rows

    def _run(self) -> None:
        begin_s = time.monotonic()
        while not self._ended.wait(LOOK_S):
            for parent in tuple(self._parents):
                for number, name in family(parent).items():
                    # A process may end between the listing and the look at it.
                    with contextlib.suppress(OSError):
                        self.looks.setdefault((name, number), []).append(look_at(number, time.monotonic() - begin_s))


@contextlib.contextmanager
def open_page(add: Callable[[int], None], environment: Mapping[str, str] | None = None) -> Iterator[None]:
    """Serve the page of the rig, and keep an observer's page open that reads all that is sent to it.

    Args:
        add: Called with the process of the server.
        environment: The environment of the rig; None for that of this process.
    """
    command = [sys.executable, "-m", "telenano", "view", "--port", "0"]
    with children.start(command, stdout=subprocess.PIPE, text=True, env=environment) as server:
        add(server.pid)
        assert server.stdout is not None
        lines = [server.stdout.readline() for _ in range(2)]
        addresses = dict(line.split() for line in Path(lines[1].split()[-1]).read_text().splitlines())
        reading = threading.Thread(target=lambda: asyncio.run(read_page(addresses["observer:"])), daemon=True)
        reading.start()
        try:
            yield
            if not reading.is_alive():
                sys.stderr.write("the page was closed before the end\n")
        finally:
            server.terminate()


async def read_page(address: str) -> None:
    """Read all that is sent to a page, as an observer's page does, until the server ends."""
    import websockets

    parts = urlsplit(address)
    origin: Any = f"http://{parts.netloc}"
    async with websockets.connect(f"ws://{parts.netloc}/bus", origin=origin, max_size=None, ping_interval=None) as page:
        await page.send(msgpack.packb({"k": "hello", "protocol": PROTOCOL, "token": parts.fragment}))
        with contextlib.suppress(websockets.ConnectionClosed):
            async for _ in page:
                await page.send(msgpack.packb({"k": "here"}))


def lasting_slope(t_s: np.ndarray, size: np.ndarray) -> float:
    """Return the lesser slope of straight lines through the first and the second half of the samples [1/s]."""
    middle = len(t_s) // 2
    halves = (slice(0, middle), slice(middle, None))
    return min(float(np.polyfit(t_s[half], size[half], 1)[0]) for half in halves)


def growth_per_min(recording: Recording, settled_s: float) -> tuple[dict[str, float | None], float]:
    """Return the lasting growth of the memory of each node [bytes/min] from `settled_s` on.

    The growth is None if too few samples of a recorder remain after its greatest lag; that lag [s] is returned as well.
    """
    samples: dict[str, list[tuple[int, int]]] = {}
    behind: dict[str, tuple[int, int]] = {}
    for message in recording.messages(["node/health"]):
        samples.setdefault(message.src, []).append((message.publish_ns, message.fields()["memory_bytes"]))
        if message.src.startswith("recorder"):
            lag_ns = message.log_ns - message.publish_ns
            behind[message.src] = max(behind.get(message.src, (0, 0)), (lag_ns, message.log_ns))
    grown: dict[str, float | None] = {}
    for node, pairs in samples.items():
        t_s, size = (np.array(pairs, dtype=float) * (1e-9, 1.0)).T
        late = (t_s - t_s[0] >= settled_s) & (t_s > behind.get(node, (0, 0))[1] * 1e-9)
        grown[node] = 60.0 * lasting_slope(t_s[late] - t_s[0], size[late]) if late.sum() > 10 else None
    return grown, max(lag_ns for lag_ns, _ in behind.values()) * 1e-9


def complaints(recording: Recording) -> tuple[dict[str, dict[str, float]], dict[str, int]]:
    """Return the longest time that each node was deaf to others [s], and how many messages each refused, by health."""
    deaf: dict[str, dict[str, float]] = {}
    refused: dict[str, int] = {}
    for message in recording.messages(["node/health"]):
        fields = message.fields()
        for peer, lasts_s in (fields.get("deaf_s") or {}).items():
            known = deaf.setdefault(message.src, {})
            known[peer] = max(known.get(peer, 0.0), lasts_s)
        refused[message.src] = max(refused.get(message.src, 0), sum((fields.get("rejected") or {}).values()))
    return deaf, {node: count for node, count in refused.items() if count}


def judge(folder: Path, settled_s: float, machine: EmptyLoops) -> dict[str, Any]:
    """Return the results of a session and whether they are within the bounds."""
    summary = json.loads((folder / "summary.json").read_text())
    recording = Recording(folder / "session.mcap")
    grown, behind_s = growth_per_min(recording, settled_s)
    deaf, refused = complaints(recording)
    machine_share = machine.share(*recording.span_ns)
    rows = {name: TOPICS.get(name.partition("@")[0]) for name in summary["seq_gaps"]}
    lossless = {n: summary["seq_gaps"][n] for n, row in rows.items() if row and row.delivery == "lossless"}
    fast = {n: share for n, share in summary["completeness"].items() if (row := rows.get(n)) and row.rate_hz == 1000.0}
    slowest = min(fast, key=lambda name: fast[name])
    within = {
        "memory": all(
            rate < (MOST_RECORDER_GROWTH_BYTES_PER_MIN if node.startswith("recorder") else MOST_GROWTH_BYTES_PER_MIN)
            for node, rate in grown.items()
            if rate is not None
        ),
        "gaps": not any(lossless.values()),
        "rate": fast[slowest] >= LEAST_RATE_SHARE * machine_share,
        "hearing": not deaf,
    }
    return {
        "duration_s": summary["duration_s"],
        "stable": summary["stable"],
        "memory_growth_mb_per_min": {
            node: None if rate is None else round(rate * 1e-6, 3) for node, rate in sorted(grown.items())
        },
        "recorder_behind_s": behind_s,
        "lossless_gaps": lossless,
        "least_rate_share": fast[slowest],
        "slowest": slowest,
        "machine_rate_share": machine_share,
        "rate_to_machine": fast[slowest] / machine_share,
        "loop_age_ms": summary["loop_age_ms"],
        "overruns": summary["overruns"],
        "deaf_s": deaf,
        "refused": refused,
        "within": within,
        "passed": all(within.values()),
    }


def run(
    duration_s: float,
    out: Path,
    settled_s: float,
    rate_hz: float = 1000.0,
    *,
    page: bool = False,
    neighbours: bool = False,
) -> dict[str, Any]:
    """Run the rig and judge it, even if its recording is incomplete; CalledProcessError if the rig failed."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "soak.yaml"
    file.write_text(yaml.safe_dump(scenario(duration_s)))
    command = [sys.executable, "-m", "telenano", "up", "--scenario", str(file), "--json"]
    command += ["--set", f"realtime.rate_hz={rate_hz:g}", "--out", str(out), "--overwrite"]
    with EmptyLoops() as machine, Watch() as watch, contextlib.ExitStack() as stack:
        rig = children.start(command, stdout=subprocess.DEVNULL)
        watch.add(rig.pid)
        if page:
            stack.enter_context(open_page(watch.add))
        if neighbours:
            watch.add(stack.enter_context(standing_reader(runtime_directory())))
            stack.enter_context(flooded(runtime_directory(), FLOOD_EVERY_S))
        try:
            code = rig.wait()
        finally:
            (out / "processes.json").write_text(json.dumps([[*key, looks] for key, looks in watch.looks.items()]))
    if code not in (0, EXIT_INCOMPLETE):
        raise subprocess.CalledProcessError(code, command)
    return judge(out, settled_s, machine) | {"processes": watch.figures(settled_s)}


def main() -> int:
    """Run and print; return 0 if the bounds were kept, else 1 (with --smoke always 0)."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--duration", type=float, default=600.0, help="length of the session [s]")
    parser.add_argument("--rate", type=float, default=1000.0, help="rate of the loop [Hz]")
    parser.add_argument("--page", action="store_true", help="keep a page of an observer open")
    parser.add_argument("--neighbours", action="store_true", help="flood endpoints, and let a reader stand still")
    parser.add_argument("--out", type=Path, help="folder of the recording; default: one that is removed again")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    if given.smoke:
        given.duration = 3.0
    settled_s = min(SETTLED_S, given.duration / 4)
    with tempfile.TemporaryDirectory() as name:
        out, beside = given.out or Path(name), {"page": given.page, "neighbours": given.neighbours}
        figures = run(given.duration, out, settled_s, given.rate, **beside)
    processes = figures["processes"]
    if given.json:
        print(json.dumps(figures))
    else:
        for key, value in figures.items():
            if key != "processes":
                print(f"{key:20}{value}")
        for name, row in processes.items():
            print(name, row)
    return 0 if figures["passed"] or given.smoke else 1


if __name__ == "__main__":
    sys.exit(main())
