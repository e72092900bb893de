"""Who holds control of a rig: one lease of the hand, of the instrument's programs and of the session's commands.

Pure steps in virtual time: a lease, who asks for what, and the time in; the next lease out, or RefusedError with the
reason. An emergency stop asks nothing of it and changes nothing in it.

Who acts while control is free has it for as long as the act takes; *Take* keeps it until it is handed over, let go
of, taken, or lost by silence. What becomes free goes to the first who asks and may take it, once a tip whose
holder vanished is withdrawn. A party that asks for something has a number of the lease in view, which changes with each
holder, so that what was said under an earlier lease is refused.
"""

from collections.abc import Mapping
from typing import NamedTuple

import msgspec

from telenano.wire.errors import RefusedError

# A holder of whom nothing was heard for this time has lost the hand, and the tip is withdrawn if it was pressed.
VANISHED_NS = 1_000_000_000
# A holder reports at this interval that it is there [s].
BEAT_S = 0.25
# Who asks for control, and of whom nothing was heard for this time, does not ask any more.
ASKED_NS = 3 * VANISHED_NS
_MOST_ASKING = 16
# They have control when it is handed over, or never.
_NEVER_TAKE = ("observer", "participant", "pupil")
# The name of a person has this number of letters at most.
MOST_LETTERS = 48
# Commands that only end a motion, or move nothing, need no lease.
FREE_COMMANDS = ("estop", "stop", "mark")
# The kinds of parties.
PAGE = "page"
EXPERIMENT = "experiment"
CONSOLE = "console"


class Party(NamedTuple):
    """A page or a process that may have the hand.

    `id`: of this page or process alone; `name`: that its person was given, or empty; `role`: observer, pupil,
    participant, operator or teacher; `what`: page, or what kind of process; `window`: the letter of a page whose person
    was given no name, or empty.
    """

    id: str
    name: str = ""
    role: str = "operator"
    what: str = PAGE
    window: str = ""

    @property
    def label(self) -> str:
        """How it is shown to others."""
        if self.window and not self.name:
            return f"window {self.window}"
        who = {"operator": "the operator's page", "participant": "the participant"}.get(self.role, f"a {self.role}")
        return self.name or (who if self.what == PAGE else f"the {self.what} at the rig")

    @property
    def is_owner(self) -> bool:
        """Whether it is of the person whose rig it is: a process on its machine, or the page of the printed address."""
        return self.what != PAGE or (self.role == "operator" and not self.name)

    @property
    def person(self) -> tuple[str, str]:
        """Whose it is: each person with a name is one, and so are all pages of one role without."""
        return self.name, "" if self.name else f"{self.role} {self.what}"


class Asking(NamedTuple):
    """A party that asks for control, and when it was seen last [ns]."""

    party: Party
    seen_ns: int


class Lease(NamedTuple):
    """Who holds control. All times are of the monotonic clock of the machine [ns].

    `number`: counts up with each holder, and with each time that it becomes free; `kept`: it lasts longer than the act;
    `presses`: the hand of the holder pushes; `withdraw`: who pressed has vanished, and the tip is to be withdrawn.
    """

    number: int = 0
    holder: Party | None = None
    seen_ns: int = 0
    kept: bool = False
    presses: bool = False
    withdraw: bool = False
    asking: tuple[Asking, ...] = ()

    def is_held_by(self, party: Party) -> bool:
        """Whether a party holds control."""
        return self.holder is not None and self.holder.id == party.id


def current(lease: Lease, now_ns: int) -> Lease:
    """Return the lease as it is now: without a holder who has vanished, and those who asked and have left.

    Free control is granted to the first who asks, was heard within VANISHED_NS, and may take it.
    A time ahead is of before the machine began.
    """
    asking = tuple(each for each in lease.asking if 0 <= now_ns - each.seen_ns <= ASKED_NS)
    lease = lease if asking == lease.asking else lease._replace(asking=asking)
    if lease.holder is not None and not 0 <= now_ns - lease.seen_ns <= VANISHED_NS:
        lease = _vacant(lease, now_ns, withdraw=lease.presses)
    # Who gets control decides for themselves, so a tip that is to be withdrawn is withdrawn before.
    if lease.holder is None and not lease.withdraw:
        heard = (each for each in lease.asking if now_ns - each.seen_ns <= VANISHED_NS)
        first = next((each for each in heard if each.party.role not in _NEVER_TAKE), None)
        if first is not None:
            return _granted(lease, first.party, now_ns, kept=True)._replace(seen_ns=first.seen_ns)
    return lease


def act(lease: Lease, party: Party, now_ns: int, number: int = 0, *, presses: bool = False) -> Lease:
    """Let a party act: its command, or the force of its hand. `number`: of the lease that it has in view, 0 for none.

    Raises:
        RefusedError: Another holds control, the role has none, or what was said belongs to an earlier lease.
    """
    lease = current(lease, now_ns)
    holder = lease.holder
    if party.role == "observer":
        raise RefusedError("an observer looks, and may stop, and not command")
    if holder is None:
        if number:
            raise RefusedError("control is free: this belongs to an earlier lease")
        if party.role == "pupil":
            raise RefusedError("a pupil holds control when it is handed over: ask for it")
        return _granted(lease, party, now_ns, kept=False, presses=presses)
    if holder.id != party.id:
        if party.role == "participant" and holder.what == EXPERIMENT:
            return lease
        if _are_the_owners(party, holder) and holder.what != EXPERIMENT and not presses:
            return lease
        raise RefusedError(f"{holder.label} holds control: ask for it")
    if (number or lease.kept) and number != lease.number and party.what == PAGE:
        raise RefusedError("this belongs to an earlier lease")
    return lease._replace(seen_ns=now_ns, presses=presses or lease.presses)


def take(lease: Lease, party: Party, now_ns: int) -> Lease:
    """Let a party keep control: what is free, or a teacher's without being granted.

    Raises:
        RefusedError: The role may not.
    """
    lease = current(lease, now_ns)
    holder = lease.holder
    if party.role in _NEVER_TAKE and not lease.is_held_by(party):
        raise RefusedError(f"a {party.role} cannot take control")
    if lease.is_held_by(party):
        return lease._replace(kept=True, seen_ns=now_ns)
    if holder is not None and party.role != "teacher" and not _are_the_owners(party, holder):
        raise RefusedError(f"{holder.label} holds control: ask for it")
    return _granted(lease, party, now_ns, kept=True)


def ask(lease: Lease, party: Party, now_ns: int) -> Lease:
    """Ask for control; who may take it gets free control at once. A person asks once, by the page used last.

    Raises:
        RefusedError: The role may not, or too many ask.
    """
    lease = current(lease, now_ns)
    if party.role in ("observer", "participant"):
        raise RefusedError(f"a {party.role} cannot hold control")
    if lease.holder is None and party.role != "pupil":
        return take(lease, party, now_ns)
    if lease.is_held_by(party):
        return lease
    others = tuple(each for each in lease.asking if each.party.person != party.person)
    if len(others) >= _MOST_ASKING:
        raise RefusedError(f"{len(others)} ask for control already")
    return lease._replace(asking=(*others, Asking(party, now_ns)))


def hand_over(lease: Lease, party: Party, to: str, now_ns: int, number: int) -> Lease:
    """Hand over to one who asks; the holder may, and a teacher.

    Args:
        lease: The lease.
        party: Who hands over.
        to: The id of one who asks; empty for the first.
        now_ns: The time.
        number: Of the lease that the party has in view.

    Raises:
        RefusedError: The party does not hold control, was speaking of an earlier lease, or that one does not ask.
    """
    lease = current(lease, now_ns)
    if party.role != "teacher" and not lease.is_held_by(party):
        raise RefusedError("only the holder of control, or a teacher, can hand it over")
    if number != lease.number:
        raise RefusedError("this belongs to an earlier lease")
    receiver = next((each.party for each in lease.asking if to in ("", each.party.id)), None)
    if receiver is None:
        raise RefusedError("control was not asked for" if not to else "that page no longer asks for control")
    return _granted(lease, receiver, now_ns, kept=True)


def let_go(lease: Lease, party: Party, now_ns: int, *, vanished: bool = False) -> Lease:
    """Return the lease without a party, which lets go of the hand or has left.

    `vanished`: it did not say so, and where its hand pressed the tip is to be withdrawn.
    """
    lease = current(lease, now_ns)
    lease = lease._replace(asking=_without(lease.asking, party))
    if not lease.is_held_by(party):
        return lease
    return _vacant(lease, now_ns, withdraw=vanished and lease.presses)


def ended(lease: Lease, party: Party, now_ns: int) -> Lease:
    """Return the lease after an act of a party, which keeps the hand only if it has taken it."""
    lease = current(lease, now_ns)
    if not lease.is_held_by(party):
        return lease
    return lease._replace(presses=False) if lease.kept else _vacant(lease, now_ns, withdraw=False)


def seen(lease: Lease, party: Party, now_ns: int, heard_ns: int | None = None) -> Lease:
    """Note that a party is there, or that it was heard at a time before now."""
    lease = current(lease, now_ns)
    if not lease.is_held_by(party):
        return lease
    return lease._replace(seen_ns=now_ns if heard_ns is None else max(lease.seen_ns, min(heard_ns, now_ns)))


def still_asks(lease: Lease, heard_ns: Mapping[str, int], now_ns: int) -> Lease:
    """Note when those who ask for the hand were heard last, by their ids."""
    asking = [each._replace(seen_ns=max(each.seen_ns, heard_ns.get(each.party.id, 0))) for each in lease.asking]
    return current(lease._replace(asking=tuple(asking)), now_ns)


def stood_still(lease: Lease, party: Party, now_ns: int) -> Lease:
    """Note that the server of a party stood still and could not hear it; what others made of the lease counts."""
    if not lease.is_held_by(party) or now_ns - lease.seen_ns > 3 * VANISHED_NS:
        return current(lease, now_ns)
    return lease._replace(seen_ns=now_ns)


def withdrawn(lease: Lease, now_ns: int, number: int) -> Lease:
    """Note that the tip has been withdrawn for the lease of a number; what came after it is still to be done."""
    lease = current(lease, now_ns)
    return lease._replace(withdraw=lease.withdraw and lease.number != number)


def packed(lease: Lease) -> bytes:
    """Return a lease as it is kept."""
    return msgspec.json.encode(lease)


def unpacked(data: bytes) -> Lease:
    """Return the lease that was kept; a file that was not written to its end is free control."""
    try:
        return msgspec.json.decode(data, type=Lease)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return Lease()


def _are_the_owners(party: Party, holder: Party) -> bool:
    """Return whether both are of the person whose rig it is, who acts at a terminal beside a page; not two pages."""
    return party.is_owner and holder.is_owner and {party.what, holder.what} != {PAGE}


def _granted(lease: Lease, party: Party, now_ns: int, *, kept: bool, presses: bool = False) -> Lease:
    return Lease(_next(lease, now_ns), party, now_ns, kept, presses, False, _without(lease.asking, party))


def _vacant(lease: Lease, now_ns: int, *, withdraw: bool) -> Lease:
    return Lease(_next(lease, now_ns), None, now_ns, withdraw=withdraw or lease.withdraw, asking=lease.asking)


def _next(lease: Lease, now_ns: int) -> int:
    # By the clock, so that a number never comes again, whatever became of what was kept.
    return max(lease.number + 1, now_ns // 1_000_000)


def _without(asking: tuple[Asking, ...], party: Party) -> tuple[Asking, ...]:
    return tuple(each for each in asking if each.party.id != party.id)
