"""Recordings to read."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, teleop_forward

from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.wire import encode


@pytest.fixture
def config(tmp_path: Path) -> RecorderConfig:
    return RecorderConfig(directory=tmp_path)


@pytest.fixture
def make_file(tmp_path: Path) -> Callable[..., Path]:
    """Write a recording of two topics, the second one received behind the link, in chunks of 10 ms."""

    def make(messages: int = 40, *, finish: bool = True, **settings: Any) -> Path:
        writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path, **settings))
        writer.attach("site.yaml", "application/yaml", b"nodes: {}\n", EPOCH_NS)
        writer.add_metadata("versions", {"python": "3"})
        hand = writer.channel("haptic/state", "haptic_node@master", "master")
        far = writer.channel("teleop/forward", "controller@master", "slave")
        for seq in range(messages):
            log_ns = EPOCH_NS + seq * MILLISECOND_NS
            writer.write(hand, log_ns + 100, log_ns, seq, encode(haptic_state(seq)))
            writer.write(far, log_ns + 200, log_ns, seq, encode(teleop_forward(seq)))
            if seq % 10 == 9:
                writer.flush()
        if finish:
            writer.finish()
        else:
            writer.flush()
            writer._stream.close()
        return writer.path

    return make
