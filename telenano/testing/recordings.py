"""Recordings for tests: sessions of both sites in virtual time, made once for all tests, and made-up files."""

import fcntl
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from telenano.recording.made_records import write_recording as write_recording
from telenano.recording.messages import RawChannel, RawMessage
from telenano.recording.records import RejectedRecord
from telenano.recording.rewrite import CopyWriter
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.settings import find_scenario, read_yaml
from telenano.testing.messages import EPOCH_NS, hand_state, numbered
from telenano.virtual import record_session
from telenano.wire import encode
from telenano.wire.messages import Array

# Heights in the scan lines of `rich_recording`, which are these times the number of the message [m].
HEIGHTS_M = np.array([1e-9, -2.5e-10, 3e-12])


def record_fig12(
    folder: Path,
    law: str = "virtual_impedance",
    settings: Sequence[str] = (),
    *,
    delay_s: float = 0.004,
    seed: int = 1,
    programme_s: float = 1.1,
    duration_s: float = 2.0,
) -> Path:
    """Record the beginning of Fig. 12 in virtual time: real nodes of both sites, the link and the recorder.

    Args:
        folder: The folder of the recording, which is created.
        law: The law.
        settings: Further settings of the scenario, in the form of `--set`.
        delay_s: The delay of the link in each direction [s].
        seed: The seed of all delays on the sites.
        programme_s: The length of the programme of the hand [s]; the whole one takes 8 s.
        duration_s: The time for which the nodes run, including 0.3 s before the programme [s].

    Returns:
        The path of the recording.
    """
    scenario = read_yaml(find_scenario("fig12")) | {"duration_s": programme_s}
    link = json.dumps({"delay_s": delay_s})
    ways = [f"delay_node.{way}={link}" for way in ("forward", "backward")]
    folder.mkdir(parents=True, exist_ok=True)
    return record_session(folder, seed, [f"controller.law={law}", *ways, *settings], duration_s, scenario)


def recording_with(folder: Path, name: str, make: Callable[[Path], Path]) -> Path:
    """Return the path of a recording, which the first process of a test run that needs it makes.

    Args:
        folder: The folder of all recordings of the run.
        name: The name of the recording's folder.
        make: Makes the recording in a given folder.
    """
    path = folder / name / "session.mcap"
    folder.mkdir(exist_ok=True)
    with (folder / f"{name}.lock").open("w") as lock:
        # Another worker may be making it now.
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            made = folder / f"{name}.made"
            make(made)
            made.rename(path.parent)
    return path


def rich_recording(folder: Path) -> Path:
    """Write a recording with every kind of field: vectors, flags, text, arrays, maps, parts that may be nil."""
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder))
    writer.attach("site.yaml", "application/yaml", b"nodes: {}\n", EPOCH_NS)
    writer.add_metadata("versions", {"python": "3"})
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    forward = writer.channel("teleop/forward", "controller@master", "slave")
    lines = writer.channel("afm/scanline", "afm_node@slave", "slave")
    event = writer.channel("session/event", "afm_node@slave", "slave")
    for seq in range(10):
        writer.write(hand, EPOCH_NS + seq, seq, seq, encode(hand_state(seq)))
        wave = (0.0, 0.0, 0.5) if seq == 3 else None
        message = numbered("teleop/forward", seq, src="controller@master", wave_sqrt_w=wave, energy_j=None)
        writer.write(forward, EPOCH_NS + seq, message.t_ns, seq, encode(message))
        heights, wide = Array.from_numpy(HEIGHTS_M * seq), Array.from_numpy((HEIGHTS_M * seq).reshape(1, 3))
        scan = numbered("afm/scanline", seq, src="afm_node@slave", height_m=heights, amplitude_m=wide)
        writer.write(lines, EPOCH_NS + seq, scan.t_ns, seq, encode(scan))
        message = numbered("session/event", seq, src="afm_node@slave", data={"force_n": 1.5, f"k{seq}": "x"})
        writer.write(event, EPOCH_NS + seq, message.t_ns, seq, encode(message))
    rejected = RejectedRecord(
        reason="malformed", text="t", publisher="afm_node@slave", size_bytes=2, frames=(b"\x00\xff",)
    )
    writer.write_rejected(EPOCH_NS, rejected)
    writer.finish()
    return writer.path


def hand_recording(folder: Path, messages: int) -> Path:
    """Write a recording of a number of messages of the hand at 100 Hz, in chunks of 8 kB."""
    from telenano.testing.messages import EPOCH_NS, hand_state

    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder, chunk_size_bytes=8192))
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    for seq in range(messages):
        t_ns = EPOCH_NS + seq * 10_000_000
        writer.write(channel, t_ns, t_ns, seq, encode(hand_state(seq, t_ns=t_ns)))
    writer.finish()
    return writer.path


def foreign_recording(path: Path, attachments: Mapping[str, bytes]) -> Path:
    """Write a recording of a foreign program: an unknown topic, and attachments of any name."""
    facts = (("delivery", "lossless"), ("site", "slave"), ("src", "afm_node@slave"), ("topic", "new/topic"))
    with CopyWriter(path) as writer:
        channel = RawChannel("new/topic", "msgpack", facts, None)
        writer.add(RawMessage(channel, EPOCH_NS, EPOCH_NS, 0, b"\x81\xa1a\x01"))
        for name, content in attachments.items():
            writer.attach(name, "text/plain", content, EPOCH_NS)
    return path
