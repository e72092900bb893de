"""The arrivals of a recorded session are those that its link made, whatever was lost, late or overtaken."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.loops.links import symmetric_link
from telenano_lab.studies.loops.recorded_link import recorded_schedule

from telenano.link import DirectionEngine
from telenano.lockstep import MESSAGE_BYTES, Schedule
from telenano.recording import FileSettings, RecordingWriter
from telenano.testing import numbered
from telenano.wire import LinkFate, RecordingError, encode

MS = 1_000_000
EPOCH_NS = 10**18
SETTLE, SESSION, PERIOD_S = 50, 250, 1e-3
# the link of a random session, and the hand a little late at every sample
SETTINGS = symmetric_link(24e-3, 9e-3, 0.2, 5)


def late_ns(seq: int) -> int:
    return (seq * 37_013) % 600_000


LEAST_NS = min(late_ns(n) for n in range(SETTLE, SETTLE + SESSION))


class Tape:
    """A recording of a session over a link, written by hand."""

    def __init__(self, folder: Path) -> None:
        self.writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder))
        self.path = self.writer.path

    def write(self, topic: str, src: str, messages: list[dict[str, Any]]) -> None:
        channel = self.writer.channel(topic, src, src.partition("@")[2])
        for seq, fields in enumerate(messages):
            t_ns = fields.get("t_ns", EPOCH_NS)
            message = numbered(topic, seq, **{**fields, "src": src, "t_ns": t_ns})
            self.writer.write(channel, t_ns, t_ns, seq, encode(message))


def told_of(fates: list[Any]) -> tuple[LinkFate, ...]:
    """Give what the link reports of the fates of its messages."""
    shown = ("topic", "seq", "arrived_ns", "delay_ns", "queue_ns", "held_ns", "dropped", "duplicated", "reordered")
    return tuple(
        LinkFate(**{name: getattr(f, name) for name in shown}, is_duplicate=f.copy > 0, corrupted=f.corrupted)
        for f in fates
    )


def recorded(folder: Path, *, told: bool = True) -> Path:
    tape = Tape(folder)
    ticks = SETTLE + SESSION
    stamps = [EPOCH_NS + n * MS + late_ns(n) for n in range(ticks)]
    session_s = [-1.0] * SETTLE + [1e-3 * n for n in range(SESSION)]
    hand = [{"t_ns": stamp, "session_s": s, "step_s": 1e-3} for stamp, s in zip(stamps, session_s, strict=True)]
    tape.write("haptic/state", "haptic_node@master", hand)
    tape.write("teleop/forward", "controller@master", [{"hand_t_ns": stamp} for stamp in stamps])
    grid = [EPOCH_NS + n * MS for n in range(ticks)]
    forward = DirectionEngine.fates(SETTINGS, "forward", "teleop/forward", grid, MESSAGE_BYTES)
    schedule = Schedule.of(SETTINGS, ticks, PERIOD_S)
    backward_at = (EPOCH_NS + schedule.forward_ns).tolist()
    tape.write("teleop/backward", "controller@slave", [{"hand_t_ns": stamps[n]} for n in schedule.forward_of.tolist()])
    backward = DirectionEngine.fates(SETTINGS, "backward", "teleop/backward", backward_at, MESSAGE_BYTES)
    for direction, fates in (("forward", forward), ("backward", backward)) if told else ():
        rows = told_of(fates)
        parts = [{"direction": direction, "fates": rows[n : n + 64]} for n in range(0, len(rows), 64)]
        tape.write("link/fates", "delay_node@master", parts)
    tape.writer.finish()
    return tape.path


def test_arrivals_are_those_of_the_link(tmp_path: Path) -> None:
    found = recorded_schedule(recorded(tmp_path), SETTLE, SETTLE + SESSION, PERIOD_S)
    made = Schedule.of(SETTINGS, SETTLE + SESSION, PERIOD_S)
    assert 40 < len(made.forward_ns) < 240
    for name in ("forward_ns", "forward_of", "backward_ns", "backward_of"):
        # the grid is that of the sample that was least late
        np.testing.assert_allclose(getattr(found, name), getattr(made, name), rtol=0.0, atol=LEAST_NS)
    assert (found.forward_of == made.forward_of).all()
    assert (found.backward_of == made.backward_of).all()
    assert (found.ticks, found.window) == (made.ticks, made.window)


def test_part_of_the_time_before_the_session_is_left_out(tmp_path: Path) -> None:
    path = recorded(tmp_path)
    whole = recorded_schedule(path, SETTLE, SETTLE + SESSION, PERIOD_S)
    part = recorded_schedule(path, 20, 20 + SESSION, PERIOD_S)
    late = whole.forward_of >= SETTLE - 20
    assert (part.forward_of == whole.forward_of[late] - (SETTLE - 20)).all()
    assert (part.forward_ns == whole.forward_ns[late] - (SETTLE - 20) * MS).all()
    answered = whole.forward_of[whole.backward_of]
    assert (part.forward_of[part.backward_of] == answered[answered >= SETTLE - 20] - (SETTLE - 20)).all()


def test_recording_without_the_truth_of_the_link_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="link/fates has no teleop/forward"):
        recorded_schedule(recorded(tmp_path, told=False), SETTLE, SETTLE + SESSION, PERIOD_S)
