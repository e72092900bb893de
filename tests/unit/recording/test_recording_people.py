"""Who acted in a recording, by the names in its commands, answers and events."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from typer.testing import CliRunner

from telenano.cli.commands import bag
from telenano.cli.commands.bag import app
from telenano.recording.multi_file import open_recordings
from telenano.recording.people import people_in
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.runtime.loop.commands import CommandHandler
from telenano.wire import encode
from telenano.wire.messages import Message, SessionControl, SessionEvent

T_NS = 10**18


def control(seq: int, command: str, by: str | None = None) -> SessionControl:
    fields: dict[str, Any] = {"seq": seq, "t_ns": T_NS, "src": "console@master", "v": 1, "id": f"c-{seq // 2}"}
    named = {} if by is None else {"by": by}
    return msgspec.convert(
        {**fields, "command": command, "target": "afm_node", "parameters": {}, "validity_s": 2.0, **named},
        SessionControl,
    )


def event(seq: int, text: str, answer_to: str = "", **data: Any) -> SessionEvent:
    header = {"seq": seq, "t_ns": T_NS, "src": "afm_node@slave", "v": 1, "kind": "ack" if answer_to else "node"}
    return msgspec.convert({**header, "id": answer_to, "level": "info", "text": text, "data": data}, SessionEvent)


def test_a_recording_says_who_gave_each_command_and_who_had_the_hand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages: list[Message] = [
        # a command is sent again until it is answered, and the answer repeats the name
        control(0, "arm", "Paul"),
        control(1, "arm", "Paul"),
        event(0, "armed", "c-0", command="arm", by="Paul"),
        control(2, "set", "Ms Tina Ås"),
        control(4, "set"),
        # an emergency stop at the inlet of a device is known by its answer alone
        event(1, "latched", "e-1", command="estop", by="Paul"),
        event(2, "Paul holds control", by="Paul", role="operator"),
        event(3, "control is free", role=""),
    ]
    writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=tmp_path))
    for number, message in enumerate(messages):
        topic = "session/control" if isinstance(message, SessionControl) else "session/event"
        channel = writer.channel(topic, message.src, "master" if topic == "session/control" else "slave")
        writer.write(channel, T_NS + number, T_NS + number, message.seq, encode(message))
    writer.finish()
    wanted = {"Ms Tina Ås": {"set": 1}, "Paul": {"arm": 1, "estop": 1, "hand": 1}}
    assert people_in(open_recordings([writer.path])) == wanted
    run = CliRunner().invoke
    assert json.loads(run(app, ["info", str(writer.path), "--json"]).output)["people"] == wanted
    assert "Ms Tina Ås" in run(app, ["info", str(writer.path)]).output
    # a long one, which is read by its index
    monkeypatch.setattr(bag, "_LONG_BYTES", 0)
    assert json.loads(run(app, ["info", str(writer.path), "--json"]).output)["people"] == wanted


def test_a_node_repeats_in_its_answer_who_gave_the_command() -> None:
    said: list[dict[str, Any]] = []

    def answer(kind: str, level: str, text: str, *, answer_to: str = "", **data: Any) -> None:
        said.append(data)

    handler = CommandHandler("afm_node@slave", ("set", "arm"), lambda given: "done", answer)
    handler.handle(control(0, "set", "Paul"), T_NS)
    handler.handle(control(2, "set"), T_NS)
    # one that is refused unheard as well
    handler.handle(control(4, "set", "Paul"), T_NS + 10**10)
    assert [data.get("by") for data in said] == ["Paul", None, "Paul"]
    assert said[2]["expired"] is True
