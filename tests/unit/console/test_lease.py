"""The lease of the hand as a pure machine: who may do what, and what becomes of who vanishes."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from telenano.console import lease_register
from telenano.console.lease import (
    ASKED_NS,
    VANISHED_NS,
    Asking,
    Lease,
    Party,
    act,
    ask,
    current,
    ended,
    hand_over,
    let_go,
    packed,
    seen,
    still_asks,
    stood_still,
    take,
    unpacked,
    withdrawn,
)
from telenano.console.lease_register import LeaseRegister, acting, holding
from telenano.files.atomic_files import changed
from telenano.wire.errors import RefusedError, RigError

OBSERVER = Party("o", "Olga", "observer")
PUPIL, OTHER = Party("p", "Paul", "pupil"), Party("q", "Petra", "pupil")
OWNER, SECOND = Party("1"), Party("2")
TEACHER = Party("t", "Tina", "teacher")
NAMED = Party("n", "Nina")
PARTICIPANT = Party("x", "", "participant")
CONSOLE, PROGRAM = Party("c", what="console"), Party("g", what="program")
EXPERIMENT = Party("e", what="experiment")


def held_by(party: Party, now_ns: int = 5) -> Lease:
    return Lease(7, party, now_ns, kept=True)


def test_who_acts_has_the_hand_for_as_long_as_the_act_takes() -> None:
    lease = act(Lease(), OWNER, 5)
    assert (lease.holder, lease.kept) == (OWNER, False)
    with pytest.raises(RefusedError, match="the operator's page holds control"):
        act(lease, SECOND, 6)
    assert act(ended(lease, OWNER, 7), SECOND, 8).holder == SECOND
    # what was taken stays
    assert ended(take(lease, OWNER, 6), OWNER, 7).holder == OWNER


@pytest.mark.parametrize("party", [OBSERVER, PUPIL, PARTICIPANT])
def test_who_looks_or_learns_takes_nothing_by_themselves(party: Party) -> None:
    for lease in (Lease(), held_by(OWNER), held_by(EXPERIMENT)):
        with pytest.raises(RefusedError, match="cannot take"):
            take(lease, party, 6)


def test_a_pupil_has_the_hand_when_it_is_handed_over_and_gives_it_back() -> None:
    with pytest.raises(RefusedError, match="ask for it"):
        act(Lease(), PUPIL, 5)
    lease = ask(held_by(OWNER), PUPIL, 6)
    with pytest.raises(RefusedError, match="only the holder of control, or a teacher"):
        hand_over(lease, PUPIL, "p", 7, lease.number)
    lease = hand_over(lease, OWNER, "", 7, lease.number)
    assert (lease.holder, lease.asking) == (PUPIL, ())
    with pytest.raises(RefusedError, match="nobody has asked for control"):
        hand_over(lease, PUPIL, "", 8, lease.number)
    assert let_go(lease, PUPIL, 9).holder is None


def test_a_person_asks_once_however_many_pages_are_open() -> None:
    lease = held_by(OWNER)
    for number in range(16):
        lease = ask(lease, Party(f"p{number}", "Paul", "pupil"), 6)
    # the page that was used last is the one that gets it
    assert [each.party.id for each in lease.asking] == ["p15"]
    for number in range(15):
        lease = ask(lease, Party(f"x{number}", f"Pupil {number}", "pupil"), 6)
    assert len(lease.asking) == 16
    with pytest.raises(RefusedError, match="16 ask for control already"):
        ask(lease, OTHER, 6)
    # pages without a name are of the one whose rig it is
    lease = ask(ask(held_by(TEACHER), OWNER, 6), SECOND, 6)
    assert [each.party.id for each in lease.asking] == ["2"]


def test_a_page_asks_one_of_the_same_address_that_has_the_hand() -> None:
    named = [Party(f"o{number}", "Otto", "operator") for number in range(2)]
    for first, second in ((OWNER, SECOND), named):
        for kept in (True, False):
            lease = ask(held_by(first)._replace(kept=kept), second, 6)
            assert [each.party for each in lease.asking] == [second]
            assert hand_over(lease, first, second.id, 7, lease.number).holder == second


def test_who_asks_and_is_not_heard_any_more_is_gone() -> None:
    lease = ask(ask(held_by(OWNER), PUPIL, 6), OTHER, 6)
    now_ns = ASKED_NS + 5
    lease = still_asks(lease._replace(seen_ns=now_ns), {"p": now_ns, "unknown": now_ns}, now_ns)
    assert len(lease.asking) == 2
    lease = current(lease._replace(seen_ns=now_ns + 9), now_ns + 9)
    assert [each.party for each in lease.asking] == [PUPIL]
    lease = current(lease._replace(seen_ns=2 * now_ns), 2 * now_ns)
    assert (lease.holder, lease.asking) == (OWNER, ())
    # a time ahead is one of before the machine was started again
    assert current(Lease(asking=(Asking(PUPIL, 9),)), 8).asking == ()


def test_a_teacher_takes_it_without_being_granted_and_grants_what_others_have() -> None:
    assert take(held_by(PUPIL), TEACHER, 6).holder == TEACHER
    lease = ask(held_by(PUPIL), OTHER, 6)
    assert hand_over(lease, TEACHER, "q", 7, lease.number).holder == OTHER
    for party in (OWNER, SECOND):
        with pytest.raises(RefusedError, match="Paul holds control"):
            take(held_by(PUPIL), party, 6)


def test_the_owner_at_a_terminal_commands_beside_the_own_page_and_not_beside_a_person() -> None:
    assert act(held_by(OWNER), CONSOLE, 6).holder == OWNER
    assert act(held_by(PROGRAM), OWNER, 6).holder == PROGRAM
    with pytest.raises(RefusedError):
        act(held_by(PROGRAM), OWNER, 6, presses=True)
    assert take(held_by(OWNER), PROGRAM, 6).holder == PROGRAM
    assert take(held_by(PROGRAM), OWNER, 6).holder == OWNER
    for lease in (held_by(PUPIL), held_by(EXPERIMENT)):
        with pytest.raises(RefusedError):
            act(lease, CONSOLE, 6)
    with pytest.raises(RefusedError, match="Paul holds control"):
        take(held_by(PUPIL), PROGRAM, 6)


def test_a_participant_presses_under_the_lease_of_the_experiment() -> None:
    assert act(held_by(EXPERIMENT), PARTICIPANT, 6, presses=True).holder == EXPERIMENT
    with pytest.raises(RefusedError):
        act(held_by(OWNER), PARTICIPANT, 6, presses=True)


def test_what_was_said_under_an_earlier_lease_is_refused() -> None:
    first = take(Lease(), OWNER, 5)
    second = take(let_go(first, OWNER, 6), OWNER, 7)
    for number in (first.number, 0):
        with pytest.raises(RefusedError, match="earlier lease"):
            act(second, OWNER, 8, number)
    assert act(second, OWNER, 8, second.number).holder == OWNER
    with pytest.raises(RefusedError, match="earlier lease"):
        act(let_go(second, OWNER, 9), OWNER, 10, second.number)


def test_who_vanishes_loses_it_and_the_tip_is_withdrawn_if_it_was_pressed() -> None:
    pressed = act(take(Lease(), OWNER, 0), OWNER, 0, 1, presses=True)
    assert current(pressed, VANISHED_NS) == pressed
    gone = current(pressed, VANISHED_NS + 1)
    assert (gone.holder, gone.withdraw) == (None, True)
    assert not withdrawn(gone, VANISHED_NS + 2, gone.number).withdraw
    # who has it next decides for themselves
    assert not take(gone, SECOND, VANISHED_NS + 2).withdraw
    assert not current(ended(pressed, OWNER, 1), 2 * VANISHED_NS + 2).withdraw
    # a time ahead is one of before the machine was started again
    assert current(pressed._replace(seen_ns=10), 9).holder is None
    assert seen(pressed, OWNER, VANISHED_NS + 1).holder is None


@pytest.mark.parametrize("end", [ended, let_go])
def test_who_asks_gets_what_nobody_holds_any_more(end: Callable[[Lease, Party, int], Lease]) -> None:
    lease = ask(act(Lease(), OWNER, 5), SECOND, 6)
    # An act that goes on is not cut off.
    assert current(lease, 7).holder == OWNER
    lease = current(end(lease, OWNER, 8), 9)
    assert (lease.holder, lease.kept, lease.asking) == (SECOND, True, ())
    # What the one before says now is refused by the name of the new one.
    with pytest.raises(RefusedError, match="the operator's page holds control: ask for it"):
        act(lease, OWNER, 10)


def test_of_those_who_ask_the_first_who_was_heard_and_may_take_it_gets_it() -> None:
    lease = held_by(TEACHER)
    for party in (PUPIL, SECOND, NAMED):
        lease = ask(lease, party, 6)
    now_ns = VANISHED_NS + 20
    lease = still_asks(lease._replace(seen_ns=now_ns), {"p": now_ns, "n": now_ns - 3}, now_ns)
    lease = current(let_go(lease, TEACHER, now_ns), now_ns)
    # A pupil has it when it is handed over, and the second page was not heard.
    assert lease.holder == NAMED
    assert [each.party for each in lease.asking] == [PUPIL, SECOND]
    # It is lost by silence since it was heard last, and not since it was granted.
    assert current(lease, now_ns - 3 + VANISHED_NS).holder == NAMED
    assert current(lease, now_ns - 2 + VANISHED_NS).holder is None
    # Nobody who may take it is heard: it stays free until one is.
    alone = current(let_go(ask(ask(held_by(TEACHER), PUPIL, 6), SECOND, 6), TEACHER, now_ns), now_ns)
    assert alone.holder is None
    assert still_asks(alone, {"2": now_ns + 1}, now_ns + 2).holder == SECOND
    # A page that was loaded again has left, and asks no more.
    left = let_go(ask(held_by(TEACHER), SECOND, 6), SECOND, 7)
    assert current(let_go(left, TEACHER, 8), 9).holder is None


def test_a_pressed_tip_is_withdrawn_before_another_who_asks_gets_control() -> None:
    pressed = act(take(Lease(), OWNER, 0), OWNER, 0, 1, presses=True)
    asked = still_asks(ask(pressed, NAMED, 1), {"n": VANISHED_NS}, VANISHED_NS)
    for gone in (current(asked, VANISHED_NS + 1), let_go(asked, OWNER, VANISHED_NS, vanished=True)):
        gone = current(gone, VANISHED_NS + 2)
        assert (gone.holder, gone.withdraw) == (None, True)
        after = current(withdrawn(gone, VANISHED_NS + 3, gone.number), VANISHED_NS + 4)
        assert (after.holder, after.withdraw) == (NAMED, False)
        # The holder who is back finds that another holds it.
        with pytest.raises(RefusedError, match="Nina holds control"):
            act(after, OWNER, VANISHED_NS + 5, 1, presses=True)


def test_windows_without_a_name_are_told_apart_by_their_letters() -> None:
    assert Party("1", window="A").label == "window A"
    assert Party("n", "Nina", window="A").label == "Nina"
    lease = ask(take(Lease(), Party("1", window="A"), 5), Party("2", window="B"), 6)
    assert unpacked(packed(lease)) == lease
    # A lease that an earlier version kept has no letters.
    assert unpacked(packed(lease).replace(b',"A"', b"").replace(b',"B"', b"")).holder == Party("1")


def test_a_server_that_stood_still_for_a_moment_keeps_the_hand_of_its_page_unless_another_took_it() -> None:
    taken = take(Lease(), OWNER, 0)
    late_ns = 2 * VANISHED_NS
    assert stood_still(taken, OWNER, late_ns).holder == OWNER
    assert stood_still(current(taken, late_ns), OWNER, late_ns).holder is None
    assert stood_still(take(taken, TEACHER, late_ns), OWNER, late_ns).holder == TEACHER
    assert stood_still(taken, OWNER, 2 * late_ns).holder is None


def test_a_lease_is_kept_as_it_is_and_half_a_file_is_nobodys() -> None:
    lease = ask(held_by(OWNER), PUPIL, 6)
    assert unpacked(packed(lease)) == lease
    for data in (b"", packed(lease)[:40], b"[]", b'{"holder": 3, "asking": []}', b"\xff"):
        assert unpacked(data) == Lease()


def test_processes_share_the_lease_by_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    register = LeaseRegister()
    with holding("program") as hold:
        assert register.look().holder == hold.party
        with acting() as same:
            assert same is hold
        register.change(lambda lease, now_ns: take(lease, TEACHER, now_ns))
        assert not hold.is_held()
        with pytest.raises(RefusedError, match="Tina holds control now"), acting():
            pass
    assert register.look().holder == TEACHER
    with pytest.raises(RefusedError, match="Tina holds control"), acting():
        pass
    register.change(lambda lease, now_ns: let_go(lease, TEACHER, now_ns))
    with acting() as hold:
        assert register.look().holder == hold.party
    assert register.look().holder is None


def test_a_process_that_stands_still_with_the_file_holds_up_nobody_for_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lease_register, "changed", partial(changed, wait_s=0.02))
    first, second = LeaseRegister(tmp_path), LeaseRegister(tmp_path)
    first.change(lambda lease, now_ns: take(lease, OWNER, now_ns))

    def stands_still(lease: Lease, now_ns: int) -> Lease:
        assert second.look().holder == OWNER
        with pytest.raises(RigError, match=r"another process has had it for 0\.02 s"):
            second.change(current)
        return lease

    first.change(stands_still)
