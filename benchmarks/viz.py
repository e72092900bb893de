"""Measure the cost of the view: the age of the loop with and without open pages, bytes to a page, time of a frame.

    python benchmarks/viz.py --rounds 4 --window 4
    python benchmarks/viz.py --recording out/session.mcap --window 5
    python benchmarks/viz.py --hour out/session.mcap

One rig runs throughout. Windows without a page alternate with windows with `--pages` of them, and the age of the loop
in each is read from the recording: the ratio compares moments of the same run. Pages are web sockets that read
everything; with `--browser` a Chromium draws one of them, all scopes live. The benchmark then measures the time between
two of its frames, which on a machine without a graphics processor is that of a software renderer, and the time that the
page itself needs for each: reading the data, decimation, drawing (`performance.now` in its own callbacks), and the age
of what it draws: the way from the rig's server, half of the time between two pictures, and a frame. A browser on the
same machine takes processor time as any program does, so its ratio says more about the machine than about the view.
With `--recording` there is no rig, and Chromium has the machine for a page that plays a recording. `--hour` repeats a
recording until it is an hour long, and opens the result twice. It measures the time to the address of the page, to
curves in a scope, to an outline of the whole, to all curves, and to the verdict; the second time with the cache of the
first.
"""

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
from observers import wait_for_session

from telenano.recording.reader import Recording
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.signals import children
from telenano.wire import TOPICS
from telenano.wire.topics import LOOP_DEADLINE_S

SETTLE_S = 1.0
PATIENCE_S = 90.0
# The age of what the page draws, by its own measure [ms]; NaN until it is known.
DRAWN_AGE = "(({ wayS, pictureS, frameS }) => 1e3 * (wayS + pictureS / 2 + frameS))(telenano.store)"
# Without a graphics processor Chromium composes a page a hundred times as fast by itself as with a software WebGL.
FLAGS = ["--no-sandbox", "--disable-background-networking", "--disable-gpu", "--enable-unsafe-swiftshader"]
FLAGS += ["--disable-renderer-backgrounding", "--disable-backgrounding-occluded-windows"]
FLAGS += ["--disable-background-timer-throttling"]


class Reader(threading.Thread):
    """A page that reads everything and draws nothing."""

    def __init__(self, address: str) -> None:
        super().__init__(daemon=True)
        base, _, self._token = address.partition("/#")
        self._base = base
        self.bytes = 0
        self.frames = 0
        self.closing = threading.Event()

    def run(self) -> None:
        from websockets.sync.client import connect

        url = self._base.replace("http", "ws") + "/bus"
        with connect(url, origin=self._base, max_size=None) as socket:  # type: ignore[arg-type]
            socket.send(msgpack.packb({"k": "hello", "token": self._token, "protocol": 1}))
            while not self.closing.is_set():
                with contextlib.suppress(TimeoutError):
                    self.bytes += len(socket.recv(timeout=0.2))
                    self.frames += 1

    def close(self) -> None:
        self.closing.set()
        self.join(5.0)


@contextlib.contextmanager
def process(arguments: Sequence[str], environment: dict[str, str]) -> Iterator["subprocess.Popen[str]"]:
    """Run a telenano command while the block runs."""
    command = [sys.executable, "-m", "telenano", *arguments]
    with children.start(command, env=environment, stdout=subprocess.PIPE, text=True) as found:
        try:
            yield found
        finally:
            found.send_signal(signal.SIGINT)
            try:
                found.communicate(timeout=PATIENCE_S)
            except subprocess.TimeoutExpired:
                found.kill()


def address_of(view: "subprocess.Popen[str]") -> str:
    """Return the operator's address, which the view writes to a file (named in its output) and not to a pipe."""
    assert view.stdout is not None
    lines = [view.stdout.readline() for _ in range(2)]
    addresses = Path(lines[1].split()[-1]).read_text()
    return next(line.split()[1] for line in addresses.splitlines() if line.startswith("operator"))


@contextlib.contextmanager
def drawn(address: str, wanted: bool) -> Iterator[Any]:
    """Yield a page in Chromium, None if none is `wanted`; SystemExit if it has no curves within PATIENCE_S."""
    if not wanted:
        yield None
        return
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = browser.new_page(viewport={"width": 1360, "height": 850})
        page.goto(address, wait_until="commit", timeout=PATIENCE_S * 1e3)
        end_s = time.monotonic() + PATIENCE_S
        while not page.evaluate("(window.telenano?.store.rings.get('tip')?.length ?? 0) > 1000"):
            if time.monotonic() > end_s:
                sys.exit(f"the page in the browser had no curves within {PATIENCE_S:g} s")
            time.sleep(0.1)
        yield page
        browser.close()


def ages_ms(recording: Path, windows: Sequence[tuple[int, int]]) -> list[float]:
    """Return the age of the loop [ms], from the hand's sample to its answer, for the samples in the windows [ns]."""
    found = []
    for begin_ns, end_ns in windows:
        for message in Recording(recording).messages(["haptic/state"], begin_ns, end_ns):
            fields = message.fields()
            if fields["answered_t_ns"]:
                found.append((fields["answered_at_ns"] - fields["answered_t_ns"]) * 1e-6)
    return [age for age in found if age < LOOP_DEADLINE_S * 1e3]


def figures(values: Sequence[float]) -> dict[str, float]:
    """Return median, 99th percentile and count of values."""
    ordered = sorted(values)
    return {"p50": statistics.median(ordered), "p99": ordered[int(0.99 * (len(ordered) - 1))], "n": len(ordered)}


def measure(given: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Run a rig and return the results."""
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": tempfile.mkdtemp(prefix="tnv-")}
    # The rig outlasts the start of each browser, and is ended when the last window is over.
    duration_s = 2 * given.rounds * (given.window + SETTLE_S) + PATIENCE_S * (1 + given.rounds * given.browser)
    out = folder / "rig"
    up = ["up", "--no-view", "--scenario", "touch", "--duration", str(duration_s), "--out", str(out), "--json"]
    without: list[tuple[int, int]] = []
    with_pages: list[tuple[int, int]] = []
    received: list[float] = []
    frames: list[float] = []
    costs: list[float] = []
    drawn_ages: list[float] = []
    pictures = 0
    with process(up, environment) as rig, process(["view", "--port", "0"], environment) as view:
        address = address_of(view)
        wait_for_session(out, rig)
        # Wait until the devices have come to rest.
        time.sleep(2.0 * SETTLE_S)
        for _ in range(given.rounds):
            without.append(_window(given.window))
            readers = [Reader(address) for _ in range(given.pages - given.browser)]
            for reader in readers:
                reader.start()
            with drawn(address, given.browser) as page:
                time.sleep(SETTLE_S)
                before = [(reader.bytes, reader.frames) for reader in readers]
                if page is not None:
                    pictures -= page.evaluate(
                        "telenano.frames.length = telenano.costs.length = 0; telenano.view.frames"
                    )
                with_pages.append(_window(given.window))
                received += [(r.bytes - b) / given.window for r, (b, _) in zip(readers, before, strict=True)]
                if page is not None:
                    drawn_ages.append(float(page.evaluate(DRAWN_AGE)))
                    drawn_frames, drawn_costs, scenes = page.evaluate(
                        "[telenano.frames, telenano.costs, telenano.view.frames]"
                    )
                    frames, costs, pictures = frames + drawn_frames, costs + drawn_costs, pictures + scenes
            for reader in readers:
                reader.close()
            time.sleep(SETTLE_S)
    recording = out / "session.mcap"
    alone, watched = figures(ages_ms(recording, without)), figures(ages_ms(recording, with_pages))
    return {
        "pages": given.pages,
        "browser": bool(given.browser),
        "loop_age_ms": {"without": alone, "with": watched},
        "ratio_p50": watched["p50"] / alone["p50"],
        "ratio_p99": watched["p99"] / alone["p99"],
        "kilobytes_per_s": statistics.mean(received) / 1e3 if received else None,
        "frame_ms": figures(frames) if frames else None,
        "page_ms": figures(costs) if costs else None,
        "drawn_age_ms": figures(drawn_ages) if drawn_ages else None,
        "pictures_of_the_scene": pictures if given.browser else None,
    }


def measure_recording(recording: str, window_s: float) -> dict[str, Any]:
    """Return the frame times of a page that plays a recording, with all scopes live and no rig."""
    with (
        process(["view", "--port", "0", recording], dict(os.environ)) as view,
        drawn(address_of(view), True) as page,
    ):
        time.sleep(4.0 * SETTLE_S)
        page.evaluate("telenano.frames.length = telenano.costs.length = 0")
        time.sleep(window_s)
        frames, costs = page.evaluate("[telenano.frames, telenano.costs]")
    return {"frame_ms": figures(frames), "page_ms": figures(costs)}


# The patterns of times [ns], and of the time of the programme [s], packed in eight bytes in the messages of a rig.
_TIMES = re.compile(rb"(_ns\xcf)(.{8})", re.DOTALL)
_PROGRAMME = re.compile(rb"(session_s\xcb)(.{8})", re.DOTALL)
_HOUR_S = 3600.0
# The steps of a page after it was opened, in order.
STEPS = {
    "connected": "window.telenano?.store.streams.size",
    "curves": "telenano.scopes.plots[0]?.data?.[1]?.some((value) => value !== null && value !== undefined)",
    "outline": "telenano.cockpit.document.whole?.rings.get('tip')?.length > 100",
    "all_curves": "telenano.cockpit.document.about?.read >= 0.999",
    "verdict": "telenano.cockpit.document.about?.read >= 1",
}


def repeated(source: str, length_s: float, folder: Path) -> Path:
    """Write a recording of a length [s] that repeats another recording."""
    recording = Recording(source)
    begin_ns, end_ns = recording.span_ns
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder))
    for name, data in recording.attachments.items():
        writer.attach(name, "application/yaml", data, begin_ns)
    for name, entries in recording.metadata.items():
        writer.add_metadata(name, entries)
    messages = [message for message in recording.select() if message.topic in TOPICS]
    places = {m.channel: (m.topic, m.src, m.site) for m in messages}
    channels = {channel: writer.channel(*place) for channel, place in places.items()}
    # The numbers of a turn continue those of the turn before: for a gap every message would have to be read.
    firsts = {message.channel: message.seq for message in reversed(messages)}
    counts = {message.channel: message.seq - firsts[message.channel] + 1 for message in messages}
    payloads = Payloads([message.payload for message in messages])
    rows = [(channels[m.channel], m.log_ns, m.publish_ns, m.seq, counts[m.channel]) for m in messages]
    flushed_ns = 0
    for turn in range(round(length_s * 1e9 / (end_ns - begin_ns))):
        by_ns = turn * (end_ns - begin_ns + 1_000_000)
        for (channel, log_ns, publish_ns, seq, count), payload in zip(rows, payloads.later(by_ns), strict=True):
            writer.write(channel, log_ns + by_ns, publish_ns + by_ns, seq + turn * count, payload)
            if log_ns + by_ns - flushed_ns > 250_000_000:
                writer.flush()
                flushed_ns = log_ns + by_ns
    writer.finish({"state": "stopped"})
    return writer.path


class Payloads:
    """The payloads of many messages in one buffer, in which all times are shifted at once."""

    def __init__(self, payloads: Sequence[bytes]) -> None:
        self._data = np.frombuffer(b"".join(payloads), dtype=np.uint8)
        ends = np.cumsum([len(payload) for payload in payloads]).tolist()
        self._bounds = list(zip([0, *ends[:-1]], ends, strict=True))
        whole = self._data.tobytes()
        self._clocks, self._times_ns = self._found(_TIMES, whole, ">u8")
        self._programmes, self._times_s = self._found(_PROGRAMME, whole, ">f8")

    def later(self, by_ns: int) -> Iterator[bytes]:
        """Return an iterator over the payloads, with their times shifted by `by_ns` [ns]."""
        data = self._data.copy()
        data[self._clocks] = (self._times_ns + np.uint64(by_ns)).astype(">u8").view(np.uint8).reshape(-1, 8)
        later_s = np.where(self._times_s >= 0.0, self._times_s + by_ns * 1e-9, self._times_s)
        data[self._programmes] = later_s.astype(">f8").view(np.uint8).reshape(-1, 8)
        whole = data.tobytes()
        return (whole[begin:end] for begin, end in self._bounds)

    def _found(self, pattern: re.Pattern[bytes], whole: bytes, kind: str) -> tuple[Any, Any]:
        """Return the places of the eight bytes of each number, and the numbers."""
        places = np.array([found.start(2) for found in pattern.finditer(whole)], dtype=np.int64)
        eight = places[:, np.newaxis] + np.arange(8)
        numbers = self._data[eight].tobytes()
        return eight, np.frombuffer(numbers, dtype=kind).astype(kind[1:])


def measure_hour(source: str, length_s: float) -> dict[str, Any]:
    """Return the times from the command to each step of a page of a long recording [s], for two looks at it."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        begun_s = time.monotonic()
        path = repeated(source, length_s, Path(folder))
        found["made_s"] = round(time.monotonic() - begun_s, 1)
        environment = {**os.environ, "XDG_CACHE_HOME": folder}
        found["megabytes"] = path.stat().st_size / 1e6
        for look in ("first", "second"):
            found[look] = _looked(str(path), environment)
    return found


def _looked(path: str, environment: dict[str, str]) -> dict[str, float]:
    from playwright.sync_api import sync_playwright

    begun_s = time.monotonic()
    times: dict[str, float] = {}
    with process(["view", "--port", "0", path], environment) as view, sync_playwright() as playwright:
        address = address_of(view)
        times["address"] = time.monotonic() - begun_s
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = browser.new_page(viewport={"width": 1360, "height": 850})
        # The start of the browser does not count, because that of a person is already running.
        begun_s = time.monotonic() - times["address"]
        page.goto(address, wait_until="commit", timeout=PATIENCE_S * 1e3)
        for step, expression in STEPS.items():
            while not page.evaluate(expression):
                time.sleep(0.02)
            times[step] = time.monotonic() - begun_s
        browser.close()
    return {step: round(time_s, 2) for step, time_s in times.items()}


def _window(length_s: float) -> tuple[int, int]:
    begin_ns = time.time_ns()
    time.sleep(length_s)
    return begin_ns, time.time_ns()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="What the view costs.")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--window", type=float, default=4.0, help="length of each measurement [s]")
    parser.add_argument("--pages", type=int, default=3)
    parser.add_argument("--browser", action="store_true", help="let a Chromium draw one of the pages")
    parser.add_argument("--recording", help="time the frames of a page that plays this recording, without a rig")
    parser.add_argument("--hour", metavar="FILE", help="open a recording that repeats this one for an hour")
    parser.add_argument("--length", type=float, default=_HOUR_S, help="how long that is [s]")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object in one line")
    given = parser.parse_args()
    if given.smoke:
        given.rounds, given.window, given.pages = 1, 1.0, 1
    if given.hour:
        print(json.dumps(measure_hour(given.hour, given.length), indent=2))
        return
    if given.recording:
        print(json.dumps(measure_recording(given.recording, given.window), indent=2))
        return
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(measure(given, Path(folder)), indent=None if given.json else 2))


if __name__ == "__main__":
    main()
