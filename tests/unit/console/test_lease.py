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
    heard,
    let_go,
    packed,
    stood_still,
    take,
    unpacked,
    withdrawn,
)
from telenano.console.lease_register import LeaseRegister, acting, holding
from telenano.files.atomic_files import changed
from telenano.wire.errors import RefusedError, RigError

OBSERVER = Party("o", "Olga", "observer")
PAUL, PETRA = Party("p", "Paul"), Party("q", "Petra")
OWNER, SECOND = Party("1"), Party("2")
TINA = Party("t", "Tina")
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


@pytest.mark.parametrize("party", [OBSERVER, PARTICIPANT])
def test_who_looks_or_answers_takes_nothing_by_themselves(party: Party) -> None:
    for lease in (Lease(), held_by(OWNER), held_by(EXPERIMENT)):
        for step in (take, ask):
            with pytest.raises(RefusedError, match=r"(an observer|the participant) cannot hold control"):
                step(lease, party, 6)


def test_it_is_handed_over_by_its_holder_to_who_asks_and_given_back() -> None:
    lease = ask(held_by(OWNER), PAUL, 6)
    with pytest.raises(RefusedError, match="only the holder of control"):
        hand_over(lease, PAUL, "p", 7, lease.number)
    lease = hand_over(lease, OWNER, "", 7, lease.number)
    assert (lease.holder, lease.asking) == (PAUL, ())
    with pytest.raises(RefusedError, match="nobody has asked for control"):
        hand_over(lease, PAUL, "", 8, lease.number)
    assert let_go(lease, PAUL, 9).holder is None


def test_a_person_asks_once_however_many_pages_are_open() -> None:
    lease = held_by(OWNER)
    for number in range(16):
        lease = ask(lease, Party(f"p{number}", "Paul"), 6)
    # the page that was used last is the one that gets it
    assert [each.party.id for each in lease.asking] == ["p15"]
    for number in range(15):
        lease = ask(lease, Party(f"x{number}", f"Person {number}"), 6)
    assert len(lease.asking) == 16
    with pytest.raises(RefusedError, match="16 ask for control already"):
        ask(lease, PETRA, 6)
    # pages without a name are of the one whose rig it is
    lease = ask(ask(held_by(TINA), OWNER, 6), SECOND, 6)
    assert [each.party.id for each in lease.asking] == ["2"]


def test_a_page_asks_one_of_the_same_address_that_has_the_hand() -> None:
    named = [Party(f"o{number}", "Otto", "operator") for number in range(2)]
    for first, second in ((OWNER, SECOND), named):
        for kept in (True, False):
            lease = ask(held_by(first)._replace(kept=kept), second, 6)
            assert [each.party for each in lease.asking] == [second]
            assert hand_over(lease, first, second.id, 7, lease.number).holder == second


def test_who_asks_and_is_not_heard_any_more_is_gone() -> None:
    lease = ask(ask(held_by(OWNER), PAUL, 6), PETRA, 6)
    now_ns = ASKED_NS + 5
    lease = heard(lease._replace(seen_ns=now_ns), {"p": now_ns, "unknown": now_ns}, now_ns)
    assert len(lease.asking) == 2
    lease = current(lease._replace(seen_ns=now_ns + 9), now_ns + 9)
    assert [each.party for each in lease.asking] == [PAUL]
    lease = current(lease._replace(seen_ns=2 * now_ns), 2 * now_ns)
    assert (lease.holder, lease.asking) == (OWNER, ())
    # a time ahead is one of before the machine was started again
    assert current(Lease(asking=(Asking(PAUL, 9),)), 8).asking == ()


def test_it_is_taken_from_anyone_at_a_terminal_of_the_rig_that_says_so_and_by_no_page() -> None:
    assert take(held_by(PAUL), CONSOLE, 6, from_anyone=True).holder == CONSOLE
    for party in (OWNER, SECOND, TINA, CONSOLE):
        with pytest.raises(RefusedError, match="Paul holds control"):
            take(held_by(PAUL), party, 6)


def test_control_that_is_lost_says_how_and_control_that_is_given_up_says_nothing() -> None:
    window = Party("1", window="A")
    taken = take(Lease(), window, 0)
    pressed = act(taken, window, 0, taken.number, presses=True)
    late_ns = VANISHED_NS + 100_000_000
    assert current(taken, late_ns).lost == ("1", "window A was not heard for 1.1 s")
    text = "window A was not heard for 1.1 s while it pressed: the tip is withdrawn"
    assert current(pressed, late_ns).lost == ("1", text)
    assert let_go(pressed, window, 5, vanished=True).lost == (
        "1",
        "window A was closed while it pressed: the tip is withdrawn",
    )
    assert let_go(pressed, window, 5).lost is None
    # An act ends nothing of what was said, as that of a page which presses on; an act alone is no loss.
    again = act(current(pressed, late_ns), window, late_ns, presses=True)
    assert again.lost == ended(again, window, late_ns + 1).lost == ("1", text)
    assert current(act(Lease(), window, 0), late_ns).lost is None
    assert take(current(pressed, late_ns), SECOND, late_ns).lost is None
    assert unpacked(packed(current(pressed, late_ns))).lost == ("1", text)


def test_the_owner_at_a_terminal_commands_beside_the_own_page_and_not_beside_a_person() -> None:
    assert act(held_by(OWNER), CONSOLE, 6).holder == OWNER
    assert act(held_by(PROGRAM), OWNER, 6).holder == PROGRAM
    with pytest.raises(RefusedError):
        act(held_by(PROGRAM), OWNER, 6, presses=True)
    assert take(held_by(OWNER), PROGRAM, 6).holder == PROGRAM
    assert take(held_by(PROGRAM), OWNER, 6).holder == OWNER
    for lease in (held_by(PAUL), held_by(EXPERIMENT)):
        with pytest.raises(RefusedError):
            act(lease, CONSOLE, 6)
    with pytest.raises(RefusedError, match="Paul holds control"):
        take(held_by(PAUL), PROGRAM, 6)


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
    assert heard(pressed, {"1": VANISHED_NS + 1}, VANISHED_NS + 1).holder is None


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


def test_of_those_who_ask_the_first_who_was_heard_gets_it() -> None:
    lease = held_by(TINA)
    for party in (PAUL, SECOND, NAMED):
        lease = ask(lease, party, 6)
    now_ns = VANISHED_NS + 20
    lease = heard(lease._replace(seen_ns=now_ns), {"n": now_ns - 3}, now_ns)
    lease = current(let_go(lease, TINA, now_ns), now_ns)
    # The two before it were not heard.
    assert lease.holder == NAMED
    assert [each.party for each in lease.asking] == [PAUL, SECOND]
    # It is lost by silence since it was heard last, and not since it was granted.
    assert current(lease, now_ns - 3 + VANISHED_NS).holder == NAMED
    assert current(lease, now_ns - 2 + VANISHED_NS).holder is None
    # Nobody is heard: it stays free until one is.
    alone = current(let_go(ask(ask(held_by(TINA), PAUL, 6), SECOND, 6), TINA, now_ns), now_ns)
    assert alone.holder is None
    assert heard(alone, {"2": now_ns + 1}, now_ns + 2).holder == SECOND
    # A page that was loaded again has left, and asks no more.
    left = let_go(ask(held_by(TINA), SECOND, 6), SECOND, 7)
    assert current(let_go(left, TINA, 8), 9).holder is None


def test_a_pressed_tip_is_withdrawn_before_another_who_asks_gets_control() -> None:
    pressed = act(take(Lease(), OWNER, 0), OWNER, 0, 1, presses=True)
    asked = heard(ask(pressed, NAMED, 1), {"n": VANISHED_NS}, VANISHED_NS)
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
    assert stood_still(take(taken, TINA, late_ns, from_anyone=True), OWNER, late_ns).holder == TINA
    assert stood_still(taken, OWNER, 2 * late_ns).holder is None


def test_a_lease_is_kept_as_it_is_and_half_a_file_is_nobodys() -> None:
    lease = ask(held_by(OWNER), PAUL, 6)
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
        register.change(lambda lease, now_ns: take(lease, TINA, now_ns, from_anyone=True))
        assert not hold.is_held()
        with pytest.raises(RefusedError, match="Tina holds control now"), acting():
            pass
    assert register.look().holder == TINA
    with pytest.raises(RefusedError, match="Tina holds control"), acting():
        pass
    register.change(lambda lease, now_ns: let_go(lease, TINA, now_ns))
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
