"""What observers cost a running rig: none, at its nodes, through its shared reader, and as pages that watch or draw.

`python benchmarks/observers.py --observers 20 --rounds 3` runs sessions of the kinds in turn. It prints the age of the
loop and the rate of the hand of each, and the ratio to the sessions without observers. Pages are `--observers` clients
of the page's protocol, which draw nothing, and `--drawing` pages in a browser, whose rendered frames are counted. All
values are those of a window in which all observers read.
"""

import argparse
import contextlib
import json
import os
import select
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cycles import cycles_of
from loop import ProcessWatch

from telenano.cli.exit_codes import EXIT_INCOMPLETE
from telenano.recording.reader import Recording
from telenano.runtime.loop.node import HEALTH_PERIOD_NS
from telenano.signals import children
from telenano.wire.messages import SUPERSEDED

KINDS = ("none", "direct", "shared", "pages")
# Readers connect while the rig is already running, and from then on take all that is sent to them.
SETTLE_S, MARGIN_S = 1.0, 2.0
# The nominal length of a session, which ends when its window is over, and the longest wait for a process [s].
LONGEST_S, PATIENCE_S = 600.0, 60.0
# An ordinary process is slow on a fully loaded machine, so readers and `status` have this long to answer [s].
ANSWER_S = 10.0
# Observers import everything before the rig starts, because that takes more processor time than to listen. They count
# messages for a time, print the number, and go on until they are ended.
OBSERVER = """
import sys
from telenano.settings import DEFAULT_SITE_FILE
from telenano.runtime.wiring.observer import Observer
from telenano.runtime import AddressBook
from telenano.wire import TOPICS
print("ready", flush=True)
sys.stdin.readline()
kind, settle_s, length_s, topics = sys.argv[1], float(sys.argv[2]), float(sys.argv[3]), sys.argv[4].split(",")
observer = Observer(AddressBook.load(DEFAULT_SITE_FILE), topics if topics != [""] else TOPICS, shared=kind == "shared")
for _ in observer.listen(settle_s):
    pass
print(sum(1 for _ in observer.listen(length_s)), flush=True)
for _ in observer.listen(None):
    pass
"""
# Clients of the page's protocol in one process, because remote people have their own processors.
WATCHING = """
import asyncio, sys, time
import msgpack, websockets
address, token, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
settle_s, length_s = float(sys.argv[4]), float(sys.argv[5])
print("ready", flush=True)
sys.stdin.readline()
begin_s = time.monotonic() + settle_s
frames = 0
async def watch():
    global frames
    taken = 0
    async with websockets.connect(f"ws://{address}/bus", origin=f"http://{address}", max_size=None) as page:
        await page.send(msgpack.packb({"k": "hello", "protocol": 1, "token": token}))
        while True:
            data = await page.recv()
            if not taken and msgpack.unpackb(data, strict_map_key=False)["k"] == "refused":
                raise SystemExit(f"refused: {data!r}")
            taken += 1
            frames += begin_s <= time.monotonic() < begin_s + length_s
            if not taken % 30:
                await page.send(msgpack.packb({"k": "here"}))
async def report():
    await asyncio.sleep(settle_s + length_s)
    print(frames, flush=True)
async def watch_all():
    await asyncio.gather(report(), *(watch() for _ in range(count)))
asyncio.run(watch_all())
"""
# Pages in a browser that renders in software if the machine has no graphics processor.
DRAWING = """
import shutil, sys, time
from playwright.sync_api import sync_playwright
address, token, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
settle_s, length_s = float(sys.argv[4]), float(sys.argv[5])
COUNT = "window.drawn = 0; const each = () => { window.drawn += 1; requestAnimationFrame(each); }; each();"
with sync_playwright() as playwright:
    flags = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-renderer-backgrounding"]
    browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
    pages = [browser.new_page() for _ in range(count)]
    print("ready", flush=True)
    sys.stdin.readline()
    for page in pages:
        page.add_init_script(COUNT)
        page.goto(f"http://{address}/#{token}")
    time.sleep(settle_s)
    before = sum(page.evaluate("window.drawn") for page in pages)
    time.sleep(length_s)
    print(sum(page.evaluate("window.drawn") for page in pages) - before, flush=True)
    sys.stdin.readline()
    browser.close()
"""


class Load(NamedTuple):
    """The readers of a rig, and the rate that the rig is to have [Hz].

    `kind` is one of KINDS, `readers` the number of processes or pages, `drawing` the number of additional pages in a
    browser, and `topics` the topics that a process reads, all if empty.
    """

    kind: str = "none"
    readers: int = 0
    drawing: int = 0
    topics: tuple[str, ...] = ()
    rate_hz: float = 1000.0


Process = subprocess.Popen[bytes]


class SessionError(Exception):
    """A session had no results; the text tells why."""


def served(environment: dict[str, str], stack: contextlib.ExitStack) -> tuple[Process, str, str]:
    """Start the server of the page; return the process with its host and the token of observers."""
    server = started([sys.executable, "-m", "telenano", "view", "--port", "0"], environment, stack, signal.SIGINT)
    addresses = Path([line_of(server, "server of the page") for _ in range(2)][1].split()[-1]).read_text().splitlines()
    host, _, token = addresses[1].split()[1].removeprefix("http://").partition("/#")
    return server, host, token


def started(command: list[str], environment: dict[str, str], stack: contextlib.ExitStack, by: int) -> Process:
    """Start a process that ends with the block, by a signal (0: by the end of its input), whatever happens."""
    pipe = subprocess.PIPE
    # The pipe has no buffer, so that `select` tells whether there is a line.
    process = children.start(command, env=environment, stdin=pipe, stdout=pipe, stderr=pipe, bufsize=0)
    stack.callback(ended, process, by)
    return process


def ended(process: Process, by: int) -> str:
    """End a process by a signal, or kill it after PATIENCE_S; return its remaining output."""
    assert process.stdout is not None
    if process.stdout.closed:
        return ""
    if by and process.poll() is None:
        process.send_signal(by)
    try:
        return process.communicate(timeout=PATIENCE_S)[0].decode()
    except subprocess.TimeoutExpired:
        process.kill()
    # A descendant of the process may keep its output open.
    with contextlib.suppress(subprocess.TimeoutExpired):
        return process.communicate(timeout=ANSWER_S)[0].decode()
    return ""


def line_of(process: Process, what: str) -> str:
    """Return the next line that a process prints; SessionError if it has ended or prints none within PATIENCE_S."""
    assert process.stdout is not None
    if not select.select([process.stdout], [], [], PATIENCE_S)[0]:
        raise SessionError(f"the {what} said nothing for {PATIENCE_S:g} s")
    if not (line := process.stdout.readline()):
        raise SessionError(f"the {what} ended: {reason_of(process)}")
    return line.decode()


def count_of(reader: Process, until_s: float) -> int:
    """Return the number of messages of a reader; 0 if it printed none by a time on the monotonic clock [s]."""
    assert reader.stdout is not None
    is_there = select.select([reader.stdout], [], [], max(0.0, until_s - time.monotonic()))[0]
    return int(line_of(reader, "reader")) if is_there else 0


def reason_of(process: Process) -> str:
    """Return the last line of the standard error of a process that has ended, or else its exit code."""
    assert process.stderr is not None
    try:
        code = process.wait(ANSWER_S)
    except subprocess.TimeoutExpired:
        return "it closed its output"
    lines = process.stderr.read().decode().strip().splitlines()
    return lines[-1].removeprefix("telenano: ") if lines else f"exit code {code}"


def wait_for_session(out: Path, rig: Process) -> None:
    """Wait until the operator's programme has begun; SessionError if the rig ends or PATIENCE_S is over first."""
    log = out / "logs" / "launcher@master.log"
    end_s = time.monotonic() + PATIENCE_S
    while not (log.exists() and "the session is running" in log.read_text()):
        if rig.poll() is not None:
            raise SessionError(f"the rig ended before its session: {reason_of(rig)}")
        if time.monotonic() > end_s:
            raise SessionError(f"the rig had no session within {PATIENCE_S:g} s")
        time.sleep(0.05)


def session(load: Load, window_s: float, folder: Path, *, asks_status: bool = False) -> dict[str, Any]:
    """Run a rig under a load, and return the results of a window [s] of its session; SessionError if there are none.

    `says` is the output of `telenano status` on the machine and on problems, while the load is still there.
    """
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(folder / "run")}
    out = folder / load.kind
    # Otherwise the log of an earlier session would be taken for that of this one.
    shutil.rmtree(out, ignore_errors=True)
    rate = ["--set", f"realtime.rate_hz={load.rate_hz:g}"]
    command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--json", "--out", str(out)]
    with contextlib.ExitStack() as stack:
        # The readers are ordinary processes, as those of a person are.
        programs, groups, times = [], dict[int, str](), [str(SETTLE_S), str(window_s)]
        if load.kind in ("direct", "shared"):
            programs = [[OBSERVER, load.kind, *times, ",".join(load.topics)]] * load.readers
        elif load.kind == "pages":
            server, host, token = served(environment, stack)
            groups[server.pid] = "page server"
            counts = ((WATCHING, load.readers), (DRAWING, load.drawing))
            programs = [[program, host, token, str(count), *times] for program, count in counts if count]
        # A browser has to be closed by the process that opened it.
        ways = [0 if program[0] is DRAWING else signal.SIGTERM for program in programs]
        readers = [
            started([sys.executable, "-c", *program], environment, stack, by)
            for program, by in zip(programs, ways, strict=True)
        ]
        groups |= {reader.pid: "readers" for reader in readers}
        for each in readers:
            line_of(each, "reader")
        rig = started([*command, "--duration", str(LONGEST_S), *rate], environment, stack, signal.SIGINT)
        watch = ProcessWatch(rig.pid, groups)
        stack.callback(watch.end)
        wait_for_session(out, rig)
        for each in readers:
            assert each.stdin is not None
            try:
                each.stdin.write(b"go\n")
            except BrokenPipeError as error:
                raise SessionError(f"a reader ended: {reason_of(each)}") from error
        time.sleep(SETTLE_S)
        begin_s, begin_ns = time.monotonic(), time.time_ns()
        time.sleep(window_s)
        end_s, end_ns = time.monotonic(), time.time_ns()
        answered_by_s = end_s + ANSWER_S
        received = [count_of(each, answered_by_s) for each in readers]
        says = status_says(environment) if asks_status else []
        watch.end()
        for each, by in zip(readers, ways, strict=True):
            ended(each, by)
        printed = ended(rig, signal.SIGINT)
        # A recorder that could not keep up is a result and no failure.
        if rig.returncode not in (0, EXIT_INCOMPLETE) or not printed:
            raise SessionError(f"the rig ended with exit code {rig.returncode}")
    share, memory = watch.within(begin_s, end_s)
    seen = seen_of(out, round(1e9 / load.rate_hz), begin_ns, end_ns)
    drawn = received.pop() if load.drawing else 0
    apart = ("readers", "page server")
    return {
        "kind": load.kind,
        **seen,
        "received_hz": round(sum(received) / max(1, load.readers) / window_s),
        "pictures_hz": round(drawn / window_s, 1),
        "rig_percent": round(sum(value for name, value in share.items() if name not in apart), 1),
        "rig_mb": round(sum(value for name, value in memory.items() if name not in apart), 1),
        "server_percent": round(share.get("page server", 0.0), 1),
        "server_mb": round(memory.get("page server", 0.0), 1),
        "readers_percent": round(share.get("readers", 0.0), 1),
        "readers_mb": round(memory.get("readers", 0.0), 1),
        "lost": json.loads(printed.splitlines()[-1])["recording"]["lost"],
        "says": says,
    }


def seen_of(out: Path, period_ns: int, begin_ns: int, end_ns: int) -> dict[str, float]:
    """Return the age of the loop, the rates and the counts of a window [ns] from the recording of a session.

    The age is that of every sample, including those whose answer another one overtook before the hand showed it. If
    none was answered, it is the length of the window, which is a lower bound.
    """
    recording, span_s = Recording(out / "session.mcap"), (end_ns - begin_ns) * 1e-9
    ages_ms = [(each.ended_ns - each.begun_ns) * 1e-6 for each in cycles_of(out, period_ns, begin_ns, end_ns)]
    # A loop that answers nothing is older than the window.
    ages_ms = ages_ms or [1e3 * span_s]
    sent = Counter(
        message.topic
        for message in recording.messages(["haptic/state", "afm/state"])
        if begin_ns <= message.publish_ns < end_ns
    )
    p50, p99 = np.percentile(ages_ms, (50.0, 99.0))
    return {
        "p50_ms": round(float(p50), 4),
        "p99_ms": round(float(p99), 4),
        "max_ms": round(max(ages_ms), 4),
        "hand_hz": round(sent["haptic/state"] / span_s, 1),
        "tip_hz": round(sent["afm/state"] / span_s, 1),
        **counted_hz(recording, begin_ns, end_ns),
    }


def counted_hz(recording: Recording, begin_ns: int, end_ns: int) -> dict[str, float]:
    """Return the superseded messages and the missed deadlines a second in a window [ns].

    Nodes count both and report twice a second, so these are differences of the reports around the window.
    """
    reports: dict[str, list[tuple[int, int, int]]] = {}
    around = begin_ns - HEALTH_PERIOD_NS, end_ns + HEALTH_PERIOD_NS
    for message in recording.messages(["node/health"]):
        if around[0] <= message.publish_ns <= around[1]:
            fields = message.fields()
            counts = int(fields["rejected"].get(SUPERSEDED, 0)), int(fields["overruns"])
            reports.setdefault(message.src, []).append((message.publish_ns, *counts))
    found = [0.0, 0.0]
    for rows in reports.values():
        (first_ns, *first), (last_ns, *last) = min(rows), max(rows)
        if last_ns > first_ns:
            found = [
                value + (b - a) * 1e9 / (last_ns - first_ns) for value, a, b in zip(found, first, last, strict=True)
            ]
    return {"superseded_hz": round(found[0], 1), "overruns_hz": round(found[1], 1)}


def status_says(environment: Mapping[str, str]) -> list[str]:
    """Return the output of `telenano status` on the machine and on problems of a running rig."""
    command = [sys.executable, "-m", "telenano", "status"]
    wide = {**environment, "COLUMNS": "400"}
    try:
        done = children.run(command, env=wide, capture_output=True, text=True, timeout=ANSWER_S)
    except subprocess.TimeoutExpired:
        return [f"no answer within {ANSWER_S:g} s"]
    return said(done.stdout, done.stderr)


def said(out: str, err: str) -> list[str]:
    """Return the statements of `telenano status` on the machine and on nodes with a problem; else its last sentence.

    Args:
        out: Its standard output. Lines below the table have a label, which may be a node that also has a row above.
        err: Its standard error: for a running rig, the nodes that have a problem.
    """
    lines, last = out.splitlines(), err.strip().removeprefix("telenano: ")
    named = [name.strip() for name in last.rpartition(":")[2].split(",")] if last else []
    found = []
    for label in ("machine", *named):
        labelled = [line for line in lines if line.startswith(f"{label} ")]
        if labelled:
            text = " ".join(labelled[-1].removeprefix(label).split())
            found.append(text if label == "machine" else f"{label} {text}")
    return found or [last or (lines[-1].strip() if lines else "nothing")]


def medians(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return the median of each figure of some sessions."""
    names = [name for name, value in rows[0].items() if isinstance(value, int | float)]
    return {name: statistics.median(row[name] for row in rows) for name in names}


def main() -> None:
    """Run the sessions in turn and print them, then the medians."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--observers", type=int, default=20, help="processes that read every topic")
    parser.add_argument("--drawing", type=int, default=2, help="pages in a browser, beside the observers as pages")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS[:3], help="run beside none")
    parser.add_argument("--rounds", type=int, default=3, help="sessions of each kind, in turn")
    parser.add_argument(
        "--duration", type=float, default=10.0, help="length of a session [s], 2 s longer than the window"
    )
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object of the medians alone")
    given = parser.parse_args()
    if given.smoke:
        given.observers, given.drawing, given.rounds, given.duration = 2, 0, 1, MARGIN_S + 1.0
    kinds = [kind for kind in KINDS if kind == "none" or kind in given.kinds]
    rows = []
    with tempfile.TemporaryDirectory(prefix="tno-") as folder:
        for _ in range(given.rounds):
            for kind in kinds:
                load = Load(kind, given.observers if kind != "none" else 0, given.drawing if kind == "pages" else 0)
                rows.append(session(load, given.duration - MARGIN_S, Path(folder)))
                if not given.json:
                    print(json.dumps(rows[-1]), flush=True)
    found = {}
    for kind in kinds:
        found[kind] = medians([row for row in rows if row["kind"] == kind])
    for kind in kinds[1:]:
        for name in ("p50_ms", "p99_ms"):
            found[kind][f"{name}_ratio"] = round(found[kind][name] / found["none"][name], 2)
    print(json.dumps({"observers": given.observers, "rounds": given.rounds, "median": found}))


if __name__ == "__main__":
    main()
