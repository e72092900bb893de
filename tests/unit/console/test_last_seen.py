"""The last known state of a device that has not answered, from a recording that is still being written."""

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from telenano.console import last_seen as module
from telenano.console.answers import Answer
from telenano.console.last_seen import last_seen, with_last_seen
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.testing.filled_messages import examples
from telenano.wire import encode
from telenano.wire.topics import TOPICS

HAND, TIP, HALF = "haptic_node@master", "afm_node@slave", "controller@slave"
# Of the rig only the recorders count, whose files are given by the test.
RIG: Any = SimpleNamespace()


def recording(folder: Path, messages: list[tuple[str, str, float, dict[str, Any]]]) -> Path:
    """Write messages, each with its topic, source, age [s] and some fields, to a file that is not closed."""
    writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=folder))
    for seq, (topic, src, age_s, fields) in enumerate(messages):
        then_ns = time.time_ns() - round(age_s * 1e9)
        header = {"seq": seq, "t_ns": then_ns, "src": src}
        message = msgspec.structs.replace(examples(TOPICS[topic])["minimal"], **header, **fields)
        channel = writer.channel(topic, src, src.partition("@")[2])
        writer.write(channel, then_ns, then_ns, seq, encode(message))
    writer.flush()
    writer.abandon()
    return writer.path


def tip(force_n: float, mode: str, *, in_contact: bool = True) -> dict[str, Any]:
    return {"tip_force_n": (0.0, 0.0, force_n), "mode": mode, "in_contact": in_contact}


@pytest.mark.parametrize(
    ("messages", "device", "words"),
    [
        ([("afm/state", TIP, 9.0, tip(1e-9, "follow")), ("afm/state", TIP, 2.0, tip(9e-9, "follow"))], TIP,
         "last seen pressing 9 nN (follow), 2."),
        ([("afm/state", TIP, 2.0, tip(-4.2e-9, "hold"))], TIP, "last seen pulled by 4.2 nN (hold), 2."),
        ([("afm/state", TIP, 2.0, tip(0.0, "retracted", in_contact=False))], TIP,
         "last seen free of the sample (retracted), 2."),
        # its half repeats the last state of a device that is gone, so the device's own word is the older one
        ([("afm/state", TIP, 8.0, tip(9e-9, "follow")),
          ("teleop/backward", HALF, 1.0, {"force_n": (0.0, 0.0, 9e-9), "in_contact": True})], TIP,
         "last seen pressing 9 nN (follow), 8."),
        ([("teleop/backward", HALF, 1.0, {"force_n": (0.0, 0.0, 9e-9), "in_contact": True})], TIP,
         "last reported as pressing 9 nN, 1."),
        ([("haptic/state", HAND, 3.0, {"mode": "position", "estop": False, "armed": True})], HAND,
         "last seen driven, armed, 3."),
        ([("haptic/state", HAND, 3.0, {"mode": "off", "estop": True, "armed": False})], HAND,
         "last seen in emergency stop, 3."),
        ([("haptic/state", HAND, 3.0, {})], TIP, ""),
    ],
)  # fmt: skip
def test_a_device_is_last_seen_as_it_was_recorded(
    messages: Any, device: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = recording(tmp_path, messages)
    monkeypatch.setattr(module, "_recorded_now", lambda rig: [path])
    assert last_seen(RIG, [device]).get(device, "").startswith(words)
    assert bool(last_seen(RIG, [device])) == bool(words)


def test_nothing_is_said_of_who_has_answered_or_without_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = recording(tmp_path, [("afm/state", TIP, 2.0, tip(9e-9, "follow"))])
    answers = {HAND: Answer(HAND, "ack", "stopped"), TIP: Answer(TIP, "kept", "did not answer")}
    monkeypatch.setattr(module, "_recorded_now", lambda rig: [path])
    found = with_last_seen(RIG, answers)
    assert found[HAND] == answers[HAND]
    assert found[TIP].sentence.startswith("did not answer; last seen pressing 9 nN (follow), 2.")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    for paths in ([], [path], [tmp_path / "gone.mcap"]):
        monkeypatch.setattr(module, "_recorded_now", lambda rig, paths=paths: paths)
        assert with_last_seen(RIG, answers)[TIP].kind == "kept"
