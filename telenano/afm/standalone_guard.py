"""The guard of the tip with its state, for a program that drives an instrument without a node.

guard = TipGuard(limits)
base_m = guard.follow(reference_m, period_s, force_n=sample.force_n)
base_m = guard.retract(period_s, force_n=sample.force_n)
"""

from telenano.afm.safety import (
    ACTION_POSITION,
    ACTION_RETRACT,
    MODE_FOLLOW,
    REASON_NAMES,
    SafetyInputs,
    initial_safety_state,
    safety_step,
)
from telenano.extend.instruments import SafetyParams


class TipGuard:
    """The guard of the node (`safety_step`), armed by the first reference that it is asked to follow."""

    def __init__(self, limits: SafetyParams) -> None:
        """Begin in the safe state, with the base retracted.

        Args:
            limits: What the guard holds the base to.
        """
        self.limits = limits
        self._state = initial_safety_state(limits)

    @property
    def base_m(self) -> float:
        """Return the position that the base was last allowed [m]."""
        return self._state.base_m

    @property
    def follows(self) -> bool:
        """Return whether the tip follows its reference."""
        return self._state.mode == MODE_FOLLOW

    @property
    def reason(self) -> str:
        """Return why the guard is in its state, in words."""
        return REASON_NAMES[self._state.reason]

    def follow(self, reference_m: float, dt: float, *, force_n: float, is_lost: bool = False) -> float:
        """Return the position of the base that is allowed as it moves to a reference [m]; a tip at rest is armed.

        Args:
            reference_m: Where the base is to go, towards the sample > 0 [m].
            dt: The time of this step [s].
            force_n: The force on the tip at the step before [N]; NaN for one that was not measured.
            is_lost: Whether nothing reaches the instrument.
        """
        return self._step(
            SafetyInputs(reference_m, 0.0, ACTION_POSITION, not self.follows, False, force_n, is_lost), dt
        )

    def retract(self, dt: float, *, force_n: float, is_lost: bool = False) -> float:
        """Return the position of the base as it moves to the safe state [m]; the arguments are those of `follow`."""
        return self._step(
            SafetyInputs(self.limits.retract_position_m, 0.0, ACTION_RETRACT, False, False, force_n, is_lost), dt
        )

    def _step(self, asked: SafetyInputs, dt: float) -> float:
        self._state, allowed = safety_step(self.limits, self._state, asked, dt)
        return allowed.base_m
