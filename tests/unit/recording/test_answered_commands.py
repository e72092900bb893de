"""Each command that was answered is in a recording, by its own message or its answer, or is named as missing."""

import random
from pathlib import Path
from typing import Any

import msgspec
import pytest

from telenano.recording.answered_commands import AnsweredCommands
from telenano.recording.multi_file import open_recordings
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.summary_section import quick_info
from telenano.recording.verify import verify
from telenano.recording.writer import RecordingWriter
from telenano.runtime.loop.commands import CommandHandler
from telenano.wire import encode
from telenano.wire.answers import AnsweredCommand, read_answer
from telenano.wire.codec import accept, fields_of
from telenano.wire.errors import RefusedError
from telenano.wire.messages import SessionControl, SessionEvent

T_NS = 10**18
NODES = ("haptic_node@master", "afm_node@slave", "controller@master", "controller@slave", "recorder@master")
# The data of an answer that versions before had.
EARLIER = ("command", "by", "sent_t_ns", "expired", "latch", "latched", "estop_age_s")


class Consoles:
    """Consoles that come and go, the nodes that answer them, and a recorder that hears only some consoles."""

    def __init__(self, seed: int, writer: RecordingWriter) -> None:
        self.draw = random.Random(seed)
        self.writer = writer
        self.events: list[dict[str, Any]] = []
        # What was given, by id; the ids that were answered, whose message was recorded, and that old nodes answered.
        self.given: dict[str, SessionControl] = {}
        self.answered: set[str] = set()
        self.recorded: set[str] = set()
        self.told: set[str] = set()
        self._seq = dict.fromkeys(NODES, 0)
        self._heard: dict[str, int] = {}
        self._now_ns = T_NS
        self.is_old = False
        self._handlers = {
            node: CommandHandler(node, ("set", "mark", "estop"), self._obey, self._event(node)) for node in NODES
        }

    def _obey(self, control: SessionControl) -> str:
        if self.draw.random() < 0.2:
            raise RefusedError("not now")
        return "done"

    def _event(self, node: str) -> Any:
        def event(kind: str, level: str, text: str, *, answer_to: str = "", **data: Any) -> None:
            data = {key: value for key, value in data.items() if key in EARLIER} if self.is_old else data
            header = {"seq": self._seq[node], "t_ns": self._now_ns, "src": node, "v": 1}
            self._seq[node] += 1
            sent = msgspec.convert(
                {**header, "id": answer_to, "kind": kind, "level": level, "text": text, "data": data}, SessionEvent
            )
            self.write("session/event", sent)
            self.answered.add(answer_to)
            if not self.is_old:
                self.told.add(answer_to)
                self.events.append(fields_of(sent))

        return event

    def write(self, topic: str, message: Any) -> None:
        channel = self.writer.channel(topic, message.src, message.src.partition("@")[2])
        # It is what a node of another machine would take.
        accept(topic, encode(message))
        self.writer.write(channel, self._now_ns, message.t_ns, message.seq, encode(message))

    def command(self, number: int) -> None:
        """Let a console bind, send a command until it is answered, and leave."""
        draw = self.draw
        self.is_old = draw.random() < 0.1
        values = (True, False, 3, -1.5e-9, "wave", "", "Ω 10", 2**62)
        keys = ("law", "wave.impedance_n_s_per_m", "parameters.x", "a b", "note", "target", "command")
        header = {"seq": 0, "src": draw.choice(("console@master", "console_desk@master", "estop@slave")), "v": 1}
        fields = {
            "id": f"{draw.randrange(16**8):08x}-{number}",
            "command": draw.choice(("arm", "start", "stop", "set", "mark", "estop")),
            "target": draw.choice(("*", "controller", "recorder", "afm_node@slave", "*@slave", "haptic*")),
            "parameters": {key: draw.choice(values) for key in draw.sample(keys, draw.randrange(len(keys)))},
            **({"by": draw.choice(("Ada", "Ms Tina Ås"))} if draw.random() < 0.3 else {}),
        }
        is_heard = draw.random() < 0.5
        for _ in range(draw.choice((1, 1, 2, 3))):
            self._now_ns += draw.randrange(1, 10**8)
            control = msgspec.convert({**header, "t_ns": self._now_ns, **fields}, SessionControl)
            header["seq"] += 1
            self.given[control.id] = control
            if is_heard:
                # A console that is heard late is no subject of this test, so its numbers have no gap.
                seq = self._heard[control.src] = self._heard.get(control.src, -1) + 1
                self.write("session/control", msgspec.structs.replace(control, seq=seq))
                self.recorded.add(control.id)
            for handler in self._handlers.values():
                handler.handle(control, self._now_ns)
            # The recorder connects while the console waits, or not at all.
            is_heard = is_heard or draw.random() < 0.3


@pytest.fixture
def writer(tmp_path: Path) -> RecordingWriter:
    return RecordingWriter.create("recorder@master", RecorderConfig(directory=tmp_path))


@pytest.mark.parametrize("seed", range(3))
def test_no_answered_command_is_left_unsaid(seed: int, writer: RecordingWriter) -> None:
    consoles = Consoles(seed, writer)
    for number in range(600):
        consoles.command(number)
    writer.finish()
    lost = consoles.answered - consoles.recorded - consoles.told
    alone = consoles.answered - consoles.recorded - lost
    assert len(lost) > 5 and len(alone) > 30, "the draws have cases of each kind"
    whole, quick = open_recordings([writer.path]).info(), quick_info(writer.path)
    assert quick is not None
    for info in (whole, quick):
        assert (info.commands, info.commands_by_answer) == (len(consoles.answered), len(alone))
        *named, rest = info.missing
        assert len(named) == 5 and all(sum(identifier in text for identifier in lost) == 1 for text in named)
        assert rest == f"{len(lost) - 5} further answered commands are missing"
        assert not info.complete
    verdict = verify([writer.path])
    assert not verdict.sound
    assert [finding.text for finding in verdict.findings if finding.level == "warning"] == list(whole.missing)


@pytest.mark.parametrize("seed", range(3))
def test_an_answer_repeats_the_command_as_it_was_given(seed: int, writer: RecordingWriter) -> None:
    consoles = Consoles(seed, writer)
    for number in range(200):
        consoles.command(number)
    writer.finish()
    assert len(consoles.events) > 100
    for event in consoles.events:
        answered = read_answer(event)
        assert answered is not None
        given = consoles.given[event["id"]]
        # The answer may have been to an earlier copy of the command, which differs in its time alone.
        assert answered._replace(sent_t_ns=given.t_ns) == AnsweredCommand(
            given.id, given.command, given.target, given.src, given.t_ns, given.by or "", dict(given.parameters)
        )


def test_a_command_with_more_parameters_than_an_answer_holds_is_missing_where_it_was_not_recorded() -> None:
    events: list[dict[str, Any]] = []

    def event(kind: str, level: str, text: str, *, answer_to: str = "", **data: Any) -> None:
        header = {"seq": 0, "t_ns": T_NS, "src": NODES[4], "v": 1, "kind": kind, "level": level, "text": text}
        sent = msgspec.convert({**header, "id": answer_to, "data": data}, SessionEvent)
        accept("session/event", encode(sent))
        events.append(fields_of(sent))

    handler = CommandHandler(NODES[4], ("mark",), lambda control: "done", event)
    header = {"seq": 0, "t_ns": T_NS, "src": "console@master", "v": 1, "command": "mark", "target": "recorder"}
    for count in (900, 901, 1024):
        fields = {"id": f"m-{count}", "parameters": {f"key_{number}": number for number in range(count)}}
        handler.handle(msgspec.convert({**header, **fields}, SessionControl), T_NS)
    commands = AnsweredCommands()
    for fields in events:
        commands.add("session/event", fields)
    assert [read_answer(fields) is not None for fields in events] == [True, False, False]
    assert len(commands.missing()) == 2
    commands.add("session/control", {"id": "m-901"})
    assert commands.missing() == ("the command mark (m-1024) that recorder@master answered is missing",)


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"kind": "ack", "id": ""},
        {"kind": "mode", "id": "a"},
        {"kind": "ack", "id": "a"},
        {"kind": "ack", "id": "a", "data": 3},
        {"kind": "ack", "id": "a", "data": {"command": "arm", "by": "Ada"}},
        {"kind": "ack", "id": "a", "data": {"command": "arm", "target": 3, "giver": "x", "sent_t_ns": 1}},
        {"kind": "ack", "id": "a", "data": {"command": "arm", "target": "*", "giver": "x", "sent_t_ns": "1"}},
    ],
)
def test_what_does_not_repeat_a_command_is_not_taken_for_one(fields: dict[str, Any]) -> None:
    assert read_answer(fields) is None
    AnsweredCommands().add("session/event", fields)
