"""The lease of the hand as the pages of a server have it: what they ask for, may do, and are told."""

import contextlib
import time
from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any

from services.viz_node.page_session import Session
from services.viz_node.requests import LeaseRequest
from telenano.console.lease import (
    BEAT_S,
    EXPERIMENT,
    Lease,
    act,
    ask,
    current,
    ended,
    hand_over,
    let_go,
    seen,
    still_asks,
    stood_still,
    take,
    withdrawn,
)
from telenano.console.lease_register import LeaseRegister, Step
from telenano.recording.messages import LeftOut
from telenano.wire.errors import RefusedError, RigError


class OwnRegister:
    """Keeps the lease of pages that share it with no other process, such as those of a recording."""

    def __init__(self, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._lease, self._now_ns = Lease(), now_ns

    def look(self) -> Lease:
        return self.change(current)

    def change(self, step: Step) -> Lease:
        self._lease = step(self._lease, self._now_ns())
        return self._lease


class LeaseDesk:
    """Applies the lease to what pages want.

    `lease`: as it was looked at last; `refused`: how often something was refused, by reason.
    """

    def __init__(self, register: LeaseRegister | OwnRegister, clock: Callable[[], float] = time.monotonic) -> None:
        self.lease = Lease()
        self.refused = LeftOut()
        self._register = register
        self._sent_facts: Mapping[str, Any] = {}
        self._sessions: Collection[Session] = ()
        self._clock, self._looked_s = clock, clock()
        self._beat_s, self._asked_s = 0.0, 0.0
        self._withdrawn = -1

    def act(self, session: Session, number: int, *, presses: bool = False) -> None:
        """Let a page act under a number of the lease, 0 for none; RefusedError says who holds control."""
        self._change(session, lambda lease, now_ns: act(lease, session.party, now_ns, number, presses=presses))

    def ended(self, session: Session) -> None:
        """Note that an act of a page is over: only what it has taken it keeps."""
        self._change(session, lambda lease, now_ns: ended(lease, session.party, now_ns))

    def ask_for(self, session: Session, request: LeaseRequest) -> str:
        """Carry out what a page wants of the lease; return it in words, or raise RefusedError."""
        party, number = session.party, request.lease
        steps: dict[str, Step] = {
            "ask": lambda lease, now_ns: ask(lease, party, now_ns),
            "take": lambda lease, now_ns: take(lease, party, now_ns),
            "hand_over": lambda lease, now_ns: hand_over(lease, party, request.to, now_ns, number),
            "let_go": lambda lease, now_ns: let_go(lease, party, now_ns),
        }
        self._change(session, steps[request.action])
        holder = self.lease.holder
        return "control is free" if holder is None else f"{holder.label} holds control"

    def leave(self, session: Session) -> None:
        """Note that the connection of a page is gone; a hand that pressed then has vanished."""
        with contextlib.suppress(RefusedError, RigError):
            self._change(session, lambda lease, now_ns: let_go(lease, session.party, now_ns, vanished=True))

    def has(self, session: Session) -> bool:
        """Return whether a page has the hand, by the lease as it was looked at last."""
        return self.lease.is_held_by(session.party)

    def may_press(self, session: Session) -> bool:
        """Return whether the force of a page may still go out, by the lease as it was looked at last."""
        holder = self.lease.holder
        is_participant = session.party.role == "participant" and holder is not None and holder.what == EXPERIMENT
        return self.has(session) or is_participant

    def tick(self, sessions: Collection[Session], now_s: float) -> Mapping[str, Any] | None:
        """Look at the lease, say that its holder is there, and return what pages are told if it has changed."""
        self._sessions = sessions
        self._forgive(now_s)
        # where the file cannot be had pages are told nothing new, and what they send is refused by name
        with contextlib.suppress(RigError):
            self.lease = self._looked()
            there = next((each for each in sessions if self.has(each)), None)
            if there is not None and there.heard_s > self._beat_s and now_s - self._beat_s >= BEAT_S:
                self._beat_s, heard_ns = now_s, round(there.heard_s * 1e9)
                self.lease = self._register.change(lambda lease, now_ns: seen(lease, there.party, now_ns, heard_ns))
            asking = {each.party.id for each in self.lease.asking}
            asked = {each.party.id: round(each.heard_s * 1e9) for each in sessions if each.party.id in asking}
            if asked and now_s - self._asked_s >= BEAT_S:
                self._asked_s = now_s
                self.lease = self._register.change(lambda lease, now_ns: still_asks(lease, asked, now_ns))
        facts = self.facts()
        if facts == self._sent_facts:
            return None
        self._sent_facts = facts
        return facts

    def _forgive(self, now_s: float) -> None:
        """Let nobody lose the hand for a moment in which this server itself stood still, if nobody else took it."""
        stood_s, self._looked_s = now_s - self._looked_s, now_s
        own = next((each for each in self._sessions if self.has(each)), None)
        if stood_s > 2.0 * BEAT_S and own is not None:
            with contextlib.suppress(RigError):
                self.lease = self._register.change(lambda lease, now_ns: stood_still(lease, own.party, now_ns))

    def facts(self) -> dict[str, Any]:
        """Return what pages are told of the lease."""
        holder = self.lease.holder
        return {
            "number": self.lease.number,
            "holder": "" if holder is None else holder.id,
            "label": "" if holder is None else holder.label,
            "what": "" if holder is None else holder.what,
            "kept": self.lease.kept,
            "asking": [[each.party.id, each.party.label] for each in self.lease.asking],
        }

    def _looked(self) -> Lease:
        """Return the lease as it is now; that the tip was withdrawn under it counts, also where it cannot be kept."""
        lease = self._register.look()
        return lease._replace(withdraw=False) if lease.number == self._withdrawn else lease

    def note_withdrawn(self, number: int) -> None:
        """Note that the tip was withdrawn after the holder had vanished, as the lease of this number says."""
        self._withdrawn = number
        with contextlib.suppress(RigError):
            self.lease = self._register.change(partial(withdrawn, number=number))

    def is_to_withdraw(self) -> bool:
        """Return whether the tip is to be withdrawn, as the lease is now: not any more once somebody else has it."""
        with contextlib.suppress(RigError):
            self.lease = self._looked()
        return self.lease.withdraw

    def _change(self, session: Session, step: Step) -> None:
        self._forgive(self._clock())
        try:
            self.lease = self._register.change(step)
        except RefusedError as error:
            self.refused.note("lease", f"{session.party.label}: {error}")
            raise
