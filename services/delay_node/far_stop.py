"""The emergency stop that the link keeps for the device at the other site until that has obeyed it (ADR 0059).

While a stop for the instrument is kept, the link sends it repeatedly, and blocks samples of the hand and commands that
start a motion. So it does not matter whether the network lost the stop, when it recovers, and which message arrives
first.

A stop that was given at the instrument's site crosses in the instrument's answer, because senders there have no
connection to the link: the answer repeats the command with its target. If the target includes the hand, the link sends
the stop to the hand until the hand has obeyed it, unless it already has.
"""

from pathlib import Path

import msgspec

from telenano.runtime.loop import kept_stop
from telenano.runtime.loop.commands import RESEND_NS
from telenano.runtime.loop.estop_latch import begins_motion
from telenano.timing.clock import NEVER_NS
from telenano.wire import encode
from telenano.wire.answers import read_answer
from telenano.wire.codec import accept, fields_of
from telenano.wire.messages import Message, SessionControl, SessionEvent
from telenano.wire.nodes import HAND, TIP, is_meant, site_of

# Sender of the copies, the estop of the site from which the stop comes. A copy has a new time, because a reader drops
# repetitions, and the number after that of the newest message of this sender that the link has sent on, so that a
# reader sees no gap.
_SENDERS = {TIP: "estop@master", HAND: "estop@slave"}
# A device that has not answered this number of copies counts as unreachable.
_UNREACHED = 5
# Number of stops that are remembered as obeyed. The instrument may answer a stop again, long after a person has armed
# the hand, which must not stop the hand once more.
_REMEMBERED = 16


class FarStopState(msgspec.Struct, array_like=True):
    """The state of the kept stop.

    payload: the stop as it was sent, empty if none is kept; copies: number of copies sent; due_ns: time of the next one
    [ns]; obeyed: id of the last stop obeyed; number: that of the newest message of the copies' sender, -1 before it;
    answered: ids of the newest stops that the device has acknowledged, by whatever way they came to it.
    """

    payload: bytes = b""
    copies: int = 0
    due_ns: int = NEVER_NS
    obeyed: str = ""
    number: int = -1
    answered: tuple[str, ...] = ()


def stop_in_answer(event: SessionEvent) -> SessionControl | None:
    """Return the emergency stop that an acknowledgement repeats; None for any other event."""
    if event.kind != "ack" or event.data.get("command") != "estop":
        return None
    answered = read_answer(fields_of(event))
    if answered is None:
        return None
    return SessionControl(
        seq=0, t_ns=event.t_ns, src=f"estop@{site_of(event.src)}", v=SessionControl.version, id=event.id,
        command="estop", target=answered.target, parameters={}, by=answered.by or None,
    )  # fmt: skip


class FarStop:
    """Keeps the newest emergency stop for a device that has passed the link and is not obeyed yet."""

    def __init__(self, path: Path | None, state: FarStopState, device: str = TIP) -> None:
        """Start with a state, which is changed in place; in the file `path`, if any, a stop outlasts this process.

        `device` is the device that has to obey the stop.

        Raises:
            ValueError: The payload in the state is invalid, or is no emergency stop.
        """
        self._path, self._device = path, device
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
        if control.src == _SENDERS[self._device]:
            self._state.number = control.seq
        if not is_meant(self._device, control.target) or control.id == self._state.obeyed:
            return ""
        if control.id == self.identifier:
            # Its sender still repeats it, so a copy can wait.
            self._state.due_ns = now_ns + RESEND_NS
            return ""
        self._stop = control
        self._state.payload, self._state.copies, self._state.due_ns = payload, 0, now_ns + RESEND_NS
        return "" if self._path is None else kept_stop.keep(self._path, payload)

    def take_answer(self, stop: SessionControl, payload: bytes, now_ns: int) -> bool:
        """Keep a stop that the answer of the other device repeats, and make its first copy due.

        Args:
            stop: The stop.
            payload: The encoded message of the stop.
            now_ns: The monotonic time [ns].

        Returns:
            Whether this device has acknowledged the stop before; it is then not kept.
        """
        if stop.id in self._state.answered:
            return True
        if is_meant(self._device, stop.target) and stop.id != self.identifier:
            self._stop = stop
            self._state.payload, self._state.copies, self._state.due_ns = payload, 0, now_ns
        return False

    def note_event(self, event: SessionEvent) -> bool:
        """Return whether an event acknowledges the kept stop; if so, forget the stop."""
        is_of_device = event.src == self._device and event.kind == "ack"
        if is_of_device and event.data.get("command") == "estop" and event.id not in self._state.answered:
            self._state.answered = (*self._state.answered, event.id)[-_REMEMBERED:]
        is_answer = self._stop is not None and is_of_device and event.id == self._stop.id
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
        return encode(
            msgspec.structs.replace(self._stop, src=_SENDERS[self._device], run=None, seq=self._state.number, t_ns=t_ns)
        )
