"""The mechanics of an emulated device of impedance type, with a hand on it, in virtual time.

m x'' + b x' = u + F(t) along each axis, in the master frame. u is the force of the drive and F that of the simulated
hand, which acts along z only (towards the sample is -z), or that of a simulated person, who acts along all three axes.
m and b are chosen for the emulator, not measured. The drive may be late.
"""

import math
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from telenano.extend.operators import OperatorInputs
from telenano.hand import operator_at_rest, operator_step
from telenano_devices.impedance.coupled import arm_step
from telenano_devices.impedance.coupling import ZERO, Vector
from telenano_devices.impedance.wires import Mechanics

# Half of the workspace.
RADIUS_M = 0.10
# The resolution of the encoders.
_STEP_M = 1e-6
# Step of the integration of the mechanics.
_SUBSTEP_S = 0.25e-3
# After a longer stall the emulation continues from the present, like the emulated handle.
_LONGEST_S = 0.05


class HandMotion(NamedTuple):
    """The hand at one time: its intended position, spring and damper, an additional force, buttons, and the cable."""

    place_m: Vector = ZERO
    stiffness_n_per_m: float = 0.0
    damping_n_s_per_m: float = 0.0
    force_n: Vector = ZERO
    buttons: int = 0
    plugged: bool = True


class EmulatedArm:
    """An arm that starts at rest at the centre of its workspace; `force_n` is the force of the drive now [N].

    Args:
        hand: The parameters of the hand, one of the models of `operator_models`.
        arm: The mass and damping of the arm.
        person: The function from a time of the session [s] to the motion of a person, who replaces the hand; before the
            session the person does nothing.
    """

    def __init__(self, hand: Any, arm: Mechanics, person: Callable[[float], HandMotion] | None = None) -> None:
        self._arm = arm
        self.force_n, self.person = ZERO, person
        # Delay of the drive, and the delayed forces, each with the time of the arm's clock at which it acts.
        self.drive_delay_s = self.time_s = 0.0
        self._late: deque[tuple[float, Vector]] = deque()
        self.position_m: Vector = ZERO
        self.velocity_m_per_s: Vector = ZERO
        self.session_s: float | None = None
        # A hand instead of the session's: its force towards the sample [N], or a hand that holds the arm in place.
        self.push_n: float | None = None
        self.held = False
        self._hand_params, self._hand = hand, operator_at_rest(hand, 0.0)
        self._hand_force_n = 0.0
        self._left_s = 0.0

    @property
    def motion(self) -> HandMotion | None:
        """Return the present motion of the person; None without a person, or before the session."""
        return None if self.person is None or self.session_s is None else self.person(self.session_s)

    def drive(self, force: Vector) -> None:
        """Command a force [N], which acts after the delay of the drive."""
        if self.drive_delay_s > 0.0:
            self._late.append((self.time_s + self._left_s + self.drive_delay_s, force))
        else:
            self.force_n = force

    def let_go(self) -> None:
        """Remove the force at once, and all delayed forces."""
        self._late.clear()
        self.force_n = ZERO

    def start_session(self, runs: bool) -> None:
        """Begin the session, and with it the force profile of the hand, or end it."""
        if runs != (self.session_s is not None):
            self.session_s = 0.0 if runs else None

    def advance(self, duration_s: float) -> None:
        """Advance by a time [s], in whole steps; the rest is kept for the next call."""
        # With a person the whole time passes, because the take goes on during a stall.
        self._left_s += duration_s if self.person is not None else min(duration_s, _LONGEST_S)
        while self._left_s >= _SUBSTEP_S:
            self._left_s -= _SUBSTEP_S
            self._step(_SUBSTEP_S)

    @property
    def measured_m(self) -> Vector:
        """Return the position as the encoders read it [m]."""
        x, y, z = self.position_m
        return (round(x / _STEP_M) * _STEP_M, round(y / _STEP_M) * _STEP_M, round(z / _STEP_M) * _STEP_M)

    def _step(self, dt: float) -> None:
        while self._late and self._late[0][0] <= self.time_s:
            self.force_n = self._late.popleft()[1]
        self.time_s += dt
        motion = self.motion
        places, speeds = [], []
        for axis in range(3):
            v = self.velocity_m_per_s[axis]
            drive = self.force_n[axis]
            if motion is not None:
                drive += motion.force_n[axis] - motion.damping_n_s_per_m * v
                drive += motion.stiffness_n_per_m * (motion.place_m[axis] - self.position_m[axis])
            elif axis == 2:
                drive += self._hand_force_n if self.push_n is None else 0.0 - self.push_n
            place, speed = arm_step(*self._arm, self.position_m[axis], v, drive, dt)
            if self.held:
                place, speed = self.position_m[axis], 0.0
            speeds.append(speed)
            places.append(place)
        before_z = self.position_m[2]
        distance = math.sqrt(places[0] ** 2 + places[1] ** 2 + places[2] ** 2)
        if distance > RADIUS_M:
            places, speeds = [p * RADIUS_M / distance for p in places], [0.0, 0.0, 0.0]
        self.position_m = (places[0], places[1], places[2])
        self.velocity_m_per_s = (speeds[0], speeds[1], speeds[2])
        if self.session_s is not None:
            self.session_s += dt
        if self.person is not None:
            return
        at_s = -1.0 if self.session_s is None else self.session_s
        ends = OperatorInputs(at_s, 0.0 - before_z, 0.0 - places[2])
        self._hand, felt = operator_step(self._hand_params, self._hand, ends, dt)
        self._hand_force_n = 0.0 - felt.force_n


def hand_of(scenario: Path | None = None) -> Any:
    """Return the parameters of the hand of a scenario (name or file), or the default ones, for `operator_step`.

    hand_of(Path("fig12"))

    Raises:
        ConfigError: There is no such scenario, or a key of it cannot be read.
    """
    from telenano.cli import section_of
    from telenano.sections import HapticConfig

    return section_of(scenario, "haptic_node", HapticConfig).operator.to_params()
