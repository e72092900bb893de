"""The emergency stop that the link keeps for the instrument until the instrument has obeyed it (ADR 0059).

While a stop is kept, the link sends it repeatedly, and blocks samples of the hand and commands that start a motion. So
it does not matter whether the network lost the stop, when it recovers, and which message arrives first.
"""

from pathlib import Path

import msgspec

from telenano.runtime.loop import kept_stop
from telenano.runtime.loop.commands import RESEND_NS
from telenano.runtime.loop.estop_latch import begins_motion
from telenano.timing.clock import NEVER_NS
from telenano.wire import encode
from telenano.wire.codec import accept
from telenano.wire.messages import Message, SessionControl, SessionEvent
from telenano.wire.nodes import TIP, is_meant

# Sender of the copies. A copy has a new time, because a reader drops repetitions, and the number after that of the
# newest message of this sender that the link has sent on, so that a reader sees no gap.
_SENDER = "estop@master"
# An instrument that has not answered this number of copies counts as unreachable.
_UNREACHED = 5


class FarStopState(msgspec.Struct, array_like=True):
    """The state of the kept stop.

    payload: the stop as it was sent, empty if none is kept; copies: number of copies sent; due_ns: time of the next one
    [ns]; obeyed: id of the last stop obeyed; number: that of the newest message of the copies' sender, -1 before it.
    """

    payload: bytes = b""
    copies: int = 0
    due_ns: int = NEVER_NS
    obeyed: str = ""
    number: int = -1


class FarStop:
    """Keeps the newest emergency stop for the instrument that has passed the link and is not obeyed yet."""

    def __init__(self, path: Path | None, state: FarStopState) -> None:
        """Start with a state, which is changed in place; in the file `path`, if any, a stop outlasts this process.

        Raises:
            ValueError: The payload in the state is invalid, or is no emergency stop.
        """
        self._path = path
        self.restore(state)

    def restore(self, state: FarStopState) -> None:
        """Continue from a state, which is changed in place.

        Raises:
            ValueError: The payload in the state is invalid, or is no emergency stop.
        """
        stop = accept("session/control", state.payload) if state.payload else None
        if stop is not None and not (isinstance(stop, SessionControl) and stop.command == "estop"):
            raise ValueError(f"the kept stop is no emergency stop: {stop}")
        self._state = state
        self._stop: SessionControl | None = stop

    @property
    def identifier(self) -> str:
        """The id of the kept stop; empty if there is none."""
        return "" if self._stop is None else self._stop.id

    def knows(self, identifier: str) -> bool:
        """Return whether a stop of this id is kept, or was the last one obeyed; in that case, remove its file."""
        if identifier == self._state.obeyed and self._stop is None and self._path is not None:
            kept_stop.forget(self._path)
        return identifier in (self.identifier, self._state.obeyed)

    @property
    def due_ns(self) -> int:
        """Time at which the next copy is due, on the monotonic clock [ns]."""
        return self._state.due_ns

    @property
    def is_unreached(self) -> bool:
        """Whether the instrument has left so many copies unanswered that it counts as unreachable."""
        return self._state.copies >= _UNREACHED

    def record(self, control: SessionControl, payload: bytes, now_ns: int) -> str:
        """Keep a stop that targets the instrument; return the reason why it could not be stored in the file, or "".

        Args:
            control: The stop.
            payload: The encoded message of the stop.
            now_ns: The monotonic time [ns].
        """
        if control.src == _SENDER:
            self._state.number = control.seq
        if not is_meant(TIP, control.target) or control.id == self._state.obeyed:
            return ""
        if control.id == self.identifier:
            # Its sender still repeats it, so a copy can wait.
            self._state.due_ns = now_ns + RESEND_NS
            return ""
        self._stop = control
        self._state.payload, self._state.copies, self._state.due_ns = payload, 0, now_ns + RESEND_NS
        return "" if self._path is None else kept_stop.keep(self._path, payload)

    def note_event(self, event: SessionEvent) -> bool:
        """Return whether an event acknowledges the kept stop; if so, forget the stop."""
        is_answer = self._stop is not None and event.src == TIP and event.kind == "ack" and event.id == self._stop.id
        if is_answer:
            state, self._stop = self._state, None
            state.payload, state.copies, state.due_ns, state.obeyed = b"", 0, NEVER_NS, event.id
            if self._path is not None:
                kept_stop.forget(self._path)
        return is_answer

    def holds_back(self, message: Message) -> bool:
        """Return whether the kept stop blocks a message: a sample of the hand, or a command that starts a motion."""
        if self._stop is None:
            return False
        if type(message) is SessionControl:
            return begins_motion(message.command, message.parameters) and is_meant(TIP, message.target)
        return True

    def copy(self, now_ns: int, t_ns: int) -> bytes | None:
        """Return the encoded copy of the stop that is due now, or None.

        Args:
            now_ns: The monotonic time [ns].
            t_ns: The same time on the clock of the time stamps [ns].
        """
        if self._stop is None or now_ns < self._state.due_ns:
            return None
        self._state.copies += 1
        self._state.number += 1
        self._state.due_ns = now_ns + RESEND_NS
        return encode(msgspec.structs.replace(self._stop, src=_SENDER, seq=self._state.number, t_ns=t_ns))
