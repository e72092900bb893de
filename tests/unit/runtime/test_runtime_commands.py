"""Commands in virtual time: the client that sends them, and the handler that a node takes them with."""

from pathlib import Path
from typing import Any, Literal

import msgspec
import pytest

from telenano.runtime.loop.commands import Command, CommandClient, CommandHandler
from telenano.testing import VirtualClock
from telenano.wire import decode
from telenano.wire.errors import LaterError, RefusedError
from telenano.wire.messages import Scalar, SessionControl, SessionEvent

MS = 1_000_000
SECOND = 1_000_000_000
BOTH = ("afm_node@slave", "haptic_node@master")
ARM = Command("arm", "*", BOTH)
ARM_HAND = Command("arm", "haptic_node", BOTH[1:])
QUOTED = {"node_latch", "node_t_ns", "validity_s"}


class Sender:
    """A client, and what it has sent."""

    def __init__(self, *commands: Command, **options: Any) -> None:
        self.clock = VirtualClock(start_ns=MS, epoch_offset_ns=10**18)
        self.sent: list[dict[str, Any]] = []
        self.times_ms: list[int] = []
        self.client = CommandClient(self.clock, self.publish, commands, **options)

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

    def pass_ms(self, duration_ms: int) -> None:
        for _ in range(duration_ms):
            self.clock.advance_ns(MS)
            self.client.advance()

    def answer(
        self,
        node: str,
        kind: Literal["ack", "refused", "mode", "node"] = "ack",
        identifier: str = "",
        seq: int = 0,
        **data: Any,
    ) -> bool:
        event = SessionEvent(
            seq=seq,
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

    def hear(self, kind: Literal["ack", "refused"], node: str = BOTH[1], **data: Any) -> None:
        """Let an answer to what was sent last arrive, and the client act on it."""
        self.answer(node, kind, **data)
        self.client.advance()


def asker(*commands: Command, **options: Any) -> Sender:
    """Return a client that has sent its first command, an `arm` to the hand if none is given."""
    found = Sender(*(commands or [ARM_HAND]), **options)
    found.client.advance()
    return found


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


def test_a_command_whose_nodes_are_not_named_is_not_sent() -> None:
    with pytest.raises(ValueError, match="arm: no node is expected to answer"):
        Sender(Command("arm", "*"))


def test_the_time_of_a_refusal_that_is_quoted_has_the_whole_round_trip_to_come_back() -> None:
    sender = asker(Command("start", "haptic_node", BOTH[1:]))
    asked_ns = sender.clock.now_ns()
    sender.clock.advance_ns(300 * MS)
    refused_ns = sender.clock.now_ns()
    sender.answer(BOTH[1], "refused", expired=True, sent_t_ns=asked_ns)
    sender.pass_ms(200)
    assert sender.sent[-1]["node_t_ns"] == {BOTH[1]: refused_ns}
    first_s = sender.sent[-1]["validity_s"]
    assert first_s > 1.0
    # the least round trip counts, and a longer one later changes nothing
    for round_trip_ms, less_s in ((500, 0.0), (100, 0.2)):
        sender.answer(BOTH[1], "refused", expired=True, sent_t_ns=sender.clock.now_ns() - round_trip_ms * MS)
        sender.pass_ms(200)
        assert first_s - sender.sent[-1]["validity_s"] == pytest.approx(less_s, rel=1e-6, abs=1e-12)


def test_an_event_before_the_first_command_is_no_answer_to_it() -> None:
    sender = Sender(ARM_HAND)
    assert not sender.answer(BOTH[1], identifier="other")
    assert sender.client.answers == {}


def test_a_command_quotes_nothing_until_a_node_has_refused_it() -> None:
    sender = asker()
    sender.pass_ms(300)
    assert len(sender.sent) == 2
    assert not any(QUOTED & set(fields) for fields in sender.sent)
    sender.hear("refused", latch="run-1", estop_age_s=60.0)
    assert set(sender.sent[-1]) >= QUOTED
    assert sender.sent[-1]["node_latch"] == {BOTH[1]: "run-1"}


def test_a_refusal_that_names_a_stop_is_answered_at_once_and_its_repetition_in_turn() -> None:
    sender = asker()
    sender.pass_ms(10)
    sender.hear("refused", latch="run-1", estop_age_s=60.0)
    assert len(sender.sent) == 2
    # the same refusal again, of what was sent before the quotation arrived
    sender.pass_ms(10)
    sender.hear("refused", latch="run-1", estop_age_s=60.0)
    sender.pass_ms(189)
    assert len(sender.sent) == 2
    sender.pass_ms(1)
    assert len(sender.sent) == 3


def test_a_refusal_of_what_had_expired_is_answered_in_turn() -> None:
    sender = asker()
    sender.pass_ms(10)
    sender.hear("refused", expired=True, latch="run-0")
    sender.pass_ms(189)
    assert len(sender.sent) == 1
    sender.pass_ms(1)
    assert len(sender.sent) == 2


@pytest.mark.parametrize("releases_stops", [True, False])
@pytest.mark.parametrize("latched", [True, False])
def test_a_launcher_leaves_a_device_in_emergency_stop_to_a_person(releases_stops: bool, latched: bool) -> None:
    sender = asker(releases_stops=releases_stops, retry_ns=60 * SECOND)
    sender.hear("refused", latch="run-1", estop_age_s=60.0, latched=latched)
    waits = latched and not releases_stops
    assert sender.client.latched == (BOTH[1] if waits else "")
    # a quotation of the stop would release the device, so whoever waits for a person sends none
    assert [fields["node_latch"] for fields in sender.sent[1:]] == ([] if waits else [{BOTH[1]: "run-1"}])
    assert (sender.client.failure, sender.client.void) == ("", False)


def test_a_launcher_asks_once_a_second_whether_a_person_has_released_the_device() -> None:
    sender = Sender(ARM_HAND, releases_stops=False, retry_ns=500 * MS)
    for _ in range(3500):
        sender.run_ms(1)
        sender.answer(BOTH[1], "refused", latch="run-1", estop_age_s=60.0, latched=True)
    assert sender.times_ms == [1, 1002, 2002, 3002]
    assert (sender.client.latched, sender.client.failure) == (BOTH[1], "")
    sender.run_ms(502)
    sender.answer(BOTH[1])
    assert sender.run_ms(1)
    assert (sender.times_ms[4:], sender.client.latched) == ([4002], "")


@pytest.mark.parametrize(("stop_age_s", "void"), [(0.4, True), (0.6, False)])
def test_a_wish_is_as_old_as_whoever_had_it_says(stop_age_s: float, void: bool) -> None:
    # the wish came half a second before the client
    sender = asker(issued_ns=MS - SECOND // 2)
    sender.hear("refused", latch="run-1", estop_age_s=stop_age_s)
    assert sender.client.void is void
    assert ("came to haptic_node@master after it" in sender.client.failure) is void


def test_only_an_emergency_stop_makes_a_command_void() -> None:
    sender = asker()
    sender.hear("refused", command="arm")
    assert (sender.client.failure != "", sender.client.void) == (True, False)
    stopped = asker()
    stopped.hear("ack", command="estop")
    assert stopped.client.failure == "haptic_node@master was stopped by an emergency stop"
    assert stopped.client.void


def test_the_emergency_stop_of_another_device_does_not_end_a_command() -> None:
    sender = asker()
    sender.hear("ack", "afm_node@slave", command="estop")
    assert (sender.client.failure, sender.client.void) == ("", False)


def test_a_device_that_is_expected_to_answer_is_concerned_whatever_the_target_says() -> None:
    sender = asker(Command("arm", "hand", (BOTH[1],)))
    sender.hear("ack", command="estop")
    assert sender.client.void


def test_a_refusal_that_comes_when_the_commands_are_over_is_taken_and_ends_nothing() -> None:
    sender = Sender(Command("arm", "*", BOTH[:1]))
    sender.run_ms(1)
    sender.answer(BOTH[0])
    assert sender.run_ms(1)
    assert not sender.answer(BOTH[1], "refused", latch="run-1", estop_age_s=60.0)
    assert sender.client.advance()
    assert (sender.client.failure, set(sender.client.answers)) == ("", {BOTH[0]})


def test_after_a_person_has_released_a_device_it_is_tried_for_as_long_as_was_asked() -> None:
    sender = Sender(ARM_HAND, releases_stops=False, retry_ns=500 * MS)
    for _ in range(2500):
        sender.run_ms(1)
        sender.answer(BOTH[1], "refused", latch="run-1", estop_age_s=60.0, latched=True)
    # it was asked at 2 s, answers from now on for another reason, and counts that time from then
    while not sender.run_ms(1):
        sender.answer(BOTH[1], "refused")
    assert sender.times_ms == [1, 1002, 2002, 3002, 3302]
    assert sender.client.failure == "haptic_node@master refused arm: haptic_node@master says refused"


# --- the client of an instrument that is to be placed ---

TIP = BOTH[0]
PLACE_TIP = Command("arm", "afm_node", (TIP,), placed=True)


def placing(answered: bool = True) -> Sender:
    """Return a client that has armed a tip half a second after its clock's first, and waits until it is placed."""
    sender = Sender(PLACE_TIP)
    sender.run_ms(500)
    if answered:
        sender.answer(TIP)
    return sender


def test_a_tip_that_has_answered_is_waited_for_until_it_says_that_it_is_placed() -> None:
    sender = placing()
    assert not sender.run_ms(4000)
    for data in ({"mode": "follow", "placed": False}, {"mode": "follow"}, {}):
        sender.answer(TIP, "mode", **data)
        assert not sender.run_ms(100)
    # what another node says of itself is nothing to this one
    sender.answer(BOTH[1], "mode", mode="follow", placed=True)
    assert not sender.run_ms(100)
    sender.answer(TIP, "mode", mode="follow", placed=True)
    assert sender.run_ms(1)
    assert (sender.client.failure, sender.client.void) == ("", False)


@pytest.mark.parametrize("placing_s", [0.0, 1.5, 4])
def test_a_tip_has_twice_the_time_that_it_says_it_needs_and_the_time_for_an_answer(placing_s: float) -> None:
    sender = placing()
    sender.pass_ms(1000)
    sender.answer(TIP, "mode", mode="follow", placing_s=placing_s)
    assert not sender.run_ms(5000 + round(2000 * placing_s))
    assert sender.run_ms(1)
    waited_s = 0.5 + 1.0 + 5.0 + 2.0 * placing_s
    assert sender.client.failure == f"{TIP} was not placed within {waited_s:.3g} s of arming: {TIP} says mode"
    assert not sender.client.void


def test_a_tip_that_is_stopped_on_its_way_ends_the_command_as_an_emergency_stop_does() -> None:
    sender = placing()
    sender.answer(TIP, "mode", mode="estop")
    assert sender.client.advance()
    assert (sender.client.failure, sender.client.void) == (f"{TIP} was stopped by an emergency stop", True)


def test_a_tip_that_goes_back_on_its_way_fails_at_once_and_is_no_stop() -> None:
    sender = placing()
    sender.answer(TIP, "mode", mode="retracting")
    assert sender.client.advance()
    assert sender.client.failure == f"{TIP} was not placed within 0.5 s of arming: {TIP} says mode"
    assert not sender.client.void


@pytest.mark.parametrize("mode", ["estop", "retracting"])
def test_what_a_tip_did_before_it_was_armed_does_not_end_the_command(mode: str) -> None:
    sender = placing(answered=False)
    sender.answer(TIP, "mode", mode=mode)
    assert not sender.run_ms(100)
    sender.answer(TIP)
    sender.answer(TIP, "mode", mode="follow", placed=True)
    assert sender.run_ms(1)
    assert sender.client.failure == ""


@pytest.mark.parametrize(("node", "mode"), [(TIP, "hold"), (BOTH[1], "estop"), (BOTH[1], "retracting")])
def test_a_tip_that_is_held_or_another_device_that_stops_does_not_end_the_command(node: str, mode: str) -> None:
    sender = placing()
    sender.answer(node, "mode", mode=mode)
    assert not sender.run_ms(1000)
    assert sender.client.failure == ""


# who tells of the end of the process that was armed: event and number of whom, and what it has
ENDS: dict[str, tuple[str, int, dict[str, Any]]] = {
    "its launcher": ("launcher@slave", 0, {"about_node": TIP, "exit_code": -9}),
    "the launcher of the rig": ("launcher@master", 0, {"about_node": TIP, "exit_code": 1}),
    "itself": (TIP, 8, {"state": "ended", "sent.afm/state": 100}),
    "the numbers of the next process": (TIP, 0, {}),
}


@pytest.mark.parametrize("told", ENDS)
def test_a_tip_whose_process_ends_on_its_way_fails_at_once_and_nothing_is_said_of_what_it_did(told: str) -> None:
    src, seq, data = ENDS[told]
    sender = Sender(PLACE_TIP)
    sender.run_ms(500)
    sender.answer(TIP, seq=6)
    sender.answer(TIP, "mode", seq=7, mode="follow", placing_s=3.0)
    sender.pass_ms(20)
    sender.answer(src, "node", seq=seq, **data)
    assert sender.client.advance()
    assert sender.client.failure.startswith(f"{TIP} ended while it was being placed")
    assert f"{TIP} says mode" not in sender.client.failure
    assert not sender.client.void


@pytest.mark.parametrize("told", ENDS)
def test_a_tip_that_ends_before_it_has_answered_is_armed_in_its_next_process(told: str) -> None:
    src, seq, data = ENDS[told]
    sender = Sender(PLACE_TIP)
    sender.run_ms(100)
    # a place of before the command's answer is none of this process either
    sender.answer(TIP, "mode", seq=7, mode="follow", placed=True)
    sender.pass_ms(20)
    sender.answer(src, "node", seq=seq, **data)
    assert not sender.run_ms(300)
    sender.answer(TIP, seq=1)
    assert not sender.run_ms(100)
    sender.answer(TIP, "mode", seq=2, mode="follow", placed=True)
    assert sender.run_ms(1)
    assert sender.client.failure == ""


def test_the_end_of_another_node_and_an_event_that_was_overtaken_end_no_placing() -> None:
    sender = Sender(PLACE_TIP)
    sender.run_ms(500)
    sender.answer(TIP, seq=6)
    sender.answer("launcher@master", "node", about_node=BOTH[1], exit_code=-9)
    # the same stamp: the link has let another one pass it
    sender.answer(TIP, "mode", seq=5, mode="follow")
    sender.answer(TIP, "mode", seq=7, mode="follow", placed=True)
    assert sender.run_ms(1)
    assert sender.client.failure == ""


# --- the handler ---


class Receiver:
    """A handler in a node, what it carried out, and what it answered."""

    def __init__(self, node: str = "controller@master") -> None:
        self.clock = VirtualClock(start_ns=5 * MS, epoch_offset_ns=10**18)
        self.carried_out: list[str] = []
        self.answers: list[tuple[str, str, str]] = []
        self.data: list[dict[str, Any]] = []
        self.header: dict[str, Any] = {}
        self.refuses_arms = False
        self.handler = CommandHandler(node, ("set", "estop"), self.carry_out, self.event)

    def carry_out(self, control: SessionControl) -> str:
        if control.command not in ("set", "estop", "arm", "stop"):
            raise RefusedError(f"controller@master does not know {control.command}")
        if control.command == "set" and "gain" not in control.parameters:
            raise RefusedError(f"set needs gain, not {', '.join(control.parameters)}")
        if control.command == "arm" and self.refuses_arms:
            raise RefusedError("not armed")
        self.carried_out.append(control.id)
        return f"{control.command} is done"

    def event(self, kind: str, level: str, text: str, *, answer_to: str = "", **data: Any) -> None:
        self.answers.append((answer_to, kind, text))
        self.data.append(data)

    def take(self, command: str = "set", target: str = "*", identifier: str = "a", **parameters: Any) -> bool:
        fields = {"id": identifier, "command": command, "target": target, "parameters": parameters}
        header = {"seq": 0, "t_ns": self.clock.now_ns(), "src": "console@master", "v": 1}
        control = msgspec.convert({**header, **fields, **self.header}, SessionControl)
        return self.handler.handle(control, self.clock.now_ns())


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


def test_a_command_that_is_being_prepared_is_answered_and_carried_out_by_a_later_copy() -> None:
    node = Receiver()
    prepared = node.carry_out

    def prepare(control: SessionControl) -> str:
        node.handler._execute = prepared
        raise LaterError("a file is being read")

    node.handler._execute = prepare
    assert [node.take(gain=1.0) for _ in range(3)] == [False, True, False]
    assert node.carried_out == ["a"]
    assert node.answers == [("a", "ack", "set is done")] * 2


def test_a_refusal_says_why_and_is_remembered_too() -> None:
    node = Receiver()
    for _ in range(2):
        node.take(identifier="r", target="controller", speed=1.0)
    assert node.answers == [("r", "refused", "set needs gain, not speed")] * 2


def test_an_unknown_command_is_refused_by_the_node_named_and_passed_over_by_a_pattern() -> None:
    node = Receiver()
    for target in ("*", "controller@*", "contro[l]ler", "controlle?"):
        assert not node.take("mark", target=target, identifier="m")
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


def test_whoever_connected_for_an_emergency_stop_can_do_that_and_no_more() -> None:
    node = Receiver()
    node.header = {"src": "estop@master"}
    for command in ("arm", "set"):
        assert not node.take(command, target="controller", identifier=command, gain=1.0)
    assert (node.carried_out, node.answers) == ([], [])
    assert node.take("estop")
    assert node.carried_out == ["a"]


def test_a_node_that_was_never_held_up_believes_fresh_commands_from_its_first_moment() -> None:
    node = Receiver()
    node.header = {"t_ns": 0}
    node.clock = VirtualClock()
    assert node.take(target="controller", gain=1.0)
    assert node.carried_out == ["a"]


# --- emergency stops ---


def test_a_switch_of_the_device_itself_ends_what_was_armed_before_and_is_kept(tmp_path: Path) -> None:
    node = Receiver()
    node.handler.latch.path = tmp_path / "x.kept"
    assert node.take("arm", identifier="arm", target="controller")
    before = node.handler.latch.quotation
    node.handler.note_own_stop(node.clock.now_ns())
    assert node.handler.latch.quotation != before
    kept = decode("session/control", (tmp_path / "x.kept").read_bytes())
    assert isinstance(kept, SessionControl)
    assert (kept.command, kept.target, kept.src) == ("estop", "controller@master", "estop@master")
    # the repetition of the command from before is no longer said to be in force
    node.clock.advance_ns(2 * SECOND)
    assert not node.take("arm", identifier="arm", target="controller")
    assert [kind for _, kind, _ in node.answers] == ["ack", "refused"]
    assert "the newest emergency stop, which came 2.0 s ago" in node.answers[-1][2]
    assert node.carried_out == ["arm"]


def test_a_stop_is_kept_until_the_node_is_armed_and_by_nothing_else_let_go(tmp_path: Path) -> None:
    node = Receiver()
    path = node.handler.latch.path = tmp_path / "x.kept"
    assert node.take("estop", identifier="e")
    assert path.exists()
    for command in ("set", "stop"):
        assert node.take(command, identifier=command, target="controller", gain=1.0)
        assert path.exists()
    # an arm that names no stop is refused, and arms nothing
    assert not node.take("arm", identifier="unquoted", target="controller")
    assert path.exists()
    node.header = {"node_latch": {"controller@master": node.handler.latch.quotation}}
    assert node.take("arm", identifier="quoted", target="controller")
    assert not path.exists()


def test_an_arm_that_the_device_refuses_lets_no_stop_go(tmp_path: Path) -> None:
    node = Receiver()
    path = node.handler.latch.path = tmp_path / "x.kept"
    node.take("estop", identifier="e")
    node.refuses_arms = True
    node.header = {"node_latch": {"controller@master": node.handler.latch.quotation}}
    assert node.take("arm", identifier="a", target="controller")
    assert node.answers[-1] == ("a", "refused", "not armed")
    assert path.exists()


# --- expiry ---


def sent(node: Receiver, age_s: float, **keys: Any) -> None:
    """Have what follows be sent `age_s` before it is taken, by the clock of its sender."""
    node.header = {"t_ns": node.clock.now_ns() - round(age_s * SECOND), **keys}


@pytest.mark.parametrize(
    ("age_s", "keys", "obeyed"),
    [
        (0.0, {}, True),
        (0.99, {}, True),
        (1.01, {}, False),
        (4.0, {}, False),
        (4.0, {"validity_s": 5.0}, True),
        (0.3, {"validity_s": 0.2}, False),
        # nobody may ask for a command that is good for an hour
        (100.0, {"validity_s": 3600.0}, False),
        # a clock that is ahead by as little as two that agree may be, and by more
        (-0.09, {}, True),
        (-0.1, {}, True),
        (-0.100000001, {}, False),
        (-0.2, {}, False),
        (-3600.0, {}, False),
    ],
)
def test_a_command_is_obeyed_while_it_is_valid(age_s: float, keys: dict[str, Any], obeyed: bool) -> None:
    node = Receiver()
    sent(node, age_s, **keys)
    assert node.take("arm", target="controller") == obeyed
    assert node.carried_out == ["a"] * obeyed
    ((identifier, kind, text),) = node.answers
    assert (identifier, kind) == ("a", "ack" if obeyed else "refused")
    if not obeyed:
        assert ("expired: it was sent" in text) == (age_s > 0.0)
        assert ("cannot be shown to be fresh: the clock of console@master" in text) == (age_s < 0.0)
        said = {"command": "arm", "target": "controller", "giver": "console@master", "expired": True}
        said |= {"sent_t_ns": node.header["t_ns"]}
        assert node.data == [{**said, "latch": node.handler.latch.quotation, "latched": False}]


def test_a_command_is_valid_to_the_last_moment_of_its_validity() -> None:
    for late_ns, obeyed in ((0, True), (1, False)):
        node = Receiver()
        then_ns = node.clock.now_ns() - SECOND - late_ns
        node.header = {"t_ns": then_ns}
        assert node.take(gain=1.0) is obeyed
        # and so is the time that it quotes, where the clock of its sender is an hour off
        sent(node, 3600.0, node_t_ns={"controller@master": then_ns})
        assert node.take(identifier="b", gain=1.0) is obeyed


@pytest.mark.parametrize("command", ["start", "set", "arm", "mark"])
def test_every_command_that_begins_something_expires(command: str) -> None:
    node = Receiver()
    sent(node, 4.0)
    node.take(command, target="controller", gain=1.0)
    assert [(kind, data["expired"]) for (_, kind, _), data in zip(node.answers, node.data, strict=True)] == [
        ("refused", True)
    ]
    assert node.carried_out == []


@pytest.mark.parametrize("age_s", [0.0, 4.0, -3600.0, 1e6])
def test_an_emergency_stop_is_obeyed_at_any_age_and_each_time(age_s: float) -> None:
    node = Receiver()
    node.handler.note_stall(node.clock.now_ns(), 4 * SECOND)
    for _ in range(3):
        sent(node, age_s)
        assert node.take("estop", identifier="e")
    assert node.carried_out == ["e"] * 3
    assert [kind for _, kind, _ in node.answers] == ["ack"] * 3


def test_the_end_of_a_motion_is_commanded_at_any_age() -> None:
    node = Receiver()
    sent(node, 4.0)
    assert node.take("stop", target="controller")
    assert node.carried_out == ["a"]


@pytest.mark.parametrize("age_s", [3600.0, -3600.0])
def test_a_sender_whose_clock_disagrees_is_believed_when_it_quotes_the_clock_of_the_node(age_s: float) -> None:
    node = Receiver()
    heard_ns = node.clock.now_ns()
    node.clock.advance_ns(900 * MS)
    sent(node, age_s, node_t_ns={"controller@master": heard_ns, "afm_node@slave": 5})
    assert node.take("arm", target="controller")
    node.clock.advance_ns(200 * MS)
    sent(node, age_s, node_t_ns={"controller@master": heard_ns})
    assert not node.take("arm", target="controller", identifier="b")
    # a time that has not come yet is no proof
    sent(node, age_s, node_t_ns={"controller@master": node.clock.now_ns() + 1})
    assert not node.take("arm", target="controller", identifier="c")
    assert node.carried_out == ["a"]


def test_after_it_was_held_up_a_node_believes_no_foreign_clock_for_a_while() -> None:
    node = Receiver()
    node.handler.note_stall(node.clock.now_ns(), 4 * SECOND)
    # 4 s old, from a clock that is 4 s ahead
    sent(node, 0.0)
    assert not node.take("arm", target="controller")
    assert "stalled for 4.0 s" in node.answers[-1][2]
    sent(node, 0.0, node_t_ns={"controller@master": node.clock.now_ns()})
    assert node.take("arm", target="controller")
    node.clock.advance_ns(SECOND)
    sent(node, 0.0)
    assert node.take("arm", target="controller", identifier="later")


def test_a_command_that_was_carried_out_is_answered_again_however_old_the_repetition() -> None:
    node = Receiver()
    node.take("arm", target="controller")
    sent(node, 4.0)
    assert not node.take("arm", target="controller")
    assert node.answers == [("a", "ack", "arm is done")] * 2
    assert node.carried_out == ["a"]


class Conversation:
    """A client and a node with a way of `way_s` each way between them, and clocks of their own."""

    def __init__(self, command: Command, way_s: float = 0.0, ahead_s: float = 0.0) -> None:
        self.way_ns = round(way_s * SECOND)
        self.time_ns = 0
        self.node = Receiver("afm_node@slave")
        self.node_clock = self.node.clock
        self.client_clock = VirtualClock(epoch_offset_ns=10**18 + round(ahead_s * SECOND))
        self.forward: list[tuple[int, SessionControl]] = []
        self.backward: list[tuple[int, SessionEvent]] = []
        self.client = CommandClient(self.client_clock, self.publish, [command])
        self.node.handler = CommandHandler("afm_node@slave", ("arm",), self.node.carry_out, self.event)
        self.stopped = False

    def publish(self, topic: str, **fields: Any) -> None:
        header = {"seq": 0, "t_ns": self.client_clock.now_ns(), "src": "console@master", "v": 1}
        self.forward.append((self.time_ns + self.way_ns, msgspec.convert({**header, **fields}, SessionControl)))

    def event(self, kind: Any, level: Any, text: str, *, answer_to: str = "", **data: Scalar) -> None:
        self.node.event(kind, level, text, answer_to=answer_to, **data)
        t_ns = self.node_clock.now_ns()
        event = SessionEvent(
            seq=0, t_ns=t_ns, src="afm_node@slave", v=1, id=answer_to, kind=kind, level=level, text=text, data=data
        )
        self.backward.append((self.time_ns + self.way_ns, event))

    def run_s(self, duration_s: float) -> bool:
        """Let time pass until the command is over or `duration_s` [s] are."""
        end_ns = self.time_ns + round(duration_s * SECOND)
        while self.time_ns < end_ns:
            if self.client is not None and self.client.advance():
                return True
            self.pass_on()
            for clock in (self.node_clock, self.client_clock):
                clock.advance_ns(10 * MS)
            self.time_ns += 10 * MS
        return False

    def pass_on(self) -> None:
        while not self.stopped and self.forward and self.forward[0][0] <= self.time_ns:
            self.node.handler.handle(self.forward.pop(0)[1], self.node_clock.now_ns())
        while self.backward and self.backward[0][0] <= self.time_ns:
            self.client.on_event(self.backward.pop(0)[1])


ARM_AFM = Command("arm", "afm_node", ("afm_node@slave",))


@pytest.mark.parametrize("ahead_s", [0.0, 3.0, -3.0, 3600.0, -3600.0])
@pytest.mark.parametrize("way_s", [0.0, 0.3, 1.3])
def test_a_command_arrives_over_any_way_and_between_clocks_that_disagree(way_s: float, ahead_s: float) -> None:
    talk = Conversation(ARM_AFM, way_s, ahead_s)
    assert talk.run_s(12.0)
    assert talk.client.failure == ""
    assert len(talk.node.carried_out) == 1


@pytest.mark.parametrize("ahead_s", [0.0, 3.5, -3.5])
def test_what_nobody_waits_for_any_more_is_not_carried_out_by_a_node_that_wakes_up(ahead_s: float) -> None:
    talk = Conversation(ARM_AFM, 0.0, ahead_s)
    talk.stopped = True
    assert not talk.run_s(1.0)
    talk.node_clock.advance_ns(4 * SECOND)
    talk.node.handler.note_stall(talk.node_clock.now_ns(), 5 * SECOND)
    talk.stopped = False
    talk.pass_on()
    assert talk.node.carried_out == []
    assert {kind for _, kind, _ in talk.node.answers} == {"refused"}
    assert len(talk.node.answers) == 5, "every repetition is answered"


def test_a_client_that_still_waits_is_obeyed_by_a_node_that_wakes_up() -> None:
    talk = Conversation(ARM_AFM)
    talk.stopped = True
    assert not talk.run_s(4.0)
    talk.node.handler.note_stall(talk.node_clock.now_ns(), 4 * SECOND)
    talk.stopped = False
    assert talk.run_s(2.0)
    assert talk.client.failure == ""
    assert len(talk.node.carried_out) == 1
    assert talk.node.answers[0][1] == "refused"


def test_a_command_that_stays_expired_fails_with_the_words_of_the_node() -> None:
    sender = Sender(Command("arm", "afm_node", BOTH[:1]))
    sender.run_ms(1)
    sender.answer(BOTH[0], "refused", expired=True, sent_t_ns=sender.clock.now_ns())
    assert sender.client.answers == {}
    # a sign of life: it has as long again
    assert sender.run_ms(5002)
    assert sender.client.failure == "afm_node@slave refused arm: afm_node@slave says refused"
