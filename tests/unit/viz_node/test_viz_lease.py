"""The lease as pages have it, in any order of what can happen, in virtual time: never two hands."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.viz_node.lease_desk import LeaseDesk, OwnRegister
from services.viz_node.page_session import Session
from services.viz_node.requests import LeaseRequest
from telenano.console.lease import ASKED_NS, CONSOLE, VANISHED_NS, Lease, Party, act, take
from telenano.serving.access import Role
from telenano.serving.people import Person
from telenano.wire.errors import RefusedError

TICK_NS, HERE_NS, WAY_NS = 33_000_000, 250_000_000, 40_000_000
PAGES = 4


@dataclass
class Page:
    """A page: what it was told, which comes late, and whether its computer stands still."""

    session: Session
    stalled: bool = False
    told: dict[str, Any] = field(default_factory=dict)
    way: list[tuple[int, dict[str, Any]]] = field(default_factory=list)
    presses: bool = False
    here_ns: int = 0

    @property
    def believes(self) -> bool:
        return self.told.get("holder") == self.session.party.id


class World:
    """Pages and one server, and an AFM that can be withdrawn. It is true after each step that one at most presses."""

    def __init__(self) -> None:
        self.now_ns = 10**9
        self.register = OwnRegister(lambda: self.now_ns)
        self.desk = self._desk()
        self.server_stalled = False
        self.serial = 0
        self.pages = [self._page() for _ in range(PAGES)]
        self.numbers: dict[int, str] = {}
        self.withdrawn: list[int] = []
        self.old: list[tuple[Session, int]] = []

    def _desk(self) -> LeaseDesk:
        return LeaseDesk(self.register, lambda: self.now_ns * 1e-9)

    def _page(self) -> Page:
        self.serial += 1
        session = Session(Role.OPERATOR, Person(f"person {self.serial}", "operator", "", 1e12))
        session.heard_s = self.now_ns * 1e-9
        return Page(session, told=self.desk.facts())

    def do(self, what: str, index: int) -> None:
        page = self.pages[index % len(self.pages)]
        if what == "stall":
            page.stalled = not page.stalled
        elif what == "vanish":
            self.desk.leave(page.session)
            self.pages[index % len(self.pages)] = self._page()
        elif what == "stall server":
            self.server_stalled = not self.server_stalled
        elif what == "restart server":
            # its pages connect again, as others, and what it knew is gone
            self.desk, self.server_stalled = self._desk(), False
            self.pages = [self._page() for _ in self.pages]
        elif what == "console takes":
            party = Party("console", what=CONSOLE)
            self.register.change(lambda lease, now_ns: take(lease, party, now_ns, from_anyone=True))
        elif what not in ("estop", "restart hand") and not page.stalled and not self.server_stalled:
            # an emergency stop, and a hand that is started anew, do not ask who has the lease
            self._ask(page, what)

    def _ask(self, page: Page, what: str) -> None:
        page.session.heard_s = self.now_ns * 1e-9
        number = page.told["number"] if page.believes else 0
        if number:
            self.old.append((page.session, number))
        try:
            if what == "press":
                self.desk.act(page.session, number, presses=True)
                page.presses = True
            elif what == "release":
                page.presses = False
                self.desk.ended(page.session)
            elif what == "replay" and self.old:
                self._replay()
            elif what in ("ask", "take", "hand_over", "let_go"):
                self.desk.ask_for(page.session, LeaseRequest("a", what, "", page.told["number"]))  # type: ignore[arg-type]
        except RefusedError:
            # a page that believes that it has the hand, and is refused, is about to be told that it has not
            is_sure = page.believes and self.desk.has(page.session) and number == self.lease.number
            assert what != "press" or not is_sure

    def _replay(self) -> None:
        """Send again what was said under an earlier lease, by who has the hand again and by another."""
        holder, number = self.lease.holder, self.lease.number
        again = [each for each in self.old if each[1] != number]
        own = [each for each in again if holder == each[0].party]
        for session, earlier in [*own[-1:], *again[-1:]]:
            step = partial(act, party=session.party, number=earlier)
            with pytest.raises(RefusedError):
                self.register.change(lambda lease, now_ns, step=step: step(lease, now_ns=now_ns))

    @property
    def lease(self) -> Lease:
        return self.register.look()

    def pass_time(self, ticks: int) -> None:
        for _ in range(ticks):
            self.now_ns += TICK_NS
            before = self.desk.lease
            if not self.server_stalled:
                for page in self.pages:
                    if not page.stalled and self.now_ns - page.here_ns >= HERE_NS:
                        page.here_ns, page.session.heard_s = self.now_ns, self.now_ns * 1e-9
                facts = self.desk.tick([page.session for page in self.pages], self.now_ns * 1e-9)
                for page in self.pages if facts is not None else ():
                    page.way.append((self.now_ns + WAY_NS, dict(facts or {})))
                if self.desk.lease.withdraw:
                    assert self.desk.lease.holder is None
                    self.withdrawn.append(self.now_ns)
                    self.desk.note_withdrawn(self.desk.lease.number)
                for page in self.pages:
                    page.presses = page.presses and self.desk.has(page.session)
            for page in self.pages:
                while page.way and not page.stalled and page.way[0][0] <= self.now_ns:
                    page.told = page.way.pop(0)[1]
            self.check(before)

    def check(self, before: Lease) -> None:
        lease = self.lease
        allowed = [page for page in self.pages if self.desk.may_press(page.session)]
        assert len(allowed) <= 1
        # what a server that runs lets press is what has the lease
        if not self.server_stalled:
            assert all(lease.holder == page.session.party for page in allowed)
        # a number never stands for two holders, and none comes again
        holder = lease.holder.id if lease.holder else ""
        assert self.numbers.setdefault(lease.number, holder) == holder
        assert lease.number == max(self.numbers)


ACTIONS = (
    "ask", "take", "hand_over", "let_go", "press", "release", "replay", "estop", "stall", "vanish", "stall server",
    "restart server", "restart hand", "console takes",
)  # fmt: skip
STEPS = st.tuples(st.sampled_from(ACTIONS), st.integers(0, 3), st.sampled_from((0, 1, 2, 9, 35)))
ORDERS = st.lists(STEPS, max_size=40)


@given(ORDERS)
def test_no_order_of_events_gives_two_hands_or_one_that_only_the_page_believes_in(orders: Any) -> None:
    world = World()
    for what, index, ticks in orders:
        world.do(what, index)
        world.pass_time(ticks)
    # once all stand up again and have been told, each page knows what is so
    world.server_stalled = False
    for page in world.pages:
        page.stalled = False
    world.pass_time(3 + (VANISHED_NS + WAY_NS) // TICK_NS)
    for page in world.pages:
        assert page.believes == (world.lease.holder == page.session.party)
    assert not world.lease.withdraw


@given(ORDERS, st.integers(0, 3), st.booleans())
def test_who_vanishes_has_lost_it_within_a_second_and_a_pressed_tip_is_withdrawn(
    orders: Any, index: int, kill: bool
) -> None:
    world = World()
    for what, other, ticks in orders:
        world.do(what, other)
        world.pass_time(ticks)
    world.server_stalled = False
    page = world.pages[index]
    page.stalled = False
    world.pass_time(40)
    world.do("take", index)
    world.pass_time(3)
    if world.lease.holder != page.session.party:
        # a page takes nothing from others
        return
    world.do("press", index)
    assert world.lease.presses
    party, begun_ns, before = page.session.party, world.now_ns, len(world.withdrawn)
    world.do("vanish" if kill else "stall", index)
    world.pass_time(2 + (VANISHED_NS + HERE_NS) // TICK_NS)
    assert world.lease.holder != party
    assert len(world.withdrawn) == before + 1
    assert world.withdrawn[-1] - begun_ns <= VANISHED_NS + HERE_NS + 2 * TICK_NS


def test_pages_that_ask_are_shown_for_as_long_as_they_are_open_and_not_after_a_kill_of_the_server() -> None:
    world = World()
    first, others = world.pages[0], world.pages[1:3]
    world.do("take", 0)
    for index in (1, 2):
        world.do("ask", index)
    # longer than who asks may be silent
    world.pass_time(round(2 * ASKED_NS / TICK_NS))
    assert [each[0] for each in world.desk.facts()["asking"]] == [page.session.party.id for page in others]
    assert world.desk.has(first.session)
    others[0].stalled = True
    world.pass_time(round(1.5 * ASKED_NS / TICK_NS))
    assert [each[0] for each in world.desk.facts()["asking"]] == [others[1].session.party.id]
    # a server that was killed has said of none of its pages that they have left
    world.do("restart server", 0)
    world.pass_time(round(1.5 * ASKED_NS / TICK_NS))
    assert world.desk.facts()["asking"] == []


def test_the_end_of_a_withdrawal_leaves_that_of_a_later_holder_to_be_done() -> None:
    world = World()
    numbers = []
    # a page, and while the stop is on its way another one
    for index in (0, 3):
        world.do("take", index)
        world.desk.act(world.pages[index].session, world.lease.number, presses=True)
        world.desk.leave(world.pages[index].session)
        assert world.desk.is_to_withdraw()
        numbers.append(world.desk.lease.number)
    world.desk.note_withdrawn(numbers[0])
    assert world.desk.is_to_withdraw()
    # a holder who vanishes in the moment in which a withdrawal ends
    world.do("take", 0)
    world.desk.act(world.pages[0].session, world.lease.number, presses=True)
    world.now_ns += VANISHED_NS + 1
    world.desk.note_withdrawn(numbers[1])
    assert world.desk.is_to_withdraw()
    world.desk.note_withdrawn(world.desk.lease.number)
    assert not world.desk.is_to_withdraw()


# Two windows, A and B: what happens in turn, and who has control then. In each order B asks for it.
ORDERS_OF_TWO = {
    "A hands over": [("take", 0), ("ask", 1), ("hand_over", 0)],
    "A gives it up": [("take", 0), ("ask", 1), ("let_go", 0)],
    "A holds it for an act that ends": [("press", 0), ("ask", 1), ("release", 0)],
    "A is closed": [("take", 0), ("ask", 1), ("vanish", 0)],
    "A falls silent while it presses": [("take", 0), ("press", 0), ("ask", 1), ("stall", 0)],
    "B is loaded again and asks again": [("take", 0), ("ask", 1), ("vanish", 1), ("ask", 1), ("hand_over", 0)],
}


@pytest.mark.parametrize("name", ORDERS_OF_TWO)
def test_handing_over_between_two_windows_works_in_each_order_and_back_again(name: str) -> None:
    world = World()
    for what, index in ORDERS_OF_TWO[name]:
        world.pass_time(3)
        world.do(what, index)
    world.pass_time(3 + (VANISHED_NS + HERE_NS) // TICK_NS)
    first, second = world.pages[:2]
    assert world.desk.has(second.session) and second.believes and not first.presses
    # A page that fell silent while it pressed has its tip withdrawn, and no other has.
    assert len(world.withdrawn) == ("while it presses" in name)
    # A comes back, presses nothing, and is given control again.
    first.stalled = False
    world.pass_time(5)
    with pytest.raises(RefusedError):
        world.desk.act(first.session, 0, presses=True)
    for what, index in (("ask", 0), ("hand_over", 1)):
        world.do(what, index)
        world.pass_time(3)
    assert world.desk.has(first.session) and first.believes and not second.believes
