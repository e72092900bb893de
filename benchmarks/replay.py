"""Recording and replay against what they are made of, in one run.

    python benchmarks/replay.py [--seconds S] [--json]

- Timing: the error of the intervals between messages against the recording, at rate 1, with all ten topics at 1 kHz.
- Rate 0: messages a second through the bus to one reader, as a ratio to reading the file without the bus.
- Recording: messages a second through the recorder's intake, as a ratio to the plain `mcap` writer with the same bytes.

Replay runs in a process of its own; the reader stamps each arrival with the monotonic clock and keeps nothing else.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import yaml
import zmq
from mcap.writer import CompressionType, Writer

from proto import TOPICS, encode
from proto.contract import examples
from proto.messages import Message
from proto.nodes import PLAYER
from recording.reader import Recording
from recording.writer import RecordingWriter
from services.player.node import PlaySettings
from services.player.run import ReplayRequest, run_replay
from services.recorder.config import RecorderConfig
from services.recorder.intake import Intake, Listener
from services.recorder.open_recording import open_recording
from services.runtime.bus.bus import Subscriber
from services.runtime.loop.clock import SystemClock

PERIOD_NS = 1_000_000
EPOCH_NS = 1_750_000_000_000_000_000
# what is sent at 1 kHz in a rig of this design, and two more of the link, so that there are ten
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


def typical(topic: str, src: str, seq: int) -> Message:
    """Give a message of usual size."""
    example = examples(TOPICS[topic])["ordinary"]
    return example.model_copy(update={"seq": seq, "t_ns": EPOCH_NS + seq * PERIOD_NS, "src": src})


def make_recording(folder: Path, seconds: float) -> Path:
    """Write a recording of all streams at 1 kHz, the messages of a tick spread over it as in a rig."""
    writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=folder))
    channels = [writer.channel(topic, src, site) for topic, src, site in STREAMS]
    for seq in range(round(seconds * 1000)):
        for number, (topic, src, _) in enumerate(STREAMS):
            log_ns = EPOCH_NS + seq * PERIOD_NS + number * PERIOD_NS // (2 * len(STREAMS))
            message = typical(topic, src, seq)
            writer.write(channels[number], log_ns, message.t_ns, seq, encode(message))
        if seq % 200 == 199:
            writer.flush()
    writer.finish()
    return writer.path


def make_site(folder: Path) -> Path:
    """Write an address book of the nodes that are played."""
    nodes = {src if src.endswith(site) else f"delay_node@{site}" for _, src, site in STREAMS} | {PLAYER}
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump({"nodes": {node: f"ipc://{folder}/{node}" for node in sorted(nodes)}}))
    return path


def play(path: Path, site_file: Path, rate: float) -> None:
    """Play a recording, in a process of its own."""
    settings = PlaySettings(rate=rate, wait_s=20.0)
    run_replay(ReplayRequest([path], site_file, settings=settings))


def listen(site_file: Path, expected: int, result: Connection) -> None:
    """Receive so many messages and send their times of arrival [ns] by stream."""
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


def replayed(path: Path, site_file: Path, rate: float, expected: int) -> tuple[Any, list[bytes]]:
    """Play a recording to a reader; gives times of arrival [ns] and frames."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    reader = context.Process(target=listen, args=(site_file, expected, theirs))
    player = context.Process(target=play, args=(path, site_file, rate))
    reader.start()
    player.start()
    found: tuple[Any, list[bytes]] = ours.recv()
    reader.join()
    player.join()
    return found


def timing(path: Path, site_file: Path) -> dict[str, Any]:
    """Measure the error of the interval between consecutive messages, all streams taken together [s]."""
    recording = Recording(path)
    due = {}
    for message in recording.messages():
        due[message.topic.encode() + message.payload, message.channel_topic] = message.log_ns
    by_frame: dict[bytes, list[int]] = {}
    for (frame, _), log_ns in due.items():
        by_frame.setdefault(frame, []).append(log_ns)
    arrivals, frames = replayed(path, site_file, 1.0, len(due))
    # the two copies of what crosses the link are the same bytes and come in the order recorded
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
        "drift_s": drift_s,
        "messages_per_s": len(times) / ((arrivals[-1] - arrivals[0]) * 1e-9),
    }


def throughput(path: Path, site_file: Path) -> dict[str, Any]:
    """Measure rate 0 against reading the file."""
    recording = Recording(path)
    begun = time.perf_counter()
    count = sum(1 for _ in recording.messages())
    reading = count / (time.perf_counter() - begun)
    arrivals, _ = replayed(path, site_file, 0.0, count)
    playing = count / ((arrivals[-1] - arrivals[0]) * 1e-9)
    return {"file_per_s": reading, "bus_per_s": playing, "ratio": playing / reading, "lost": count - len(arrivals)}


def recording_throughput(path: Path, folder: Path) -> dict[str, Any]:
    """Measure the intake, from frames to the file, against the mcap writer with the same payloads."""
    rows = [(m.topic.encode(), m.payload, m.log_ns, m.publish_ns, m.seq, m.site) for m in Recording(path).messages()]
    plain = _plain_writer(rows, folder / "plain.mcap")
    ours = _our_intake(rows, folder / "ours")
    return {"plain_per_s": len(rows) / plain, "recorder_per_s": len(rows) / ours, "ratio": plain / ours}


def _plain_writer(rows: list[tuple[Any, ...]], path: Path) -> float:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        writer.start()
        channels = {topic: writer.register_channel(topic.decode(), "msgpack", 0) for topic in {row[0] for row in rows}}
        begun = time.perf_counter()
        for topic, payload, log_ns, publish_ns, seq, _ in rows:
            writer.add_message(channels[topic], log_ns, payload, publish_ns, seq)
        writer.finish()
        return time.perf_counter() - begun


def _our_intake(rows: list[tuple[Any, ...]], folder: Path) -> float:
    clock = SystemClock()
    site_file = folder.parent / "site.yaml"
    with zmq.Context() as context:
        listeners = {
            site: Listener(f"delay_node@{site}", Subscriber(context, clock, {"inproc://nowhere": ["haptic/state"]}))
            for site in ("master", "slave")
        }
        config = RecorderConfig(directory=folder)
        intake: Intake = open_recording("recorder@master", clock, config, site_file, None)
        begun = time.perf_counter()
        for number, (topic, payload, log_ns, _, _, site) in enumerate(rows):
            intake.record(listeners[site], [topic, payload], log_ns)
            # as often as the node does at 10 000 messages a second
            if number % 2000 == 1999:
                intake.flush(clock.monotonic_ns())
        intake.finish()
        took = time.perf_counter() - begun
        for listener in listeners.values():
            listener.subscriber.close()
    return took


def main() -> int:
    """Run all three and print them."""
    parser = argparse.ArgumentParser(description="Recording and replay against what they are made of.")
    parser.add_argument("--seconds", type=float, default=10.0, help="length of the recording [s]")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path, site_file = make_recording(folder, given.seconds), make_site(folder)
        results = {
            "cpus": os.cpu_count(),
            "timing": timing(path, site_file),
            "rate_0": throughput(path, site_file),
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
