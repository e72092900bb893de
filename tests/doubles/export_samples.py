"""Recordings to export: one with every kind of field, and one of any length."""

from pathlib import Path

import numpy as np
from recorder_samples import EPOCH_NS, NODE, haptic_state, sample

from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import RejectedRecord
from telenano.recording.writer import RecordingWriter
from telenano.wire import encode
from telenano.wire.messages import Array

HEIGHTS = np.array([1e-9, -2.5e-10, 3e-12])


def rich_recording(folder: Path) -> Path:
    """Write a recording with every kind of field: vectors, flags, text, arrays, maps, parts that may be nil."""
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=folder))
    writer.attach("site.yaml", "application/yaml", b"nodes: {}\n", EPOCH_NS)
    writer.add_metadata("versions", {"python": "3"})
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    forward = writer.channel("teleop/forward", "controller@master", "slave")
    lines = writer.channel("afm/scanline", "afm_node@slave", "slave")
    event = writer.channel("session/event", "afm_node@slave", "slave")
    for seq in range(10):
        writer.write(hand, EPOCH_NS + seq, seq, seq, encode(haptic_state(seq)))
        wave = (0.0, 0.0, 0.5) if seq == 3 else None
        message = sample("teleop/forward", seq, src="controller@master", wave_sqrt_w=wave, energy_j=None)
        writer.write(forward, EPOCH_NS + seq, message.t_ns, seq, encode(message))
        heights, wide = Array.from_numpy(HEIGHTS * seq), Array.from_numpy((HEIGHTS * seq).reshape(1, 3))
        scan = sample("afm/scanline", seq, src="afm_node@slave", height_m=heights, amplitude_m=wide)
        writer.write(lines, EPOCH_NS + seq, scan.t_ns, seq, encode(scan))
        message = sample("session/event", seq, src="afm_node@slave", data={"force_n": 1.5, f"k{seq}": "x"})
        writer.write(event, EPOCH_NS + seq, message.t_ns, seq, encode(message))
    rejected = RejectedRecord(
        reason="malformed", text="t", publisher="afm_node@slave", size_bytes=2, frames=(b"\x00\xff",)
    )
    writer.write_rejected(EPOCH_NS, rejected)
    writer.finish()
    return writer.path


def hand_recording(folder: Path, messages: int) -> Path:
    """Write the hand at 100 Hz in chunks of 8 kB."""
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=folder, chunk_size_bytes=8192))
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    for seq in range(messages):
        t_ns = EPOCH_NS + seq * 10_000_000
        writer.write(channel, t_ns, t_ns, seq, encode(haptic_state(seq, t_ns=t_ns)))
    writer.finish()
    return writer.path
