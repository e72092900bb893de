"""The adviser of every rig that compares the stiffness felt by the hand with that of the sample during a session.

Its findings are shown to the operator and never act on a device.
"""

import contextlib
from collections.abc import Callable, Iterable, Sequence

from telenano.analysis.felt_stiffness import (
    GONE_S,
    LASTS_S,
    SCALE_CHANGED,
    Felt,
    FeltWindow,
    NotKnown,
    SampleFacts,
    changes_scale,
    scale_of,
)
from telenano.extend.advice import Advice
from telenano.sections.controller_section import ControllerConfig
from telenano.wire.errors import RigError
from telenano.wire.messages import AfmState, HapticState, LawStatus, Message, SessionEvent

# Interval of the comparison [ns].
_LOOK_NS = 500_000_000
# Shortest interval between two updates of the text for `telenano status` [ns].
_TELL_NS = 2_000_000_000
_NO_TIP = NotKnown("the samples of the instrument are not heard at this site, and its recording will tell")
_NOT_RUNNING = NotKnown("no session runs")
_ADVICE = {
    "hard": "a sample feels harder than it is: trust the force at the tip and not the hand, or take another law",
    "soft": "a sample feels softer than it is: trust the force at the tip and not the hand, or take another law",
}


class FeltAdviser:
    """Compares felt and actual stiffness; `found` is the present result, or the reason why it is unknown."""

    inputs: Sequence[str] = ("law/status", "haptic/state", "afm/state", "session/event")

    def __init__(
        self,
        now_ns: Callable[[], int],
        controller: ControllerConfig,
        facts: SampleFacts,
        tell: Callable[..., None] | None = None,
    ) -> None:
        """Begin with an unknown result.

        Args:
            now_ns: Returns the time on the monotonic clock [ns].
            controller: The settings of the controller.
            facts: Properties of the sample according to the settings.
            tell: Called at most every 2 s with the present result in words, as `felt=`, for `telenano status`.
        """
        self.found: Felt | NotKnown = _NOT_RUNNING
        self._now_ns, self._controller = now_ns, controller
        self._window = FeltWindow(facts)
        self._law = controller.law
        self._hears_master = self._hears_tip = self._scale_changed = False
        self._look_ns = self._tell_ns = now_ns()
        self._tell = tell
        # Kind of the last warning (empty: none in force), kind of the present result, and the time since that holds.
        self._warned = ""
        self._finds = ""
        self._since_ns = self._look_ns

    def look(self, messages: Iterable[Message], *, runs: bool) -> Advice | None:
        """Take the messages, and return a warning if the hand has come to feel far more or far less stiffness."""
        for message in messages:
            self._take(message)
        now_ns = self._now_ns()
        if now_ns < self._look_ns:
            return None
        self._look_ns = now_ns + _LOOK_NS
        if runs:
            self.found = self._looked()
        else:
            self._window.forget()
            self.found, self._warned, self._finds = _NOT_RUNNING, "", ""
        if self._tell is not None and now_ns >= self._tell_ns:
            self._tell_ns = now_ns + _TELL_NS
            # A fault of the file is reported by the launcher, which restores it.
            with contextlib.suppress(RigError):
                self._tell(felt=str(self.found))
        return self._judged(now_ns) if runs else None

    def _take(self, message: Message) -> None:
        time_s = 1e-9 * message.t_ns
        if isinstance(message, HapticState):
            if message.mode == "off":
                self._window.forget()
            else:
                self._window.hand(time_s, 0.0 - message.position_m[2], 0.0 - message.operator_force_n[2])
        elif isinstance(message, AfmState):
            self._hears_tip = True
            touches = message.in_contact and message.mode == "follow" and message.felt_channel is None
            self._window.tip(time_s, 0.0 - message.base_position_m[2], message.tip_force_n[2], touches=touches)
        elif isinstance(message, LawStatus):
            # Only the master's half measures the round trip, so this identifies it. The slave's half is used only until
            # the master's has reported, because the two may have different laws for a moment.
            self._hears_master |= message.round_trip_valid
            if (message.round_trip_valid or not self._hears_master) and message.law != self._law:
                self._law = message.law
                self._window.forget()
        elif isinstance(message, SessionEvent) and message.kind == "ack" and message.text.startswith("set "):
            self._scale_changed |= changes_scale([f"{message.src}: {message.text}"])

    def _looked(self) -> Felt | NotKnown:
        if self._scale_changed:
            return SCALE_CHANGED
        if not self._hears_tip:
            return _NO_TIP
        scale, reason = scale_of(self._controller, self._law)
        return NotKnown(reason) if scale is None else self._window.look(scale)

    def _judged(self, now_ns: int) -> Advice | None:
        kind = self.found.kind if isinstance(self.found, Felt) else "not known"
        if kind != self._finds:
            self._finds, self._since_ns = kind, now_ns
        lasts_s = 1e-9 * (now_ns - self._since_ns)
        if isinstance(self.found, Felt) and kind in _ADVICE:
            if kind == self._warned or lasts_s < LASTS_S:
                return None
            self._warned = kind
            facts = {name: float(f"{value:.4g}") for name, value in zip(_FACTS, self.found, strict=True)}
            return Advice(f"The hand feels {self.found}; {_ADVICE[kind]}.", {"felt": kind, "law": self._law, **facts})
        # An unknown result does not end a warning; only a confirmed match that lasts does.
        if kind == "as it is" and lasts_s >= GONE_S:
            self._warned = ""
        return None


_FACTS = ("felt_ratio", "least_felt_ratio", "most_felt_ratio", "felt_n_per_m", "there_n_per_m")
