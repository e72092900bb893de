"""Commands at their bounds: what a node says that it executed, clocks that nearly agree, and time that was quoted."""

from typing import Any

import pytest

from proto.messages import SessionControl, SessionEvent
from services.runtime.loop.clock import VirtualClock
from services.runtime.loop.commands import Command, CommandClient, CommandHandler

MS, SECOND = 1_000_000, 1_000_000_000
NODE = "haptic_node@master"
NOW_NS = 10**18 + 500 * SECOND


class Taker:
    """A handler that notes what it executed and what it said."""

    def __init__(self) -> None:
        self.executed: list[str] = []
        self.said: list[tuple[str, str]] = []
        self.handler = CommandHandler(NODE, ("arm", "estop"), self.execute, self.event)

    def execute(self, control: SessionControl) -> str:
        self.executed.append(control.command)
        return "done"

    def event(self, kind: str, level: str, text: str, **data: Any) -> None:
        self.said.append((kind, text))

    def take(self, command: str, target: str = "haptic_node", src: str = "launcher@master", **changes: Any) -> bool:
        fields = {"seq": 0, "t_ns": NOW_NS, "src": src, "v": 1, "id": "a", "parameters": {}}
        control = SessionControl.model_validate({**fields, "command": command, "target": target, **changes})
        return self.handler.handle(control, NOW_NS)


def test_a_node_says_that_it_executed_what_it_executed_and_nothing_else() -> None:
    taker = Taker()
    assert taker.take("set")
    # the same again is answered and not executed
    assert not taker.take("set")
    assert taker.executed == ["set"]
    assert [kind for kind, _ in taker.said] == ["ack", "ack"]
    # neither what is for another node, nor what a pattern reaches it with and it does not know
    assert not taker.take("set", "afm_node", id="b")
    assert not taker.take("set", "*", id="c")
    assert len(taker.said) == 2
    # one that has expired is refused
    assert not taker.take("set", id="d", t_ns=NOW_NS - 3600 * SECOND)
    assert taker.said[2][0] == "refused"
    assert taker.executed == ["set"]


def test_whoever_connected_for_an_emergency_stop_can_do_that_and_no_more() -> None:
    taker = Taker()
    for command in ("arm", "set"):
        assert not taker.take(command, src="estop@master", id=command)
    assert (taker.executed, taker.said) == ([], [])
    assert taker.take("estop", "*", src="estop@master", id="stop")
    assert taker.executed == ["estop"]


def test_a_node_that_was_never_held_up_believes_fresh_commands_from_its_first_moment() -> None:
    clock_begins = CommandHandler(NODE, ("arm",), lambda control: "done", lambda *facts, **data: None)
    control = SessionControl.model_validate(
        {"seq": 0, "t_ns": 0, "src": "launcher@master", "v": 1, "id": "a", "command": "set",
         "target": "haptic_node", "parameters": {}}
    )  # fmt: skip
    assert clock_begins.handle(control, 0)


def test_the_time_of_a_refusal_that_is_quoted_has_the_whole_round_trip_to_come_back() -> None:
    clock = VirtualClock(start_ns=MS, epoch_offset_ns=10**18)
    sent: list[dict[str, Any]] = []
    command = Command("start", "haptic_node", (NODE,))
    client = CommandClient(clock, lambda topic, **fields: sent.append(fields), [command])
    assert not client.advance()
    usual_s = 1.0
    asked_ns = clock.now_ns()
    clock.advance_ns(300 * MS)
    refused = {"seq": 0, "t_ns": clock.now_ns(), "src": NODE, "v": 1, "kind": "refused", "level": "warning"}
    data = {"command": "start", "expired": True, "sent_t_ns": asked_ns}
    client.on_event(SessionEvent.model_validate({**refused, "id": sent[0]["id"], "text": "expired", "data": data}))
    clock.advance_ns(200 * MS)
    client.advance()
    assert sent[-1]["node_t_ns"] == {NODE: refused["t_ns"]}
    first_s = sent[-1]["validity_s"]
    assert first_s > usual_s
    # the least round trip counts, and a longer one later changes nothing
    again = {**refused, "id": sent[0]["id"], "text": "expired", "data": data}
    client.on_event(SessionEvent.model_validate(again))
    clock.advance_ns(200 * MS)
    client.advance()
    assert sent[-1]["validity_s"] == pytest.approx(first_s, rel=1e-12, abs=0.0)
    quick = {**again, "data": {**data, "sent_t_ns": clock.now_ns() - 100 * MS}}
    client.on_event(SessionEvent.model_validate(quick))
    clock.advance_ns(200 * MS)
    client.advance()
    assert first_s - sent[-1]["validity_s"] == pytest.approx(0.2, rel=1e-6, abs=0.0)


def test_an_event_before_the_first_command_is_no_answer_to_it() -> None:
    clock = VirtualClock(start_ns=MS, epoch_offset_ns=10**18)
    client = CommandClient(clock, lambda topic, **fields: None, [Command("start", "haptic_node", (NODE,))])
    header = {"seq": 0, "t_ns": clock.now_ns(), "src": NODE, "v": 1, "kind": "ack", "level": "info", "data": {}}
    assert not client.on_event(SessionEvent.model_validate({**header, "id": "other", "text": "done"}))
    assert client.answers == {}
