"""Commands in virtual time: the client that sends them, and the handler that a node takes them with."""

from typing import Any, Literal

import pytest

from proto.errors import RefusedError
from proto.messages import SessionControl, SessionEvent
from services.runtime.clock import VirtualClock
from services.runtime.commands import Command, CommandClient, CommandHandler

MS = 1_000_000
BOTH = ("afm_node@slave", "haptic_node@master")
ARM = Command("arm", "*", BOTH)


class Sender:
    """A client, and what it has sent."""

    def __init__(self, *commands: Command, retry_ns: int = 0) -> None:
        self.clock = VirtualClock(start_ns=MS, epoch_offset_ns=10**18)
        self.sent: list[dict[str, Any]] = []
        self.times_ms: list[int] = []
        self.client = CommandClient(self.clock, self.publish, commands, retry_ns=retry_ns)

    def publish(self, topic: str, **fields: Any) -> None:
        assert topic == "session/control"
        self.sent.append(fields)
        self.times_ms.append(self.clock.monotonic_ns() // MS)

    def run_ms(self, duration_ms: int) -> bool:
        for _ in range(duration_ms):
            if self.client.advance():
                return True
            self.clock.advance_ns(MS)
        return False

    def answer(
        self, node: str, kind: Literal["ack", "refused", "mode"] = "ack", identifier: str = "", **data: Any
    ) -> bool:
        event = SessionEvent(
            seq=0,
            t_ns=self.clock.now_ns(),
            src=node,
            v=1,
            id=identifier or self.sent[-1]["id"],
            kind=kind,
            level="info",
            text=f"{node} says {kind}",
            data=data,
        )
        return self.client.on_event(event)


# --- the client ---


def test_a_command_is_sent_at_once_and_then_every_200_ms_with_one_id() -> None:
    sender = Sender(ARM)
    assert not sender.run_ms(1000)
    assert sender.times_ms == [1, 201, 401, 601, 801]
    assert len({fields["id"] for fields in sender.sent}) == 1
    assert {(f["command"], f["target"]) for f in sender.sent} == {("arm", "*")}


def test_ids_differ_between_commands_and_between_senders() -> None:
    ids = set()
    for _ in range(2):
        sender = Sender(Command("mark", "recorder", ("r@m",)), Command("mark", "recorder", ("r@m",)))
        while not sender.client.advance():
            sender.answer("r@m")
        ids |= {fields["id"] for fields in sender.sent}
    assert len(ids) == 4


def test_it_is_over_when_all_have_answered() -> None:
    sender = Sender(ARM)
    sender.run_ms(1)
    assert sender.answer(BOTH[0])
    assert not sender.answer(BOTH[0]), "a repeated answer is no news"
    assert not sender.run_ms(1000)
    assert sender.answer(BOTH[1])
    sent = len(sender.sent)
    assert sender.run_ms(10_000)
    assert len(sender.sent) == sent
    assert sender.client.failure == ""
    assert sender.client.ids == {"arm": sender.sent[0]["id"]}
    assert set(sender.client.answers) == set(BOTH)


def test_other_events_are_no_answers() -> None:
    sender = Sender(ARM)
    sender.run_ms(1)
    assert not sender.answer(BOTH[0], identifier="another")
    assert not sender.answer(BOTH[0], "mode")
    assert sender.client.answers == {}


def test_missing_answers_fail_at_the_deadline_and_are_named() -> None:
    sender = Sender(Command("start", "*", BOTH))
    sender.run_ms(1)
    sender.answer(BOTH[0])
    assert not sender.run_ms(4999)
    assert sender.run_ms(1)
    assert sender.client.failure == f"{BOTH[1]} did not answer start in time"


def test_a_refusal_fails_with_its_reason_when_all_have_answered() -> None:
    sender = Sender(ARM)
    sender.run_ms(1)
    sender.answer(BOTH[0], "refused")
    assert not sender.run_ms(10)
    sender.answer(BOTH[1])
    assert sender.run_ms(1)
    assert sender.client.failure == "afm_node@slave refused arm: afm_node@slave says refused"


def test_a_new_reader_has_it_sent_at_once() -> None:
    sender = Sender(ARM)
    sender.run_ms(5)
    sender.client.make_due()
    sender.run_ms(1)
    assert sender.times_ms == [1, 6]


def test_a_refusal_is_tried_anew_under_another_id_for_as_long_as_was_asked() -> None:
    sender = Sender(Command("arm", "afm_node", BOTH[:1]), Command("start", "*", BOTH[1:]), retry_ns=1000 * MS)
    while not sender.run_ms(1):
        sender.answer(BOTH[0], "refused")
    assert sender.times_ms == [1, 302, 602, 902]
    assert len({fields["id"] for fields in sender.sent}) == 4
    assert sender.clock.monotonic_ns() == 1001 * MS
    assert sender.client.failure == "afm_node@slave refused arm: afm_node@slave says refused"
    assert {fields["command"] for fields in sender.sent} == {"arm"}, "what follows a failure is not sent"


def test_what_is_not_required_may_fail_and_the_next_follows() -> None:
    sender = Sender(Command("set", "recorder", ("r@m",), {"x": True}, required=False), Command("stop", "*", BOTH[:1]))
    sender.run_ms(5001)
    sender.answer(BOTH[0])
    assert sender.run_ms(1)
    assert sender.client.failure == ""
    assert sender.client.tolerated_failures == {"recorder": "r@m did not answer set in time"}
    assert set(sender.client.ids) == {"stop"}


def test_a_pattern_is_over_after_the_census_and_a_quiet_time() -> None:
    sender = Sender(Command("arm", "*"))
    sender.run_ms(1)
    sender.answer(BOTH[0])
    sender.run_ms(1000)
    sender.answer(BOTH[1])
    assert not sender.run_ms(500)
    assert sender.run_ms(1)
    assert sender.client.failure == ""
    assert set(sender.client.answers) == set(BOTH)


def test_a_pattern_that_nobody_answers_fails_at_the_deadline() -> None:
    sender = Sender(Command("arm", "*"))
    assert not sender.run_ms(5000)
    assert sender.run_ms(1)
    assert sender.client.failure == "no node answered arm"


# --- the handler ---


class Receiver:
    """A handler in a node, what it carried out, and what it answered."""

    def __init__(self, node: str = "controller@master") -> None:
        self.clock = VirtualClock(start_ns=5 * MS, epoch_offset_ns=10**18)
        self.carried_out: list[str] = []
        self.answers: list[tuple[str, str, str]] = []
        self.data: list[dict[str, Any]] = []
        self.handler = CommandHandler(node, ("set", "estop"), self.carry_out, self.event)

    def carry_out(self, control: SessionControl) -> str:
        if control.command not in ("set", "estop", "arm"):
            raise RefusedError(f"controller@master does not know {control.command}")
        if control.command == "set" and "gain" not in control.parameters:
            raise RefusedError(f"set needs gain, not {', '.join(control.parameters)}")
        self.carried_out.append(control.id)
        return f"{control.command} is done"

    def event(self, kind: str, level: str, text: str, *, answer_to: str = "", **data: Any) -> None:
        self.answers.append((answer_to, kind, text))
        self.data.append(data)

    def take(self, command: str = "set", target: str = "*", identifier: str = "a", **parameters: Any) -> bool:
        fields = {"id": identifier, "command": command, "target": target, "parameters": parameters}
        header = {"seq": 0, "t_ns": self.clock.now_ns(), "src": "console@master", "v": 1}
        return self.handler.handle(SessionControl.model_validate({**header, **fields}))


@pytest.mark.parametrize(
    ("target", "concerned"),
    [
        ("controller@master", True),
        ("controller", True),
        ("*", True),
        ("*@master", True),
        ("contr*", True),
        ("control?er@*", True),
        ("[bc]ontroller", True),
        ("controller@slave", False),
        ("*@slave", False),
        ("afm_node", False),
        ("Controller", False),
        ("", False),
        ("master", False),
    ],
)
def test_whom_a_command_concerns(target: str, concerned: bool) -> None:
    node = Receiver()
    assert node.take(target=target, gain=1.0) == concerned
    assert [kind for _, kind, _ in node.answers] == ["ack"] * concerned
    assert node.carried_out == ["a"] * concerned


def test_a_command_sent_again_is_carried_out_once_and_answered_again() -> None:
    node = Receiver()
    asked = [node.take(identifier="once", gain=1.0) for _ in range(3)]
    node.take(identifier="twice", gain=2.0)
    assert asked == [True, False, False]
    assert node.carried_out == ["once", "twice"]
    assert node.answers == [("once", "ack", "set is done")] * 3 + [("twice", "ack", "set is done")]
    assert {data["command"] for data in node.data} == {"set"}


def test_a_refusal_says_why_and_is_remembered_too() -> None:
    node = Receiver()
    for _ in range(2):
        node.take(identifier="r", target="controller", speed=1.0)
    assert node.answers == [("r", "refused", "set needs gain, not speed")] * 2


def test_an_unknown_command_is_refused_by_the_node_named_and_passed_over_by_a_pattern() -> None:
    node = Receiver()
    for target in ("*", "controller@*", "contro[l]ler", "controlle?"):
        node.take("mark", target=target, identifier="m")
    assert node.answers == []
    node.take("mark", target="controller", identifier="m")
    assert node.answers == [("m", "refused", "controller@master does not know mark")]


def test_answers_are_remembered_to_a_bound() -> None:
    node = Receiver()
    for number in range(257):
        node.take(identifier=f"n{number}", gain=1.0)
    node.take(identifier="n1", gain=1.0)
    assert len(node.carried_out) == 257
    node.take(identifier="n0", gain=1.0)
    assert node.carried_out[-1] == "n0"
    assert len(node.carried_out) == 258
