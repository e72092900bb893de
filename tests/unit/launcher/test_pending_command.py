from typing import Literal

from proto.messages import SessionEvent
from services.launcher.pending_command import PendingCommand
from services.runtime.clock import VirtualClock

MS = 1_000_000
BOTH = ("afm_node@slave", "haptic_node@master")


def answer(pending: PendingCommand, node: str, kind: Literal["ack", "refused", "mode"] = "ack") -> SessionEvent:
    return SessionEvent(
        seq=0, t_ns=0, src=node, v=1, id=pending.id, kind=kind, level="info", text=f"{node} says {kind}", data={}
    )


def test_it_is_sent_at_once_and_then_every_200_ms_with_one_id() -> None:
    clock = VirtualClock(start_ns=MS)
    pending = PendingCommand(clock, "arm", "*", BOTH)
    sent: list[int] = []
    ids = set()
    for _ in range(1000):
        if pending.take_due():
            sent.append(clock.monotonic_ns() // MS)
            ids.add(pending.fields()["id"])
        clock.advance_ns(MS)
    assert sent == [1, 201, 401, 601, 801]
    assert len(ids) == 1


def test_two_commands_have_two_ids() -> None:
    clock = VirtualClock()
    assert PendingCommand(clock, "arm", "*", BOTH).id != PendingCommand(clock, "arm", "*", BOTH).id


def test_it_ends_when_all_have_answered() -> None:
    clock = VirtualClock()
    pending = PendingCommand(clock, "arm", "*", BOTH)
    assert pending.record(answer(pending, BOTH[0]))
    assert not pending.record(answer(pending, BOTH[0])), "a repeated answer is no news"
    assert pending.missing == [BOTH[1]]
    assert not pending.complete
    assert pending.record(answer(pending, BOTH[1]))
    assert pending.complete
    clock.advance_ns(10_000 * MS)
    assert not pending.take_due()
    assert pending.failure() == ""


def test_other_events_are_no_answers() -> None:
    clock = VirtualClock()
    pending, other = (PendingCommand(clock, "arm", "*", BOTH) for _ in range(2))
    assert not pending.record(answer(other, BOTH[0]))
    assert not pending.record(answer(pending, BOTH[0], "mode"))
    assert pending.missing == sorted(BOTH)


def test_missing_answers_fail_at_the_deadline_and_are_named() -> None:
    clock = VirtualClock()
    pending = PendingCommand(clock, "start", "*", BOTH)
    pending.record(answer(pending, BOTH[0]))
    clock.advance_ns(5000 * MS - 1)
    assert pending.failure() == ""
    clock.advance_ns(1)
    assert BOTH[1] in pending.failure()
    assert BOTH[0] not in pending.failure()


def test_a_refusal_fails_with_its_reason() -> None:
    pending = PendingCommand(VirtualClock(), "arm", "*", BOTH)
    pending.record(answer(pending, BOTH[0], "refused"))
    assert pending.failure() == "afm_node@slave refused arm: afm_node@slave says refused"


def test_a_new_reader_has_it_sent_at_once() -> None:
    clock = VirtualClock()
    pending = PendingCommand(clock, "mark", "*", BOTH)
    assert pending.take_due()
    clock.advance_ns(MS)
    assert not pending.take_due()
    pending.make_due()
    assert pending.take_due()
