"""A turn of the journal is matched with the message that the node had, or with none."""

import random
from pathlib import Path
from typing import Any

import numpy as np

from telenano.recording.reader import Recording
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.rerun.rerun_inputs import RecordedNode, turns_of
from telenano.runtime.loop.journal import COMMAND
from telenano.wire.codec import encode
from telenano.wire.journal_messages import JournalInput, NodeJournal
from telenano.wire.messages import Array, SessionControl

NODE, CONSOLE, TOPIC = "controller@master", "console@master", "session/control"
BEGIN_NS = 1_750_000_000_000_000_000


def journal(turns: list[tuple[int, int]]) -> NodeJournal:
    """Return a batch whose turns, time [ns] and seq, are commands of the console."""
    columns: dict[str, Any] = dict(
        kind=np.full(len(turns), COMMAND, "u1"),
        time_ns=np.array([time_ns for time_ns, _ in turns], "i8"),
        input=np.zeros(len(turns), "i2"),
        number=np.array([seq for _, seq in turns], "i8"),
        state=np.zeros(0, "u1"),
    )
    return NodeJournal(
        src=NODE, seq=0, t_ns=BEGIN_NS, v=NodeJournal.version, first_turn=0, epoch_offset_ns=0, outputs={},
        inputs=(JournalInput(topic=TOPIC, src=CONSOLE),),
        **{name: Array.from_numpy(column) for name, column in columns.items()},
    )  # fmt: skip


def test_a_command_of_one_console_is_not_taken_for_that_of_another(tmp_path: Path) -> None:
    found = {"recorded": 0, "missing": 0}
    for seed in range(60):
        draw = random.Random(seed)
        writer = RecordingWriter.create("recorder@master", FileSettings(directory=tmp_path / str(seed)))
        channel = writer.channel(TOPIC, CONSOLE, "master")
        sent_ns, turns, heard = BEGIN_NS, [], []
        for _ in range(draw.randint(2, 6)):
            # Each console is a process, which the recorder hears from its first command on or not at all.
            is_heard = draw.random() < 0.6
            sent_ns += draw.randint(50_000_000, 30_000_000_000)
            for seq in range(draw.randint(1, 3)):
                sent_ns += draw.randint(10_000_000, 500_000_000)
                command = SessionControl(
                    src=CONSOLE, seq=seq, t_ns=sent_ns, v=SessionControl.version,
                    id=f"{seed}-{len(turns)}", command="arm", target="*", parameters={},
                )  # fmt: skip
                turns.append((sent_ns + draw.randint(200_000, 5_000_000), seq))
                heard.append(encode(command) if is_heard else None)
                if is_heard:
                    writer.write(channel, sent_ns + draw.randint(200_000, 5_000_000), sent_ns, seq, encode(command))
        writer.finish()
        batch = journal(turns)
        node = RecordedNode(Recording(writer.path), NODE, [batch])
        for turn, payload in zip(turns_of(batch), heard, strict=True):
            message = node.input(turn)
            assert (None if message is None else message.payload) == payload, (seed, turn)
            found["missing" if payload is None else "recorded"] += 1
    assert min(found.values()) > 100
