"""The lease of control for the pages of a server: carries out their requests, checks their rights, and informs them."""

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
    heard,
    let_go,
    stood_still,
    take,
    withdrawn,
)
from telenano.console.lease_register import LeaseRegister, Step
from telenano.recording.messages import LeftOut
from telenano.wire.errors import RefusedError, RigError


class OwnRegister:
    """Stores the lease of pages that share it with no other process, such as those of a recording."""

    def __init__(self, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._lease, self._now_ns = Lease(), now_ns

    def look(self) -> Lease:
        return self.change(current)

    def change(self, step: Step) -> Lease:
        self._lease = step(self._lease, self._now_ns())
        return self._lease


class LeaseDesk:
    """Applies the lease to the requests of pages.

    `lease`: the lease as last read; `refused`: the number of refusals, by reason.
    """

    def __init__(self, register: LeaseRegister | OwnRegister, clock: Callable[[], float] = time.monotonic) -> None:
        self.lease = Lease()
        self.refused = LeftOut()
        self._register = register
        self._sent_facts: Mapping[str, Any] = {}
        self._sessions: Collection[Session] = ()
        self._clock, self._looked_s = clock, clock()
        self._beat_s = 0.0
        self._withdrawn = -1

    def act(self, session: Session, number: int, *, presses: bool = False) -> None:
        """Let a page act under a number of the lease, 0 for none; raise RefusedError if another party has control."""
        self._change(session, lambda lease, now_ns: act(lease, session.party, now_ns, number, presses=presses))

    def ended(self, session: Session) -> None:
        """Record that an act of a page is over; the page then keeps control only if it has taken it."""
        self._change(session, lambda lease, now_ns: ended(lease, session.party, now_ns))

    def ask_for(self, session: Session, request: LeaseRequest) -> str:
        """Carry out a page's request for the lease; return the result as a sentence, or raise RefusedError."""
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
        """Release control for a page whose connection has ended; if it pressed, its holder counts as vanished."""
        with contextlib.suppress(RefusedError, RigError):
            self._change(session, lambda lease, now_ns: let_go(lease, session.party, now_ns, vanished=True))

    def has(self, session: Session) -> bool:
        """Return whether a page has control, by the lease as last read."""
        return self.lease.is_held_by(session.party)

    def may_press(self, session: Session) -> bool:
        """Return whether the force of a page may still be published, by the lease as last read."""
        holder = self.lease.holder
        is_participant = session.party.role == "participant" and holder is not None and holder.what == EXPERIMENT
        return self.has(session) or is_participant

    def tick(self, sessions: Collection[Session], now_s: float) -> Mapping[str, Any] | None:
        """Read the lease, report the presence of its holder, and return the facts for pages; None if unchanged."""
        self._sessions = sessions
        self._forgive(now_s)
        # If the file cannot be read, pages get no news, and their requests are refused with that reason.
        with contextlib.suppress(RigError):
            self.lease = self._looked()
            parties = {each.party.id for each in self.lease.asking}
            parties |= set() if self.lease.holder is None else {self.lease.holder.id}
            heard_ns = {each.party.id: round(each.heard_s * 1e9) for each in sessions if each.party.id in parties}
            if heard_ns and now_s - self._beat_s >= BEAT_S:
                self._beat_s = now_s
                self.lease = self._register.change(lambda lease, now_ns: heard(lease, heard_ns, now_ns))
        facts = self.facts()
        if facts == self._sent_facts:
            return None
        self._sent_facts = facts
        return facts

    def _forgive(self, now_s: float) -> None:
        """After a standstill of this server, let its page keep control unless another party has taken it."""
        stood_s, self._looked_s = now_s - self._looked_s, now_s
        own = next((each for each in self._sessions if self.has(each)), None)
        if stood_s > 2.0 * BEAT_S and own is not None:
            with contextlib.suppress(RigError):
                self.lease = self._register.change(lambda lease, now_ns: stood_still(lease, own.party, now_ns))

    def facts(self) -> dict[str, Any]:
        """Return the facts on the lease for pages."""
        holder = self.lease.holder
        return {
            "number": self.lease.number,
            "holder": "" if holder is None else holder.id,
            "label": "" if holder is None else holder.label,
            "what": "" if holder is None else holder.what,
            "kept": self.lease.kept,
            "asking": [[each.party.id, each.party.label] for each in self.lease.asking],
            "lost": list(self.lease.lost or ()),
        }

    def _looked(self) -> Lease:
        """Return the present lease, without the request to withdraw a tip that this server has withdrawn already."""
        lease = self._register.look()
        return lease._replace(withdraw=False) if lease.number == self._withdrawn else lease

    def note_withdrawn(self, number: int) -> None:
        """Record that the tip was withdrawn, as the lease of this number requested after its holder had vanished."""
        self._withdrawn = number
        with contextlib.suppress(RigError):
            self.lease = self._register.change(partial(withdrawn, number=number))

    def is_to_withdraw(self) -> bool:
        """Return whether the present lease requests to withdraw the tip; no longer if another party has control."""
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
