"""Commands at their bounds: what a node says that it executed, clocks that nearly agree, and time that was quoted."""

from typing import Any

import pytest

from proto.messages import SessionControl, SessionEvent
from services.runtime.loop.commands import Command, CommandClient, CommandHandler
from telenano.extend.testing import VirtualClock

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


class Asker:
    """A client in virtual time, what it has sent, and the refusals of a node that it hears of."""

    def __init__(self, *commands: Command, **options: Any) -> None:
        self.clock = VirtualClock(start_ns=SECOND, epoch_offset_ns=10**18)
        self.sent: list[dict[str, Any]] = []
        self.client = CommandClient(self.clock, self.publish, commands or [ARM_HAND], **options)
        self.client.advance()

    def publish(self, topic: str, **fields: Any) -> None:
        self.sent.append(fields)

    def pass_ms(self, duration_ms: int) -> None:
        for _ in range(duration_ms):
            self.clock.advance_ns(MS)
            self.client.advance()

    def hear(self, kind: str, node: str = NODE, **data: Any) -> None:
        """Let an event arrive that answers what was sent last."""
        header = {"seq": 0, "t_ns": self.clock.now_ns(), "src": node, "v": 1, "id": self.sent[-1]["id"]}
        fields = {"kind": kind, "level": "warning", "text": f"{node} says {kind}", "data": data}
        self.client.on_event(SessionEvent.model_validate({**header, **fields}))
        self.client.advance()


ARM_HAND = Command("arm", "haptic_node", (NODE,))
QUOTED = {"node_latch", "node_t_ns", "validity_s"}


def test_a_command_quotes_nothing_until_a_node_has_refused_it() -> None:
    asker = Asker()
    asker.pass_ms(300)
    assert len(asker.sent) == 2
    assert not any(QUOTED & set(fields) for fields in asker.sent)
    asker.hear("refused", latch="run-1", estop_age_s=60.0)
    assert set(asker.sent[-1]) >= QUOTED
    assert asker.sent[-1]["node_latch"] == {NODE: "run-1"}


def test_a_refusal_that_names_a_stop_is_answered_at_once_and_its_repetition_in_turn() -> None:
    asker = Asker()
    asker.pass_ms(10)
    asker.hear("refused", latch="run-1", estop_age_s=60.0)
    assert len(asker.sent) == 2
    # the same refusal again, of what was sent before the quotation arrived
    asker.pass_ms(10)
    asker.hear("refused", latch="run-1", estop_age_s=60.0)
    asker.pass_ms(189)
    assert len(asker.sent) == 2
    asker.pass_ms(1)
    assert len(asker.sent) == 3


def test_a_refusal_of_what_had_expired_is_answered_in_turn() -> None:
    asker = Asker()
    asker.pass_ms(10)
    asker.hear("refused", expired=True, latch="run-0")
    asker.pass_ms(189)
    assert len(asker.sent) == 1
    asker.pass_ms(1)
    assert len(asker.sent) == 2


@pytest.mark.parametrize("releases_stops", [True, False])
@pytest.mark.parametrize("latched", [True, False])
def test_a_launcher_leaves_a_device_in_emergency_stop_to_a_person(releases_stops: bool, latched: bool) -> None:
    asker = Asker(releases_stops=releases_stops, retry_ns=60 * SECOND)
    asker.hear("refused", latch="run-1", estop_age_s=60.0, latched=latched)
    waits = latched and not releases_stops
    assert asker.client.latched == (NODE if waits else "")
    # a quotation of the stop would release the device, so whoever waits for a person sends none
    assert [fields["node_latch"] for fields in asker.sent[1:]] == ([] if waits else [{NODE: "run-1"}])
    assert (asker.client.failure, asker.client.void) == ("", False)


@pytest.mark.parametrize(("stop_age_s", "void"), [(0.4, True), (0.6, False)])
def test_a_wish_is_as_old_as_whoever_had_it_says(stop_age_s: float, void: bool) -> None:
    # the wish came half a second before the client
    asker = Asker(issued_ns=SECOND // 2)
    asker.hear("refused", latch="run-1", estop_age_s=stop_age_s)
    assert asker.client.void is void
    assert ("came to haptic_node@master after it" in asker.client.failure) is void


def test_only_an_emergency_stop_makes_a_command_void() -> None:
    asker = Asker()
    asker.hear("refused", command="arm")
    assert (asker.client.failure != "", asker.client.void) == (True, False)
    stopped = Asker()
    stopped.hear("ack", command="estop")
    assert stopped.client.failure == "haptic_node@master was stopped by an emergency stop"
    assert stopped.client.void


def test_the_emergency_stop_of_another_device_does_not_end_a_command() -> None:
    asker = Asker()
    asker.hear("ack", "afm_node@slave", command="estop")
    assert (asker.client.failure, asker.client.void) == ("", False)


def test_a_device_that_is_expected_to_answer_is_concerned_whatever_the_target_says() -> None:
    asker = Asker(Command("arm", "hand", (NODE,)))
    asker.hear("ack", command="estop")
    assert asker.client.void


def test_a_command_is_valid_to_the_last_moment_of_its_validity() -> None:
    for late_ns, obeyed in ((0, True), (1, False)):
        assert Taker().take("set", t_ns=NOW_NS - SECOND - late_ns) is obeyed
        # and so is the time that it quotes, where the clock of its sender is an hour off
        quoted = {NODE: NOW_NS - SECOND - late_ns}
        assert Taker().take("set", t_ns=NOW_NS - 3600 * SECOND, node_t_ns=quoted) is obeyed
