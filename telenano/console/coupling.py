"""`telenano session couple`: couple hand and tip of a running rig again, without an offset between them.

A law sends the tip to x_ref = alpha_p x + offset. If the hand moves while only the tip follows, as in a stall, the law
absorbs the motion in the offset, so that neither jumps. In every law the offset is zero only over a retracted tip
(docs/laws.md). This command therefore withdraws the tip by its own guard, arms it again when the hand is at rest, and
waits until the tip reports that it is placed: it goes to alpha_p x at the speed limit of the base, and each law begins
with the energy of a first session.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from typing import Any, Protocol

from telenano.console.send_commands import send_control
from telenano.numerics.frames import to_paper_axis
from telenano.runtime.loop.arming import PLACE_TIP
from telenano.runtime.loop.commands import Command
from telenano.runtime.wiring.observer import RIG_HINT, Observer
from telenano.wire.errors import RigError
from telenano.wire.messages import AfmState, HapticState, TeleopBackward
from telenano.wire.nodes import TIP, name_of

TOPICS = ("haptic/state", "afm/state", "teleop/backward")
# A hand that presses harder [N] is not coupled, because it would lose its resistance while it presses.
PRESSING_N = 0.5
# The hand is at rest while it stays within this distance [m].
_REST_M = 1e-3
# Hand and tip are coupled while no greater offset is left between them [m].
_APART_M = 1e-9
# The tip comes no nearer to the sample than this by itself [m].
_CLEARANCE_M = 5e-9
# Time for which the hand must be at rest [s].
_REST_S = 0.3
# Longest wait for the hand to come to rest [s].
_REST_PATIENCE_S = 10.0
# Interval at which the states of the rig are checked [s].
_LOOK_S = 0.1
# Longest wait for the first states of the rig, and for hand and tip to follow [s].
_PATIENCE_S = 5.0
# Longest wait for the tip to be withdrawn, and for its node to be armed [s].
_RETRACT_S = 20.0
_LATCHED = "emergency stop"


class RunningRig(Protocol):
    """Interface to a rig: its newest states, and commands."""

    def look(self, duration_s: float) -> Iterable[Any]:
        """Return the messages of TOPICS received within `duration_s` [s], without those before the last command."""

    def send(self, command: Command, retry_s: float = 0.0) -> str:
        """Send a command, and repeat it for `retry_s` [s] after a refusal; return the answer, or raise RigError."""


class _Console:
    """A rig reached through the console of its master's site."""

    def __init__(
        self, site_file: Path, observer: Observer, is_wanted: Callable[[], bool], issued_ns: int | None, by: str | None
    ) -> None:
        self._site_file, self._observer, self._is_wanted, self._by = site_file, observer, is_wanted, by
        self._issued_ns = time.monotonic_ns() if issued_ns is None else issued_ns

    def look(self, duration_s: float) -> Iterable[Any]:
        if not self._is_wanted():
            raise RigError("couple was given up")
        return (observed.received.message for observed in self._observer.listen(duration_s))

    def send(self, command: Command, retry_s: float = 0.0) -> str:
        answers = send_control(
            command,
            self._site_file,
            "master",
            lambda event: None,
            self._is_wanted,
            issued_ns=self._issued_ns,
            retry_ns=round(retry_s * 1e9),
            by=self._by,
        )
        # Discard the messages received before the answer.
        deque(self._observer.listen(_LOOK_S), maxlen=0)
        if refused := [event.text for event in answers.values() if event.kind == "refused"]:
            raise RigError("; ".join(refused))
        return "; ".join(event.text for event in answers.values())


def recouple(
    site_file: Path,
    is_wanted: Callable[[], bool] = lambda: True,
    *,
    issued_ns: int | None = None,
    by: str | None = None,
) -> str:
    """Couple hand and tip of a running rig again, and return a sentence with their positions.

    Args:
        site_file: The site file of the rig.
        is_wanted: Called before each sending; once it returns False, nothing more is sent.
        issued_ns: Time at which a person gave the command, by the monotonic clock of this machine [ns]; None for now.
            A later emergency stop makes the command void.
        by: Name of the person, as in `send_controls`.

    Raises:
        RigError: The command is refused and nothing has moved, or it was not completed and the tip stays withdrawn.
        ConfigError: The site file cannot be used.
    """
    with closing(Observer.of_rig(site_file, TOPICS)) as observer:
        return couple(_Console(site_file, observer, is_wanted, issued_ns, by))


def couple(rig: RunningRig) -> str:
    """Withdraw the tip, wait until the hand is at rest, arm the tip, and wait until both follow; see `recouple`."""
    states = _States(rig)
    states.require(lambda: states.known, _PATIENCE_S, f"states of hand and tip: {RIG_HINT}")
    if reason := states.objection():
        raise RigError(f"not coupled, and nothing has moved: {reason}")
    before_m = states.base_m
    answer = rig.send(Command("stop", name_of(TIP), parameters={"because": "hand and tip are to be coupled again"}))
    if _LATCHED in answer:
        raise RigError(f"not coupled: {answer}, which `telenano session arm` releases")
    states.require(lambda: not states.follows, _RETRACT_S, f"the tip to be withdrawn ({answer})")
    states.hand_still.forget()
    stays = "the tip stays withdrawn until it is armed"
    states.require(lambda: states.hand_still.for_s(_REST_S), _REST_PATIENCE_S, f"a hand at rest; {stays}")
    try:
        rig.send(PLACE_TIP, _RETRACT_S)
    except RigError as error:
        raise RigError(f"not coupled: {error}; {stays}") from error
    states.require(
        lambda: states.follows and states.hand.mode != "off",
        _PATIENCE_S,
        "a hand that follows: its newest event says why; then couple again",
    )
    if states.offset_m > _APART_M:
        raise RigError(
            f"not coupled: the hand is where the sample is, and the tip waits {1e9 * states.offset_m:.1f} nm away from"
            " there: lift the hand, and couple again"
        )
    return (
        f"hand and tip are coupled again: the tip went from {1e9 * before_m:.1f} to {1e9 * states.base_m:.1f} nm, for a"
        f" hand at {1e3 * to_paper_axis(states.hand.reference_m):.2f} mm"
    )


class _Still:
    """Measures how long a position stays within a distance [m], by the stamps of its messages."""

    def __init__(self, way_m: float) -> None:
        self._way_m = way_m
        self.forget()

    def forget(self) -> None:
        self._place_m: tuple[float, ...] = ()
        self._since_ns = self._newest_ns = 0

    def add(self, place_m: tuple[float, ...], t_ns: int) -> None:
        self._newest_ns = t_ns
        if not self._place_m or math.dist(place_m, self._place_m) > self._way_m:
            self._place_m, self._since_ns = place_m, t_ns

    def for_s(self, time_s: float) -> bool:
        return (self._newest_ns - self._since_ns) * 1e-9 >= time_s


class _States:
    """The newest states of hand and tip."""

    def __init__(self, rig: RunningRig) -> None:
        self._rig = rig
        self.hand: Any = None
        self.tip: Any = None
        self._afm: AfmState | None = None
        self.hand_still = _Still(_REST_M)

    @property
    def known(self) -> bool:
        return self.hand is not None and self.tip is not None

    @property
    def follows(self) -> bool:
        """Whether the tip follows, as its half of the law reports it."""
        return bool(self.tip.active)

    @property
    def offset_m(self) -> float:
        """Distance by which the base stays away from where the hand sends it [m]; 0 if there is none."""
        return 0.0 if self._afm is None else self._afm.offset_m or 0.0

    @property
    def is_beyond(self) -> bool:
        """Whether the place to which the hand sends the base is known, and is in the sample or nearly."""
        afm = self._afm
        return afm is not None and afm.separation_valid and self.offset_m > afm.separation_m - _CLEARANCE_M > 0.0

    @property
    def base_m(self) -> float:
        return to_paper_axis(self.tip.position_m if self._afm is None else self._afm.base_position_m)

    def until(self, is_so: Callable[[], bool], patience_s: float) -> bool:
        """Read states until a condition holds, for at most `patience_s` [s]; return whether it holds."""
        for _ in range(math.ceil(patience_s / _LOOK_S)):
            for message in self._rig.look(_LOOK_S):
                self._take(message)
            if is_so():
                return True
        return False

    def require(self, is_so: Callable[[], bool], patience_s: float, what: str) -> None:
        """Wait until a condition holds; raise RigError, naming `what` was awaited, after `patience_s` [s]."""
        if not self.until(is_so, patience_s):
            raise RigError(f"not coupled: waited {patience_s:g} s for {what}")

    def objection(self) -> str:
        """Return the reason why hand and tip cannot be coupled now; empty if they can."""
        hand, press_n = self.hand, abs(to_paper_axis(self.hand.operator_force_n))
        if hand.estop or (self._afm is not None and self._afm.mode == "estop"):
            return "a device is in emergency stop, which `telenano session arm` releases"
        if hand.armed is not True:
            return "the hand is not armed, which `telenano session arm` does"
        if hand.device == "lost":
            return "the device of the hand is lost or refused; its newest event says why"
        if self.follows and hand.mode == "off":
            return "the hand does not follow; its newest event says why"
        if self.follows and self.tip.in_contact:
            return (
                "the tip touches the sample, and would come back to where the hand is: lift the hand until the tip is"
                " free, or withdraw the tip (`telenano session stop --target afm_node`) and take the hand to where the"
                " tip may go"
            )
        if self.is_beyond:
            return "the hand is where the sample is, and the tip would come there: lift the hand, and couple again"
        if press_n > PRESSING_N:
            return f"the hand presses with {press_n:.2f} N: let go of it, or hold it without force"
        return ""

    def _take(self, message: Any) -> None:
        if isinstance(message, HapticState):
            self.hand = message
            self.hand_still.add(message.position_m, message.t_ns)
            if message.device == "lost":
                self.hand_still.forget()
        elif isinstance(message, AfmState):
            self._afm = message
        elif isinstance(message, TeleopBackward):
            self.tip = message
