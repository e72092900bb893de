"""What observers cost a running rig: none, at its nodes, through its shared reader, and as pages that watch or draw.

`python benchmarks/observers.py --observers 20 --rounds 3` runs sessions of the kinds in turn, and prints the age of the
loop and the rate of the hand of each, and the ratio to the sessions without observers. Pages are `--observers` clients
of the page's protocol, which draw nothing, and `--drawing` pages in a browser, of which the pictures are counted.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from telenano.signals import children

KINDS = ("none", "direct", "shared", "pages")
# The sessions begin some seconds after the processes; the observers connect when the rig runs.
START_S, MARGIN_S = 4.0, 2.0
# They have imported all that they need when the rig starts: that takes more processor time than to listen.
OBSERVER = """
import sys
from telenano.settings import DEFAULT_SITE_FILE
from telenano.runtime.wiring.observer import Observer
from telenano.runtime.wiring.main import load_site
print("ready", flush=True)
sys.stdin.readline()
observer, count = Observer(load_site(DEFAULT_SITE_FILE), shared=sys.argv[1] == "shared"), 0
for _ in observer.listen(float(sys.argv[2])):
    count += 1
print(count)
"""
# Clients of the page's protocol in one process, as far away people have processors of their own.
WATCHING = """
import asyncio, sys, time
import msgpack, websockets
address, token, count, length_s = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
print("ready", flush=True)
sys.stdin.readline()
async def watch():
    frames, end_s = 0, time.monotonic() + length_s
    async with websockets.connect(f"ws://{address}/bus", origin=f"http://{address}", max_size=None) as page:
        await page.send(msgpack.packb({"k": "hello", "protocol": 1, "token": token}))
        while time.monotonic() < end_s:
            data = await page.recv()
            if not frames and msgpack.unpackb(data, strict_map_key=False)["k"] == "refused":
                raise SystemExit(f"refused: {data!r}")
            frames += 1
            if not frames % 30:
                await page.send(msgpack.packb({"k": "here"}))
    return frames
async def watch_all():
    return sum(await asyncio.gather(*(watch() for _ in range(count))))
print(asyncio.run(watch_all()) if count else 0)
"""
# Pages in a browser that draws in software where the machine has no graphics.
DRAWING = """
import shutil, sys, time
from playwright.sync_api import sync_playwright
address, token, count, length_s = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
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
    time.sleep(length_s)
    print(sum(page.evaluate("window.drawn") for page in pages))
    browser.close()
"""


def served(environment: dict[str, str]) -> tuple[subprocess.Popen[str], str, str]:
    """Start the server of the page; return it with its host and the token of observers."""
    command = [sys.executable, "-m", "telenano", "view", "--port", "0"]
    server = children.start(command, env=environment, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    lines = [server.stdout.readline() for _ in range(2)]
    addresses = Path(lines[1].split()[-1]).read_text().splitlines()
    host, _, token = addresses[1].split()[1].removeprefix("http://").partition("/#")
    return server, host, token


def session(kind: str, observers: int, drawing: int, duration_s: float, folder: Path) -> dict[str, Any]:
    """Run a session with its observers, and return what its summary says of the loop."""
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(folder / "run")}
    command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--json", "--out", str(folder / kind)]
    command += ["--overwrite", "--duration", str(duration_s)]
    listening_s = duration_s - MARGIN_S
    # They are as important as those of a person: ordinary processes.
    reader = [sys.executable, "-c", OBSERVER, kind, str(listening_s)]
    pipe = subprocess.PIPE
    commands, server = [reader] * (observers if kind in ("direct", "shared") else 0), None
    if kind == "pages":
        server, host, token = served(environment)
        for program, count in ((WATCHING, observers), (DRAWING, drawing)):
            commands += [[sys.executable, "-c", program, host, token, str(count), str(listening_s)]] if count else []
    readers = [children.start(each, env=environment, stdin=pipe, stdout=pipe, text=True) for each in commands]
    for each in readers:
        assert each.stdout is not None
        each.stdout.readline()
    rig = children.start(command, env=environment, stdout=pipe, text=True)
    time.sleep(START_S)
    for each in readers:
        assert each.stdin is not None
        each.stdin.write("go\n")
        each.stdin.flush()
    received = [int(each.communicate()[0] or 0) for each in readers]
    out, _ = rig.communicate()
    summary = json.loads(out)
    if server is not None:
        server.terminate()
        server.communicate()
    watched, drawn = (received[0] / max(1, observers), received[-1] / max(1, drawing)) if server else (0, 0)
    return {
        "kind": kind,
        "p50_ms": summary["loop_age_ms"]["p50"],
        "p99_ms": summary["loop_age_ms"]["p99"],
        "max_ms": summary["loop_age_ms"]["max"],
        "hand_hz": summary["rate_hz"]["haptic/state"],
        "tip_hz": summary["rate_hz"]["afm/state"],
        "received_hz": round((watched if server else statistics.mean(received or [0])) / listening_s),
        "pictures_hz": round(drawn / listening_s, 1) if drawing else 0,
    }


def main() -> None:
    """Run the sessions in turn and print them, then the medians."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--observers", type=int, default=20, help="processes that read every topic")
    parser.add_argument("--drawing", type=int, default=2, help="pages in a browser, beside the observers as pages")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS[:3], help="run beside none")
    parser.add_argument("--rounds", type=int, default=3, help="sessions of each kind, in turn")
    parser.add_argument("--duration", type=float, default=10.0, help="length of a session [s]")
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
                rows.append(session(kind, given.observers, given.drawing, given.duration, Path(folder)))
                if not given.json:
                    print(json.dumps(rows[-1]), flush=True)
    found = {}
    for kind in kinds:
        own = [row for row in rows if row["kind"] == kind]
        found[kind] = {name: statistics.median(row[name] for row in own) for name in own[0] if name != "kind"}
    for kind in kinds[1:]:
        for name in ("p50_ms", "p99_ms"):
            found[kind][f"{name}_ratio"] = round(found[kind][name] / found["none"][name], 2)
    print(json.dumps({"observers": given.observers, "rounds": given.rounds, "median": found}))


if __name__ == "__main__":
    main()
