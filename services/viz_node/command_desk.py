"""The queue of commands from pages: one at a time, refused if old, and cancelled by an emergency stop."""

import asyncio
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, wait
from functools import partial
from typing import Protocol

from services.viz_node.page_hand import TICK_S
from services.viz_node.page_session import Session
from services.viz_node.page_threads import in_thread
from services.viz_node.requests import CommandRequest
from telenano.console.lease import FREE_COMMANDS
from telenano.wire.errors import RefusedError
from telenano.wire.messages import Scalar

# Most waiting commands of one page, including the one that is being carried out.
MOST_COMMANDS = 4
# Time for which a command is valid, as for a session/control (ADR 0014); a page may send it again [s].
VALIDITY_S = 1.0
# Most simultaneous emergency stops. A key that is held down requests thirty per second, and each may take seconds if a
# device does not answer.
_MOST_STOPS = 4
# Time for which the end of the page waits for stops under way, each of which gives up after 5 s [s].
_STOPS_END_S = 6.0
# This command is obeyed at any age, and even after its page has closed, because it only ends a motion.
_STOP = "stop"
_ARM = "arm"

Answers = Mapping[str, tuple[str, str]]


class Commander(Protocol):
    """Sends the commands of pages to the rig. The methods block, so they are called in threads."""

    def send(
        self,
        command: str,
        target: str,
        parameters: Mapping[str, Scalar],
        is_wanted: Callable[[], bool],
        issued_ns: int,
        by: str,
    ) -> Answers:
        """Send a command; return for each node `ack` or `refused` and a sentence; raise TelenanoError if that fails.

        The command is not repeated once `is_wanted` returns false. An emergency stop after `issued_ns`, on the
        monotonic clock [ns], cancels it. `by` is the name of the person who gave it, or empty.
        """

    def estop(self, by: str) -> Answers:
        """Stop the devices at once; return for each device a kind of `telenano.console.answers` and a sentence."""


class PageCommand:
    """A command of a page, from its arrival to its answer; an emergency stop or the end of its page cancels it."""

    def __init__(self, session: Session, request: CommandRequest, arrived_s: float) -> None:
        self.session, self.request, self.arrived_s = session, request, arrived_s
        self.reason = ""
        self.needs_lease = request.command not in FREE_COMMANDS
        # Whether it sends the tip to a place; any other command ends that motion.
        self.goes = request.command == _ARM and bool(request.parameters)
        self._is_void = threading.Event()

    def make_void(self, reason: str) -> None:
        """Cancel the command, whether it waits or is being sent, unless it only ends a motion."""
        if self.request.command != _STOP:
            self.reason = f"{self.request.command} was cancelled: {reason}"
            self._is_void.set()

    def is_wanted(self) -> bool:
        return not self._is_void.is_set()

    def check(self, now_s: float) -> None:
        """Raise RefusedError if the command was cancelled, or is no longer valid."""
        if not self.is_wanted():
            raise RefusedError(self.reason)
        waited_s = now_s - self.arrived_s
        if self.request.command != _STOP and waited_s > VALIDITY_S:
            text = f"it waited for {waited_s:.1f} s behind other commands and was valid for {VALIDITY_S:.1f} s"
            raise RefusedError(f"{self.request.command} expired: {text}")


class CommandDesk:
    """Sends the commands of pages, one at a time, and emergency stops without waiting for these."""

    def __init__(self, commander: Commander | None) -> None:
        """Prepare to send through a commander; None if there is nothing to command."""
        self.commander = commander
        self.wishes: list[PageCommand] = []
        self._turn = asyncio.Lock()
        self._stops: set[Future[Answers]] = set()
        self._next_stop: asyncio.Task[Answers] | None = None
        # Time at which this process last ran [s]; length of its last standstill, and until when commands are refused
        # because of it [s].
        self._alive_s: float | None = None
        self._held_up_s = self._distrust_until_s = 0.0

    def waiting(self, session: Session) -> int:
        """Return the number of commands of a page that wait or are being sent."""
        return sum(wish.session is session for wish in self.wishes)

    def make_void(self, reason: str, is_meant: Callable[[PageCommand], bool] = lambda wish: True) -> None:
        """Cancel the commands for which `is_meant` is true, by default all."""
        for wish in self.wishes:
            if is_meant(wish):
                wish.make_void(reason)

    def check_arrival(self, session: Session, command: str) -> None:
        """Raise RefusedError for a command that must not enter the queue.

        The page has too many waiting commands, an emergency stop is being sent, or this process stood still, so that
        the age of the command is unknown. `stop` is refused only for the first reason.
        """
        if (waiting := self.waiting(session)) >= MOST_COMMANDS:
            raise RefusedError(
                f"{command} was not sent: {waiting} commands of this page wait already, which is the most allowed"
            )
        if command == _STOP:
            return
        if self._stops:
            raise RefusedError(f"{command} was not sent: an emergency stop is being sent, wait for its answer")
        now_s = time.monotonic()
        self.note_alive(now_s)
        if now_s < self._distrust_until_s:
            raise RefusedError(
                f"{command} cannot be shown to be fresh: the view was held up for {self._held_up_s:.1f} s, "
                "during which it may have waited: send it again"
            )

    async def send(self, wish: PageCommand) -> Answers:
        """Send a command in its turn, unless it is cancelled or too old by then; return the answers of the nodes.

        Raises:
            TelenanoError: The command was not sent, or not obeyed; the message has the reason.
        """
        assert self.commander is not None
        self.make_void("another command came after it", lambda other: other.goes)
        self.wishes.append(wish)
        try:
            async with self._turn:
                wish.check(time.monotonic())
                request, arrived_ns = wish.request, round(wish.arrived_s * 1e9)
                names = request.command, request.target, request.parameters
                send = partial(self.commander.send, *names, wish.is_wanted, arrived_ns, wish.session.party.name)
                return await asyncio.wrap_future(in_thread(send))
        finally:
            self.wishes.remove(wish)

    async def stop(self, by: str) -> Answers:
        """Stop the devices at once, and cancel every other command of every page; return the answers of the nodes."""
        self.make_void("an emergency stop came after it")
        if len(self._stops) < _MOST_STOPS:
            return await self._stop_now(by)
        if self._next_stop is None:
            self._next_stop = asyncio.create_task(self._stop_next(by))
        # Requests that come meanwhile share this stop, because it has not begun.
        return await asyncio.shield(self._next_stop)

    async def _stop_next(self, by: str) -> Answers:
        while len(self._stops) >= _MOST_STOPS:
            await asyncio.sleep(TICK_S)
        self._next_stop = None
        return await self._stop_now(by)

    async def _stop_now(self, by: str) -> Answers:
        assert self.commander is not None
        stop = in_thread(partial(self.commander.estop, by))
        self._stops.add(stop)
        stop.add_done_callback(self._stops.discard)
        return await asyncio.wrap_future(stop)

    def note_alive(self, now_s: float) -> None:
        """Detect a standstill of this process: commands that waited during it seem to arrive only now."""
        if self._alive_s is not None and now_s - self._alive_s > VALIDITY_S:
            self._held_up_s, self._distrust_until_s = now_s - self._alive_s, now_s + VALIDITY_S
        self._alive_s = now_s

    def close(self) -> None:
        """Wait for the emergency stops under way, at most `_STOPS_END_S`."""
        wait(self._stops.copy(), _STOPS_END_S)
