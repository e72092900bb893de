"""The loop of a process of several nodes: one wait for all sockets and deadlines, and one order of the nodes' turns."""

import contextlib
import os
import select
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import NamedTuple

from telenano.runtime.bus.bus import Reader
from telenano.runtime.loop.hang_guard import HangGuard
from telenano.runtime.loop.node import Node
from telenano.runtime.loop.node_loop import NodeLoop
from telenano.runtime.loop.turn_limit import TurnLimit
from telenano.runtime.site.shared_tasks import SharedTasks
from telenano.runtime.site.site_bus import Exchange, SiteBus
from telenano.timing.clock import NEVER_NS, Clock
from telenano.wire.nodes import DEVICES, HAND, STOP_ORDER
from telenano.wire.received import Received

# After one of these messages the longest idle gap of a tick begins, because the tick is at the other site or over; the
# single one applies to a process without the hand.
_IDLE_AFTER = {(HAND, "haptic/command"), ("controller@slave", "afm/state")}
_IDLE_WITHOUT_HAND = ("controller@master", "teleop/backward")
# After this number of turns for messages in memory alone, the sockets are checked again.
_MOST_TURNS = 64
# Bytes read at once from the wake descriptor; each signal writes one byte, and fewer than this number will wait.
_MOST_SIGNALS = 64


class Member(NamedTuple):
    """A node of the process, with its bus and its loop."""

    key: str
    node: Node
    bus: SiteBus
    loop: NodeLoop

    def due_ns(self) -> int:
        """Return the time of its next turn without a message, on the monotonic clock [ns]."""
        return min(self.node.deadline_ns(), self.loop.health_due_ns, self.bus.due_ns)


class SiteLoop:
    """The loop of the nodes of a process.

    Args:
        keys: The nodes.
        clock: The clock of the process.
        exchange: Passes messages between the nodes in memory.
        tell: Writes an error to the log of the process.
    """

    def __init__(self, keys: Collection[str], clock: Clock, exchange: Exchange, tell: Callable[[str], None]) -> None:
        self.exchange = exchange
        self.tasks = SharedTasks(clock)
        self.members: dict[str, Member] = {}
        self._idle_after = _IDLE_AFTER if HAND in keys else {*_IDLE_AFTER, _IDLE_WITHOUT_HAND}
        self._monotonic_ns = clock.monotonic_ns
        self._limit = TurnLimit(lambda: self._at, tell)
        # The node that takes its turn now, and whether a message received in this turn begins the idle gap.
        self._at = ""
        self._was_last = self._is_signalled = False
        self._order: list[Member] = []
        self._descriptors: list[int] = []
        self._owner: dict[int, Member] = {}
        self._sockets: list[tuple[Reader, SiteBus]] = []
        self._readable: Sequence[int] = ()
        self._wake = -1

    def open(self, members: Iterable[Member], wake_descriptor: int) -> None:
        """Add the nodes, whose buses are open."""
        self.members = {member.key: member for member in members}
        # Devices come first: a tick of the hand precedes messages that sockets have received meanwhile.
        self._order = sorted(self.members.values(), key=lambda member: member.key not in DEVICES)
        self._owner = {number: member for member in self._order for number in member.bus.descriptors}
        self._sockets = [(socket, member.bus) for member in self._order for socket in member.bus.sockets]
        self._descriptors, self._wake = [*self._owner, wake_descriptor], wake_descriptor
        for member in self._order:
            member.bus.has_arrived_anywhere = self.has_arrived

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The nodes of the process."""
        return tuple(member.node for member in self._order)

    def note_received(self, key: str, received: Sequence[Received]) -> None:
        """Note the messages that a node has received: for the begin of the idle gap, and for the exchange."""
        self._was_last |= (key, received[-1].topic) in self._idle_after
        self.exchange.note_received(key, received)

    def note_signal(self) -> None:
        """Make every node take its next turn at once; called within the handler of a signal."""
        self._is_signalled = True

    def has_arrived(self) -> bool:
        """Return whether messages may have arrived since the last wait, in memory or at a socket."""
        self._readable, _, _ = select.select(self._descriptors, (), (), 0)
        return bool(self.exchange.pending or self._readable)

    def run(self, guard: HangGuard) -> None:
        """Run until the stop of a node is requested; then make every node safe, also after an error."""
        members = self.members.values()
        with guard:
            try:
                while not any(member.node.context.stop_requested for member in members):
                    self.turn()
            # Code of a package may raise SystemExit.
            except (Exception, SystemExit) as error:
                self.members[self._at or next(iter(self.members))].loop.report_failure(error)
                raise
            finally:
                # Each node ends separately, so that the failure of one does not keep another from being made safe.
                with contextlib.ExitStack() as ends:
                    for key in reversed([key for key in STOP_ORDER if key in self.members]):
                        ends.callback(self.members[key].loop.end)

    def turn(self) -> None:
        """Wait for messages or deadlines; let every node concerned take its turn, and then nodes with new messages."""
        readable = self._wait()
        self._limit.begin()
        try:
            self._take_turns(readable)
            if self.tasks.due_ns < NEVER_NS:
                self._run_deferred()
        finally:
            self._limit.end()

    def _take_turns(self, readable: Sequence[int]) -> None:
        woken_ns, pending = self._monotonic_ns(), self.exchange.pending
        all_wake, self._is_signalled = self._is_signalled, False
        for number in readable:
            if number in self._owner:
                self._owner[number].bus.wake(number)
            else:
                # A signal may stand for an emergency stop.
                all_wake = True
                with contextlib.suppress(BlockingIOError):
                    os.read(number, _MOST_SIGNALS)
        for socket, bus in self._sockets:
            if not socket.drained:
                bus.wake(socket.descriptor)
        self._was_last = is_event = False
        for member in self._order:
            if all_wake or member.bus.asked or member.due_ns() <= woken_ns:
                is_event = True
                self.take(member)
        for _ in range(_MOST_TURNS):
            if not pending:
                break
            self.take(self.members[pending.popleft()])
        if is_event:
            self.tasks.note_event(woken_ns, self._monotonic_ns(), is_last=self._was_last)

    def take(self, member: Member) -> None:
        """Let a node take a turn."""
        self._at = member.key
        member.loop.turn_now()

    def _next_ns(self) -> int:
        """Return the time of the next turn of any node without a message, on the monotonic clock [ns]."""
        return min(member.due_ns() for member in self._order)

    def _wait(self) -> Sequence[int]:
        if self._readable:
            readable, self._readable = self._readable, ()
            return readable
        remaining_ns, has_more = 0, self._is_signalled or bool(self.exchange.pending)
        if not has_more and all([socket.drained for socket, _ in self._sockets]):
            remaining_ns = max(0, min(self._next_ns(), self.tasks.due_ns) - self._monotonic_ns())
        readable, _, _ = select.select(self._descriptors, (), (), remaining_ns * 1e-9)
        return readable

    def _run_deferred(self) -> None:
        """Run the deferred tasks that are due, until a message is passed in memory."""
        while not self.exchange.pending and (now_ns := self._monotonic_ns()) >= self.tasks.due_ns:
            if (task := self.tasks.take(now_ns, self._next_ns())) is not None:
                self._at = self.tasks.owners[task.run]
                self.members[self._at].loop.run_task(task)
                # Each task has the time limit of a turn.
                self._limit.begin()


class SharedGuard(HangGuard):
    """The limit of processor time of a process of several nodes: it restarts when every node has reported.

    The report of one node does not show that the others are alive.
    """

    def __init__(self, keys: Collection[str]) -> None:
        self._keys = tuple(keys)
        self._waiting = set(keys)

    def note(self, key: str) -> None:
        """Note the report of a node."""
        self._waiting.discard(key)
        if not self._waiting:
            self._waiting.update(self._keys)
            self.renew()
