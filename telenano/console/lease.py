"""The lease of control of a rig: who may move the hand, run programs of the instrument and command the session.

Pure functions in virtual time: each takes a lease, a request and the time, and returns the next lease, or raises
RefusedError with the reason. An emergency stop needs no lease and changes none.

A party that acts while control is free holds it for the duration of the act; *Take* keeps it until the party hands it
over, releases it, loses it to `--take` at a terminal of the rig, or falls silent. Free control goes to the first party
that asks, but only after the tip is withdrawn if its holder vanished while pressing. Each change of holder changes the
number of the lease. Requests carry the number that their sender saw, so that requests under an earlier lease are
refused. `lost` says of free control how its last holder lost it without wanting to.
"""

from collections.abc import Mapping
from typing import NamedTuple

import msgspec

from telenano.wire.errors import RefusedError

# A holder that is silent for this time loses control, and the tip is withdrawn if the holder was pressing [ns].
VANISHED_NS = 1_000_000_000
# Interval at which a holder reports its presence [s].
BEAT_S = 0.25
# A request for control expires if its party is silent for this time [ns].
ASKED_NS = 3 * VANISHED_NS
_MOST_ASKING = 16
# Most letters of a person's name.
MOST_LETTERS = 48
# Commands that need no lease, because they end a motion or move nothing.
FREE_COMMANDS = ("estop", "stop", "mark")
# The kinds of parties.
PAGE = "page"
EXPERIMENT = "experiment"
CONSOLE = "console"


class Party(NamedTuple):
    """A page or a process that may hold control.

    `id`: unique to this page or process; `name`: the given name of its person, or empty; `role`: observer, participant
    or operator; `what`: page, or the kind of process; `window`: the letter of a page of a person
    without a name, or empty.
    """

    id: str
    name: str = ""
    role: str = "operator"
    what: str = PAGE
    window: str = ""

    @property
    def label(self) -> str:
        """The name shown to others."""
        if self.window and not self.name:
            return f"window {self.window}"
        who = {"operator": "the operator's page", "participant": "the participant"}.get(self.role, "an observer")
        return self.name or (who if self.what == PAGE else f"the {self.what} at the rig")

    @property
    def is_owner(self) -> bool:
        """Whether the party is the owner of the rig: a process on its machine, or the page of the printed address."""
        return self.what != PAGE or (self.role == "operator" and not self.name)

    @property
    def person(self) -> tuple[str, str]:
        """Key of the person: the name, or for parties without a name the role and kind, which count as one person."""
        return self.name, "" if self.name else f"{self.role} {self.what}"


class Asking(NamedTuple):
    """A party that asks for control, and the time at which it was last seen [ns]."""

    party: Party
    seen_ns: int


class Loss(NamedTuple):
    """How a holder lost control without wanting to: the id of the party, and a sentence."""

    id: str
    text: str


class Lease(NamedTuple):
    """State of control. All times are by the monotonic clock of the machine [ns].

    `number`: rises whenever control changes its holder or becomes free; `kept`: True if it lasts longer than one act;
    `presses`: True if the holder's hand pushes; `withdraw`: True if a holder vanished while pressing, so that the tip
    must be withdrawn; `lost`: the last loss, until a party takes control, and not only for an act.
    """

    number: int = 0
    holder: Party | None = None
    seen_ns: int = 0
    kept: bool = False
    presses: bool = False
    withdraw: bool = False
    asking: tuple[Asking, ...] = ()
    lost: Loss | None = None

    def is_held_by(self, party: Party) -> bool:
        """Return whether a party holds control."""
        return self.holder is not None and self.holder.id == party.id


def current(lease: Lease, now_ns: int) -> Lease:
    """Return the lease as of now, without a holder that vanished and without expired requests.

    Free control is granted to the first party that asks and was heard within VANISHED_NS. A time in the future is from
    before the machine was booted and counts as expired.
    """
    asking = tuple(each for each in lease.asking if 0 <= now_ns - each.seen_ns <= ASKED_NS)
    lease = lease if asking == lease.asking else lease._replace(asking=asking)
    if lease.holder is not None and not 0 <= now_ns - lease.seen_ns <= VANISHED_NS:
        silent = f"{lease.holder.label} was not heard for {max(0, now_ns - lease.seen_ns) * 1e-9:.1f} s"
        lease = _vacant(lease, now_ns, withdraw=lease.presses, loss=silent)
    # Withdraw a pending tip first, because the next holder must not get control of a pressing tip.
    if lease.holder is None and not lease.withdraw:
        heard = (each for each in lease.asking if now_ns - each.seen_ns <= VANISHED_NS)
        first = next(heard, None)
        if first is not None:
            return _granted(lease, first.party, now_ns, kept=True)._replace(seen_ns=first.seen_ns)
    return lease


def act(lease: Lease, party: Party, now_ns: int, number: int = 0, *, presses: bool = False) -> Lease:
    """Let a party act, by a command or by the force of its hand; `number` is that of the lease it saw, 0 for none.

    Raises:
        RefusedError: Another party holds control, the role may not act, or the act belongs to an earlier lease.
    """
    lease = current(lease, now_ns)
    holder = lease.holder
    if party.role == "observer":
        raise RefusedError("an observer may look and stop, but not command")
    if holder is None:
        if number:
            raise RefusedError("control is free: this belongs to an earlier lease")
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


def take(lease: Lease, party: Party, now_ns: int, *, from_anyone: bool = False) -> Lease:
    """Let a party take and keep control that is free, held by the same owner, or with `from_anyone` held by any other.

    Raises:
        RefusedError: The role may not take control, or another party holds it.
    """
    lease = current(lease, now_ns)
    holder = lease.holder
    if party.role != "operator":
        raise RefusedError(f"{Party('', role=party.role).label} cannot hold control")
    if lease.is_held_by(party):
        return lease._replace(kept=True, seen_ns=now_ns)
    if holder is not None and not from_anyone and not _are_the_owners(party, holder):
        raise RefusedError(f"{holder.label} holds control: ask for it")
    return _granted(lease, party, now_ns, kept=True)


def ask(lease: Lease, party: Party, now_ns: int) -> Lease:
    """Request control; free control is granted at once. A person has one request, the latest.

    Raises:
        RefusedError: The role cannot hold control, or there are too many requests.
    """
    lease = current(lease, now_ns)
    if lease.holder is None or party.role != "operator":
        return take(lease, party, now_ns)
    if lease.is_held_by(party):
        return lease
    others = tuple(each for each in lease.asking if each.party.person != party.person)
    if len(others) >= _MOST_ASKING:
        raise RefusedError(f"{len(others)} ask for control already")
    return lease._replace(asking=(*others, Asking(party, now_ns)))


def hand_over(lease: Lease, party: Party, to: str, now_ns: int, number: int) -> Lease:
    """Let the holder hand control over to a party that asks.

    Args:
        lease: The lease.
        party: The party that hands over.
        to: The id of the party that receives control; empty for the first that asks.
        now_ns: The time [ns].
        number: The number of the lease that the party saw.

    Raises:
        RefusedError: The party is not the holder, saw an earlier lease, or the receiver does not ask.
    """
    lease = current(lease, now_ns)
    if not lease.is_held_by(party):
        raise RefusedError("only the holder of control can hand it over")
    if number != lease.number:
        raise RefusedError("this belongs to an earlier lease")
    receiver = next((each.party for each in lease.asking if to in ("", each.party.id)), None)
    if receiver is None:
        raise RefusedError("nobody has asked for control" if not to else "that page no longer asks for control")
    return _granted(lease, receiver, now_ns, kept=True)


def let_go(lease: Lease, party: Party, now_ns: int, *, vanished: bool = False) -> Lease:
    """Return the lease without a party that releases control or has left.

    `vanished`: it left without notice, so the tip must be withdrawn if its hand pressed.
    """
    lease = current(lease, now_ns)
    lease = lease._replace(asking=_without(lease.asking, party))
    if not lease.is_held_by(party):
        return lease
    loss = f"{party.label} was closed" if vanished else ""
    return _vacant(lease, now_ns, withdraw=vanished and lease.presses, loss=loss)


def ended(lease: Lease, party: Party, now_ns: int) -> Lease:
    """Return the lease after an act of a party, which keeps control only if it has taken it."""
    lease = current(lease, now_ns)
    if not lease.is_held_by(party):
        return lease
    return lease._replace(presses=False) if lease.kept else _vacant(lease, now_ns, withdraw=False)


def heard(lease: Lease, heard_ns: Mapping[str, int], now_ns: int) -> Lease:
    """Record the times [ns] at which the holder, and parties that ask for control, were last heard, by their ids."""
    asking = tuple(each._replace(seen_ns=max(each.seen_ns, heard_ns.get(each.party.id, 0))) for each in lease.asking)
    lease = current(lease if asking == lease.asking else lease._replace(asking=asking), now_ns)
    if lease.holder is None or lease.holder.id not in heard_ns:
        return lease
    return lease._replace(seen_ns=max(lease.seen_ns, min(heard_ns[lease.holder.id], now_ns)))


def stood_still(lease: Lease, party: Party, now_ns: int) -> Lease:
    """Extend the lease of a party that was not heard because its server stalled, unless it has lapsed meanwhile."""
    if not lease.is_held_by(party) or now_ns - lease.seen_ns > 3 * VANISHED_NS:
        return current(lease, now_ns)
    return lease._replace(seen_ns=now_ns)


def withdrawn(lease: Lease, now_ns: int, number: int) -> Lease:
    """Record that the tip was withdrawn for the lease with this number; a later request to withdraw stays pending."""
    lease = current(lease, now_ns)
    return lease._replace(withdraw=lease.withdraw and lease.number != number)


def packed(lease: Lease) -> bytes:
    """Return a lease as JSON for the file."""
    return msgspec.json.encode(lease)


def unpacked(data: bytes) -> Lease:
    """Return the lease from the content of the file; control is free if the content is incomplete."""
    try:
        return msgspec.json.decode(data, type=Lease)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return Lease()


def _are_the_owners(party: Party, holder: Party) -> bool:
    """Return whether both parties are the rig's owner, at a terminal beside a page; two pages do not count."""
    return party.is_owner and holder.is_owner and {party.what, holder.what} != {PAGE}


def _granted(lease: Lease, party: Party, now_ns: int, *, kept: bool, presses: bool = False) -> Lease:
    asking, lost = _without(lease.asking, party), None if kept else lease.lost
    return Lease(_next(lease, now_ns), party, now_ns, kept, presses, False, asking, lost)


def _vacant(lease: Lease, now_ns: int, *, withdraw: bool, loss: str = "") -> Lease:
    lost = lease.lost
    if loss and lease.holder is not None and (lease.kept or lease.presses):
        lost = Loss(lease.holder.id, f"{loss} while it pressed: the tip is withdrawn" if withdraw else loss)
    withdraw = withdraw or lease.withdraw
    return Lease(_next(lease, now_ns), None, now_ns, withdraw=withdraw, asking=lease.asking, lost=lost)


def _next(lease: Lease, now_ns: int) -> int:
    # From the clock, so that a number is never used again, even if the file was lost.
    return max(lease.number + 1, now_ns // 1_000_000)


def _without(asking: tuple[Asking, ...], party: Party) -> tuple[Asking, ...]:
    return tuple(each for each in asking if each.party.id != party.id)
