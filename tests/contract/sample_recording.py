"""A small recording that has something of everything: a message of each topic, and the recorder's own records."""

from pathlib import Path
from typing import Any

import msgpack
import msgspec

from telenano.recording.provenance import configuration_files, write_provenance
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import GapRecord, RejectedRecord
from telenano.recording.writer import RecordingWriter
from telenano.settings import DEFAULT_SITE_FILE
from telenano.testing.filled_messages import examples
from telenano.wire import encode
from telenano.wire.topics import OWN_TOPICS as TOPICS

SCENARIO = Path(__file__).parents[2] / "telenano" / "settings" / "scenarios" / "fig12.yaml"
_NS = 1_750_000_000_000_000_000


def write_sample(folder: Path, **changes: dict[str, Any]) -> Path:
    """Write a recording with a message of every topic, one that came over the link, and the recorder's own records.

    Args:
        folder: The folder that it is written to.
        changes: By topic, keys that its message has besides, or others.
    """
    config = RecorderConfig(directory=folder)
    writer = RecordingWriter.create("recorder@master", config)
    write_provenance(writer, config, configuration_files(DEFAULT_SITE_FILE, SCENARIO), _NS)
    for topic, row in TOPICS.items():
        message = msgspec.structs.replace(examples(row)["ordinary"], seq=0, t_ns=_NS)
        payload = msgpack.packb(msgpack.unpackb(encode(message)) | changes.get(topic, {}))
        writer.write(writer.channel(topic, message.src, message.src.partition("@")[2]), _NS, _NS, 0, payload)
        if topic == "teleop/forward":
            writer.write(writer.channel(topic, message.src, "slave"), _NS, _NS, 0, payload)
    gap = GapRecord(channel_topic="haptic/state", src="haptic_node@master", first_missing=1, last_missing=2, count=2)
    writer.write_gap(_NS, gap)
    text = RejectedRecord(reason="frames", text="3 frames", publisher="a@master", size_bytes=1, frames=(b"x",))
    writer.write_rejected(_NS, text)
    writer.finish({"state": "stopped", "note": ""})
    return writer.path
