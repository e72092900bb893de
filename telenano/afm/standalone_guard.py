"""The guard of the tip with its state, for a program that drives an instrument without a node.

The program calls it once a period:

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
    """The guard of the node (`safety_step`), which its first reference arms."""

    def __init__(self, limits: SafetyParams) -> None:
        """Begin in the safe state, with the base retracted.

        Args:
            limits: The limits of the base and of the force.
        """
        self.limits = limits
        self._state = initial_safety_state(limits)

    @property
    def base_m(self) -> float:
        """Return the base position that the guard last allowed [m]."""
        return self._state.base_m

    @property
    def follows(self) -> bool:
        """Return whether the tip follows its reference."""
        return self._state.mode == MODE_FOLLOW

    @property
    def reason(self) -> str:
        """Return the name of the reason of the last transition, such as force_limit."""
        return REASON_NAMES[self._state.reason]

    def follow(self, reference_m: float, dt: float, *, force_n: float, is_lost: bool = False) -> float:
        """Return the base position allowed in this step towards a reference [m]; arm the tip if it does not follow.

        Args:
            reference_m: The target of the base [m], positive towards the sample.
            dt: The time of this step [s].
            force_n: The force on the tip at the step before [N]; NaN if it was not measured.
            is_lost: Whether the connection to the instrument is lost.
        """
        return self._step(
            SafetyInputs(reference_m, 0.0, ACTION_POSITION, not self.follows, False, force_n, is_lost), dt
        )

    def retract(self, dt: float, *, force_n: float, is_lost: bool = False) -> float:
        """Return the base position allowed in this step towards the safe state [m]; arguments as in `follow`."""
        return self._step(
            SafetyInputs(self.limits.retract_position_m, 0.0, ACTION_RETRACT, False, False, force_n, is_lost), dt
        )

    def _step(self, asked: SafetyInputs, dt: float) -> float:
        self._state, allowed = safety_step(self.limits, self._state, asked, dt)
        return allowed.base_m
