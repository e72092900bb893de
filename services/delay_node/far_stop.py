"""The emergency stop that the link keeps for the instrument until the instrument has obeyed it (ADR 0059).

While a stop is kept it is sent again and again, and neither a sample of the hand nor a command that begins a motion
passes the link. So it does not matter whether the network has lost the stop, when it is back, and what arrives first.
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

# A copy has a time of its own, because a reader drops what looks like a repetition, and the number after that of the
# newest message of this sender that the link has sent on, so that a reader misses none.
_SENDER = "estop@master"
# An instrument that has not answered this number of copies cannot be reached.
_UNREACHED = 5


class FarStopState(msgspec.Struct, array_like=True):
    """The stop that is kept, as it was sent, empty for none; its copies, when the next is due [ns]; last id obeyed.

    number: that of the newest message of the sender of copies, -1 before it.
    """

    payload: bytes = b""
    copies: int = 0
    due_ns: int = NEVER_NS
    obeyed: str = ""
    number: int = -1


class FarStop:
    """The newest emergency stop for the instrument that has passed the link and is not obeyed yet."""

    def __init__(self, path: Path | None, state: FarStopState) -> None:
        """Begin with a state and work on it; `path` is the file in which a stop outlasts this process, None for none.

        Raises:
            ValueError: What the state keeps is no stop.
        """
        self._path = path
        self.restore(state)

    def restore(self, state: FarStopState) -> None:
        """Continue from a state and work on it.

        Raises:
            ValueError: What it keeps is no stop.
        """
        stop = accept("session/control", state.payload) if state.payload else None
        self._state = state
        self._stop: SessionControl | None = stop if isinstance(stop, SessionControl) else None

    @property
    def identifier(self) -> str:
        """The id of the stop that is kept, empty for none."""
        return "" if self._stop is None else self._stop.id

    def knows(self, identifier: str) -> bool:
        """Return whether a stop of this id is kept, or was obeyed: then nothing has to be kept in the file."""
        if identifier == self._state.obeyed and self._stop is None and self._path is not None:
            kept_stop.forget(self._path)
        return identifier in (self.identifier, self._state.obeyed)

    @property
    def due_ns(self) -> int:
        """When the next copy is due, on the monotonic clock [ns]."""
        return self._state.due_ns

    @property
    def is_unreached(self) -> bool:
        """Whether the instrument has not answered for so long that it cannot be reached."""
        return self._state.copies >= _UNREACHED

    def record(self, control: SessionControl, payload: bytes, now_ns: int) -> str:
        """Keep a stop that means the instrument; return why it does not outlast this process, empty where it does.

        Args:
            control: The stop.
            payload: The same as it was sent.
            now_ns: The monotonic time [ns].
        """
        if control.src == _SENDER:
            self._state.number = control.seq
        if not is_meant(TIP, control.target) or control.id == self._state.obeyed:
            return ""
        if control.id == self.identifier:
            # its sender still repeats it
            self._state.due_ns = now_ns + RESEND_NS
            return ""
        self._stop = control
        self._state.payload, self._state.copies, self._state.due_ns = payload, 0, now_ns + RESEND_NS
        return "" if self._path is None else kept_stop.keep(self._path, payload)

    def note_event(self, event: SessionEvent) -> bool:
        """Return whether an event is the first word of the instrument that it has obeyed the stop that is kept."""
        is_answer = self._stop is not None and event.src == TIP and event.kind == "ack" and event.id == self._stop.id
        if is_answer:
            state, self._stop = self._state, None
            state.payload, state.copies, state.due_ns, state.obeyed = b"", 0, NEVER_NS, event.id
            if self._path is not None:
                kept_stop.forget(self._path)
        return is_answer

    def holds_back(self, message: Message) -> bool:
        """Return whether a message has to wait until the stop is obeyed: a sample of the hand, or a wish to move."""
        if self._stop is None:
            return False
        if type(message) is SessionControl:
            return begins_motion(message.command, message.parameters) and is_meant(TIP, message.target)
        return True

    def copy(self, now_ns: int, t_ns: int) -> bytes | None:
        """Return the copy of the stop that is due now; None where none is.

        Args:
            now_ns: The monotonic time [ns].
            t_ns: The same time on the clock of the stamps [ns].
        """
        if self._stop is None or now_ns < self._state.due_ns:
            return None
        self._state.copies += 1
        self._state.number += 1
        self._state.due_ns = now_ns + RESEND_NS
        return encode(msgspec.structs.replace(self._stop, src=_SENDER, seq=self._state.number, t_ns=t_ns))
