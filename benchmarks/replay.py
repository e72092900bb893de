"""Measure recording and replay in one run, each against the bare parts that it is built on.

    python benchmarks/replay.py [--seconds S] [--smoke] [--json]

- Timing: the error of the intervals between messages against the recording, at rate 1, with all ten topics at 1 kHz,
  beside that of a plain loop that sleeps until each message of a list is due and sends it over one bare XPUB socket.
- Rate 0: messages a second through the bus to one reader, as a ratio to the same frames from memory to the same reader
  over one bare XPUB socket, and over one for each node as the player has them, and to reading the file without the bus.
- Verify: messages a second, as a ratio to reading the file.
- Recording: messages a second through the recorder's intake, as a ratio to the plain `mcap` writer with the same bytes,
  by the processor's time: best of three, in turns.

Replay runs in a process of its own; the reader, under the scheduling of a node, stamps each arrival with the monotonic
clock and keeps nothing else.
"""

import argparse
import contextlib
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache, partial
from multiprocessing.connection import Connection
from operator import itemgetter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import yaml
import zmq
from mcap.writer import CompressionType, Writer
from wire_examples import ordinary_example

from services.player.node import PlaySettings
from services.player.plan import node_of
from services.player.run import ReplayRequest, run_replay
from services.recorder.intake import Intake, Listener, begin_recording
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.verify import verify
from telenano.recording.writer import RecordingWriter
from telenano.runtime.bus.bus import Subscriber
from telenano.runtime.bus.publisher import SEND_HIGH_WATER_MARK
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.realtime import apply_realtime, freeze_garbage, on_time, shallow_idle
from telenano.settings.scenario import RealtimeConfig
from telenano.signals import children
from telenano.timing.clock import SystemClock
from telenano.wire import encode
from telenano.wire.messages import LinkClock, Message
from telenano.wire.nodes import PLAYER

PERIOD_NS = 1_000_000
EPOCH_NS = 1_750_000_000_000_000_000
# The time between the sending of a message and its reception by the recorder.
LAG_NS = 20_000
# The streams that a rig of this design sends at 1 kHz, and two more of the link, so that there are ten.
STREAMS = (
    ("haptic/state", "haptic_node@master", "master"),
    ("haptic/command", "controller@master", "master"),
    ("teleop/forward", "controller@master", "master"),
    ("teleop/forward", "controller@master", "slave"),
    ("teleop/backward", "controller@slave", "slave"),
    ("teleop/backward", "controller@slave", "master"),
    ("afm/command", "controller@slave", "slave"),
    ("afm/state", "afm_node@slave", "slave"),
    ("link/status", "delay_node@master", "master"),
    ("link/status", "delay_node@slave", "slave"),
)


@cache
def ordinary(topic: str) -> Message:
    """Return the example of a topic, with an invalid clock: a clock offset would make the player shift the times."""
    example = ordinary_example(topic)
    if topic != "link/status":
        return example
    clock = {"valid": False, "offset_s": 0.0, "uncertainty_s": 0.0, "round_trip_s": 0.0, "exchanges": 0}
    return msgspec.structs.replace(example, clock=LinkClock(**clock))


def typical(topic: str, src: str, seq: int, t_ns: int) -> Message:
    """Return a message of usual size that was sent at a time [ns]."""
    return msgspec.structs.replace(ordinary(topic), seq=seq, t_ns=t_ns, src=src)


def make_recording(folder: Path, seconds: float) -> Path:
    """Write a recording of all streams at 1 kHz, with the messages of a tick spread over it as in a rig."""
    writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=folder))
    channels = [writer.channel(topic, src, site) for topic, src, site in STREAMS]
    for seq in range(round(seconds * 1000)):
        for number, (topic, src, _) in enumerate(STREAMS):
            # A player plays at the times of sending, so the messages of a tick have different ones, as in a rig.
            t_ns = EPOCH_NS + seq * PERIOD_NS + number * PERIOD_NS // (2 * len(STREAMS))
            writer.write(channels[number], t_ns + LAG_NS, t_ns, seq, encode(typical(topic, src, seq, t_ns)))
        if seq % 200 == 199:
            writer.flush()
    writer.finish()
    return writer.path


def make_site(folder: Path) -> Path:
    """Write an address book of the nodes whose messages are played."""
    nodes = {src if src.endswith(site) else f"delay_node@{site}" for _, src, site in STREAMS} | {PLAYER}
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump({"nodes": {node: f"ipc://{folder}/{node}" for node in sorted(nodes)}}))
    return path


def play(path: Path, site_file: Path, rate: float) -> None:
    """Play a recording, in its own process."""
    settings = PlaySettings(rate=rate, wait_s=20.0)
    run_replay(ReplayRequest([path], site_file, settings=settings))


def listen(site_file: Path, expected: int, result: Connection) -> None:
    """Receive `expected` messages; send their times of arrival [ns] and their frames, in order, through `result`."""
    apply_realtime(RealtimeConfig(cpus="free", memory_lock="off"), StructuredLog("reader"), "reader@master")
    freeze_garbage()
    endpoints = yaml.safe_load(site_file.read_text())["nodes"]
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.set(zmq.RCVHWM, 10_000)
        for topic in dict.fromkeys(topic for topic, _, _ in STREAMS):
            socket.subscribe(topic)
        for node, endpoint in endpoints.items():
            if node != PLAYER:
                socket.connect(endpoint)
        arrivals = np.zeros(expected, dtype=np.int64)
        topics: list[bytes] = []
        for number in range(expected):
            topic, payload = socket.recv_multipart()
            arrivals[number] = time.monotonic_ns()
            topics.append(topic + payload)
        result.send((arrivals, topics))


def schedule(path: Path) -> list[tuple[int, str, bytes, bytes]]:
    """Return the messages of a recording in order: time of playing [ns], node, topic and payload."""
    # A message that the link sent on is played at the time at which the link did, known from its reception.
    rows = [
        (
            message.log_ns if message.via == "link" else message.publish_ns,
            node_of(message.channel),
            message.topic.encode(),
            message.payload,
        )
        for message in Recording(path).messages()
    ]
    return sorted(rows, key=itemgetter(0))


def send_bare(path: Path, site_file: Path, rate: float, *, apart: bool = False) -> None:
    """Send the frames of a recording from memory, in a process of its own.

    Args:
        path: The recording.
        site_file: The address book.
        rate: 0 sends as fast as the reader takes them, 1 as recorded.
        apart: True if each node has its own socket, as in a replay; False if all share one.
    """
    rows = schedule(path)
    endpoints = yaml.safe_load(site_file.read_text())["nodes"]
    nodes = sorted({node for _, node, _, _ in rows})
    # The threads of a context have the scheduling under which the context was made.
    scheduling = on_time() if rate > 0.0 else contextlib.nullcontext()
    with contextlib.ExitStack() as stack:
        stack.enter_context(scheduling)
        stack.enter_context(shallow_idle())
        context = stack.enter_context(zmq.Context())
        sockets = [stack.enter_context(context.socket(zmq.XPUB)) for _ in (nodes if apart else nodes[:1])]
        for socket, node in zip(sockets, nodes, strict=False):
            socket.set(zmq.SNDHWM, SEND_HIGH_WATER_MARK if apart else 100_000)
            socket.set(zmq.XPUB_NODROP, 1)
            socket.bind(endpoints[node])
        for socket in sockets:
            for _ in dict.fromkeys(topic for topic, _, _ in STREAMS):
                socket.recv()
        socket_of = dict(zip(nodes, sockets if apart else sockets * len(nodes), strict=True))
        parts = [(due_ns, socket_of[node], (topic, payload)) for due_ns, node, topic, payload in rows]
        freeze_garbage()
        (send_on_time if rate > 0.0 else send_at_once)(parts)


def send_at_once(parts: list[tuple[int, "zmq.Socket[bytes]", tuple[bytes, bytes]]]) -> None:
    """Send messages as fast as the reader takes them."""
    for _, socket, pair in parts:
        while True:
            try:
                socket.send_multipart(pair, zmq.DONTWAIT, copy=True)
                break
            except zmq.Again:
                time.sleep(0.0005)


def send_on_time(parts: list[tuple[int, "zmq.Socket[bytes]", tuple[bytes, bytes]]]) -> None:
    """Send each message when it is due, in a plain loop."""
    ahead_ns = parts[0][0] - time.monotonic_ns()
    for due_ns, socket, pair in parts:
        if (wait_ns := due_ns - ahead_ns - time.monotonic_ns()) > 0:
            time.sleep(wait_ns * 1e-9)
        socket.send_multipart(pair, copy=True)


Sender = Callable[[Path, Path, float], None]


def replayed(path: Path, site_file: Path, rate: float, expected: int, sender: Sender) -> tuple[Any, list[bytes]]:
    """Play a recording to a reader from another process; return the times of arrival [ns] and the frames."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    reader = context.Process(target=listen, args=(site_file, expected, theirs))
    player = context.Process(target=sender, args=(path, site_file, rate))
    with children.spawning_workers():
        reader.start()
        player.start()
    found: tuple[Any, list[bytes]] = ours.recv()
    reader.join()
    player.join()
    return found


def timing(path: Path, site_file: Path, sender: Sender = play) -> dict[str, Any]:
    """Return the error of the interval between consecutive messages [s], over all streams together."""
    by_frame: dict[bytes, list[int]] = {}
    rows = schedule(path)
    for sent_ns, _, topic, payload in rows:
        by_frame.setdefault(topic + payload, []).append(sent_ns)
    arrivals, frames = replayed(path, site_file, 1.0, len(rows), sender)
    # The two copies of a message that crosses the link are the same bytes, and come in the order recorded.
    times = [by_frame[frame].pop(0) for frame in frames]
    order = np.argsort(times, kind="stable")
    recorded, arrived = np.asarray(times)[order], arrivals[order]
    interval = np.abs(np.diff(arrived) - np.diff(recorded)) * 1e-9
    lateness = (arrived - arrived[0]) - (recorded - recorded[0])
    p50, p99 = np.percentile(interval, [50.0, 99.0])
    drift_s = float(np.median(lateness[-1000:]) - np.median(lateness[:1000])) * 1e-9
    return {
        "messages": len(times),
        "interval_error_p50_s": float(p50),
        "interval_error_p99_s": float(p99),
        "interval_error_max_s": float(interval.max()),
        "drift_s": drift_s,
        "messages_per_s": len(times) / ((arrivals[-1] - arrivals[0]) * 1e-9),
    }


def throughput(path: Path, site_file: Path) -> dict[str, Any]:
    """Measure rate 0 against bare sockets and against reading the file; best of two of each, in turns."""
    count, reading_s = timed(lambda: sum(1 for _ in Recording(path).messages()))
    senders: dict[str, Sender] = {"bare": send_bare, "bare_apart": partial(send_bare, apart=True), "bus": play}
    best = dict.fromkeys(senders, 0.0)
    for _ in range(2):
        for name, sender in senders.items():
            arrivals, _ = replayed(path, site_file, 0.0, count, sender)
            best[name] = max(best[name], count / ((arrivals[-1] - arrivals[0]) * 1e-9))
    reading = count / reading_s
    return {
        "file_per_s": reading,
        **{f"{name}_per_s": per_s for name, per_s in best.items()},
        "ratio_to_bare": best["bus"] / best["bare"],
        "ratio_to_bare_apart": best["bus"] / best["bare_apart"],
        "ratio_to_file": best["bus"] / reading,
    }


def verification(path: Path) -> dict[str, Any]:
    """Measure verify against reading the file; best of three of each, in turns."""
    pairs = []
    for _ in range(3):
        count, reading_s = timed(lambda: sum(1 for _ in Recording(path).messages()))
        verdict, verify_s = timed(lambda: verify([path]))
        if not verdict.sound:
            raise SystemExit(f"the recording is not sound: {verdict.findings[:3]}")
        pairs.append((reading_s, verify_s))
    reading_s, verify_s = map(min, zip(*pairs, strict=True))
    return {"file_per_s": count / reading_s, "verify_per_s": count / verify_s, "ratio": reading_s / verify_s}


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return a result and the processor time that it took [s]."""
    begun = time.process_time()
    return work(), time.process_time() - begun


def recording_throughput(path: Path, folder: Path) -> dict[str, Any]:
    """Measure the intake, from frames to the file, against the mcap writer with the same payloads."""
    rows = [(m.topic.encode(), m.payload, m.log_ns, m.publish_ns, m.seq, m.site) for m in Recording(path).messages()]
    pairs = [(_plain_writer(rows, folder / f"{turn}.mcap"), _our_intake(rows, folder / f"{turn}")) for turn in range(3)]
    plain, ours = map(min, zip(*pairs, strict=True))
    return {"plain_per_s": len(rows) / plain, "recorder_per_s": len(rows) / ours, "ratio": plain / ours}


def _plain_writer(rows: list[tuple[Any, ...]], path: Path) -> float:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        writer.start()
        channels = {topic: writer.register_channel(topic.decode(), "msgpack", 0) for topic in {row[0] for row in rows}}
        begun = time.process_time()
        for topic, payload, log_ns, publish_ns, seq, _ in rows:
            writer.add_message(channels[topic], log_ns, payload, publish_ns, seq)
        writer.finish()
        return time.process_time() - begun


def _our_intake(rows: list[tuple[Any, ...]], folder: Path) -> float:
    clock = SystemClock()
    site_file = folder.parent / "site.yaml"
    with zmq.Context() as context:
        listeners = {
            site: Listener(f"delay_node@{site}", Subscriber(context, clock, {"inproc://nowhere": ["haptic/state"]}))
            for site in ("master", "slave")
        }
        config = RecorderConfig(directory=folder)
        intake: Intake = begin_recording("recorder@master", clock, config, site_file, None)
        begun = time.process_time()
        for number, (topic, payload, log_ns, _, _, site) in enumerate(rows):
            intake.record(listeners[site], [topic, payload], log_ns)
            # This is as often as the node flushes at 10 000 messages a second.
            if number % 2000 == 1999:
                intake.flush(clock.monotonic_ns())
        intake.finish()
        took = time.process_time() - begun
        for listener in listeners.values():
            listener.subscriber.close()
    return took


def main() -> int:
    """Run all measurements and print them."""
    parser = argparse.ArgumentParser(description="Recording and replay against what they are made of.")
    parser.add_argument("--seconds", type=float, default=10.0, help="length of the recording [s]")
    parser.add_argument("--smoke", action="store_true", help="a fraction of a second of each, to see that it runs")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    seconds = 0.3 if given.smoke else given.seconds
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path, site_file = make_recording(folder, seconds), make_site(folder)
        results = {
            "cpus": os.cpu_count(),
            "timing": timing(path, site_file),
            "plain_timer": timing(path, site_file, send_bare),
            "rate_0": throughput(path, site_file),
            "verify": verification(path),
            "recording": recording_throughput(path, folder),
        }
    if given.json:
        print(json.dumps(results))
        return 0
    for group, values in results.items():
        print(f"{group}: {json.dumps(values, indent=2)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
