"""Whether the hand feels the stiffness that is there while a session runs: the adviser that every rig has.

What it finds is advice, and never acts on a device.
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

# It is judged this often [ns].
_LOOK_NS = 500_000_000
# What is known is told this often [ns].
_TELL_NS = 2_000_000_000
_NO_TIP = NotKnown("the samples of the instrument are not heard at this site, and its recording will tell")
_NOT_RUNNING = NotKnown("no session runs")
_ADVICE = {
    "hard": "a sample feels harder than it is: trust the force at the tip and not the hand, or take another law",
    "soft": "a sample feels softer than it is: trust the force at the tip and not the hand, or take another law",
}


class FeltAdviser:
    """Watches what the hand feels; `found` is what is known of it at present, or why nothing is."""

    inputs: Sequence[str] = ("law/status", "haptic/state", "afm/state", "session/event")

    def __init__(
        self,
        now_ns: Callable[[], int],
        controller: ControllerConfig,
        facts: SampleFacts,
        tell: Callable[..., None] | None = None,
    ) -> None:
        """Prepare to watch.

        Args:
            now_ns: Returns the time on the monotonic clock [ns].
            controller: The section of the controller.
            facts: What the settings say of the sample.
            tell: Called every `_TELL_NS` at most with what is known, as `felt=` in words, for `telenano status`.
        """
        self.found: Felt | NotKnown = _NOT_RUNNING
        self._now_ns, self._controller = now_ns, controller
        self._window = FeltWindow(facts)
        self._law = controller.law
        self._hears_master = self._hears_tip = self._scale_changed = False
        self._look_ns = self._tell_ns = now_ns()
        self._tell = tell
        # What is warned of, and since when it has been found, or has not been any more.
        self._warned = ""
        self._finds = ""
        self._since_ns = self._look_ns

    def look(self, messages: Iterable[Message], *, runs: bool) -> Advice | None:
        """Return a warning where the hand has come to feel far more, or far less, than is there."""
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
            # What stands in the way of the file is told by whoever looks after it.
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
            # The round trip is measured at the master's half, and the slave's may be at another law for a moment.
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
        # What is not known any more is not known to be as it is.
        if kind == "as it is" and lasts_s >= GONE_S:
            self._warned = ""
        return None


_FACTS = ("felt_ratio", "least_felt_ratio", "most_felt_ratio", "felt_n_per_m", "there_n_per_m")
